"""What deflections of gears are fitted to: both encoders, the motion, and the torque of gears."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.filters import low_pass
from sdpid.experiment.recording.gaps import continuous, make_grid
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.recording.recording import Recording

# Rows whose regressors are held at a time.
_CHUNK = 20_000


class Run(NamedTuple):
    """A stretch of a recording without gaps, in uniform samples.

    Attributes
    ----------
    link : ndarray, shape (N, m)
        Positions that the links' encoders recorded, of the joints that have one, rad (m).
    difference : ndarray, shape (N, m)
        Positions of the motors' encoders less those.
    torque : ndarray, shape (N, m)
        Torques through the gears, N·m (N).
    slopes : ndarray, shape (m, p)
        Sums over the samples of torques, their means taken off, times how these depend on the
        standard parameters.
    late : callable
        Takes a delay (s) and returns the motors' velocities (N, m) half of it earlier, whose
        product with it they went on by meanwhile, and the torques (N, m) that much earlier.
    """

    link: Array
    difference: Array
    torque: Array
    slopes: Array
    late: Callable[[float], tuple[Array, Array]]


def runs_of(estimate: Estimate, log: Recording, joints: Indices, rotors: Array) -> list[Run]:
    """Return a recording's stretches.

    Parameters
    ----------
    estimate : Estimate
        The rigid robot, whose links and rotors move as the motors do.
    log : Recording
        With positions of links; without, those of motors stand for them.
    joints : ndarray of int, shape (m,)
        Those with an encoder at the link.
    rotors : ndarray, shape (n,)
        Rotor inertia of every joint, kg·m² (kg), whose torque does not pass its gear.
    """
    matched = match_joints(estimate.problem.robot, log)
    cutoff_hz = default_processing(matched).cutoff_hz
    return [_run(estimate, piece, joints, rotors, cutoff_hz) for piece in continuous(matched)[0]]


def _run(
    estimate: Estimate, log: Recording, joints: Indices, rotors: Array, cutoff_hz: float
) -> Run:
    """Return a stretch without gaps."""
    from scipy.interpolate import CubicSpline

    robot, theta, grid = estimate.problem.robot, estimate.some_theta, make_grid(log)
    links = log.link_position
    motor, link = (
        np.stack([grid.read(column, 0, grid.count) for column in np.asarray(table).T], axis=1)
        for table in (log.position, log.position if links is None else links)
    )
    smooth = low_pass("butterworth", cutoff_hz, 4, 1.0 / grid.step).whole(motor)
    time = grid.step * np.arange(grid.count)
    spline = CubicSpline(time, smooth)
    velocity, acceleration = spline(time, 1), spline(time, 2)
    known = {name: k for k, name in enumerate(estimate.problem.base.theta_names)}
    drives = [(row, known.get(f"Ia{j + 1}")) for row, j in enumerate(joints.tolist())]
    torque, sums = np.empty((grid.count, len(joints))), np.zeros((2, len(joints), len(theta)))
    for first in range(0, grid.count, _CHUNK):
        rows = slice(first, first + _CHUNK)
        bodies = robot.regressor(smooth[rows], velocity[rows], acceleration[rows])[:, joints]
        columns = np.zeros((*bodies.shape[:2], len(theta)))
        columns[:, :, : bodies.shape[2]] = bodies
        for row, column in drives:
            if column is not None:
                columns[:, row, column] = acceleration[rows, joints[row]]
        torque[rows] = columns @ theta - rotors[joints] * acceleration[rows][:, joints]
        sums += np.einsum("nm,nmp->mp", torque[rows], columns), columns.sum(axis=0)

    torques = CubicSpline(time, torque)

    def late(delay: float) -> tuple[Array, Array]:
        half, whole = (np.clip(time - part * delay, 0.0, time[-1]) for part in (0.5, 1.0))
        return np.asarray(spline(half, 1)[:, joints]), np.asarray(torques(whole))

    return Run(
        link=link[:, joints],
        difference=(motor - link)[:, joints],
        torque=torque,
        slopes=sums[0] - torque.mean(axis=0)[:, None] * sums[1],
        late=late,
    )
