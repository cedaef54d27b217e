"""Choose by the data which effects a model needs beside its friction terms.

Effects are added one at a time, the one first that lowers the cost most by its own measure, until
none is left that the data show. Every trial is the semidefinite program with its prior, so that an
effect is not taken for what an impossible body would explain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import frozen
from sdpid.errors import DataError, IdentifiabilityError, SolverError
from sdpid.estimation.compression.covariance import pooled
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.constraints.condition import Layout
from sdpid.estimation.constraints.equalities import Fixed
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.estimation.effects.choose import close_terms
from sdpid.estimation.effects.kinds import EFFECTS, Effect, Tried, at_estimate
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior.prior import Prior, prior_terms
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solved_or_found
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import PosedTerm
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.model import RobotModel

# An effect is chosen where a fall of the cost as large as its own has at most this probability if
# it is absent: several are tried, and of twenty logs without any at most one may show one. On
# recordings, what is there has 1e-5 or less.
BY_CHANCE = 0.01

# Samples looked at, evenly spread: filtered signals need no more.
_MOST_SAMPLES = 2048

# Builds the problem with other terms, some of them with open parameters.
Rebuild = Callable[[tuple[str | FrictionTerm, ...]], Problem]


@dataclass(frozen=True)
class _Trial:
    """An effect beside the present terms, what became of it, and whether the data show it."""

    effect: Effect
    term: FrictionTerm
    estimate: Estimate
    told: Tried
    shown: bool


def with_chosen_effects(
    problem: Problem,
    given: tuple[str | FrictionTerm, ...],
    prior: Prior | None,
    rebuild: Rebuild,
) -> Problem:
    """Add the effects that the data show to a problem.

    Parameters
    ----------
    problem : Problem
        Without effects, its rows here.
    given : tuple of str or FrictionTerm
        Its terms, those with open parameters as they were.
    prior : Prior or None
        What its prior was made of.
    rebuild : callable
        Returns the problem with given terms in place of its own.

    Returns
    -------
    Problem
        With `effects` filled in: what was chosen, and what was tried and left out.
    """
    try:
        taken, left_out = _greedy(problem, prior)
    except SolverError:
        # Whoever solves the problem itself is told why it has no optimum.
        return problem
    while taken:
        effects = [trial.effect for trial in taken]
        try:
            final, sizes = _built(problem, given, effects, taken[-1].estimate, rebuild)
        except (IdentifiabilityError, SolverError):
            # Without a prior what the data show may still not be determined joint by joint.
            left_out.append(taken.pop())
            continue
        told = []
        for trial in taken:
            fall = f"lowers the cost by {_percent(trial.told.fall, 0)}"
            words = f"{trial.effect.title} {fall}: {trial.effect.meaning}{sizes[trial.effect]}"
            told.append(replace(trial.told, chosen=True, words=words))
        return final.with_origin(effects=(*told, *(trial.told for trial in left_out)))
    return problem.with_origin(effects=tuple(trial.told for trial in left_out))


def with_effects(
    problem: Problem,
    given: tuple[str | FrictionTerm, ...],
    names: Sequence[str],
    rebuild: Rebuild,
) -> Problem:
    """Add effects by name, whatever the data say; those that the terms hold already are left out.

    Parameters
    ----------
    problem, given, rebuild
        As for `with_chosen_effects`.
    names : sequence of str
        Names of `EFFECTS`. A coupled wrist brings rotor inertia along.

    Raises
    ------
    DataError
        For an effect that has no place on the robot.
    """
    terms: tuple[FrictionTerm, ...] = problem.friction.terms
    asked, position = [], problem.samples.position
    needed = {effect.beside for effect in EFFECTS if effect.name in names}
    for effect in (own for each in EFFECTS for own in each.each(problem.robot, terms, position)):
        if effect.name not in (*names, *needed) or effect.held(terms):
            continue
        term = effect.term(problem.robot, terms, position)
        if term is None:
            raise DataError(
                f"effects: {effect.name} has no place on '{problem.robot.name}', for it takes "
                f"{effect.place}; leave it out."
            )
        asked.append(effect)
        terms = (*terms, term)
    if not asked:
        return problem
    final, sizes = _built(problem, given, asked, solved_or_found(problem), rebuild)
    told = []
    for effect in asked:
        why = "as asked" if effect.name in names else "with what was asked beside it"
        words = f"{effect.title}: in the model {why}{sizes[effect]}"
        told.append(Tried(name=effect.name, chosen=True, words=words))
    return final.with_origin(effects=tuple(told))


def _greedy(problem: Problem, prior: Prior | None) -> tuple[list[_Trial], list[_Trial]]:
    """Return the trials that were taken, and those of the last rounds, which were not."""
    terms, estimate = problem.friction.terms, solved_or_found(problem)
    taken, left_out = _added(problem, prior, EFFECTS, terms, estimate)
    for effect in EFFECTS:
        if effect.of_joint is None:
            continue
        if taken:
            terms, estimate = (*terms, *(each.term for each in taken)), taken[-1].estimate
        own = effect.each(problem.robot, terms, problem.samples.position)
        more, others = _added(problem, prior, own, terms, estimate, effect)
        taken += more
        # Of the joints that are left the best one is told.
        left_out += sorted(others, key=lambda trial: trial.told.fall or 0.0)[-1:]
    return taken, left_out


def _added(
    problem: Problem,
    prior: Prior | None,
    effects: Sequence[Effect],
    terms: tuple[FrictionTerm, ...],
    estimate: Estimate,
    together: Effect | None = None,
) -> tuple[list[_Trial], list[_Trial]]:
    """Add effects to terms as long as one is shown: return those, and the last round's others.

    One alone brings no more than all do `together`: it is not tried where that is too little.
    """
    taken: list[_Trial] = []
    # Open numbers of terms are closed once: they are chosen again with the final terms.
    closed: dict[Effect, FrictionTerm] = {}
    while True:
        terms, candidates = tuple(_at(term, estimate) for term in terms), {}
        for effect in effects:
            term = effect.term(problem.robot, terms, problem.samples.position)
            if term is not None and not effect.by_name:
                if effect not in closed:
                    closed[effect] = _closed(problem, terms, term)
                candidates[effect] = _at(closed[effect], estimate)
        if not candidates:
            return taken, []
        largest, independent = with_every_term(problem, (*terms, *candidates.values()), prior)
        every = list(candidates.values())
        before = solved_or_found(without_terms(largest, every))
        if together is not None:
            whole = replace(together, title=f"{together.title} of all joints")
            most = _tried(whole, every, before, largest, independent)
            if (most.told.fall or 0.0) < whole.least_fall:
                return taken, [most]
        tried = []
        for effect, term in candidates.items():
            alone = without_terms(largest, [each for each in every if each is not term])
            tried.append(_tried(effect, [term], before, alone, independent))
        shown = [trial for trial in tried if trial.shown]
        if not shown:
            return taken, tried
        best = max(shown, key=lambda trial: (trial.told.fall or 0.0) / trial.effect.least_fall)
        taken.append(best)
        terms, estimate = (*terms, best.term), best.estimate


def with_every_term(
    problem: Problem, terms: Sequence[FrictionTerm], prior: Prior | None
) -> tuple[Problem, float]:
    """Return a problem with other terms, and how many more independent rows than parameters it has.

    Its weights are one variance a joint, from the residuals of these terms; each of their
    parameters has its own column, which may depend on others.
    """
    samples = problem.require_rows_here("choice of effects").samples.judged
    friction = _model(problem.robot, terms)
    rows = RowSource(problem.robot, friction, problem.base, samples.thinned(_MOST_SAMPLES))
    rows = rows.with_every_column()
    found = Factor.of(rows, "residual")
    rows = rows.with_force_scale(found.force_scale)
    belief = None
    if prior is not None:
        assert problem.prior is not None
        prior = replace(prior, kind="pullback", strength=problem.prior.strength)
        belief = replace(problem.prior, terms=prior_terms(prior, rows).terms)
    feasible = FeasibleSet.build(
        problem.constraints, problem.consistency, Layout(problem.robot, friction)
    )
    largest = replace(
        problem,
        friction=friction,
        base=rows.base,
        A=frozen(found.A),
        rhs=frozen(found.rhs),
        floor=found.floor,
        feasible=feasible,
        prior=belief,
        rows=rows,
    ).with_origin(weighting="residual")
    return largest, float(found.used / found.time - np.linalg.matrix_rank(found.A))


def without_terms(problem: Problem, absent: Sequence[FrictionTerm]) -> Problem:
    """Return a problem of `with_every_term` without some of its terms: all they have is zero."""
    names = problem.friction.joint_names
    zero = {each.name: 0.0 for term in absent for each in term.parameters(names)}
    if not zero:
        return problem
    others = (*problem.constraints.others, Fixed(zero))
    return problem.constrained(constraints=problem.constraints.replace(others=others))


def _model(robot: RobotModel, terms: Sequence[FrictionTerm]) -> FrictionModel:
    return FrictionModel.from_terms(terms, robot.joint_names, first=robot.n_base)


def _tried(
    effect: Effect,
    terms: Sequence[FrictionTerm],
    before: Estimate,
    problem: Problem,
    independent: float,
) -> _Trial:
    """Solve with the terms of an effect, and compare."""
    from scipy.special import fdtrc

    after = solved_or_found(problem)
    saved = max(before.cost - after.cost, 0.0)
    count = sum(len(term.parameters(problem.friction.joint_names)) for term in terms)
    probability = 1.0
    if independent >= 1.0:
        noise = problem.cost(after.base) / independent
        probability = float(fdtrc(count, independent, saved / count / noise))
    fall, doubt = saved / before.cost, effect.doubt(_named(after))
    reason = doubt or (
        f"{_percent(effect.least_fall, 0)} and a probability of {BY_CHANCE:g} at most are asked"
    )
    told = Tried(
        name=effect.name,
        chosen=False,
        words=f"{effect.title} would lower the cost by {_percent(fall, 1)} (probability by chance "
        f"{probability:.1g}): {reason}",
        fall=fall,
        least_fall=effect.least_fall,
        probability=probability,
        parameters=count,
    )
    shown = fall >= effect.least_fall and probability <= BY_CHANCE and not doubt
    return _Trial(effect, terms[0], after, told, shown)


def _closed(problem: Problem, terms: tuple[FrictionTerm, ...], term: FrictionTerm) -> FrictionTerm:
    """Return a term with its open numbers fitted beside others."""
    model, sigma = _model(problem.robot, (*terms, term)), pooled(problem.sigma)
    samples = problem.samples.thinned(_MOST_SAMPLES)
    return close_terms(model, problem.robot, samples, lambda _: sigma)[0].terms[-1]


def _built(
    problem: Problem,
    given: tuple[str | FrictionTerm, ...],
    effects: Sequence[Effect],
    estimate: Estimate,
    rebuild: Rebuild,
) -> tuple[Problem, dict[Effect, str]]:
    """Return the problem with effects, and how large they are, in brackets where that says much.

    It is linear about its own estimate, where terms are products.
    """
    terms: tuple[FrictionTerm, ...] = ()
    for effect in effects:
        held = (*problem.friction.terms, *terms)
        term = effect.term(problem.robot, held, problem.samples.position)
        assert term is not None
        terms = (*terms, _at(term, estimate))
    bent = any(effect.bends_friction for effect in effects)
    final = rebuild((*(given if bent else problem.friction.terms), *terms))
    profiled = final.origin.profiled if bent else problem.origin.profiled
    if any(isinstance(term, PosedTerm) for term in terms):
        found = solved_or_found(final)
        final = rebuild(tuple(_at(term, found) for term in final.friction.terms))
    final = final.with_origin(profiled=profiled)
    found = solved_or_found(final)
    sizes = {effect: effect.size(_named(found)) for effect in effects}
    return final, {effect: f" ({words})" if words else "" for effect, words in sizes.items()}


def _at(term: FrictionTerm, estimate: Estimate) -> FrictionTerm:
    """Return a term with its columns taken at an estimate, where they depend on it."""
    assert estimate.theta is not None
    problem = estimate.problem
    bodies = problem.feasible.bodies(estimate.theta)
    return at_estimate(term, bodies, _named(estimate), problem.friction.terms)


def _named(estimate: Estimate) -> Mapping[str, float]:
    return estimate.named_theta() or {}


def _percent(share: float | None, digits: int) -> str:
    return f"{100.0 * (share or 0.0):.{digits}f} %"
