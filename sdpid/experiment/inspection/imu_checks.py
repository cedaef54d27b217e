"""Check an IMU's axes, place, biases and scales against the rates of its base's pose."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.experiment.inspection.base_checks import GRAVITY, LEAST_RATE, rms
from sdpid.experiment.inspection.block_fit import SURE, BlockFit, block_fit, sure_part
from sdpid.experiment.inspection.delays.kinematic import Smooth, lag
from sdpid.experiment.inspection.kinds import KINDS, Finding, found, vector, warning
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.processing.on_time import on_time as shifted
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.floating import Imu
from sdpid.experiment.recording.recording import Recording, rows_of
from sdpid.robot.inertia import skew

_DELAYS = "delays are told once this is mended"
KINDS.update(
    imu_axes=warning(f"axes of the {{what}}; {_DELAYS}", "{remedy}", hides=("late",), about="imu"),
    imu_place=warning(
        "the {sensor} sits at {place} m in the base's frame, {distance:.3g} m from where it is "
        f"said to be, as the pose shows (standard error {{error:.2g}} m, limit {{limit:g}} m); "
        f"{_DELAYS}",
        "give the IMU's translation={place}",
        hides=("late",),
        about="imu",
    ),
    imu_bias=warning(
        "the {sensor} shows {value} {unit} too much along its axes, as the pose shows (standard "
        "error {error:.2g}, limit {limit:g}){also}",
        "take it off the {sensor}",
        about="imu",
    ),
    imu_scale=warning(
        "the {sensor} shows {scale:.4g} times what the pose does (standard error {error:.2g}, "
        "limit {least:g} to {most:g}){also}",
        "divide the {sensor} by it",
        about="imu",
    ),
)

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
# Columns of what may be wrong, and how far off it is at most: m/s² (rad/s), 1, rad, s, m. The delay
# is told elsewhere.
_AT = {"bias": (0, 1, 2), "scale": (3,), "axes": (4, 5, 6), "late": (7,), "place": (8, 9, 10)}
_MOST = np.repeat([20.0, 2.0, np.pi, 0.1, 2.0], [3, 1, 3, 1, 3])
# Turns are linearized anew so often.
_ROUNDS = 5
# A turn far from what was stated has to leave less than this of what one nearby leaves.
_CLEARLY = 0.8

# What is wrong with a sensor, with the standard error of its least certain direction: the change
# from what was stated to what the data show, in the base's axes. In m of a place, m/s² or rad/s of
# a bias (what is sensed too much), 1 of a scale (likewise), rad of a turn.
Wrong = dict[str, tuple[Array, float]]


def _fit(
    at: Callable[[Array], tuple[Array, Array]],
    shown: tuple[str, ...],
    reference: Array,
    start: Array,
    bias: float,
) -> tuple[Wrong, Array]:
    """Return what is wrong with a sensor, all of it at once, and its turn.

    A level base hardly tells a tilt, or a scale, from a bias. Where these are not sure the sensor
    is taken to have none.

    Parameters
    ----------
    at : callable
        Returns columns (K, 3, p) in the order of `_AT`, and what is sensed beyond the pose, (K, 3),
        at a turn of the sensor.
    shown : tuple of str
        What can be wrong.
    reference, start : (3, 3) ndarray
        The turn from which a change is told, and another one to look from.
    bias : float
        Least size of a bias that is told.
    """
    from scipy.spatial.transform import Rotation

    wrong: Wrong = {}
    for optional in ("axes", "scale", ""):
        columns = np.concatenate([_AT[name] for name in shown])
        of_axes = np.isin(columns, _AT["axes"])

        def fit(turn: Array, columns: Indices = columns) -> BlockFit:
            every, signal = at(turn)
            return block_fit(every[..., columns], signal, _MOST[columns])

        ends = []
        for turn in (reference, start) if of_axes.any() else (reference,):
            for _ in range(_ROUNDS if of_axes.any() else 0):
                turn = Rotation.from_rotvec(fit(turn).values[of_axes]).as_matrix() @ turn
            ends.append((fit(turn), turn))
        # Where few axes turn, others fit as well that are far from what was stated.
        near, far = ends[0], ends[-1]
        last, turn = far if far[0].left < _CLEARLY * near[0].left else near
        wrong = {}
        for name in shown:
            own = np.isin(columns, _AT[name])
            value, covariance = last.values[own], last.covariance[np.ix_(own, own)]
            if name == "axes":
                value = value + Rotation.from_matrix(turn @ reference.T).as_rotvec()
            size = bias if name == "bias" else SIZES.get(name, np.inf)
            if (sure := sure_part(value, covariance, size)) is not None:
                wrong[name] = sure
        shown = tuple(name for name in shown if name != optional or name in wrong)
    return wrong, turn if "axes" in wrong else reference


def _nearest_turn(wanted: Array, given: Array) -> Array:
    """Return the rotation that turns vectors (K, 3) best into others [schonemann1966]_."""
    left, _, right = np.linalg.svd(wanted.T @ given)
    if np.linalg.det(left @ right) < 0.0:
        left[:, 2] *= -1.0
    return np.asarray(left @ right)


def _compared(log: Recording, cutoff_hz: float) -> tuple[Smooth, slice] | None:
    """Return the filter of a sensor's values, and the samples that are compared."""
    smooth = Smooth.of(log, cutoff_hz, _LEAST)
    if smooth is None:
        return None
    stride = max(1, int(1.0 / (_SAMPLES * cutoff_hz * log.step)))
    return smooth, slice(smooth.inner.start, smooth.inner.stop, stride)


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


