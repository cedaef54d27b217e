"""Build the problem that `identify` solves, with its defaults; refit the friction of another."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import frozen
from sdpid.errors import DataError
from sdpid.estimation.compression.covariance import PRINTED, Weighting
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.constraints.equalities import Fixed
from sdpid.estimation.constraints.mass import known_mass
from sdpid.estimation.effects.kinds import Effects, names_of_effects
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.selection.choose import with_chosen_effects, with_effects
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.preparation.prepare import Logs, Prepared, ProcessingOf, friction_of, prepare
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import Consistency
from sdpid.robot.model.model import RobotModel

# Units of parameters that belong to the rigid part beside the links: rotors and gravity's
# direction. Everything else of a joint changes with temperature, wear and zero errors.
_RIGID_UNITS = ("kg.m2", "rad")


@dataclass(frozen=True, kw_only=True)
class Formulation:
    """What is asked of the problem that `identify` solves, checked; arguments are those of it."""

    friction: Iterable[str | FrictionTerm] | None = None
    weighting: Weighting | None = None
    consistency: Consistency = "pseudo_inertia"
    constraints: Constraints | None = None
    prior: Prior | bool | None = None
    effects: Effects = "auto"

    def __post_init__(self) -> None:
        """Refuse what is of another kind; terms and effects become tuples."""
        constraints, prior, friction = self.constraints, self.prior, self.friction
        if constraints is not None and not isinstance(constraints, Constraints):
            raise DataError(f"constraints: is {constraints!r:.80}; give sdpid.Constraints(...).")
        if prior is not None and not isinstance(prior, (bool, np.bool_, Prior)):
            raise DataError(f"prior: is {prior!r:.80}; give True, False or a Prior.")
        if isinstance(friction, (str, FrictionTerm)):
            raise DataError(f"friction: is {friction!r}; give a tuple of terms, ({friction!r},).")
        if friction is not None and not isinstance(friction, Iterable):
            raise DataError(
                f"friction: is {friction!r}; give a tuple of terms, such as ('coulomb', 'viscous')."
            )
        asked = names_of_effects(self.effects)
        object.__setattr__(self, "friction", None if friction is None else tuple(friction))
        object.__setattr__(self, "effects", "auto" if asked is None else asked)

    def prepare(
        self, robot: RobotModel | str | os.PathLike[str], log: Logs, **how: Any
    ) -> Prepared:
        """Prepare recordings of a robot that weighs what the constraints say."""
        mass = None if self.constraints is None else known_mass(self.constraints.others)
        return prepare(robot, log, total_mass=mass, **how)

    def without_choices(self, problem: Problem) -> Formulation:
        """Return the same with the terms that were chosen for a problem, and no more."""
        return replace(self, friction=problem.friction.terms, effects="none")

    def problem(self, prepared: Prepared) -> Problem:
        """Build the problem of prepared recordings, with what follows from them."""
        robot, samples, prior = prepared.robot, prepared.samples, self.prior
        weighting = self.weighting or ("residual" if samples.covariance is None else "gls")
        if prior is None:
            # Friction of a joint without effort is known from a prior or not at all.
            lacks = weighting == "gls" and bool(prepared.without_effort)
            prior = (weighting == "residual" or lacks) and bool(np.any(robot.prior[:, 0] > 0.0))
        if isinstance(prior, (bool, np.bool_)):
            prior = Prior() if prior else None
        given = friction_of(prepared.logs[0], self.friction)

        def build(terms: tuple[str | FrictionTerm, ...]) -> Problem:
            return build_problem(
                robot,
                samples,
                friction=terms,
                weighting=weighting,
                consistency=self.consistency,
                constraints=self.constraints or Constraints.of_size(robot),
                prior=prior,
            )

        problem = build(given)
        if (asked := names_of_effects(self.effects)) is not None:
            return with_effects(problem, given, asked, build)
        if weighting in PRINTED:
            # No likelihood: a fall of it is no evidence.
            return problem
        return with_chosen_effects(problem, given, prior, build)


def formulate(
    robot: RobotModel | str | os.PathLike[str],
    log: Logs | Prepared,
    *,
    processing: ProcessingOf = None,
    without_effort: Iterable[str] = (),
    accept: str | Iterable[str] = (),
    gains: DriveGains | str | os.PathLike[str] | ArrayLike | None = None,
    **options: Any,
) -> Problem:
    """Build the problem that `identify` solves; arguments and errors are those of `identify`.

    `log` may also be recordings that are prepared already (see `prepare`), which know their robot;
    other options are those of `Formulation`.
    """
    formulation = Formulation(**options)
    if not isinstance(log, Prepared):
        how = {"without_effort": without_effort, "accept": accept, "gains": gains}
        log = formulation.prepare(robot, log, processing=processing, **how)
    return formulation.problem(log)


def adapt(
    estimate: Estimate,
    log: Logs,
    *,
    processing: ProcessingOf = None,
    without_effort: Iterable[str] = (),
    accept: str | Iterable[str] = (),
) -> Estimate:
    """Refit friction and offsets alone to a new recording.

    Friction changes with temperature, load and wear, and sensors' zeros drift, where links do not:
    on recorded robots friction fitted anew halves the error on another day's recording. The
    parameters of the links, rotor inertias and gravity's direction stay exactly as they are; so do
    the shapes of the friction terms. All others are fitted again, with the usual weak belief that
    friction is small.

    Parameters
    ----------
    estimate : Estimate
        With standard parameters, such as those of `solve_sdp`.
    log : Recording or path, or a sequence of these
        What was measured on the same robot.
    processing : Processing or mapping, optional
        As for `identify`.
    without_effort : iterable of str, optional
        As for `identify`; the friction of these joints is the believed one, which is none.
    accept : str or iterable of str, optional
        As for `identify`: kinds of findings that do not refuse a recording.

    Returns
    -------
    Estimate
        The optimum over friction and offsets, of a problem that can be certified.

    Raises
    ------
    DataError
        When the estimate has no standard parameters or breaks its own constraints, or the
        recording cannot be used.
    SolverError
        When the program ends without an optimum.

    Examples
    --------
    >>> warm = sdpid.adapt(estimate, log)  # log: a run on another day
    >>> warm.status
    'optimal'
    >>> bool(np.array_equal(warm.theta[:60], estimate.theta[:60]))  # the links are the same
    True
    """
    old = estimate.problem
    if estimate.theta is None:
        raise DataError(
            f"adapt: the estimate ({estimate.method}) has no standard parameters to keep; give one "
            "of solve_sdp."
        )
    if not estimate.feasible:
        raise DataError(
            f"adapt: the estimate ({estimate.method}) breaks its constraints by "
            f"{estimate.violation:.1e}; give one of solve_sdp."
        )
    links = 10 * old.robot.n_links
    units = np.array(old.base.theta_units)
    rigid = np.isin(units, _RIGID_UNITS)
    rigid[:links] = True
    kept = {old.base.theta_names[i]: float(estimate.theta[i]) for i in np.flatnonzero(rigid)}
    constraints = old.constraints.replace(others=(*old.constraints.others, Fixed(kept)))
    formulation = Formulation(
        friction=old.friction.terms,
        consistency=old.consistency,
        constraints=constraints,
        prior=Prior(bodies=estimate.theta[:links].reshape(-1, 10)),
        effects="none",
    )
    prepared = prepare(old.robot, log, processing, without_effort=without_effort, accept=accept)
    problem = formulation.problem(prepared)
    found = solve_sdp(problem)
    assert found.theta is not None
    # Equations hold up to rounding; what was not fitted again is the same number.
    theta = np.where(rigid, estimate.theta, found.theta)
    return replace(found, theta=frozen(theta), base=frozen(problem.base_of(theta)))
