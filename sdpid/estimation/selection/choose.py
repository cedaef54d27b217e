"""Choose by the data which effects a model needs beside its friction terms.

Effects are added one at a time, the one first that lowers the cost most by its own measure, until
none is left that the data show. Every trial is the semidefinite program with its prior, so that an
effect is not taken for what an impossible body would explain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from sdpid.errors import DataError, IdentifiabilityError, SolverError
from sdpid.estimation.compression.covariance import pooled
from sdpid.estimation.effects.choose import close_terms
from sdpid.estimation.effects.kinds import EFFECTS, Effect, at_estimate
from sdpid.estimation.effects.tried import Tried
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.selection.trials import Trials
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import PosedTerm
from sdpid.robot.friction.term import FrictionTerm

# An effect is chosen where a fall of the cost as large as its own has at most this probability if
# it is absent: several are tried, and of twenty logs without any at most one may show one. On
# recordings, what is there has 1e-5 or less.
BY_CHANCE = 0.01

# Samples that the numbers of effects are fitted to, evenly spread.
_MOST_SAMPLES = 2048

# Builds the problem with other terms, some of them with open parameters.
Rebuild = Callable[[tuple[str | FrictionTerm, ...]], Problem]


@dataclass(frozen=True)
class _Trial:
    """An effect beside the present terms."""

    effect: Effect
    term: FrictionTerm
    estimate: Estimate
    fall: float
    probability: float

    @property
    def parameters(self) -> int:
        return len(self.term.parameters(self.estimate.problem.friction.joint_names))

    @property
    def shown(self) -> bool:
        """Whether the data show the effect, and its size is believed."""
        enough = self.fall >= self.effect.least_fall and self.probability <= BY_CHANCE
        return enough and not self.doubt

    @property
    def doubt(self) -> str:
        return self.effect.doubt(_named(self.estimate))

    def told(self, chosen: bool, words: str) -> Tried:
        return Tried(
            name=self.effect.name,
            chosen=chosen,
            words=words,
            fall=self.fall,
            least_fall=self.effect.least_fall,
            probability=self.probability,
            parameters=self.parameters,
        )


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
        try:
            effects = [trial.effect for trial in taken]
            final = _built(problem, given, effects, taken[-1].estimate, rebuild)
            found = _named(_solved(final))
        except (IdentifiabilityError, SolverError):
            # Without a prior what the data show may still not be determined joint by joint.
            left_out.append(taken.pop())
            continue
        told = [
            trial.told(
                True,
                f"{trial.effect.title} lowers the cost by {100.0 * trial.fall:.0f} %: "
                f"{trial.effect.meaning}{_in_brackets(trial.effect.size(found))}",
            )
            for trial in taken
        ]
        return final.with_origin(effects=(*told, *map(_left_out, left_out)))
    return problem.with_origin(effects=tuple(map(_left_out, left_out)))


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
    asked = []
    needed = {effect.beside for effect in EFFECTS if effect.name in names}
    for effect in EFFECTS:
        if effect.name not in (*names, *needed) or effect.held(terms):
            continue
        term = effect.term(problem.robot, terms)
        if term is None:
            raise DataError(
                f"effects: {effect.name} has no place on '{problem.robot.name}', for it takes "
                f"{effect.place}; leave it out."
            )
        asked.append(effect)
        terms = (*terms, term)
    if not asked:
        return problem
    final = _built(problem, given, asked, _solved(problem), rebuild)
    found = _named(_solved(final))
    told = (
        Tried(
            name=effect.name,
            chosen=True,
            words=f"{effect.title}: in the model "
            + ("as asked" if effect.name in names else "with what was asked beside it")
            + _in_brackets(effect.size(found)),
        )
        for effect in asked
    )
    return final.with_origin(effects=tuple(told))


def _greedy(problem: Problem, prior: Prior | None) -> tuple[list[_Trial], list[_Trial]]:
    """Return the trials that were taken, and those of the last round, which were not."""
    terms, estimate = problem.friction.terms, _solved(problem)
    taken: list[_Trial] = []
    closed: dict[Effect, FrictionTerm] = {}
    while True:
        terms = tuple(_at(term, estimate) for term in terms)
        candidates = _candidates(problem, terms, closed, estimate)
        if not candidates:
            return taken, []
        trials = Trials.of(problem, (*terms, *candidates.values()), prior)
        before = _solved(trials.with_terms(terms))
        tried = [
            _tried(effect, term, before, trials.with_terms((*terms, term)), trials.independent)
            for effect, term in candidates.items()
        ]
        shown = [trial for trial in tried if trial.shown]
        if not shown:
            return taken, tried
        best = max(shown, key=lambda trial: trial.fall / trial.effect.least_fall)
        taken.append(best)
        terms, estimate = (*terms, best.term), best.estimate


def _tried(
    effect: Effect, term: FrictionTerm, before: Estimate, problem: Problem, independent: float
) -> _Trial:
    """Solve with an effect, and compare."""
    from scipy.special import fdtrc

    after = _solved(problem)
    saved = max(before.cost - after.cost, 0.0)
    count = len(term.parameters(problem.friction.joint_names))
    probability = 1.0
    if independent >= 1.0:
        noise = problem.cost(after.base) / independent
        probability = float(fdtrc(count, independent, saved / count / noise))
    return _Trial(effect, term, after, saved / before.cost, probability)


def _candidates(
    problem: Problem,
    terms: tuple[FrictionTerm, ...],
    closed: dict[Effect, FrictionTerm],
    estimate: Estimate,
) -> dict[Effect, FrictionTerm]:
    """Return the terms of effects that have a place beside others, their open numbers closed.

    Numbers are closed once, and kept in `closed`: they are chosen again with the final terms.
    """
    found = {}
    for effect in EFFECTS:
        term = effect.term(problem.robot, terms)
        if term is None:
            continue
        if effect not in closed:
            closed[effect] = _closed(problem, terms, term)
        found[effect] = _at(closed[effect], estimate)
    return found


def _closed(problem: Problem, terms: tuple[FrictionTerm, ...], term: FrictionTerm) -> FrictionTerm:
    """Return a term with its open numbers fitted beside others."""
    names, sigma = problem.robot.joint_names, pooled(problem.sigma)
    model = FrictionModel.from_terms((*terms, term), names, first=problem.robot.n_base)
    samples = problem.samples.thinned(_MOST_SAMPLES)
    return close_terms(model, problem.robot, samples, lambda _: sigma)[0].terms[-1]


def _built(
    problem: Problem,
    given: tuple[str | FrictionTerm, ...],
    effects: Sequence[Effect],
    estimate: Estimate,
    rebuild: Rebuild,
) -> Problem:
    """Return the problem with effects: linear about its own estimate, where they are products."""
    terms: list[FrictionTerm] = []
    for effect in effects:
        term = effect.term(problem.robot, (*problem.friction.terms, *terms))
        assert term is not None
        terms.append(_at(term, estimate))
    bent = any(effect.bends_friction for effect in effects)
    built = rebuild((*(given if bent else problem.friction.terms), *terms))
    if not bent:
        built = built.with_origin(profiled=problem.origin.profiled)
    if not any(isinstance(term, PosedTerm) for term in terms):
        return built
    found = _solved(built)
    closed = tuple(_at(term, found) for term in built.friction.terms)
    return rebuild(closed).with_origin(profiled=built.origin.profiled)


def _left_out(trial: _Trial) -> Tried:
    reason = trial.doubt or (
        f"{100.0 * trial.effect.least_fall:.0f} % and a probability of {BY_CHANCE:g} at most are "
        "asked"
    )
    return trial.told(
        False,
        f"{trial.effect.title} would lower the cost by {100.0 * trial.fall:.1f} % (probability by "
        f"chance {trial.probability:.1g}): {reason}",
    )


def _solved(problem: Problem) -> Estimate:
    """Return the optimum, or what a solver found that could not prove it: enough to compare."""
    try:
        return solve_sdp(problem)
    except SolverError as error:
        found: Estimate | None = error.found
        if found is None or found.theta is None or not found.feasible:
            raise
        return found


def _at(term: FrictionTerm, estimate: Estimate) -> FrictionTerm:
    """Return a term with its columns taken at an estimate, where they depend on it."""
    assert estimate.theta is not None
    problem = estimate.problem
    bodies = problem.feasible.bodies(estimate.theta)
    return at_estimate(term, bodies, _named(estimate), problem.friction.terms)


def _named(estimate: Estimate) -> Mapping[str, float]:
    return estimate.named_theta() or {}


def _in_brackets(words: str) -> str:
    return f" ({words})" if words else ""
