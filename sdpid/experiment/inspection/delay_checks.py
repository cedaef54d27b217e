"""Checks of channels that are late against each other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.delays.find import (
    DEVIATIONS,
    LEAST,
    channel_delays,
    gyroscope_delay,
    is_told,
)
from sdpid.experiment.inspection.delays.lag import pooled
from sdpid.experiment.inspection.finding import Finding, Subject, check
from sdpid.experiment.inspection.rows import Rows
from sdpid.experiment.processing.delays.on_time import CHANNELS
from sdpid.experiment.recording.rest import moving
from sdpid.robot.model.model import RobotModel

# Delays below this (s), and below this many samples, are the drives' own and those of filters: of
# 17 good recordings the efforts seem late by -13 to 12 ms.
_LEAST_DELAY, _LEAST_STEPS = 0.02, 1.5
# A delay counts from this many of its standard errors on, ...
_SURE = 5.0
# ... in which the joints' spread counts too, and where it takes this share of the residual.
_TAKES = 0.1
# Rows slower than tanh of one width and a half are left out: stiction has delays of its own.
_MOVES = 0.9
# One joint alone may have a delay for other reasons, such as backlash.
_LEAST_JOINTS = 2
# Directions of the regressor with less than this share of the largest singular value are noise.
_RANK = 1e-3
_BLOCKS = 12
_CORRELATED = 0.9


@check
def late_velocities(subject: Subject) -> Iterator[Finding]:
    """Find recorded velocities that are late, or early, against the rate of the positions."""
    rows = subject.low_passed
    if rows is None or rows.recorded_velocity is None:
        return
    limit = max(_LEAST_DELAY, _LEAST_STEPS * rows.step)
    lags = {}
    for j in np.flatnonzero(moving(*subject.position_range)).tolist():
        lag = _lag(rows.recorded_velocity[:, j], rows.velocity[:, j], rows.acceleration[:, j])
        if lag is not None and abs(lag) >= limit:
            lags[subject.log.names[j]] = lag
    if not lags:
        return
    worst = max(lags.values(), key=abs)
    yield Finding(
        severity=subject.about_velocity,
        kind="velocity_late",
        joint=next(iter(lags)) if len(lags) == 1 else None,
        message=(
            f"velocity of {', '.join(lags)} is {_late(worst)} by up to {1e3 * abs(worst):.3g} ms "
            f"against the rate of the position, limit {1e3 * limit:.3g} ms"
        ),
        remedy="shift it, or leave the velocity out (velocity=none)",
        numbers={"delay": worst, "limit": limit},
    )


def _lag(measured: Array, velocity: Array, acceleration: Array) -> float | None:
    """Return by how much a velocity is late, s; None where it is another signal.

    A signal that is late by a little is itself less its derivative times the delay.
    """
    columns = np.column_stack([velocity, acceleration, np.ones_like(velocity)])
    weights = np.linalg.lstsq(columns, measured, rcond=None)[0]
    left = measured - columns @ weights
    power = float(np.var(measured))
    if weights[0] == 0.0 or not float(np.var(left)) < (1.0 - _CORRELATED**2) * power:
        return None
    return -float(weights[1] / weights[0])


@check
def late_efforts(subject: Subject) -> Iterator[Finding]:
    """Find efforts that are late, or early, against the motion."""
    rows, robot = subject.low_passed, subject.robot
    if robot is None or robot.n_base or rows is None or subject.closed:
        return
    if subject.corrected is not None and subject.corrected.steps:
        return  # With a wrong sign or order nothing can be said of delays.
    found = effort_delay(robot, rows)
    limit = max(_LEAST_DELAY, _LEAST_STEPS * rows.step)
    if found is None or abs(found[0]) < limit or abs(found[0]) < _SURE * found[1]:
        return
    delay, error = found
    yield Finding(
        kind="effort_late",
        message=(
            f"efforts are {_late(delay)} by {1e3 * abs(delay):.2g} ms or more against the motion, "
            f"limit {1e3 * limit:.2g} ms: of delays in simulated logs 62 to 80 % are told"
        ),
        remedy="take both from one clock, or shift the efforts until the error is least",
        numbers={"delay": delay, "error": error, "limit": limit},
    )


@check
def late_channels(subject: Subject) -> Iterator[Finding]:
    """Find channels of a recording with a base that are late, or early, against the joints."""
    robot, log = subject.floating, subject.log
    if log.base is None or not subject.pieces or subject.closed:
        return
    if subject.corrected is not None and subject.corrected.steps:
        return  # With a wrong sign or order nothing can be said of delays.
    against = "the joints' positions"
    if robot is not None and robot.free_flyer:
        found = channel_delays(robot, log, subject.without)
    else:
        found, against = gyroscope_delay(log), "the orientation of the base"
    for channel, delay in found.items():
        if not is_told(channel, delay):
            continue
        limit = max(LEAST[channel], DEVIATIONS * delay.error)
        yield Finding(
            kind=dict(
                zip(
                    CHANNELS,
                    ("effort_late", "imu_late", "base_late", "contacts_late"),
                    strict=True,
                )
            )[channel],
            message=(
                f"{CHANNELS[channel]} {'is' if channel == 'imu' else 'are'} "
                f"{_late(delay.value)} by {1e3 * abs(delay.value):.3g} ms (error "
                f"{1e3 * delay.error:.2g} ms) against {against}, limit {1e3 * limit:.2g} ms"
            ),
            remedy=(
                "identify takes this off by itself; elsewhere give processing="
                f"{{'{channel}_delay_s': {delay.value:.5f}}}, or record with one clock"
            ),
            numbers={"delay": delay.value, "error": delay.error, "limit": limit},
        )


def effort_delay(robot: RobotModel, rows: Rows) -> tuple[float, float] | None:
    """Return by how much the efforts are late against the motion, and its standard error, s.

    An effort that is late by a little is the effort of the motion less its derivative times the
    delay. What the regressor and friction leave of either is compared, joint by joint. They take a
    part of the delay: of six delays of 30 to 100 ms in three simulated logs 62 to 80 % are
    found.

    Returns
    -------
    tuple of float or None
        None where a delay would explain next to nothing, or joints move too little.
    """
    Y = robot.regressor(rows.position, rows.velocity, rows.acceleration)
    delays, errors, left, taken = [], [], 0.0, 0.0
    for j in np.flatnonzero(rows.usable).tolist():
        keep = np.abs(rows.sign[:, j]) > _MOVES
        if np.count_nonzero(keep) < 2 * _BLOCKS:
            continue
        friction = (rows.sign[:, j], rows.velocity[:, j], rows.acceleration[:, j])
        columns = np.column_stack([Y[:, j], *friction, np.ones(len(Y))])[keep]
        basis = _basis(columns)
        if len(columns) < 2 * basis.shape[1] + 2 * _BLOCKS:
            continue
        effort, rate = (
            each - basis @ (basis.T @ each)
            for each in (rows.effort[keep, j], rows.effort_rate[keep, j])
        )
        power, size = float(rate @ rate), float(effort @ effort)
        if not power * size > 0.0:
            continue
        delay = -float(effort @ rate) / power
        rest = effort + delay * rate
        scores = np.array([part.sum() for part in np.array_split(rest * rate, _BLOCKS)])
        delays.append(delay)
        errors.append(float(np.sqrt(scores @ scores)) / power)
        left += 1.0
        taken += 1.0 - float(rest @ rest) / size
    if len(delays) < _LEAST_JOINTS or taken < _TAKES * left:
        return None
    return pooled(np.array(delays), np.array(errors))


def _basis(columns: Array) -> Array:
    """Return an orthonormal basis of columns, without directions that are noise."""
    size = np.linalg.norm(columns, axis=0)
    scaled = columns[:, size > 0.0] / size[size > 0.0]
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > _RANK**2 * values[-1]
    return np.asarray(scaled @ (vectors[:, kept] / np.sqrt(values[kept])))


def _late(delay: float) -> str:
    return "late" if delay > 0.0 else "early"
