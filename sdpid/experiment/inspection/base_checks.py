"""Check that orientation, velocities and IMU of a base agree, and that it falls or is borne."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import permutations, product
from typing import TYPE_CHECKING

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.experiment.inspection.kinds import KINDS, Finding, found, refuse, warning
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.recording.floating import BaseMotion, Imu
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.contacts.jacobians import frame_places
from sdpid.robot.model.model import RobotModel

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

KINDS.update(
    base_orientation=refuse(
        "orientation of the base is no quaternion x y z w from base to world: {seen}; both agree "
        "where it is read as {right}",
        "read it in its order (base={{'quaternion': 'wxyz'}}), or give the inverse",
        hides=("base", "imu", "feet", "late"),
        spoils=True,
    ),
    base_velocity=warning(
        "{velocity} of the base, said to be in {axes} axes, leaves {unexplained:.3g %} of the rate "
        "of its {pose} unexplained, limit {limit:g %}{better}",
        "say its axes (velocity_frame) or its unit, or leave it out",
        spoils=True,
        about="base",
    ),
    # A sensor that is far off would seem to have all other mistakes.
    imu_gyroscope=warning(
        "gyroscope of the base{what}", "{remedy}", hides=("imu",), spoils=True, about="base"
    ),
    imu_accelerometer=warning(
        "accelerometer of the base{what}", "{remedy}", hides=("imu",), spoils=True, about="base"
    ),
    contacts_missing=refuse(
        "{said}, and the robot does not fall: its mean specific force upward is then "
        "{specific_force:.3g} m/s² (limit {limit:.3g}; gravity {gravity:.3g})",
        "give what bears it, Recording.contacts: flags, forces or wrenches; of a base that is "
        "held, log.with_held_base(link)",
        spoils=True,
    ),
)

GRAVITY = 9.80665
# Rates below this (rad/s, rms) are noise of the orientation.
LEAST_RATE = 0.05
# Means over this time (s) make rates of noisy orientations comparable.
_WINDOW = 0.02
# Rows at which places of feet are looked at.
_ROWS = 200
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
# A mirrored gyroscope, whose axes no rotation mends, is told from this share on, where a mirror
# leaves so much less.
_MIRROR_SHARE, _MIRROR_BETTER = 0.02, 10.0
# Mean specific forces differ from gravity by noise, and by no more than this share.
_GRAVITY_SHARE = 0.05
_DEGREES = 180.0 / math.pi
# Where velocities in the other axes leave so much less, this share is told already: in a public log
# of a jump the right axes leave 0.04 %, the wrong ones 1.6 %.
_TOLD_SHARE = 0.003
# The base must move to show the axes of its velocity (m/s, rms).
_LEAST_SPEED = 0.02
# Times without a closed contact that are shorter than this (s) say little about acceleration, and
# a small share of a log may be flags that close late.
_LEAST_TIME, _LEAST_SHARE = 0.3, 0.2
# A robot in the air feels nothing on average, one on the ground all of gravity.
_BORNE_SHARE = 0.5


def rms(values: Array) -> float:
    """Return the root mean square of all values."""
    return float(np.sqrt(np.mean(values**2)))


def _turns(base: BaseMotion) -> Rotation:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.asarray(base.orientation))


def _turn_rates(turns: Rotation, step: float, axes: str = "base") -> Array:
    """Return the mean angular velocity of each window in some axes, (windows, 3), rad/s."""
    width = max(1, round(_WINDOW / step))
    ends = turns[::width]
    rates = (ends[:-1].inv() * ends[1:]).as_rotvec() / (width * step)
    return np.asarray(rates if axes == "base" else ends[:-1].apply(rates))


def _window_means(table: Array, step: float) -> Array:
    """Return the means over the windows of `_turn_rates`, (windows, columns)."""
    width = max(1, round(_WINDOW / step))
    count = (len(table) - 1) // width
    return np.asarray(table[: count * width].reshape(count, width, -1).mean(axis=1))


def _unexplained(measured: Array, wanted: Array) -> float:
    """Return the share of a signal's mean square that another one does not explain."""
    power = float(np.mean(measured**2))
    return float(np.mean((measured - wanted) ** 2)) / power if power > 0.0 else 0.0


