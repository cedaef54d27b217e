"""Motions of any kind as curves in the order of a robot's joints."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.errors import DataError
from sdpid.experiment.trajectory.curve import Curve, SampledCurve
from sdpid.experiment.trajectory.reading import read_trajectory
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.model.model import RobotModel

# The quantities of sampled motions; the first is needed.
_QUANTITIES = ("position", "velocity", "acceleration")

# What is taken for a motion.
Motion = Trajectory | Curve | str | os.PathLike[str] | Mapping[str, Any]


def curves_of(robot: RobotModel, motion: Motion) -> tuple[tuple[float, Curve], ...]:
    """Return the distinct curves of a motion with their starts in s, joints in the robot's order.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    motion : Trajectory, Curve, path, mapping or data frame
        A file as for `read_trajectory`; a mapping or data frame has ``time`` and ``position``
        (K, n) or columns ``position_<joint>``, and may have velocities and accelerations.

    Raises
    ------
    DataError
        When it is none of these, or its joints are not the robot's.
    """
    if isinstance(motion, str | os.PathLike):
        motion = read_trajectory(motion, robot.joint_names)
    if isinstance(motion, Trajectory):
        order = _order(robot, motion.joint_names)
        return tuple((start, _reordered(curve, order)) for start, curve in motion.curves())
    curve: Curve
    if hasattr(motion, "enclose") and hasattr(motion, "breaks"):
        curve = motion  # type: ignore[assignment]
    elif hasattr(motion, "keys") and hasattr(motion, "__getitem__"):
        curve = _of_columns(robot, motion)
    else:
        raise DataError(
            f"motion: got {type(motion).__name__}; give a Trajectory, a file, or columns time, "
            "position_<joint>, …."
        )
    if curve.n != robot.n:
        raise DataError(
            f"motion: {curve.n} joints, '{robot.name}' has {robot.n}: "
            f"{', '.join(robot.joint_names)}."
        )
    return ((0.0, curve),)


def _of_columns(robot: RobotModel, columns: Any) -> Curve:
    """Return the curve through the samples of a mapping or a data frame."""
    names = [str(name) for name in columns.keys()]  # noqa: SIM118 - of a data frame, too
    found: dict[str, Any] = {}
    for quantity in _QUANTITIES:
        own = [f"{quantity}_{joint}" for joint in robot.joint_names]
        if quantity in names:
            found[quantity] = np.asarray(columns[quantity])
        elif all(name in names for name in own):
            found[quantity] = np.column_stack([np.asarray(columns[name]) for name in own])
        elif any(name in names for name in own) or quantity == "position":
            missing = [name for name in own if name not in names]
            raise DataError(
                f"motion: column {missing[0]} is missing; give {', '.join(own)}, or {quantity} as "
                f"(K, {robot.n}). Found: {', '.join(names[:40]) or 'nothing'}."
            )
    if "time" not in names:
        raise DataError(f"motion: column time is missing. Found: {', '.join(names[:40])}.")
    return SampledCurve(time=np.asarray(columns["time"]), **found)


def _order(robot: RobotModel, names: Sequence[str]) -> Indices:
    """Return the places of the robot's joints among names."""
    if sorted(names) != sorted(robot.joint_names):
        raise DataError(
            f"motion: its joints are {', '.join(names)}, those of '{robot.name}' "
            f"{', '.join(robot.joint_names)}; rename them."
        )
    return np.array([list(names).index(name) for name in robot.joint_names])


def _reordered(curve: Curve, order: Indices) -> Curve:
    if np.array_equal(order, np.arange(len(order))):
        return curve
    return _Reordered(curve, order, curve.n, curve.duration, curve.breaks)


@dataclass(frozen=True, eq=False)
class _Reordered:
    """A curve with its joints in another order."""

    curve: Curve
    order: Indices
    n: int
    duration: float
    breaks: Array

    def evaluate(self, time: Any, *, derivative: int = 0) -> Array:
        return self.curve.evaluate(time, derivative=derivative)[:, self.order]

    def enclose(self, edges: Any, *, derivative: int = 0) -> tuple[Array, Array]:
        lower, upper = self.curve.enclose(edges, derivative=derivative)
        return lower[:, self.order], upper[:, self.order]
