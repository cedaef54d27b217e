"""Check an IMU's axes, place, biases and scales against the pose of its base."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid.experiment.inspection.finding import Finding, Subject, check, vector
from sdpid.experiment.inspection.floating import base_checks
from sdpid.experiment.inspection.floating.evidence import GRAVITY, axes_in_words, signed_axes
from sdpid.experiment.inspection.places.imu_fit import (
    RATE_BIAS,
    SIZES,
    Found,
    ImuFit,
    accelerometer_fit,
    gyroscope_fit,
    on_time,
)
from sdpid.experiment.recording.floating.base import Imu

# Accelerations of a wrong place or axes are those of another time.
_DELAYS = "delays are told once this is mended"
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
    """Return what is wrong with a sensor."""
    told = {"axes": _axes, "place": _place, "bias": _bias, "scale": _scale}
    for name, found in fit.found.items():
        yield told[name](sensor, imu, fit, found)


def _axes(sensor: str, imu: Imu, fit: ImuFit, found: Found) -> Finding:
    angle = float(np.linalg.norm(found.value))
    matrix = (fit.turn @ imu.rotation).round(4)
    rows = ", ".join(f"[{', '.join(f'{x:.4f}' for x in row)}]" for row in matrix + 0.0)
    return Finding(
        kind="imu_axes",
        message=(
            f"axes of the {sensor} are turned by {np.degrees(angle):.3g}° about "
            f"{vector(found.value / angle)} of the base against those stated, as the pose shows "
            f"(standard error {np.degrees(found.error):.2g}°, limit "
            f"{np.degrees(SIZES['axes']):.2g}°); {_DELAYS}"
        ),
        remedy=f"give the IMU's rotation=[{rows}]",
        numbers={"angle": angle, "error": found.error, "limit": SIZES["axes"]},
    )


def _mirrored(imu: Imu, fit: ImuFit) -> Finding:
    matrix = imu.rotation.T @ fit.turn @ imu.rotation
    nearest = max(signed_axes(), key=lambda axes: float(np.sum(axes * matrix)))
    return Finding(
        kind="imu_axes",
        message=(
            "axes of the gyroscope are mirrored: no rotation makes it the pose's turning, and "
            f"{axes_in_words(nearest)} measured does; {_DELAYS}"
        ),
        remedy="exchange its columns or their signs; rotation= can only turn them",
        numbers={"determinant": -1.0},
    )


def _place(sensor: str, imu: Imu, fit: ImuFit, found: Found) -> Finding:
    away = float(np.linalg.norm(found.value))
    return Finding(
        kind="imu_place",
        message=(
            f"the {sensor} sits at {vector(imu.translation + found.value)} m in the base's frame, "
            f"{away:.3g} m from where it is said to be, as the pose shows (standard error "
            f"{found.error:.2g} m, limit {SIZES['place']:g} m); {_DELAYS}"
        ),
        remedy=f"give the IMU's translation={vector(imu.translation + found.value)}",
        numbers={"distance": away, "error": found.error, "limit": SIZES["place"]},
    )


def _bias(sensor: str, imu: Imu, fit: ImuFit, found: Found) -> Finding:
    unit, limit = ("rad/s", RATE_BIAS) if sensor == "gyroscope" else ("m/s²", SIZES["bias"])
    value = (fit.turn @ imu.rotation).T @ found.value
    return Finding(
        kind="imu_bias",
        message=(
            f"the {sensor} shows {vector(value)} {unit} too much along its axes, as the pose "
            f"shows (standard error {found.error:.2g}, limit {limit:g}){_also(found)}"
        ),
        remedy=f"take it off the {sensor}",
        numbers={"bias": float(np.linalg.norm(value)), "error": found.error, "limit": limit},
    )


def _scale(sensor: str, imu: Imu, fit: ImuFit, found: Found) -> Finding:
    factor = 1.0 / (1.0 - float(found.value[0]))
    return Finding(
        kind="imu_scale",
        message=(
            f"the {sensor} shows {factor:.4g} times what the pose does (standard error "
            f"{found.error:.2g}, limit {1.0 - SIZES['scale']:g} to {1.0 + SIZES['scale']:g})"
            f"{_also(found)}"
        ),
        remedy=f"divide the {sensor} by it",
        numbers={"scale": factor, "error": found.error, "limit": SIZES["scale"]},
    )


def _also(found: Found) -> str:
    if not found.rivals:
        return ""
    return f"; {' or '.join(_RIVALS[name] for name in found.rivals)} would show the same"
