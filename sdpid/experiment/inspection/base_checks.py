"""Check that orientation, velocities and IMU of a base agree, and that it falls or is borne.

What is far off with a sensor of the IMU is told by its mean, or by the axes in which it turns as
the pose does: axes, signs and units. What is a little off, its turn, place, biases and scales, is
fitted against rates of the pose.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import permutations, product
from typing import TYPE_CHECKING

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.experiment.inspection.block_fit import SURE, BlockFit, block_fit, sure_part
from sdpid.experiment.inspection.delays import LEAST_RATE, imu_against_pose, rms, without_delays
from sdpid.experiment.inspection.kinds import KINDS, Finding, found, refuse, vector, warning
from sdpid.experiment.inspection.rows import SLOPES, smoother, turning
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.processing.filters import correlated
from sdpid.experiment.recording.floating import BaseMotion, Imu
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.stored import middle
from sdpid.robot.inertia import skew
from sdpid.robot.model.jacobians import frame_places
from sdpid.robot.model.model import RobotModel

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

_DELAYS = "delays are told once this is mended"
_SHOWN = "as the pose shows (standard error"
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
    imu_axes=warning(
        f"axes of the {{sensor}} are turned by {{angle:.3g °}} about {{about}} of the base against "
        f"those stated, {_SHOWN} {{error:.2g °}}, limit {{limit:.2g °}}); {_DELAYS}",
        "give the IMU's rotation=[{rows}]",
        hides=("late",),
        about="imu",
    ),
    imu_place=warning(
        "the {sensor} sits at {place} m in the base's frame, {distance:.3g} m from where it is "
        f"said to be, {_SHOWN} {{error:.2g}} m, limit {{limit:g}} m); {_DELAYS}",
        "give the IMU's translation={place}",
        hides=("late",),
        about="imu",
    ),
    imu_bias=warning(
        f"the {{sensor}} shows {{value}} {{unit}} too much along its axes, {_SHOWN} {{error:.2g}}, "
        "limit {limit:g}){also}",
        "take it off the {sensor}",
        about="imu",
    ),
    imu_scale=warning(
        "the {sensor} shows {scale:.4g} times what the pose does (standard error {error:.2g}, "
        "limit {least:g} to {most:g})",
        "divide the {sensor} by it",
        about="imu",
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
# Means over this time (s) make rates of noisy orientations comparable.
_WINDOW = 0.02
# Rows at which places of feet are looked at.
_ROWS = 200
_DEGREES = 180.0 / math.pi
# An orientation that leaves more than half of a measured rate unexplained, or that is further off
# the vertical than any gait leans on average, is wrong, and another reading is right where it
# leaves little of both. Noise of simulated legged robots leaves a few per cent.
_WRONG_SHARE, _WRONG_TILT = 0.5, math.radians(30.0)
_RIGHT_SHARE, _RIGHT_TILT = 0.2, math.radians(15.0)
# What shows an orientation: both limits, how it is told, and in what unit.
_EVIDENCE = {
    "rates": (
        *(_WRONG_SHARE, _RIGHT_SHARE),
        "{:.3g} % of the measured turning is not that of the orientation (limit {:g} %)",
        100.0,
    ),
    "tilt": (
        *(_WRONG_TILT, _RIGHT_TILT),
        "the mean specific force points {:.3g}° off the vertical (limit {:.3g}°)",
        _DEGREES,
    ),
    "above": (
        *(_WRONG_SHARE, _RIGHT_SHARE),
        "feet that are down are above the base in {:.3g} % of all",
        100.0,
    ),
}
# Of other axes, units and signs the best must be better by this factor.
_BETTER = 3.0
# A mirrored gyroscope, whose axes no rotation mends, is told from this share on, where a mirror
# leaves so much less.
_MIRROR_SHARE, _MIRROR_BETTER = 0.02, 10.0
# Mean specific forces differ from gravity by noise, and by no more than this share.
_GRAVITY_SHARE = 0.05
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


def _turns(quaternions: Array) -> Rotation:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quaternions)


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


def _upward(mean: Array) -> float:
    """Return the cosine of a vector's angle to the vertical."""
    return min(1.0, max(-1.0, float(mean[2] / max(float(np.linalg.norm(mean)), 1e-12))))