def _signed_axes() -> Iterator[tuple[str, Array, bool]]:
    """Yield the 48 matrices that exchange axes and turn signs, in words, and which of them mirror.

    The unit matrix is first.
    """
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            names = (
                "-" * (sign < 0) + "xyz"[axis] for axis, sign in zip(order, signs, strict=True)
            )
            matrix = np.eye(3)[list(order)] * np.array(signs)[:, None]
            mirrors = bool(np.linalg.det(matrix) < 0.0)
            yield f"x, y, z are {', '.join(names)} measured", matrix, mirrors


def _evidence(
    log: Recording, turns: Rotation, feet: tuple[Indices, Array] | None
) -> dict[str, float]:
    """Return how badly an orientation agrees with what else was measured; only what there is.

    ``"rates"`` is the share of the measured angular velocity that it leaves unexplained, ``"tilt"``
    the angle between the mean specific force and the world's upward axis, rad, ``"above"`` the
    share of feet that are down and above the base's origin, of all times.
    """
    base, seen = log.base, {}
    assert base is not None
    wanted = _turn_rates(turns, log.step)
    force, turned = base.sensed("accelerometer"), base.angular_velocity
    if turned is not None and base.velocity_frame == "world":
        turned = turns.inv().apply(np.array(turned))
    shown = [each for each in (base.sensed("gyroscope"), turned) if each is not None]
    means = [_window_means(np.asarray(each), log.step) for each in shown]
    # Of a base that hardly turns rates say nothing.
    shares = [_unexplained(each, wanted) for each in means if rms(each) >= LEAST_RATE]
    if shares:
        seen["rates"] = min(shares)
    if force is not None and np.any(force):  # Zeros point nowhere.
        seen["tilt"] = math.acos(_upward(turns.apply(np.array(force)).mean(axis=0)))
    if feet is not None:
        rows, places = feet
        seen["above"] = float(np.mean(turns[rows].apply(places)[:, 2] > 0.0))
    return seen


def _feet_in_base(log: Recording, robot: RobotModel | None) -> tuple[Indices, Array] | None:
    """Return rows of the recording and places (x, y, z) in the base of feet that are down."""
    contacts = log.contacts
    if robot is None or contacts is None or contacts.down is None or not robot.free_flyer:
        return None
    rows = np.unique(np.linspace(0, log.n_samples - 1, _ROWS).astype(np.intp))
    down = contacts.down[rows]
    if robot.pin_model.nq != 7 + log.n or not down.any():
        return None
    still = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (len(rows), 1))
    places = frame_places(robot, np.hstack([still, log.position[rows]]), contacts.frames)
    return np.broadcast_to(rows[:, None], down.shape)[down], places[down]


@check
def orientation(subject: Subject) -> Iterator[Finding]:
    """Find quaternions in another order, or turned around."""
    from scipy.spatial.transform import Rotation

    if subject.based is None:
        return
    log, base = subject.based
    turns = _turns(base)
    rolled = Rotation.from_quat(np.roll(base.orientation, -1, axis=1))
    readings = {
        "in the order w x y z": rolled,
        "the inverse": turns.inv(),
        "the inverse, in the order w x y z": rolled.inv(),
    }
    feet = _feet_in_base(log, subject.floating)
    given = _evidence(log, turns, feet)
    if not any(given[name] > _WRONG[name] for name in given):
        return
    # What is right agrees with all that there is, and better than the orientation.
    right = []
    for name, turns in readings.items():
        seen = _evidence(log, turns, feet)
        agrees = all(seen[each] <= _RIGHT[each] for each in seen)
        if agrees and any(seen[each] * _BETTER < given[each] for each in seen):
            right.append(name)
    if not right:
        return
    words = {
        "rates": "{:.3g} % of the measured turning is not that of the orientation (limit {:g} %)",
        "tilt": "the mean specific force points {:.3g}° off the vertical (limit {:.3g}°)",
        "above": "feet that are down are above the base in {:.3g} % of all",
    }
    sizes = {"rates": 100.0, "tilt": _DEGREES, "above": 100.0}
    said = [
        text.format(sizes[name] * given[name], sizes[name] * _WRONG[name])
        for name, text in words.items()
        if name in given and (name != "above" or given[name] > _WRONG[name])
    ]
    numbers = {name: given.get(name, 0.0) for name in ("rates", "tilt")}
    yield found("base_orientation", seen=" and ".join(said), right=" or ".join(right), **numbers)


