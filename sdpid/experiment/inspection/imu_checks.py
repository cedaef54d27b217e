"""Check an IMU's axes, place, biases and scales against the rates of its base's pose."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection import base_checks
from sdpid.experiment.inspection.block_fit import SURE, BlockFit, BlockSums, sure_part
from sdpid.experiment.inspection.delays.kinematic import Smooth, lag
from sdpid.experiment.inspection.evidence import GRAVITY, LEAST_RATE, axes_in_words, signed_axes
from sdpid.experiment.inspection.kinds import Finding, found, vector
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.processing.on_time import on_time as shifted
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.floating.base import Imu
from sdpid.experiment.recording.recording import Recording, rows_of
from sdpid.robot.inertia import skew

# Cut-offs (Hz): rates of a pose are noisy, their rates are noisier.
_RATE_HZ, _ACCELERATION_HZ = 15.0, 10.0
# Samples that are looked at, from the middle of longer recordings, and least number of memories of
# the filter.
_READ, _LEAST = 40_000, 12
# Delays above this (s) are taken off first, as differences do not hold for long ones.
_LATE = 0.002
# Samples for each period of the cut-off are enough.
_SAMPLES = 10.0
# Told from five standard errors on and from this size: turned by 3°, placed 1 cm off, 0.1 m/s²
# (0.05 rad/s) or 2 % off. Right logs of three quadrupeds are off by 3.2 errors at most; an
# accelerometer 5 cm off costs 1.2 %.
SIZES = {"place": 0.01, "bias": 0.1, "scale": 0.02, "axes": np.radians(3.0)}
RATE_BIAS = 0.05
# Nothing is farther off than this: m, m/s² (rad/s), 1, rad, s.
_MOST = {"place": 2.0, "bias": 20.0, "scale": 2.0, "axes": np.pi, "late": 0.1}
# A reflection is told where rotations leave this share of the turning, and it so much less.
_MIRROR_SHARE, _MIRROR_BETTER = 0.02, 10.0
# Columns of what may be wrong. That of the delay is always fitted: it is told elsewhere.
_GYROSCOPE = {"bias": (0, 1, 2), "scale": (3,), "axes": (4, 5, 6), "late": (7,)}
_ACCELEROMETER = {**_GYROSCOPE, "place": (8, 9, 10)}
# Turns are linearized anew so often.
_ROUNDS = 5
# A turn far from what was stated has to leave less than this of what one nearby leaves.
_CLEARLY = 0.8
# Of what explains this share of what the best does, the first is taken: a level base does not tell
# an axis that is tilted from a bias.
_RIVAL = 0.5
_ORDER_OF_BLAME = ("place", "bias", "scale", "axes")


# What is wrong with a sensor, with the standard error of its least certain direction: the change
# from what was stated to what the data show, in the base's axes. In m of a place, m/s² or rad/s of
# a bias (what is sensed too much), 1 of a scale (likewise), rad of a turn.
_Wrong: TypeAlias = dict[str, tuple[Array, float]]


def searched(
    sums: Callable[[Array], BlockSums],
    groups: Mapping[str, tuple[int, ...]],
    sizes: Mapping[str, float],
    reference: Array,
    start: Array,
) -> tuple[_Wrong, Array, float]:
    """Return what is wrong, one after another, the sensor's turn, and what is left.

    What explains most comes first: one mistake leaks into all others until it is known.
    """
    from scipy.spatial.transform import Rotation

    turn, now = reference, sums(reference)
    chosen: list[str] = []

    def fit(names: Iterable[str]) -> BlockFit:
        return now.fit([i for name in ("late", *names) for i in groups[name]])

    while True:
        before, drops = fit(chosen).left, {}
        for name in _ORDER_OF_BLAME:
            if name in groups and name not in chosen:
                tried = fit((*chosen, name))
                if sure_part(*tried.of(groups[name]), sizes[name]) is not None:
                    drops[name] = before**2 - tried.left**2
        if not drops:
            break
        chosen.append(next(name for name in drops if drops[name] >= _RIVAL * max(drops.values())))
        if "axes" in chosen:
            # Anew with whatever came later: all of them are found together.
            starts = (reference, start) if chosen[-1] == "axes" else (turn, turn)
            turn, now = _turned(sums, groups, tuple(chosen), starts)
    last, wrong = fit(chosen), {}
    for name in chosen:
        value, covariance = last.of(groups[name])
        if name == "axes":
            value = value + Rotation.from_matrix(turn @ reference.T).as_rotvec()
        if (sure := sure_part(value, covariance, sizes[name])) is not None:
            wrong[name] = sure
    return wrong, turn if "axes" in wrong else reference, last.left


def _turned(
    sums: Callable[[Array], BlockSums],
    groups: Mapping[str, tuple[int, ...]],
    chosen: tuple[str, ...],
    starts: tuple[Array, ...],
) -> tuple[Array, BlockSums]:
    """Return the turn that fits best, linearized anew until it stays."""
    from scipy.spatial.transform import Rotation

    columns = [i for name in ("late", *chosen) for i in groups[name]]
    ends = []
    for turn in starts:
        for _ in range(_ROUNDS):
            own = sums(turn)
            turned = own.fit(columns).of(groups["axes"])[0]
            turn = Rotation.from_rotvec(turned).as_matrix() @ turn
        own = sums(turn)
        ends.append((own.fit(columns).left, turn, own))
    # Where few axes turn, others fit as well that are far from what was stated.
    near, far = ends
    return far[1:] if far[0] < _CLEARLY * near[0] else near[1:]


def nearest_turn(wanted: Array, given: Array, *, proper: bool) -> Array:
    """Return the orthogonal matrix that turns vectors (K, 3) best into others [schonemann1966]_.

    Of determinant 1 where it shall be `proper`: a rotation.
    """
    left, _, right = np.linalg.svd(wanted.T @ given)
    if proper and np.linalg.det(left @ right) < 0.0:
        left[:, 2] *= -1.0
    return np.asarray(left @ right)


def _kept(smooth: Smooth) -> slice:
    """Return the samples that are compared."""
    stride = max(1, int(1.0 / (_SAMPLES * smooth.cutoff_hz * smooth.step)))
    return slice(smooth.inner.start, smooth.inner.stop, stride)


def on_time(log: Recording) -> Recording:
    """Return the middle of a recording with its IMU on the pose's time.

    Both turn equally fast, whatever the sensor's axes are.
    """
    first = max(0, (log.n_samples - _READ) // 2)
    log = rows_of(log, slice(first, first + _READ)) if first else log
    base, smooth = log.base, Smooth.of(log, _RATE_HZ, _LEAST)
    shown = None if base is None else base.sensed("gyroscope")
    if base is None or shown is None or smooth is None:
        return log
    sensed, speed = (
        np.linalg.norm(smooth.low(each), axis=1)[smooth.inner, None]
        for each in (shown, smooth.turning(base))
    )
    late = lag(sensed, speed, log.step)
    if late is None or not late.sure(_LATE, SURE):
        return log
    return shifted(log, Processing(imu_delay_s=late.value))


def gyroscope_fit(log: Recording) -> tuple[_Wrong, Array, bool]:
    """Compare a gyroscope with the turning of the pose: what is wrong, its turn, if it is mirrored.

    Sensed is ``turn @ (E + scale) @ turning + bias``, late by a delay that is of no interest here.
    """
    base, smooth = log.base, Smooth.of(log, _RATE_HZ, _LEAST)
    shown = None if base is None else base.sensed("gyroscope")
    if base is None or shown is None or smooth is None:
        return {}, np.eye(3), False
    kept, sensed = _kept(smooth), smooth.low(shown)
    late = np.gradient(sensed, log.step, axis=0)[kept]
    turning, sensed = smooth.low(smooth.turning(base))[kept], sensed[kept]
    # At rest it has nothing but a bias.
    rests = _rms(turning) < LEAST_RATE
    groups = {name: _GYROSCOPE[name] for name in ("bias", "late")} if rests else _GYROSCOPE

    def sums(turn: Array) -> BlockSums:
        turned = sensed @ turn.T
        ones = np.broadcast_to(np.eye(3), (len(turned), 3, 3))
        columns = [ones, turned[:, :, None], skew(turned), -(late @ turn.T)[:, :, None]]
        return BlockSums.of(np.concatenate(columns, axis=2), turned - turning, _scales(_GYROSCOPE))

    start = nearest_turn(turning, sensed, proper=True)
    wrong, turn, left = searched(sums, groups, {**SIZES, "bias": RATE_BIAS}, np.eye(3), start)
    best = nearest_turn(turning, sensed, proper=False)
    mirrored = (
        np.linalg.det(best) < 0.0
        and left > np.sqrt(_MIRROR_SHARE) * _rms(turning)
        and np.sqrt(_MIRROR_BETTER) * _rms(turning - sensed @ best.T) < left
    )
    return ({}, best, True) if mirrored else (wrong, turn, False)


def accelerometer_fit(log: Recording, gravity: float, turn: Array) -> tuple[_Wrong, Array, bool]:
    """Compare an accelerometer with the pose's accelerations: what is wrong, its turn, if at rest.

    In the world's axes, with the base's orientation R and position p, the sensor's place r and
    the upward axis z, specific force is ``p'' + R''·r + g·z``: what is filtered alike on both
    sides stays equal, with no velocity of the base and no product of rates.

    Parameters
    ----------
    log : Recording
        With a base.
    gravity : float
        m/s².
    turn : (3, 3) ndarray
        Of the sensor, as the gyroscope shows it, against what is stated.
    """
    base, smooth = log.base, Smooth.of(log, _ACCELERATION_HZ, _LEAST)
    stated = None if base is None else base.sensed("accelerometer")
    if base is None or base.position is None or stated is None or smooth is None:
        return {}, turn, False
    assert base.imu is not None
    R, kept, low = base.rotations, _kept(smooth), smooth.low
    axes = low(R)
    moved = smooth.second(low(np.asarray(base.position)))
    moved[:, 2] += gravity
    swung = smooth.second(axes)
    wanted = (moved + swung @ base.imu.translation)[kept]
    axes, swung = axes[kept], swung[kept]

    def sums(turn: Array) -> BlockSums:
        sensed = stated @ turn.T
        force = low(np.einsum("kij,kj->ki", R, sensed))
        late = np.gradient(force, log.step, axis=0)[kept]
        turned = low(np.einsum("kij,kjl->kil", R, skew(sensed)))[kept]
        force = force[kept]
        columns = np.concatenate(
            [axes, force[:, :, None], turned, -late[:, :, None], swung], axis=2
        )
        return BlockSums.of(columns, force - wanted, _scales(_ACCELEROMETER))

    rests = _rms(low(smooth.turning(base))[kept]) < LEAST_RATE
    names = ("bias", "scale", "late") if rests else tuple(_ACCELEROMETER)
    groups = {name: _ACCELEROMETER[name] for name in names}
    sensed = low(np.einsum("kij,kj->ki", R, stated))[kept]
    in_base = [np.einsum("kji,kj->ki", axes, each) for each in (wanted, sensed)]
    start = nearest_turn(*in_base, proper=True)
    wrong, total, _ = searched(sums, groups, SIZES, turn, start)
    return wrong, total, rests


def _scales(groups: Mapping[str, tuple[int, ...]]) -> Array:
    order = sorted(groups, key=lambda name: groups[name])
    return np.array([_MOST[name] for name in order for _ in groups[name]])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@check
def imu(subject: Subject) -> Iterator[Finding]:
    """Find an IMU that sits elsewhere, is turned, or whose sensors have biases or scales."""
    given = None if subject.based is None else subject.based[1].imu
    if given is None:
        return
    of_sensors = (base_checks.unchanging_sensors, base_checks.gyroscope, base_checks.accelerometer)
    if any(True for each in (base_checks.orientation, *of_sensors) for _ in each(subject)):
        return  # What is far off is told as such, and would seem to be all of these.
    log = on_time(subject.longest)
    wrong, turn, mirrored = gyroscope_fit(log)
    if mirrored:
        matrix = given.rotation.T @ turn @ given.rotation
        nearest = max(signed_axes(), key=lambda axes: float(np.sum(axes * matrix)))
        what = (
            "gyroscope are mirrored: no rotation makes it the pose's turning, and "
            f"{axes_in_words(nearest)} measured does"
        )
        remedy = "exchange its columns or their signs; rotation= can only turn them"
        yield found("imu_axes", what=what, remedy=remedy, determinant=-1.0)
        turn = np.eye(3)
    yield from _findings("gyroscope", given, wrong, turn)
    gravity = GRAVITY
    if subject.floating is not None and np.any(subject.floating.gravity):
        gravity = float(np.linalg.norm(subject.floating.gravity))
    wrong, turn, rests = accelerometer_fit(log, gravity, turn)
    # At rest an axis that is tilted shows the same as a bias.
    also = "; axes that are tilted would show the same" if rests else ""
    yield from _findings("accelerometer", given, wrong, turn, also)


def _findings(
    sensor: str, imu: Imu, wrong: _Wrong, turn: Array, also: str = ""
) -> Iterator[Finding]:
    """Yield what is wrong with a sensor."""
    matrix = turn @ imu.rotation
    for name, (value, error) in wrong.items():
        size, limit = float(np.linalg.norm(value)), SIZES[name]
        fields = {"sensor": sensor, "also": also, "error": error, "limit": limit}
        if name == "axes":
            rows = ", ".join(
                f"[{', '.join(f'{x:.4f}' for x in row)}]" for row in matrix.round(4) + 0.0
            )
            what = (
                f"{sensor} are turned by {np.degrees(size):.3g}° about {vector(value / size)} of "
                "the base against those stated, as the pose shows (standard error "
                f"{np.degrees(error):.2g}°, limit {np.degrees(limit):.2g}°)"
            )
            remedy = f"give the IMU's rotation=[{rows}]"
            yield found("imu_axes", what=what, remedy=remedy, angle=size, error=error, limit=limit)
        elif name == "place":
            yield found("imu_place", place=imu.translation + value, distance=size, **fields)
        elif name == "bias":
            unit = "m/s²"
            if sensor == "gyroscope":
                unit, fields["limit"] = "rad/s", RATE_BIAS
            yield found("imu_bias", value=matrix.T @ value, unit=unit, bias=size, **fields)
        else:
            fields |= {"least": 1.0 - limit, "most": 1.0 + limit, "also": ""}
            yield found("imu_scale", scale=1.0 / (1.0 - float(value[0])), **fields)
