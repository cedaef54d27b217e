"""What bounds of a curve do not show: jumps between its pieces, and what its ends ask for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.experiment.trajectory.curve import Curve

# A jump of a derivative counts as a change within this time, s: a cycle of a fast controller. Jumps
# that a limit allows within it are those of rounded samples.
_CYCLE = 1e-3
# An arm that is slower than this is at rest, rad/s or m/s.
_AT_REST = 1e-3


def jumps_of(curves: Sequence[tuple[float, Curve]], derivative: int) -> tuple[Array, Array]:
    """Return the largest jump (n,) of a derivative at the breaks of curves, as a rate, and when."""
    n = curves[0][1].n
    rates, times = [np.zeros((1, n))], [np.zeros(1)]
    for start, curve in curves:
        inner = np.asarray(curve.breaks)[1:-1]
        if len(inner):
            before = curve.evaluate(np.nextafter(inner, -np.inf), derivative=derivative)
            after = curve.evaluate(inner, derivative=derivative)
            rates.append(np.abs(after - before) / _CYCLE)
            times.append(start + inner)
    rate, time = np.concatenate(rates), np.concatenate(times)
    where = np.argmax(rate, axis=0)
    return rate[where, np.arange(n)], time[where]


def range_of(
    joints: JointLimits, curves: Sequence[tuple[float, Curve]], sliding: Mask
) -> tuple[Array, Array]:
    """Return the positions (n,), least and largest, that limits allow or the motion comes to.

    Joints that turn without limits stay so: the little that a motion uses of their turn would not
    show which pairs overlap by the coarseness of their shapes.
    """
    whole = [curve.enclose(np.array([0.0, curve.duration])) for _, curve in curves]
    lower = np.min([low[0] for low, _ in whole], axis=0)
    upper = np.max([high[0] for _, high in whole], axis=0)
    below, above = np.isfinite(joints.lower), np.isfinite(joints.upper)
    return (
        np.where(below | ~sliding, np.minimum(joints.lower, lower), lower),
        np.where(above | ~sliding, np.maximum(joints.upper, upper), upper),
    )


def in_motion(joints: JointLimits, curves: Sequence[tuple[float, Curve]]) -> list[str]:
    """Return a sentence for each end at which the arm is not at rest: its limits are not known."""
    (_, first), (_, last) = curves[0], curves[-1]
    told = []
    for verb, curve, time in (("starts", first, 0.0), ("ends", last, last.duration)):
        speed, change = (
            np.abs(curve.evaluate(np.array([time]), derivative=order)[0]) for order in (1, 2)
        )
        moving, jolted = speed > _AT_REST, change > _CYCLE * joints.jerk
        for what, where in (("in motion", moving), ("with a jolt from rest", jolted & ~moving)):
            if where.any():
                names = ", ".join(joints.joint_names[j] for j in np.flatnonzero(where))
                told.append(
                    f"the motion {verb} {what} ({names}): the way from or to rest is no part of it "
                    "and is not checked."
                )
    return told
