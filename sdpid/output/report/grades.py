"""Grade how far predicted efforts can be trusted on other motion.

Every limit is a constant here, with its reason.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.kept import kept
from sdpid.assurance.diagnostics.bands import random_motion
from sdpid.assurance.diagnostics.held_out import HeldOut
from sdpid.assurance.diagnostics.rest import rest_speeds
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.errors import SdpidError
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.processing.samples import Samples
from sdpid.output.report.kinds import Level

# Share of a joint's effort that is explained (R²). At 0.95 the error is 22 % of the effort's
# spread, and a feedback loop is left with less than a quarter of the work; at 0.8 it is 45 %, and
# what the model gets wrong is about as large as friction or gravity alone usually are.
EXPLAINED, HARDLY = 0.95, 0.8

# A joint whose effort hardly varies has a low R² however small its error is. An error of a tenth of
# the effort itself is small all the same: payloads and temperature change it by as much. It lifts a
# joint by one level and no more, since R² alone tells a model from a constant.
SMALL = 0.1

# Held-out blocks repeat the motion that was trained on. A joint is trusted on other motion where
# twice their error would still be good: then all of 229 joints of six real robots kept the grade on
# another recording. By blocks alone the shortest recordings (Gen3) kept 4 of 10; with a margin of
# 1.5 they keep 2 of 3, with 2 none is trusted there (examples/evidence/grades.py).
MARGIN = 2.0


@dataclass(frozen=True)
class Grade:
    """How far a joint's predicted effort can be trusted.

    Attributes
    ----------
    joint : int
        Its index.
    level : {"good", "caution", "bad"}
        Trusted, roughly right, or not trusted.
    shown : bool
        Whether other motion has shown it, or leaves room for it. A joint that is predicted well on
        the motion that was trained on, and no more, is not: its level is "caution".
    moved : bool
        Whether the joint moved at all.
    """

    joint: int
    level: Level
    shown: bool = True
    moved: bool = True


def grades(estimate: Estimate, training: Validation, held_out: HeldOut | None) -> tuple[Grade, ...]:
    """Return the grade of every joint whose effort was measured.

    Parameters
    ----------
    estimate : Estimate
        The estimate.
    training : Validation
        Its errors on the training rows.
    held_out : HeldOut or None
        Its errors on what was held out.
    """
    if held_out is None:
        every = graded(estimate.problem.samples, training)
        return tuple(_unshown(each) if each.level == "good" else each for each in every)
    every = graded(held_out.samples, held_out.fit)
    if held_out.by == "recording":
        return tuple(every)
    errors, room = held_out.fit.moving, left_room(estimate)
    found = []
    for each in every:
        r2, nrmse = float(errors.r2[each.joint]), float(errors.nrmse[each.joint])
        wide = level_of(1.0 - MARGIN**2 * (1.0 - r2), MARGIN * nrmse)
        doubtful = each.level == "good" and not wide == room[each.joint] == "good"
        found.append(_unshown(each) if doubtful else each)
    return tuple(found)


def _unshown(grade: Grade) -> Grade:
    """Return the grade of a joint that is predicted well on the motion of the training alone."""
    return replace(grade, level="caution", shown=False)


def graded(samples: Samples, fit: Validation) -> Iterator[Grade]:
    """Yield the grade of every joint whose effort was measured, by one prediction alone.

    A joint that stood still is at most "caution": a constant would have predicted its effort too.
    Of one without a motor there is nothing to predict.
    """
    for j in range(len(fit.joint_names)):
        if not fit.rows[j] or not np.any(samples.effort[:, j]):
            continue
        if not moved(samples, fit, j):
            yield Grade(j, "caution" if fit.nrmse[j] <= SMALL else "bad", moved=False)
            continue
        errors = fit.moving if fit.moving.rows[j] else fit
        yield Grade(j, level_of(float(errors.r2[j]), float(errors.nrmse[j])))


def level_of(r2: float, nrmse: float) -> Level:
    """Return the level of an error: R², and RMSE over rms effort."""
    small = nrmse <= SMALL
    if r2 >= (HARDLY if small else EXPLAINED):
        return "good"
    return "caution" if small or r2 >= HARDLY else "bad"


def moved(samples: Samples, fit: Validation, joint: int) -> bool:
    """Return whether a joint was ever faster, on the rows in use, than one that rests."""
    speeds = np.abs(samples.velocity[samples.used[:, joint], joint])
    return bool(np.any(speeds > rest_speeds(fit.slides)[joint]))


@kept
def left_room(estimate: Estimate) -> tuple[Level, ...]:
    """Return the level, joint by joint, of the error that parameters leave on random motion."""
    try:
        deviation, effort = random_motion(estimate)
    except SdpidError:  # no covariance: nothing tells how much is left open
        unknown: Level = "caution"
        return (unknown,) * estimate.problem.robot.n
    tiny = np.finfo(float).tiny
    r2 = 1.0 - deviation**2 / np.maximum(effort.var(axis=0), tiny)
    nrmse = deviation / np.sqrt(np.maximum(np.mean(effort**2, axis=0), tiny))
    return tuple(map(level_of, r2.tolist(), nrmse.tolist()))
