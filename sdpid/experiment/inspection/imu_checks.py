"""Check an IMU's axes, place, biases and scales against the pose of its base."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid.experiment.inspection import base_checks
from sdpid.experiment.inspection.evidence import GRAVITY, axes_in_words, signed_axes
from sdpid.experiment.inspection.finding import Finding
from sdpid.experiment.inspection.imu_fit import (
    RATE_BIAS,
    SIZES,
    ImuFit,
    accelerometer_fit,
    gyroscope_fit,
    on_time,
)
from sdpid.experiment.inspection.kinds import found, vector
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.recording.floating.base import Imu

_RIVALS = {
    "bias": "a bias",
    "scale": "another scale",
    "axes": "axes that are tilted",
}


@check
def imu(subject: Subject) -> Iterator[Finding]:
    """Find an IMU that sits elsewhere, is turned, or whose sensors have biases or scales."""
    given = None if subject.based is None else subject.based[1].imu
    if given is None:
        return
    of_sensors = (base_checks.unchanging_sensors, base_checks.gyroscope, base_checks.accelerometer)
    coarse = (base_checks.orientation, *of_sensors)
    if any(True for each in coarse for _ in each(subject)):
        return  # What is far off is told as such, and would seem to be all of these.
    log = on_time(subject.longest)
    turned = gyroscope_fit(log)
    turn = np.eye(3)
    if turned is not None:
        if turned.mirrored:
            yield _mirrored(given, turned)
        else:
            turn = turned.turn
            yield from _findings("gyroscope", given, turned)
    gravity = GRAVITY
    if subject.floating is not None and np.any(subject.floating.gravity):
        gravity = float(np.linalg.norm(subject.floating.gravity))
    moved = accelerometer_fit(log, gravity, turn)
    if moved is not None:
        yield from _findings("accelerometer", given, moved)


def _findings(sensor: str, imu: Imu, fit: ImuFit) -> Iterator[Finding]:
    """Yield what is wrong with a sensor."""
    matrix = fit.turn @ imu.rotation
    for name, wrong in fit.found.items():
        also, size = "", float(np.linalg.norm(wrong.value))
        if wrong.rivals:
            also = f"; {' or '.join(_RIVALS[each] for each in wrong.rivals)} would show the same"
        numbers = {"error": wrong.error, "limit": SIZES[name]}
        fields = {"sensor": sensor, "also": also, **numbers}
        if name == "axes":
            rows = ", ".join(
                f"[{', '.join(f'{x:.4f}' for x in row)}]" for row in matrix.round(4) + 0.0
            )
            what = (
                f"{sensor} are turned by {np.degrees(size):.3g}° about "
                f"{vector(wrong.value / size)} of the base against those stated, as the pose shows "
                f"(standard error {np.degrees(wrong.error):.2g}°, limit "
                f"{np.degrees(SIZES['axes']):.2g}°)"
            )
            remedy = f"give the IMU's rotation=[{rows}]"
            yield found("imu_axes", what=what, remedy=remedy, angle=size, **numbers)
        elif name == "place":
            place = vector(imu.translation + wrong.value)
            yield found("imu_place", place=place, distance=size, **fields)
        elif name == "bias":
            unit = "m/s²"
            if sensor == "gyroscope":
                unit, fields["limit"] = "rad/s", RATE_BIAS
            value = vector(matrix.T @ wrong.value)
            yield found("imu_bias", value=value, unit=unit, bias=size, **fields)
        else:
            scale = 1.0 / (1.0 - float(wrong.value[0]))
            least, most = 1.0 - SIZES["scale"], 1.0 + SIZES["scale"]
            yield found("imu_scale", scale=scale, least=least, most=most, **fields)


def _mirrored(imu: Imu, fit: ImuFit) -> Finding:
    matrix = imu.rotation.T @ fit.turn @ imu.rotation
    nearest = max(signed_axes(), key=lambda axes: float(np.sum(axes * matrix)))
    return found(
        "imu_axes",
        what=(
            "gyroscope are mirrored: no rotation makes it the pose's turning, and "
            f"{axes_in_words(nearest)} measured does"
        ),
        remedy="exchange its columns or their signs; rotation= can only turn them",
        determinant=-1.0,
    )
