"""Build the problem that `identify` solves, with its defaults."""

from __future__ import annotations

import os
from collections.abc import Iterable

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
from sdpid.experiment.preparation.default_friction import friction_of
from sdpid.experiment.preparation.prepare import (
    Logs,
    Prepared,
    ProcessingOf,
    prepare,
)
from sdpid.experiment.recording.floating.robots import robot_of
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import Consistency
from sdpid.robot.model.model import RobotModel


def tuple_of_terms(
    friction: Iterable[str | FrictionTerm] | None,
) -> tuple[str | FrictionTerm, ...] | None:
    """Return the friction terms as a tuple; None stays None.

    Raises
    ------
    DataError
        When it is a single name or term, or cannot be iterated over.
    """
    if friction is None:
        return None
    if isinstance(friction, (str, FrictionTerm)):
        raise DataError(f"friction: is {friction!r}; give a tuple of terms, ({friction!r},).")
    try:
        return tuple(friction)
    except TypeError:
        raise DataError(
            f"friction: is {friction!r}; give a tuple of terms, such as ('coulomb', 'viscous')."
        ) from None


def check_kinds(constraints: object, prior: object) -> None:
    """Refuse constraints and a prior of another kind.

    Raises
    ------
    DataError
        Naming the argument.
    """
    if constraints is not None and not isinstance(constraints, Constraints):
        raise DataError(f"constraints: is {constraints!r:.80}; give sdpid.Constraints(...).")
    if prior is not None and not isinstance(prior, (bool, np.bool_, Prior)):
        raise DataError(f"prior: is {prior!r:.80}; give True, False or a Prior.")


def formulate(
    robot: RobotModel | str | os.PathLike[str],
    log: Logs | Prepared,
    *,
    processing: ProcessingOf = None,
    without_effort: Iterable[str] = (),
    accept: str | Iterable[str] = (),
    gains: DriveGains | str | os.PathLike[str] | ArrayLike | None = None,
    friction: Iterable[str | FrictionTerm] | None = None,
    weighting: Weighting | None = None,
    consistency: Consistency = "pseudo_inertia",
    constraints: Constraints | None = None,
    prior: Prior | bool | None = None,
    effects: Effects = "auto",
) -> Problem:
    """Build the problem that `identify` solves; arguments and errors are those of `identify`.

    `log` may also be recordings that are prepared already (see `prepare`).
    """
    check_kinds(constraints, prior)
    friction = tuple_of_terms(friction)
    if not isinstance(log, Prepared):
        log = prepare(
            robot,
            log,
            processing,
            without_effort=without_effort,
            accept=kinds_accepted(accept),
            gains=gains,
            total_mass=None if constraints is None else known_mass(constraints.others),
        )
    robot = robot_of(robot, log.logs)
    samples = log.samples
    chosen: Weighting = weighting or ("residual" if samples.covariance is None else "gls")
    if prior is None:
        # Friction of a joint without effort is known from a prior or not at all.
        wanted = chosen == "residual" or (chosen == "gls" and bool(log.without_effort))
        prior = wanted and bool(np.any(robot.prior[:, 0] > 0.0))
    if isinstance(prior, (bool, np.bool_)):
        prior = Prior() if prior else None
    asked = names_of_effects(effects)
    given = friction_of(log.logs[0], friction)
    constraints = Constraints.of_size(robot) if constraints is None else constraints

    def build(terms: tuple[str | FrictionTerm, ...]) -> Problem:
        return build_problem(
            robot,
            samples,
            friction=terms,
            weighting=chosen,
            consistency=consistency,
            constraints=constraints,
            prior=prior,
        )

    problem = build(given)
    if asked is not None:
        return with_effects(problem, given, asked, build)
    if chosen in PRINTED:
        # No likelihood: a fall of it is no evidence.
        return problem
    return with_chosen_effects(problem, given, prior, build)
