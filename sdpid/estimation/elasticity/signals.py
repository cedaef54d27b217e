"""What deflections of gears are fitted to: both encoders, the motion, and the torque of gears."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.filters import low_pass
from sdpid.experiment.recording.gaps import continuous, make_grid
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.model import RobotModel

# Rows whose regressors are held at a time.
_CHUNK = 20_000
# Time constants of the filter in which it is off at the ends of a stretch.
_SPOILED = 5.0
# Samples of the shortest stretch that is used.
_LEAST = 10


class Run(NamedTuple):
    """A stretch of a recording without gaps, in uniform samples.

    Attributes
    ----------
    time : ndarray, shape (N,)
        Of the samples, s.
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
        Takes every joint's delay (s) and returns the motors' velocities (N, m) half of it earlier,
        whose product with it they went on by meanwhile, and the torques (N, m) that much earlier.
    """

    time: Array
    link: Array
    difference: Array
    torque: Array
    slopes: Array
    late: Callable[[Array], tuple[Array, Array]]


def pieces_of(robot: RobotModel, log: Recording) -> tuple[Recording, ...]:
    """Return the stretches of a recording without gaps, with the robot's joints."""
    return continuous(match_joints(robot, log))[0]


def runs_of(
    estimate: Estimate,
    log: Recording,
    joints: Indices,
    rotors: Array,
    stride: int | None = None,
) -> list[Run]:
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
    stride : int, optional
        Every so many samples are returned, without those at the ends that the filter spoils. By
        default all are.
    """
    pieces = [each for each in pieces_of(estimate.problem.robot, log) if each.n_samples >= _LEAST]
    if not pieces:
        return []
    # Periods, which are averaged elsewhere, are samples like others here.
    plain = replace(log, period=None, start=None, periods=None)
    cutoff_hz = default_processing(plain).cutoff_hz
    runs = [_run(estimate, piece, joints, rotors, cutoff_hz, stride) for piece in pieces]
    return [run for run in runs if len(run.time)]


def _run(
    estimate: Estimate,
    log: Recording,
    joints: Indices,
    rotors: Array,
    cutoff_hz: float,
    stride: int | None,
) -> Run:
    """Return a stretch without gaps."""
    from scipy.interpolate import CubicSpline, PPoly

    robot, theta, grid = estimate.problem.robot, estimate.some_theta, make_grid(log)
    links = log.link_position
    motor, link = (
        np.stack([grid.read(column, 0, grid.count) for column in np.asarray(table).T], axis=1)
        for table in (log.position, log.position if links is None else links)
    )
    passed = low_pass("butterworth", cutoff_hz, 4, 1.0 / grid.step)
    smooth, kept = passed.whole(motor), np.arange(grid.count)
    if stride is not None:
        ends = math.ceil(_SPOILED * passed.time_constant)
        kept = kept[ends:-ends:stride]
    time = grid.step * np.arange(grid.count)
    spline = CubicSpline(time, smooth)
    known = {name: k for k, name in enumerate(estimate.problem.base.theta_names)}
    drives = [(row, known.get(f"Ia{j + 1}")) for row, j in enumerate(joints.tolist())]
    torque, sums = np.empty((grid.count, len(joints))), np.zeros((2, len(joints), len(theta)))
    for first in range(0, grid.count, _CHUNK):
        rows = slice(first, first + _CHUNK)
        velocity, acceleration = spline(time[rows], 1), spline(time[rows], 2)
        bodies = robot.regressor(smooth[rows], velocity, acceleration)[:, joints]
        columns = np.zeros((*bodies.shape[:2], len(theta)))
        columns[:, :, : bodies.shape[2]] = bodies
        for row, column in drives:
            if column is not None:
                columns[:, row, column] = acceleration[:, joints[row]]
        torque[rows] = columns @ theta - rotors[joints] * acceleration[:, joints]
        own = kept[np.searchsorted(kept, first) : np.searchsorted(kept, first + _CHUNK)]
        columns = columns[own - first]
        sums += np.einsum("nm,nmp->mp", torque[own], columns), columns.sum(axis=0)

    rates = [PPoly(spline.c[:, :, j], time).derivative() for j in joints.tolist()]
    torques = [CubicSpline(time, each) for each in torque.T]
    taken = time[kept]

    def late(delays: Array) -> tuple[Array, Array]:
        moved = [np.clip(taken - delay, 0.0, time[-1]) for delay in (*(0.5 * delays), *delays)]
        both = [curve(when) for curve, when in zip((*rates, *torques), moved, strict=True)]
        return np.stack(both[: len(joints)], axis=1), np.stack(both[len(joints) :], axis=1)

    # Without samples there is no mean.
    mean = torque[kept].sum(axis=0) / max(len(kept), 1)
    return Run(
        time=np.asarray(grid.origin + taken),
        link=link[kept][:, joints],
        difference=(motor - link)[kept][:, joints],
        torque=torque[kept],
        slopes=sums[0] - mean[:, None] * sums[1],
        late=late,
    )