def _signed_axes() -> Iterator[tuple[str, Array, bool]]:
    """Yield the 48 matrices that exchange axes and turn signs, in words, and which of them mirror.

    The unit matrix is first.
    """
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        names = ("-" * (sign < 0) + "xyz"[axis] for axis, sign in zip(order, signs, strict=True))
        matrix = np.diag(signs) @ np.eye(3)[list(order)]
        mirrors = bool(np.linalg.det(matrix) < 0.0)
        yield f"x, y, z are {', '.join(names)} measured", matrix, mirrors


def _evidence(
    base: BaseMotion, step: float, turns: Rotation, feet: tuple[Indices, Array] | None
) -> dict[str, float]:
    """Return how badly an orientation agrees with what else was measured; only what there is.

    ``"rates"`` is the share of the measured angular velocity that it leaves unexplained, ``"tilt"``
    the angle between the mean specific force and the world's upward axis, rad, ``"above"`` the
    share of feet that are down and above the base's origin, of all times.
    """
    seen, force, turned = {}, base.sensed("accelerometer"), base.angular_velocity
    if turned is not None and base.velocity_frame == "world":
        turned = turns.inv().apply(np.array(turned))
    shown = [each for each in (base.sensed("gyroscope"), turned) if each is not None]
    means = [_window_means(each, step) for each in shown]
    wanted = _turn_rates(turns, step)
    # Of a base that hardly turns rates say nothing.
    if shares := [_unexplained(each, wanted) for each in means if rms(each) >= LEAST_RATE]:
        seen["rates"] = min(shares)
    if force is not None and np.any(force):  # Zeros point nowhere.
        seen["tilt"] = math.acos(_upward(turns.apply(force).mean(axis=0)))
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
    places = frame_places(robot, robot.at_rest(log.position[rows]), contacts.frames)
    return np.broadcast_to(rows[:, None], down.shape)[down], places[down]


@check("longest", "base")
def orientation(subject: Subject, log: Recording, base: BaseMotion) -> Iterator[Finding]:
    """Find quaternions in another order, or turned around."""
    turns, rolled = _turns(base.orientation), _turns(np.roll(base.orientation, -1, axis=1))
    readings = {
        "in the order w x y z": rolled,
        "the inverse": turns.inv(),
        "the inverse, in the order w x y z": rolled.inv(),
    }
    feet = _feet_in_base(log, subject.floating)
    given = _evidence(base, log.step, turns, feet)
    wrong = {name: seen > _EVIDENCE[name][0] for name, seen in given.items()}
    if not any(wrong.values()):
        return
    # What is right agrees with all that there is, and better than the orientation.
    right = []
    for name, turns in readings.items():
        seen = _evidence(base, log.step, turns, feet)
        agrees = all(seen[each] <= _EVIDENCE[each][1] for each in seen)
        if agrees and any(seen[each] * _BETTER < given[each] for each in seen):
            right.append(name)
    if right:
        said = [
            text.format(size * given[name], size * limit)
            for name, (limit, _, text, size) in _EVIDENCE.items()
            if name in given and (name != "above" or wrong[name])
        ]
        numbers = {name: given.get(name, 0.0) for name in ("rates", "tilt")}
        told = {"seen": " and ".join(said), "right": " or ".join(right)}
        yield found("base_orientation", **told, **numbers)


