"""The quantities of a floating base in a log: their usual names, parts and settings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sdpid.errors import DataError

# Names under which quantities are found, in the order in which they are looked for.
NAMES: dict[str, tuple[str, ...]] = {
    "base_orientation": ("base_orientation", "base_quaternion", "base_quat"),
    "base_position": ("base_position", "base_pos"),
    "base_linear_velocity": ("base_linear_velocity", "base_lin_vel", "base_velocity"),
    "base_angular_velocity": ("base_angular_velocity", "base_ang_vel"),
    "gyroscope": ("gyroscope", "gyro", "imu_gyroscope", "imu_gyro", "imu_angular_velocity"),
    "accelerometer": (
        *("accelerometer", "accel", "imu_accelerometer", "imu_accel", "imu_acceleration"),
        "imu_linear_acceleration",
    ),
    "contact": ("contact", "contacts", "contact_state", "foot_contact", "foot_contacts"),
    "contact_force": ("contact_force", "contact_forces", "foot_force", "foot_forces"),
    "contact_wrench": ("contact_wrench", "contact_wrenches"),
}
_XYZ = ("x", "y", "z")
# The parts of a sample, of contacts those of each.
PARTS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(NAMES, _XYZ),
    "base_orientation": (*_XYZ, "w"),
    "contact": (),
    "contact_wrench": ("fx", "fy", "fz", "mx", "my", "mz"),
}
# What an argument, or a table of a mapping, may say.
SETTINGS: dict[str, tuple[str, ...]] = {
    "base": ("quaternion", "velocity_frame", "topic", "held", "orientation"),
    "imu": ("translation", "rotation", "topic"),
    "contacts": ("frames", "kind", "offset", "threshold"),
}
# Of these, what is said of a base that was held.
HELD = ("held", "orientation")
_ORDERS = ("xyzw", "wxyz")


def checked_settings(name: str, given: Any) -> dict[str, Any]:
    """Return the settings of base, IMU or contacts, or say which is not known.

    Raises
    ------
    DataError
        When it is no table, or has another key or another order of quaternions.
    """
    if not isinstance(given, Mapping):
        raise DataError(f"{name}: is {given!r:.80}, expected a table [{name}].")
    if unknown := sorted(map(str, set(given) - set(SETTINGS[name]))):
        raise DataError(
            f"{name}: {', '.join(unknown)} is not known; known are {', '.join(SETTINGS[name])}."
        )
    if name == "base" and given.get("quaternion", "xyzw") not in _ORDERS:
        raise DataError(
            f"base.quaternion: is {given['quaternion']!r:.80}, expected one of "
            f"{', '.join(_ORDERS)}: the order in which the log has it."
        )
    if name == "base":
        _check_held(given)
    return dict(given)


def _check_held(given: Mapping[str, Any]) -> None:
    """Raise where what is said of a held base makes no sense."""
    if "held" not in given:
        if "orientation" in given:
            raise DataError(
                "base.orientation: is that of a base that was held; say which link was, "
                'held = "base_link".'
            )
        return
    if not (isinstance(given["held"], str) and given["held"]):
        raise DataError(
            f"base.held: is {given['held']!r:.80}, expected the name of the link that was held, "
            'such as "base_link".'
        )
    if others := [key for key in given if key not in HELD]:
        raise DataError(
            f"base.held: the base was held at '{given['held']:.80}', and {', '.join(others)} is "
            "about one that moves; leave one of them out."
        )
