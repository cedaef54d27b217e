"""Check that orientation, velocities and IMU of a base agree, and that it falls or is borne."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.experiment.inspection.evidence import (
    GRAVITY,
    LEAST_RATE,
    axes_in_words,
    evidence,
    feet_in_base,
    readings,
    signed_axes,
    turn_rates,
    unexplained,
    window_means,
)
from sdpid.experiment.inspection.kinds import Finding, found
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.recording.floating.base import BaseMotion, Imu
from sdpid.experiment.recording.recording import Recording

# An orientation that leaves more than half of a measured rate unexplained, or that is further off
# the vertical than any gait leans on average, is wrong ...
_WRONG_SHARE, _WRONG_TILT = 0.5, math.radians(30.0)
_WRONG = {"rates": _WRONG_SHARE, "tilt": _WRONG_TILT, "above": _WRONG_SHARE}
# ... and another reading is right where it leaves little of both. Noise of simulated legged robots
# leaves a few per cent.
_RIGHT_SHARE, _RIGHT_TILT = 0.2, math.radians(15.0)
_RIGHT = {"rates": _RIGHT_SHARE, "tilt": _RIGHT_TILT, "above": _RIGHT_SHARE}
# Of other axes, units and signs the best must be better by this factor.
_BETTER = 3.0
# Mean specific forces differ from gravity by noise, and by no more than this share.
_GRAVITY_SHARE = 0.05
_DEGREES = 180.0 / math.pi
# Where velocities in the other axes leave so much less, this share is told already: in a public log
# of a jump the right axes leave 0.04 %, the wrong ones 1.6 %.
_TOLD_SHARE = 0.003
# The base must move to show the axes of its velocity (m/s, rms).
_LEAST_SPEED = 0.02


@check
def orientation(subject: Subject) -> Iterator[Finding]:
    """Find quaternions in another order, or turned around."""
    if subject.based is None:
        return
    log, base = subject.based
    ways = feet_in_base(log, subject.floating)
    own, *others = (
        (name, evidence(log, quaternions, ways)) for name, quaternions in readings(base).items()
    )
    given = own[1]
    if not any(given[name] > _WRONG[name] for name in given):
        return
    # What is right agrees with all that there is, and better than the orientation.
    right = [
        name
        for name, seen in others
        if all(seen[each] <= _RIGHT[each] for each in seen)
        and any(seen[each] * _BETTER < given[each] for each in seen)
    ]
    if not right:
        return
    said = {
        "rates": "{:.3g} % of the measured turning is not that of the orientation (limit {:g} %)",
        "tilt": "the mean specific force points {:.3g}° off the vertical (limit {:.3g}°)",
        "above": "feet that are down are above the base in {:.3g} % of all",
    }
    sizes = {"rates": 100.0, "tilt": _DEGREES, "above": 100.0}
    seen = [
        words.format(sizes[name] * given[name], sizes[name] * _WRONG[name])
        for name, words in said.items()
        if name in given and (name != "above" or given[name] > _WRONG[name])
    ]
    numbers = {name: given.get(name, 0.0) for name in ("rates", "tilt")}
    yield found("base_orientation", seen=" and ".join(seen), right=" or ".join(right), **numbers)


@check
def unchanging_sensors(subject: Subject) -> Iterator[Finding]:
    """Find sensors of an IMU that show the same in every row."""
    imu = None if subject.based is None else subject.based[1].imu
    for sensor, values in ({} if imu is None else imu.channels).items():
        if np.any(np.ptp(values, axis=0)):
            continue
        shown = ", ".join(f"{value + 0.0:.4g}" for value in values[0])
        yield found(
            f"imu_{sensor}",
            what=f" never changes: it is ({shown}) in every row",
            remedy="if it was not measured, leave it out",
            size=float(np.linalg.norm(values[0])),
        )


def _changing(subject: Subject, sensor: str) -> tuple[Recording, BaseMotion, Imu, Array] | None:
    """Return the longest piece, its base, its IMU, and what a sensor shows, if that changes."""
    based = subject.based
    if based is None or (imu := based[1].imu) is None:
        return None
    values: Array | None = imu.channels.get(sensor)
    if values is None or not np.any(np.ptp(values, axis=0)):
        return None
    return (*based, imu, values)


@check
def gyroscope(subject: Subject) -> Iterator[Finding]:
    """Find a gyroscope with other axes, another unit, or that measures something else."""
    if (changing := _changing(subject, "gyroscope")) is None:
        return
    log, base, imu, values = changing
    wanted = turn_rates(base.orientation, log.step)
    sensed = window_means(values, log.step)
    measured = sensed @ imu.rotation.T
    if np.sqrt(np.mean(wanted**2)) < LEAST_RATE or np.sqrt(np.mean(measured**2)) < LEAST_RATE:
        return
    own = unexplained(wanted, measured)
    if own <= _WRONG_SHARE:
        return
    fits = [
        (unexplained(wanted, sensed @ axes.T @ imu.rotation.T / scale), axes, scale)
        for axes in signed_axes()
        for scale in (1.0, _DEGREES, -1.0 / _DEGREES)
    ]
    left, axes, scale = min(fits, key=lambda fit: fit[0])
    known = left < _RIGHT_SHARE and left * _BETTER < own
    better = ""
    if known:
        right = [] if np.array_equal(axes, np.eye(3)) else [axes_in_words(axes) + " measured"]
        right += ["it is in deg/s"] if scale == _DEGREES else []
        better = f"; {100 * left:.2g} % where {' and '.join(right)}"
    yield found(
        "imu_gyroscope",
        what=(
            f" leaves {100 * own:.3g} % of the orientation's turning unexplained, limit "
            f"{100 * _WRONG_SHARE:g} %{better}"
        ),
        remedy="give the sensor's axes (imu rotation) or its unit, or leave it out",
        unexplained=own,
        best=left,
        limit=_WRONG_SHARE,
    )


@check
def accelerometer(subject: Subject) -> Iterator[Finding]:
    """Find an accelerometer in g, with other axes, or without gravity."""
    if (changing := _changing(subject, "accelerometer")) is None:
        return
    log, base, imu, values = changing
    sensed = window_means(values, log.step)
    force = sensed @ imu.rotation.T
    turns = window_means(base.rotations.reshape(-1, 9), log.step).reshape(-1, 3, 3)
    mean = np.einsum("kij,kj->i", turns, force) / len(force)
    size = float(np.linalg.norm(mean))
    along = float(mean[2]) / max(size, 1e-12)
    if abs(size / GRAVITY - 1.0) <= _GRAVITY_SHARE and along > math.cos(_WRONG_TILT):
        return
    what = f"mean specific force is {size:.4g} m/s²"
    remedy = "correct it, or leave the accelerometer out"
    if abs(size - 1.0) <= _GRAVITY_SHARE:
        what, remedy = f"{what}: it is in g", "give its unit (units={'accelerometer': 'g'})"
    elif size < _GRAVITY_SHARE * GRAVITY:
        what = f"{what}: gravity is taken off"
        remedy = "log the specific force, +9.81 m/s² upward at rest, or leave it out"
    elif abs(size / GRAVITY - 1.0) > _GRAVITY_SHARE:
        what = f"{what}, {size / GRAVITY:.3g} times gravity (limit {1 - _GRAVITY_SHARE:g} to "
        what += f"{1 + _GRAVITY_SHARE:g})"
    if along <= math.cos(_WRONG_TILT):
        turned = imu.rotation.T
        ups = {axes_in_words(a): _upward(turns, sensed @ a.T @ turned) for a in signed_axes()}
        best = max(ups.values())
        named = next(name for name, up in ups.items() if up > best - 1e-3)
        angle = math.degrees(math.acos(max(-1.0, along)))
        what += f", and points {angle:.3g}° off the vertical (limit {math.degrees(_WRONG_TILT):.3g}"
        what += "°)"
        if along < -math.cos(_RIGHT_TILT):
            what += ": it has the opposite sign"
        elif best > math.cos(_RIGHT_TILT):
            what += f"; upright where {named} measured, among others"
    numbers = {"size": size, "upward": along, "limit": _GRAVITY_SHARE}
    yield found("imu_accelerometer", what=f": {what}", remedy=remedy, **numbers)


def _upward(turns: Array, force: Array) -> float:
    """Return the upward part of the mean direction of specific forces, at most 1."""
    mean = np.einsum("kij,kj->i", turns, force)
    return float(mean[2] / max(float(np.linalg.norm(mean)), 1e-12))


@check
def base_velocities(subject: Subject) -> Iterator[Finding]:
    """Find velocities of the base in other axes than said, or in other units."""
    if subject.based is None:
        return
    log, base = subject.based
    turns = base.rotations
    wanted: dict[str, Array] = {}
    if base.linear_velocity is not None and base.position is not None:
        means = window_means(np.gradient(base.position, log.step, axis=0), log.step)
        wanted["linear_velocity"] = means
    if base.angular_velocity is not None:
        in_base = turn_rates(base.orientation, log.step)
        middle = window_means(turns.reshape(-1, 9), log.step).reshape(-1, 3, 3)
        wanted["angular_velocity"] = np.einsum("kij,kj->ki", middle, in_base)
    for name, rates in wanted.items():
        least = _LEAST_SPEED if name == "linear_velocity" else LEAST_RATE
        if np.sqrt(np.mean(rates**2)) < least:
            continue
        given = np.asarray(getattr(base, name))
        other = "base" if base.velocity_frame == "world" else "world"
        frames = {
            "world": window_means(given, log.step),
            "base": window_means(np.einsum("kij,kj->ki", turns, given), log.step),
        }
        own = unexplained(rates, frames[str(base.velocity_frame)])
        left = unexplained(rates, frames[other])
        fits = left < _RIGHT_SHARE and left * _BETTER < own
        limit = _TOLD_SHARE if fits else _WRONG_SHARE
        if own <= limit:
            continue
        yield found(
            "base_velocity",
            velocity=name.replace("_", " "),
            axes=base.velocity_frame,
            pose="position" if name == "linear_velocity" else "orientation",
            better=f"; {100 * left:.2g} % where they are the {other}'s" if fits else "",
            unexplained=own,
            other=left,
            limit=limit,
        )


# Times without a closed contact that are shorter than this (s) say little about acceleration, and
# a small share of a log may be flags that close late.
_LEAST_TIME, _LEAST_SHARE = 0.3, 0.2
# A robot in the air feels nothing on average, one on the ground all of gravity.
_BORNE_SHARE = 0.5


@check
def contacts_missing(subject: Subject) -> Iterator[Finding]:
    """Find a robot that stands or walks, and of which no contact is said to be closed."""
    if subject.based is None:
        return
    log, _ = subject.based
    up, gravity = np.array([0.0, 0.0, 1.0]), GRAVITY
    if subject.floating is not None:
        vector = np.asarray(subject.floating.gravity)
        gravity = float(np.linalg.norm(vector))
        if gravity == 0.0:
            return
        up = -vector / gravity
    times, felt = [], []
    for run in _open_runs(log):
        specific = _specific_force(log, run, up, gravity)
        if specific is None:
            return
        times.append((run.stop - run.start) * log.step)
        felt.append(specific)
    share = sum(times) / (log.n_samples * log.step)
    if share < _LEAST_SHARE:
        return
    mean = float(np.average(felt, weights=times))
    if mean < _BORNE_SHARE * gravity:
        return
    said = "the recording has no contacts"
    if log.contacts is not None:
        said = f"no contact is closed for {100.0 * share:.3g} % of the time"
    limit = _BORNE_SHARE * gravity
    yield found(
        "contacts_missing",
        said=said,
        share=share,
        specific_force=mean,
        limit=limit,
        gravity=gravity,
    )


def _open_runs(log: Recording) -> list[slice]:
    """Return the times in which no contact is closed."""
    borne: Mask = np.zeros((log.n_samples, 1), dtype=np.bool_)
    if log.contacts is not None:
        borne = log.contacts.closed
    in_air = (~borne).all(axis=1)
    edges = np.flatnonzero(np.diff(np.pad(in_air.astype(np.int8), 1)))
    runs = [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
    return [run for run in runs if (run.stop - run.start) * log.step >= _LEAST_TIME]


def _specific_force(log: Recording, run: slice, up: Array, gravity: float) -> float | None:
    """Return the mean specific force upward, m/s², of what there is; None of nothing."""
    assert log.base is not None
    base = log.base.rows(run)
    time = log.step * np.arange(base.n_samples)
    sensed = base.sensed("accelerometer")
    if sensed is not None:
        return float(np.einsum("kij,kj->ki", base.rotations, sensed).mean(axis=0) @ up)
    if base.linear_velocity is not None:
        velocity = base.linear_velocity
        if base.velocity_frame == "base":
            velocity = np.einsum("kij,kj->ki", base.rotations, velocity)
        return float(np.polyfit(time, velocity @ up, 1)[0]) + gravity
    if base.position is not None:
        return 2.0 * float(np.polyfit(time, base.position @ up, 2)[0]) + gravity
    return None
