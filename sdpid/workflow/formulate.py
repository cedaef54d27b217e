"""Build the problem that `identify` solves, with its defaults."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid.errors import DataError
from sdpid.estimation.compression.covariance import PRINTED, Weighting
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.constraints.mass import known_mass
from sdpid.estimation.effects.kinds import Effects, names_of_effects
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.selection.choose import with_chosen_effects, with_effects
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.inspection.inspect import kinds_accepted
from sdpid.experiment.preparation.prepare import (
    Logs,
    Prepared,
    ProcessingOf,
    friction_of,
    prepare,
)
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import Consistency
from sdpid.robot.model.model import RobotModel


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

    @property
    def total_mass(self) -> float | None:
        """What the robot is known to weigh."""
        return None if self.constraints is None else known_mass(self.constraints.others)

    def without_choices(self, problem: Problem) -> Formulation:
        """Return the same with the terms that were chosen for a problem, and no more."""
        return replace(self, friction=problem.friction.terms, effects="none")

    def problem(self, robot: RobotModel, prepared: Prepared) -> Problem:
        """Build the problem of prepared recordings, with what follows from them."""
        samples, prior = prepared.samples, self.prior
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

    `log` may also be recordings that are prepared already (see `prepare`); other options are those
    of `Formulation`.
    """
    formulation = Formulation(**options)
    if not isinstance(log, Prepared):
        log = prepare(
            robot,
            log,
            processing,
            without_effort=without_effort,
            accept=kinds_accepted(accept),
            gains=gains,
            total_mass=formulation.total_mass,
        )
    return formulation.problem(robot if isinstance(robot, RobotModel) else log.robot, log)