@check("longest", "base", "imu")
def imu_channels(subject: Subject, log: Recording, base: BaseMotion, imu: Imu) -> Iterator[Finding]:
    """Find sensors with other axes or units, that measure something else, or never change."""
    turns = _turns(base.orientation)
    for sensor, values in imu.channels.items():
        if not np.any(np.ptp(values, axis=0)):
            what = f" never changes: it is {vector(values[0])} in every row"
            size, remedy = np.linalg.norm(values[0]), "if it was not measured, leave it out"
            yield found(f"imu_{sensor}", what=what, remedy=remedy, size=size)
        elif sensor == "gyroscope":
            yield from _gyroscope(log, turns, imu, values)
        else:
            yield from _accelerometer(turns, imu, values)


def _gyroscope(log: Recording, turns: Rotation, imu: Imu, values: Array) -> Iterator[Finding]:
    """Find a gyroscope with other axes, another unit, or that measures something else."""
    wanted, sensed = _turn_rates(turns, log.step), _window_means(values, log.step)
    own = _unexplained(wanted, sensed @ imu.rotation.T)
    if min(rms(wanted), rms(sensed)) < LEAST_RATE or own <= _MIRROR_SHARE:
        return
    tried = (
        (_unexplained(wanted, sensed @ axes.T @ imu.rotation.T / scale), name, scale, mirrors)
        for name, axes, mirrors in _signed_axes()
        for scale in (1.0, _DEGREES, -1.0 / _DEGREES)
    )
    left, axes, scale, mirrored = min(tried, key=lambda each: each[0])
    limit = _MIRROR_SHARE if mirrored and left * _MIRROR_BETTER < own else _WRONG_SHARE
    if own <= limit:
        return
    better = ""
    if left < _RIGHT_SHARE and left * _BETTER < own:
        right = [axes] if axes != next(_signed_axes())[0] else []
        right += ["it is in deg/s"] if scale == _DEGREES else []
        better = f"; {100 * left:.2g} % where {' and '.join(right)}"
    what = f" leaves {100 * own:.3g} % of the orientation's turning unexplained, limit "
    what += f"{100 * limit:g} %{better}"
    remedy = "give the sensor's axes (imu rotation) or its unit, or leave it out"
    numbers = {"unexplained": own, "best": left, "limit": limit}
    yield found("imu_gyroscope", what=what, remedy=remedy, **numbers)


def _accelerometer(turns: Rotation, imu: Imu, values: Array) -> Iterator[Finding]:
    """Find an accelerometer in g, with other axes, or without gravity."""
    # Means of what each axis of the sensor would be along each of the base's, in the world's axes.
    means = np.einsum("kij,kl->ijl", turns.as_matrix(), values) / len(values)
    mean = np.einsum("ijl,jl->i", means, imu.rotation)
    size, along = float(np.linalg.norm(mean)), _upward(mean)
    off = abs(size / GRAVITY - 1.0) > _GRAVITY_SHARE
    if not off and along > math.cos(_WRONG_TILT):
        return
    what = f": mean specific force is {size:.4g} m/s²"
    remedy = "correct it, or leave the accelerometer out"
    if abs(size - 1.0) <= _GRAVITY_SHARE:
        what, remedy = f"{what}: it is in g", "give its unit (units={'accelerometer': 'g'})"
    elif size < _GRAVITY_SHARE * GRAVITY:
        what = f"{what}: gravity is taken off"
        remedy = "log the specific force, +9.81 m/s² upward at rest, or leave it out"
    elif off:
        least, most = 1.0 - _GRAVITY_SHARE, 1.0 + _GRAVITY_SHARE
        what += f", {size / GRAVITY:.3g} times gravity (limit {least:g} to {most:g})"
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


