"""Quantities of each joint along a motion, with their limits, to be looked at."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.limits.joint_limits import UNITS, JointLimits
from sdpid.excitation.limits.torque import TorqueModel
from sdpid.experiment.trajectory.trajectory import Played
from sdpid.robot.model.coordinates import sliding
from sdpid.robot.model.model import RobotModel

# Label with unit, values (K,), and lower and upper limit, None where there is none.
Quantity: TypeAlias = tuple[str, Array, float | None, float | None]


def limited_quantities(
    robot: RobotModel, limits: JointLimits, motion: Played
) -> Iterator[tuple[str, list[Quantity]]]:
    """Yield each joint's position, velocity, acceleration, jerk and torque, with their limits.

    Parameters
    ----------
    robot : RobotModel
        The robot; its description says the torques.
    limits : JointLimits
        The limits.
    motion : Played
        The motion.

    Yields
    ------
    str
        The joint.
    list of (str, ndarray of shape (K,), float or None, float or None)
        Label with unit, values, lower and upper limit, for `sdpid.plots.plot_against_limits`.
    """
    model = TorqueModel.of(robot)
    torque = model.torque(motion.position, motion.velocity, motion.acceleration)
    slides = sliding(robot.pin_model, robot.joint_names)
    sized = {
        "velocity": (motion.velocity, limits.velocity),
        "acceleration": (motion.acceleration, limits.acceleration),
        "jerk": (motion.jerk, limits.jerk),
        "torque": (torque, model.allowed(limits.torque)),
    }
    for j, name in enumerate(robot.joint_names):
        unit = {kind: UNITS[kind][int(slides[j])] for kind in ("lower", *sized)}
        ends = _ends(limits.lower[j], limits.upper[j])
        rows: list[Quantity] = [(unit["lower"], motion.position[:, j], *ends)]
        for kind, (values, limit) in sized.items():
            rows.append((unit[kind], values[:, j], *_ends(-limit[j], limit[j])))
        yield name, rows


def _ends(lower: float, upper: float) -> tuple[float | None, float | None]:
    """Return limits, None where there are none."""
    return (
        float(lower) if np.isfinite(lower) else None,
        float(upper) if np.isfinite(upper) else None,
    )
