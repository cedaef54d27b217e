"""A motion as the ROS message trajectory_msgs/JointTrajectory, written as YAML."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from sdpid import __version__
from sdpid._common.arrays import Array
from sdpid._common.files import atomic_write_text
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.output.plans.motion_files import whole_motion

# Points per second, at most: controllers interpolate between them with polynomials of fifth degree
# where positions, velocities and accelerations are given.
RATE_HZ = 100.0

# Without exponents, which YAML 1.1 takes for text where they have no decimal point before them.
_DECIMALS = 12


def write_joint_trajectory(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write a whole trajectory as a JointTrajectory message in YAML.

    Times are whole nanoseconds from the first point, at which the robot must stand already.
    """
    atomic_write_text(Path(path), "\n".join(_lines(trajectory)) + "\n")


def _lines(trajectory: Trajectory) -> Iterator[str]:
    """Yield the lines of the file."""
    step = max(int(trajectory.rate_hz // RATE_HZ), 1)
    time, states = whole_motion(trajectory)
    last = len(time) - 1
    index = np.append(np.arange(0, last, step), last)
    yield f"# trajectory_msgs/JointTrajectory by sdpid {__version__}; rad or m, and s."
    yield "# The robot must stand at the first point when it starts."
    yield "header:"
    yield "  stamp: {sec: 0, nanosec: 0}"
    yield "  frame_id: ''"
    yield f"joint_names: {json.dumps(list(trajectory.joint_names))}"
    yield "points:"
    nanoseconds = np.rint(1e9 * time[index]).astype(np.int64)
    position, velocity, acceleration = states[:, index]
    for k, when in enumerate(nanoseconds.tolist()):
        yield f"- positions: {_listed(position[k])}"
        yield f"  velocities: {_listed(velocity[k])}"
        yield f"  accelerations: {_listed(acceleration[k])}"
        yield f"  time_from_start: {{sec: {when // 10**9}, nanosec: {when % 10**9}}}"


def _listed(values: Array) -> str:
    """Return numbers as a list."""
    return "[" + ", ".join(f"{value:.{_DECIMALS}f}" for value in values.tolist()) + "]"