@check("longest", "base")
def base_velocities(subject: Subject, log: Recording, base: BaseMotion) -> Iterator[Finding]:
    """Find velocities of the base in other axes than stated, or in other units."""
    turns, compared, step = _turns(base.orientation), [], log.step
    if base.linear_velocity is not None and base.position is not None:
        rates = _window_means(np.gradient(base.position, step, axis=0), step)
        compared.append(("linear velocity", "position", _LEAST_SPEED, base.linear_velocity, rates))
    if base.angular_velocity is not None:
        rates = _turn_rates(turns, step, "world")
        given = base.angular_velocity
        compared.append(("angular velocity", "orientation", LEAST_RATE, given, rates))
    for name, pose, least, given, rates in compared:
        frames = {"world": given, "base": turns.apply(np.array(given))}
        shares = {key: _unexplained(rates, _window_means(x, step)) for key, x in frames.items()}
        own = shares.pop(str(base.velocity_frame))
        ((other, left),) = shares.items()
        fits = left < _RIGHT_SHARE and left * _BETTER < own
        limit = _TOLD_SHARE if fits else _WRONG_SHARE
        if rms(rates) >= least and own > limit:
            better = f"; {100 * left:.2g} % where they are the {other}'s" if fits else ""
            words = {"velocity": name, "axes": base.velocity_frame, "pose": pose, "better": better}
            yield found("base_velocity", **words, unexplained=own, other=left, limit=limit)


def _pull(subject: Subject) -> Array:
    """Return gravity in the world's axes, m/s²: that of the robot, where it is known."""
    robot = subject.floating
    return np.array([0.0, 0.0, -GRAVITY]) if robot is None else np.asarray(robot.gravity)


@check("longest", "base")
def contacts_missing(subject: Subject, log: Recording, base: BaseMotion) -> Iterator[Finding]:
    """Find a robot that stands or walks while no contact is recorded as closed."""
    pull = _pull(subject)
    gravity = float(np.linalg.norm(pull))
    if gravity == 0.0:
        return
    closed = np.zeros((log.n_samples, 1)) if log.contacts is None else log.contacts.closed
    in_air = ~np.any(closed, axis=1)
    edges = np.flatnonzero(np.diff(np.pad(in_air.astype(np.int8), 1))).reshape(-1, 2).tolist()
    runs = [slice(a, b) for a, b in edges if (b - a) * log.step >= _LEAST_TIME]
    felt = [_specific_force(base.rows(run), log.step, -pull / gravity, gravity) for run in runs]
    counts = [run.stop - run.start for run in runs]
    share = sum(counts) / log.n_samples
    known = [each for each in felt if each is not None]
    if share < _LEAST_SHARE or len(known) < len(felt):
        return
    mean, limit = float(np.average(known, weights=counts)), _BORNE_SHARE * gravity
    if mean >= limit:
        said = "the recording has no contacts"
        if log.contacts is not None:
            said = f"no contact is closed for {100.0 * share:.3g} % of the time"
        numbers = {"share": share, "specific_force": mean, "limit": limit, "gravity": gravity}
        yield found("contacts_missing", said=said, **numbers)


def _specific_force(base: BaseMotion, step: float, up: Array, gravity: float) -> float | None:
    """Return the mean specific force upward, m/s², of what there is; None of nothing."""
    time, turns = step * np.arange(base.n_samples), _turns(base.orientation)
    if (sensed := base.sensed("accelerometer")) is not None:
        return float(turns.apply(sensed).mean(axis=0) @ up)
    if (velocity := base.linear_velocity) is not None:
        if base.velocity_frame == "base":
            velocity = turns.apply(np.array(velocity))
        return float(np.polyfit(time, velocity @ up, 1)[0]) + gravity
    if base.position is not None:
        return 2.0 * float(np.polyfit(time, base.position @ up, 2)[0]) + gravity
    return None