@check
def imu_channels(subject: Subject) -> Iterator[Finding]:
    """Find sensors with other axes or units, that measure something else, or never change."""
    based = subject.based
    if based is None or (imu := based[1].imu) is None:
        return
    compared = {"gyroscope": _gyroscope, "accelerometer": _accelerometer}
    for sensor, values in imu.channels.items():
        if np.any(np.ptp(values, axis=0)):
            yield from compared[sensor](based[0], _turns(based[1]), imu, np.asarray(values))
            continue
        shown = ", ".join(f"{value + 0.0:.4g}" for value in values[0])
        yield found(
            f"imu_{sensor}",
            what=f" never changes: it is ({shown}) in every row",
            remedy="if it was not measured, leave it out",
            size=float(np.linalg.norm(values[0])),
        )


def _gyroscope(log: Recording, turns: Rotation, imu: Imu, values: Array) -> Iterator[Finding]:
    """Find a gyroscope with other axes, another unit, or that measures something else."""
    wanted, sensed = _turn_rates(turns, log.step), _window_means(values, log.step)
    own = _unexplained(wanted, sensed @ imu.rotation.T)
    if min(rms(wanted), rms(sensed)) < LEAST_RATE or own <= _MIRROR_SHARE:
        return
    left, axes, scale, mirrored = min(
        (
            (_unexplained(wanted, sensed @ axes.T @ imu.rotation.T / scale), name, scale, mirrors)
            for name, axes, mirrors in _signed_axes()
            for scale in (1.0, _DEGREES, -1.0 / _DEGREES)
        ),
        key=lambda each: each[0],
    )
    limit = _MIRROR_SHARE if mirrored and left * _MIRROR_BETTER < own else _WRONG_SHARE
    if own <= limit:
        return
    better = ""
    if left < _RIGHT_SHARE and left * _BETTER < own:
        right = [axes] if axes != next(_signed_axes())[0] else []
        right += ["it is in deg/s"] if scale == _DEGREES else []
        better = f"; {100 * left:.2g} % where {' and '.join(right)}"
    yield found(
        "imu_gyroscope",
        what=(
            f" leaves {100 * own:.3g} % of the orientation's turning unexplained, limit "
            f"{100 * limit:g} %{better}"
        ),
        remedy="give the sensor's axes (imu rotation) or its unit, or leave it out",
        unexplained=own,
        best=left,
        limit=limit,
    )


def _accelerometer(_: Recording, turns: Rotation, imu: Imu, values: Array) -> Iterator[Finding]:
    """Find an accelerometer in g, with other axes, or without gravity."""
    # Means of what each axis of the sensor would be along each of the base's, in the world's axes.
    means = np.einsum("kij,kl->ijl", turns.as_matrix(), values) / len(values)
    mean = np.einsum("ijl,jl->i", means, imu.rotation)
    size, along = float(np.linalg.norm(mean)), _upward(mean)
    off = abs(size / GRAVITY - 1.0) > _GRAVITY_SHARE
    if not off and along > math.cos(_WRONG_TILT):
        return
    what, remedy = f": mean specific force is {size:.4g} m/s²", "correct it, or leave the "
    remedy += "accelerometer out"
    if abs(size - 1.0) <= _GRAVITY_SHARE:
        what, remedy = f"{what}: it is in g", "give its unit (units={'accelerometer': 'g'})"
    elif size < _GRAVITY_SHARE * GRAVITY:
        what = f"{what}: gravity is taken off"
        remedy = "log the specific force, +9.81 m/s² upward at rest, or leave it out"
    elif off:
        what = f"{what}, {size / GRAVITY:.3g} times gravity (limit {1 - _GRAVITY_SHARE:g} to "
        what += f"{1 + _GRAVITY_SHARE:g})"
    if along <= math.cos(_WRONG_TILT):
        what += f", and points {_DEGREES * math.acos(along):.3g}° off the vertical (limit "
        what += f"{_DEGREES * _WRONG_TILT:.3g}°)"
        ups = {
            name: _upward(np.einsum("ijl,jl->i", means, imu.rotation @ axes))
            for name, axes, _ in _signed_axes()
        }
        best = max(ups.values())
        if along < -math.cos(_RIGHT_TILT):
            what += ": it has the opposite sign"
        elif best > math.cos(_RIGHT_TILT):
            named = next(name for name, up in ups.items() if up > best - 1e-3)
            what += f"; upright where {named}, among others"
    numbers = {"size": size, "upward": along, "limit": _GRAVITY_SHARE}
    yield found("imu_accelerometer", what=what, remedy=remedy, **numbers)


