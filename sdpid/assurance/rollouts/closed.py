"""Stretches of a recording in closed loop, under its commanded positions."""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.rollouts.errors import Runs
from sdpid.errors import DataError
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.closed_loop import simulate_closed_loop
from sdpid.experiment.simulation.open_loop import Track
from sdpid.robot.model.model import RobotModel

# What the reference itself is called, beside the models.
REFERENCE = "reference followed exactly"


def reference_on(track: Track, robot: RobotModel, log: Recording | None) -> Array:
    """Return commanded positions (T, n) at the instants of a track.

    Raises
    ------
    DataError
        When the recording has none.
    """
    from scipy.interpolate import CubicSpline

    commanded = None if log is None else match_joints(robot, log).reference
    if log is None or commanded is None:
        raise DataError(
            "controller: a simulation in closed loop follows commanded positions, and the "
            "recording has none; give a recording with a reference, or leave the controller out."
        )
    return np.asarray(CubicSpline(log.time, commanded)(track.time))


def in_closed_loop(
    arm: SimulatedArm, runs: Runs, track: Track, reference: Array, controller: Any
) -> Array:
    """Return simulated positions (1, S, L, n) of all joints, not numbers from where one ran away.

    Each starts in the measured state; a controller that integrates starts with nothing integrated.
    """
    steps = int(runs.after[-1])
    out = np.full((1, len(runs.first), len(runs.after), runs.robot.n), np.nan)
    for s, first in enumerate(runs.first):
        moved = simulate_closed_loop(
            arm,
            reference[first : first + steps + 1],
            controller,
            rate_hz=1.0 / track.step,
            start=(track.position[first], track.velocity[first]),
        )
        kept = runs.after < len(moved.position)
        out[0, s, kept] = moved.position[runs.after[kept]]
    return out