# Samples that are looked at of an IMU, from the middle of longer recordings, and least number of
# memories of the filter.
_READ, _LEAST = 40_000, 12
# Delays above this (s) are taken off first, as differences do not hold for long ones.
_LATE = 0.002
# Samples for each period of the cut-off are enough.
_SAMPLES = 10.0
# Cut-offs (Hz): rates of a pose are noisy, their rates are noisier.
_CUTOFFS_HZ = {"gyroscope": 15.0, "accelerometer": 10.0}
# Told from five standard errors on and from this size: turned by 3°, placed 1 cm off, 0.1 m/s²
# (0.05 rad/s) or 2 % off. Right logs of three quadrupeds are off by 3.2 errors at most; an
# accelerometer 5 cm off costs 1.2 %.
_OF_BOTH = {"scale": 0.02, "axes": np.radians(3.0), "late": np.inf}
_SIZES = {
    "gyroscope": {"bias": 0.05, **_OF_BOTH},
    "accelerometer": {"bias": 0.1, **_OF_BOTH, "place": 0.01},
}
# Columns of what may be wrong, and how far off it is at most: m/s² (rad/s), 1, rad, s, m. The delay
# is told elsewhere.
_AT = {"bias": (0, 1, 2), "scale": (3,), "axes": (4, 5, 6), "late": (7,), "place": (8, 9, 10)}
_MOST = np.repeat([20.0, 2.0, np.pi, 0.1, 2.0], [3, 1, 3, 1, 3])
# Turns are linearized anew so often.
_ROUNDS = 5
# A turn far from what was stated has to leave less than this of what one nearby leaves.
_CLEARLY = 0.8


def sensor_fit(
    log: Recording, sensor: str, gravity: float, stated: Array
) -> tuple[dict[str, tuple[Array, float]], Array, bool]:
    """Compare a sensor with the pose: what is wrong with it, its turn, and whether the base rests.

    In the world's axes, with the base's orientation R and position p, the sensor's place r, the
    upward axis z and the angular velocity w, a gyroscope shows ``R·w``, and an accelerometer
    ``p'' + R''·r + g·z``: what is filtered alike on both sides stays equal, with no velocity of the
    base and no product of rates. All that may be wrong is fitted at once, turns from the one stated
    and from the nearest one of the signals [schonemann1966]_. A level base hardly tells
    a tilt, or a scale, from a bias: where these are not sure the sensor is taken to have none.

    Parameters
    ----------
    log : Recording
        With a base.
    sensor : {"gyroscope", "accelerometer"}
    gravity : float
        m/s².
    stated : (3, 3) ndarray
        The turn of the sensor from which a change is told.

    Returns
    -------
    wrong : dict of str to tuple
        The change from what was stated to what the data show, in the base's axes, and the standard
        error of its least certain direction. In m of a place, m/s² or rad/s of a bias (what is
        sensed too much), 1 of a scale (likewise), rad of a turn.
    turn : (3, 3) ndarray
    rests : bool
    """
    from scipy.spatial.transform import Rotation

    base, cutoff, gyroscope = log.base, _CUTOFFS_HZ[sensor], sensor == "gyroscope"
    sensed, smooth = None if base is None else base.sensed(sensor), smoother(log, cutoff, _LEAST)
    if base is None or sensed is None or smooth is None or base.imu is None:
        return {}, stated, False
    if base.position is None and not gyroscope:
        return {}, stated, False
    low, inner = smooth
    kept = slice(inner.start, inner.stop, max(1, int(1.0 / (_SAMPLES * cutoff * log.step))))
    R, turns = base.rotations, turning(base, log.step)
    axes = low(R)
    swung = _second(axes, log.step)
    if base.position is None or gyroscope:
        wanted = low(np.einsum("kij,kj->ki", R, turns))
    else:
        wanted = _second(low(base.position), log.step) + swung @ base.imu.translation
        wanted[:, 2] += gravity
    # What each axis of the sensor would be along each of the base's, in the world's axes.
    along = low(np.einsum("kij,kl->kijl", R, sensed))
    rate = np.gradient(along, log.step, axis=0)
    axes, swung, wanted, along, rate = (x[kept] for x in (axes, swung, wanted, along, rate))

    def fit(turn: Array, columns: Indices) -> BlockFit:
        turned = along @ turn.T
        shown, late = (np.einsum("kijj->ki", each) for each in (turned, rate @ turn.T))
        of_axes = np.einsum("kijm,mjl->kil", turned, skew(np.eye(3)))
        every = np.concatenate([axes, shown[..., None], of_axes, -late[..., None], swung], axis=2)
        return block_fit(every[..., columns], shown - wanted, _MOST[columns])

    # At rest it has nothing but a bias; a gyroscope shows the same wherever it sits.
    rests = rms(low(turns)[kept]) < LEAST_RATE
    names = ["bias", "late"] if rests else [*_SIZES[sensor]]
    starts = [stated]
    if not rests:
        in_base = [np.einsum("kji,kj->ki", axes, x) for x in (wanted, np.einsum("kijj->ki", along))]
        # SciPy's own warns where vectors are along one axis; any turn about it is a start then.
        left, _, right = np.linalg.svd(in_base[0].T @ in_base[1])
        left[:, 2] *= np.sign(np.linalg.det(left @ right))
        starts.append(left @ right)
    wrong: dict[str, tuple[Array, float]] = {}
    for optional in ("axes", "scale", ""):
        columns = np.concatenate([_AT[name] for name in names])
        of_axes, ends = np.isin(columns, _AT["axes"]), []
        turned = "axes" in names
        for turn in starts if turned else (stated,):
            for _ in range(_ROUNDS if turned else 0):
                change = fit(turn, columns).values[of_axes]
                turn = Rotation.from_rotvec(change).as_matrix() @ turn
            ends.append((fit(turn, columns), turn))
        # Where few axes turn, others fit as well that are far from what was stated.
        near, far = ends[0], ends[-1]
        last, turn = far if far[0].left < _CLEARLY * near[0].left else near
        wrong = {}
        for name in names:
            own = np.isin(columns, _AT[name])
            value, covariance = last.values[own], last.covariance[np.ix_(own, own)]
            if name == "axes":
                value = value + Rotation.from_matrix(turn @ stated.T).as_rotvec()
            if (sure := sure_part(value, covariance, _SIZES[sensor][name])) is not None:
                wrong[name] = sure
        names = [name for name in names if name != optional or name in wrong]
    return wrong, turn if "axes" in wrong else stated, rests