def gyroscope_fit(log: Recording) -> tuple[Wrong, Array]:
    """Compare a gyroscope with the turning of the pose: what is wrong, and its turn.

    Sensed is ``turn @ (E + scale) @ turning + bias``, late by a delay that is of no interest here.
    """
    base, compared = log.base, _compared(log, _RATE_HZ)
    stated = None if base is None else base.sensed("gyroscope")
    if base is None or stated is None or compared is None:
        return {}, np.eye(3)
    smooth, kept = compared
    sensed, turning = smooth.low(stated), smooth.low(smooth.turning(base))[kept]
    late, sensed = np.gradient(sensed, log.step, axis=0)[kept], sensed[kept]
    # At rest it has nothing but a bias.
    rests = rms(turning) < LEAST_RATE
    ones = np.broadcast_to(np.eye(3), (len(turning), 3, 3))

    def at(turn: Array) -> tuple[Array, Array]:
        turned = sensed @ turn.T
        columns = [ones, turned[..., None], skew(turned), -(late @ turn.T)[..., None]]
        return np.concatenate(columns, axis=2), turned - turning

    shown = ("bias", "late") if rests else ("bias", "scale", "axes", "late")
    return _fit(at, shown, np.eye(3), _nearest_turn(turning, sensed), RATE_BIAS)


def accelerometer_fit(log: Recording, gravity: float, turn: Array) -> tuple[Wrong, Array, bool]:
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
    base, compared = log.base, _compared(log, _ACCELERATION_HZ)
    stated = None if base is None else base.sensed("accelerometer")
    if base is None or base.position is None or stated is None or compared is None:
        return {}, turn, False
    assert base.imu is not None
    smooth, kept = compared
    R, low = base.rotations, smooth.low
    axes = low(R)
    moved, swung = smooth.second(low(np.asarray(base.position))), smooth.second(axes)
    moved[:, 2] += gravity
    axes, swung, wanted = axes[kept], swung[kept], (moved + swung @ base.imu.translation)[kept]
    # What each axis of the sensor would be along each of the base's, in the world's axes.
    along = low(np.einsum("kij,kl->kijl", R, stated))
    rate, along = np.gradient(along, log.step, axis=0)[kept], along[kept]

    def at(turn: Array) -> tuple[Array, Array]:
        turned = along @ turn.T
        force, late = (np.einsum("kijj->ki", each) for each in (turned, rate @ turn.T))
        of_axes = np.einsum("kijm,mjl->kil", turned, skew(np.eye(3)))
        columns = [axes, force[..., None], of_axes, -late[..., None], swung]
        return np.concatenate(columns, axis=2), force - wanted

    rests = rms(low(smooth.turning(base))[kept]) < LEAST_RATE
    shown = ("bias", "late") if rests else ("bias", "scale", "axes", "late", "place")
    sensed = np.einsum("kijj->ki", along)
    in_base = [np.einsum("kji,kj->ki", axes, each) for each in (wanted, sensed)]
    return *_fit(at, shown, turn, _nearest_turn(*in_base), SIZES["bias"]), rests


@check
def imu(subject: Subject) -> Iterator[Finding]:
    """Find an IMU that sits elsewhere, is turned, or whose sensors have biases or scales."""
    given = None if subject.based is None else subject.based[1].imu
    if given is None:
        return
    log = on_time(subject.longest)
    wrong, turn = gyroscope_fit(log)
    yield from _findings("gyroscope", given, wrong, turn)
    gravity = GRAVITY
    if subject.floating is not None and np.any(subject.floating.gravity):
        gravity = float(np.linalg.norm(subject.floating.gravity))
    wrong, turn, rests = accelerometer_fit(log, gravity, turn)
    # At rest an axis that is tilted shows the same as a bias.
    also = "; axes that are tilted would show the same" if rests else ""
    yield from _findings("accelerometer", given, wrong, turn, also)


def _findings(
    sensor: str, imu: Imu, wrong: Wrong, turn: Array, also: str = ""
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
