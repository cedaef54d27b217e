"""Processing and friction terms with which gains are estimated."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.effects.kinds import Effects, names_of_effects
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.selection.choose import with_chosen_effects, with_effects
from sdpid.experiment.preparation.for_robot import SMOOTH, friction_of
from sdpid.experiment.preparation.several import ProcessingOf, common_processing
from sdpid.experiment.processing.choose import with_changes
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.friction.posed import LoadFriction
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import Coulomb
from sdpid.robot.model.model import RobotModel

# Rows of slow motion are masked: there friction under load is least like any curve. Below this
# speed, rad/s, or this share of the joints' usual speed, whichever is less, and within this time,
# s, of it. On two pairs of records of a UR10e it lowers what is left of the wrist's currents by a
# third, and the gains of joints 4 and 6 of the pairs come nearer (docs/evidence/drive_gains.md).
_SLOW, _SLOW_SHARE, _SLOW_TIME = 0.1, 0.2, 0.1
# A joint keeps at least this share of its rows, or is not masked.
_KEPT = 0.3


def gain_processing(
    logs: Sequence[Recording], given: ProcessingOf
) -> tuple[Processing, str | None]:
    """Return one processing for all recordings, and why it was chosen.

    Raises
    ------
    DataError
        When a change names no setting, or recordings have periods.
    """
    if any(log.period is not None for log in logs):
        raise DataError("gains: leave periods out of the recordings (period=None).")
    if isinstance(given, Processing):
        return given, None
    common, why = common_processing([replace(log, currents=False) for log in logs])
    speeds = [np.sqrt(np.mean(np.gradient(log.position, log.time, axis=0) ** 2)) for log in logs]
    slow = {
        "reversal_speed": min(_SLOW, _SLOW_SHARE * float(np.median(speeds))),
        "reversal_time": _SLOW_TIME,
        "kept_share": _KEPT,
    }
    return with_changes(common, {**slow, **({} if given is None else given)}), why


def first_terms(robot: RobotModel) -> tuple[str | FrictionTerm, ...]:
    """Return terms with which nearly right gains are found, before any are chosen by the data."""
    terms: tuple[str | FrictionTerm, ...] = (
        Coulomb(width=SMOOTH),
        "viscous",
        "offset",
        "rotor_inertia",
    )
    if not np.any(robot.prior[:, 0] > 0.0):
        return terms
    return (*terms, LoadFriction(width=SMOOTH))


def chosen_terms(
    robot: RobotModel,
    samples: Sequence[Samples],
    logs: Sequence[Recording],
    gains: Array,
    friction: Iterable[str | FrictionTerm] | None,
    effects: Effects,
) -> tuple[tuple[FrictionTerm, ...], tuple[str, ...]]:
    """Return the friction terms, their numbers closed, and what the data say of effects.

    Parameters
    ----------
    robot : RobotModel
        The arm.
    samples : sequence of Samples
        Without load, efforts in A.
    logs : sequence of Recording
        What they were made of.
    gains : ndarray, shape (n,)
        Nearly right gains.
    friction, effects
        As `identify_drive_gains` takes them.
    """
    names = names_of_effects(effects)
    given = friction_of(logs[0], friction)
    joined = Samples.join([replace(each, effort=each.effort * gains) for each in samples])
    described = bool(np.any(robot.prior[:, 0] > 0.0))
    prior = Prior() if described else None
    constraints = Constraints.of_size(robot)

    def build(terms: tuple[str | FrictionTerm, ...]) -> Problem:
        return build_problem(
            robot,
            joined,
            friction=terms,
            weighting="residual",
            constraints=constraints,
            prior=prior,
            check_excitation=False,
        )

    problem = build(given)
    if names is None:
        problem = with_chosen_effects(problem, given, prior, build)
    elif names:
        problem = with_effects(problem, given, names, build)
    terms = problem.friction.terms
    return terms, tuple(each.words for each in problem.origin.effects if each.chosen)