def _second(values: Array, step: float) -> Array:
    """Return the second derivative of signals (N, ...)."""
    return correlated(values, SLOPES.second) / step**2


@check("longest", "imu")
def imu(subject: Subject, log: Recording, given: Imu) -> Iterator[Finding]:
    """Find an IMU that sits elsewhere, is turned, or whose sensors have biases or scales."""
    log = log.rows(middle(log.n_samples, _READ))
    late = imu_against_pose(log, axes=False)
    if late is not None and late.sure(_LATE, SURE):
        log = without_delays(log, {"imu": late})
    turn, gravity = np.eye(3), float(np.linalg.norm(_pull(subject))) or GRAVITY
    for sensor in _CUTOFFS_HZ:
        wrong, turn, rests = sensor_fit(log, sensor, gravity, turn)
        matrix = turn @ given.rotation
        for name, (value, error) in wrong.items():
            size, limit = float(np.linalg.norm(value)), _SIZES[sensor][name]
            fields = {"sensor": sensor, "error": error, "limit": limit}
            if name == "axes":
                rows = (", ".join(f"{x:.4f}" for x in row) for row in matrix.round(4) + 0.0)
                fields |= {"angle": size, "about": vector(value / size)}
                fields["rows"] = ", ".join(f"[{row}]" for row in rows)
            elif name == "place":
                fields |= {"place": given.translation + value, "distance": size}
            elif name == "bias":
                # At rest an axis that is tilted shows the same as a bias.
                tilt = "; axes that are tilted would show the same"
                fields["also"] = tilt if rests and sensor == "accelerometer" else ""
                fields["unit"] = "rad/s" if sensor == "gyroscope" else "m/s²"
                fields |= {"value": matrix.T @ value, "bias": size}
            else:
                fields |= {"least": 1.0 - limit, "most": 1.0 + limit}
                fields["scale"] = 1.0 / (1.0 - float(value[0]))
            yield found(f"imu_{name}", **fields)