def _upward(mean: Array) -> float:
    """Return the cosine of a vector's angle to the vertical."""
    return min(1.0, max(-1.0, float(mean[2] / max(float(np.linalg.norm(mean)), 1e-12))))


@check
def base_velocities(subject: Subject) -> Iterator[Finding]:
    """Find velocities of the base in other axes than stated, or in other units."""
    if subject.based is None:
        return
    log, base = subject.based
    turns, step = _turns(base), log.step
    compared: list[tuple[str, str, float, Array | None, Array]] = []
    if base.position is not None:
        rates = _window_means(np.gradient(base.position, step, axis=0), step)
        compared.append(("linear velocity", "position", _LEAST_SPEED, base.linear_velocity, rates))
    rates = _turn_rates(turns, step, "world")
    compared.append(("angular velocity", "orientation", LEAST_RATE, base.angular_velocity, rates))
    for name, pose, least, values, rates in compared:
        if values is None or rms(rates) < least:
            continue
        given = np.array(values)
        frames = {"world": given, "base": turns.apply(given)}
        shares = {key: _unexplained(rates, _window_means(x, step)) for key, x in frames.items()}
        own = shares.pop(str(base.velocity_frame))
        ((other, left),) = shares.items()
        fits = left < _RIGHT_SHARE and left * _BETTER < own
        limit = _TOLD_SHARE if fits else _WRONG_SHARE
        if own <= limit:
            continue
        yield found(
            "base_velocity",
            velocity=name,
            axes=base.velocity_frame,
            pose=pose,
            better=f"; {100 * left:.2g} % where they are the {other}'s" if fits else "",
            unexplained=own,
            other=left,
            limit=limit,
        )


@check
def contacts_missing(subject: Subject) -> Iterator[Finding]:
    """Find a robot that stands or walks while no contact is recorded as closed."""
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
    closed = np.zeros((log.n_samples, 1)) if log.contacts is None else log.contacts.closed
    in_air = ~np.any(closed, axis=1)
    edges = np.flatnonzero(np.diff(np.pad(in_air.astype(np.int8), 1))).reshape(-1, 2).tolist()
    runs = [slice(a, b) for a, b in edges if (b - a) * log.step >= _LEAST_TIME]
    felt = [_specific_force(log, run, up, gravity) for run in runs]
    counts = [run.stop - run.start for run in runs]
    share = sum(counts) / log.n_samples
    known = [each for each in felt if each is not None]
    if share < _LEAST_SHARE or len(known) < len(felt):
        return
    mean, limit = float(np.average(known, weights=counts)), _BORNE_SHARE * gravity
    if mean < limit:
        return
    said = "the recording has no contacts"
    if log.contacts is not None:
        said = f"no contact is closed for {100.0 * share:.3g} % of the time"
    numbers = {"share": share, "specific_force": mean, "limit": limit, "gravity": gravity}
    yield found("contacts_missing", said=said, **numbers)


def _specific_force(log: Recording, run: slice, up: Array, gravity: float) -> float | None:
    """Return the mean specific force upward, m/s², of what there is; None of nothing."""
    assert log.base is not None
    base = log.base.rows(run)
    time, turns = log.step * np.arange(base.n_samples), _turns(base)
    sensed = base.sensed("accelerometer")
    if sensed is not None:
        return float(turns.apply(np.array(sensed)).mean(axis=0) @ up)
    if base.linear_velocity is not None:
        velocity = np.array(base.linear_velocity)
        if base.velocity_frame == "base":
            velocity = turns.apply(velocity)
        return float(np.polyfit(time, velocity @ up, 1)[0]) + gravity
    if base.position is not None:
        return 2.0 * float(np.polyfit(time, base.position @ up, 2)[0]) + gravity
    return None
