"""Where a robot can rest within its limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array, frozen, generator
from sdpid.errors import DataError
from sdpid.excitation.limits.joint_limits import DESCRIBED, JointLimits, unit_of
from sdpid.robot.model.model import RobotModel

# Gravity takes at most this share of the torque limits at rest, where such a position is found
# among those drawn: a reserve for friction, and some torque for the motion, are left.
_EASY, _DRAWN = 0.7, 1000


def check_rest(robot: RobotModel, limits: JointLimits) -> None:
    """Raise `DataError` unless a robot can stand at its rest position within the limits."""
    rest, names, sliding = limits.rest, limits.joint_names, limits.sliding
    for j in np.flatnonzero((rest < limits.lower) | (rest > limits.upper)):
        unit = unit_of("lower", sliding[j])
        below = rest[j] < limits.lower[j]
        side, limit = ("below", limits.lower[j]) if below else ("above", limits.upper[j])
        raise DataError(
            f"limits: joint '{names[j]}': the rest position {rest[j]:.6g} {unit} is {side} the "
            f"limit of {limit:.6g} {unit}; start elsewhere, or widen the limit."
        )
    load = _load(robot, limits, rest[None])[0]
    worst = int(np.argmax(load))
    if load[worst] > 1.0:
        raise DataError(
            f"limits: joint '{names[worst]}': gravity alone needs "
            f"{_of_torque(limits, worst, load[worst])} at "
            f"the rest position, the torque limit is {_of_torque(limits, worst)} "
            f"({limits.sources['torque'][worst]}); give another rest position, or "
            f"{_larger(limits, worst)}."
        )


def able_to_rest(robot: RobotModel, limits: JointLimits) -> JointLimits:
    """Return limits with a rest position that the motors hold easily, the nearest one drawn.

    Raises
    ------
    DataError
        When they can hold none.
    """
    worst = int(np.argmax(_load(robot, limits, limits.rest[None])[0]))
    rng, width = generator(0), limits.upper - limits.lower
    drawn = limits.lower + width * rng.uniform(0.05, 0.95, (_DRAWN, limits.n))
    # From the usual position on, ever farther towards each drawn one.
    shares = np.linspace(0.0, 1.0, _DRAWN)[:, None]
    tried = np.vstack([limits.rest, limits.rest + shares * (drawn - limits.rest), drawn])
    load = _load(robot, limits, tried).max(axis=1)
    easy = load <= _EASY
    if easy[0]:
        return limits
    away = np.abs((tried - limits.rest) / width).sum(axis=1)
    best = int(np.argmin(np.where(easy, away, np.inf) if easy.any() else load))
    if load[best] > 1.0:
        j = int(np.argmax(_load(robot, limits, tried[best : best + 1])[0]))
        raise DataError(
            f"limits: joint '{limits.joint_names[j]}': gravity alone needs "
            f"{_of_torque(limits, j, load[best])} at the best of {len(tried)} positions, the "
            f"torque limit is {_of_torque(limits, j)} ({limits.sources['torque'][j]}); give "
            f"{_larger(limits, j)}, or a rest position."
        )
    told = (
        "the rest position is one that the motors hold easily: at the usual one "
        f"{100.0 * _EASY:.0f} % of the torque limit of {limits.joint_names[worst]} are not enough."
    )
    return replace(limits, rest=frozen(tried[best]), assumed=(*limits.assumed, told))


def _load(robot: RobotModel, limits: JointLimits, positions: Array) -> Array:
    """Return what gravity needs at positions (K, n), in shares of the torque limits."""
    still = np.zeros_like(positions)
    return np.asarray(np.abs(robot.described_efforts(positions, still, still)) / limits.torque)


def _of_torque(limits: JointLimits, joint: int, share: float = 1.0) -> str:
    """Return a share of a joint's torque limit in words."""
    unit = unit_of("torque", limits.sliding[joint])
    return f"{share * limits.torque[joint]:.4g} {unit}"


def _larger(limits: JointLimits, joint: int) -> str:
    """Return how to give a larger torque limit."""
    described = limits.sources["torque"][joint] == DESCRIBED
    return "a larger limit" + (" with override = true" if described else "")
