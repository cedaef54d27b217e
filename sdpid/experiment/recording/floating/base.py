"""`BaseMotion` and `Imu`: what was measured of a base that nothing holds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from sdpid._common.arrays import Array, frozen_view, rotation_matrices
from sdpid._common.tables import facts_html
from sdpid.errors import DataError
from sdpid.experiment.recording.floating.arrays import (
    Sampled,
    keep_samples,
    keep_vector,
    rotation_matrix,
)

# A unit quaternion printed with three digits has a norm this far from 1.
_OFF_UNIT = 2e-3
# Quaternions this near to norm 1 are kept to the bit, so that rows of a recording are its rows.
_EXACT = 1e-15
_FRAMES = ("world", "base")
_VELOCITIES = ("linear_velocity", "angular_velocity")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Imu(Sampled):
    """What an inertial measurement unit on the base measured, and where it sits.

    Parameters
    ----------
    gyroscope : (N, 3) array_like, optional
        Angular velocity in rad/s, in the sensor's axes.
    accelerometer : (N, 3) array_like, optional
        Specific force in m/s², in the sensor's axes: acceleration less gravity, so +9.81 along
        the upward axis at rest.
    translation : (3,) array_like, optional
        The sensor's place in the frame of the base link, m.
    rotation : (3, 3) array_like, optional
        The sensor's axes in the frame of the base link, as columns: a vector in the base is
        ``rotation @ vector_in_sensor``.

    Raises
    ------
    DataError
        When neither sensor is there, shapes do not agree, or `rotation` is no rotation.

    Examples
    --------
    >>> still = np.zeros((100, 3))
    >>> sdpid.Imu(gyroscope=still, accelerometer=still + [0.0, 0.0, 9.81])
    Imu(100 samples, gyroscope, accelerometer)
    """

    gyroscope: Array | None = None
    accelerometer: Array | None = None
    translation: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    _sampled: ClassVar[tuple[str, ...]] = ("gyroscope", "accelerometer")

    def __post_init__(self) -> None:
        keep_samples(self, "gyroscope", (3,), "rad/s about x, y, z", called="imu.gyroscope")
        keep_samples(self, "accelerometer", (3,), "m/s² along x, y, z", called="imu.accelerometer")
        if self.gyroscope is None and self.accelerometer is None:
            raise DataError("imu: has neither gyroscope nor accelerometer; leave it out.")
        self._require_equal_lengths("imu")
        keep_vector(self, "translation", called="imu.translation")
        rotation = rotation_matrix(self.rotation, called="imu.rotation")
        object.__setattr__(self, "rotation", rotation)

    def __repr__(self) -> str:
        return f"Imu({', '.join([f'{self.n_samples} samples', *_given(self)])})"

    def _repr_html_(self) -> str:
        return facts_html(
            "Imu",
            {
                "samples": self.n_samples,
                "measured": ", ".join(_given(self)),
                "translation, m": str(self.translation.tolist()),
            },
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BaseMotion(Sampled):
    """Pose and velocity of a robot's base link over time: that of a quadruped or a humanoid.

    Parameters
    ----------
    orientation : (N, 4) array_like
        Unit quaternions x, y, z, w that turn vectors of the base link's frame into the world's.
        The world's z axis points up. They are normalized, and their signs made continuous.
    position : (N, 3) array_like, optional
        Origin of the base link's frame in the world, m.
    linear_velocity : (N, 3) array_like, optional
        Velocity of that origin, m/s. Identification never needs it.
    angular_velocity : (N, 3) array_like, optional
        rad/s.
    velocity_frame : {"world", "base"}, optional
        Axes of both velocities; to be said where there is one.
    imu : Imu, optional
        What a sensor on the base measured.

    Raises
    ------
    DataError
        When shapes do not agree, quaternions are not of norm 1 within 0.002, or the frame of
        velocities is not said.

    Examples
    --------
    >>> level = np.tile([0.0, 0.0, 0.0, 1.0], (100, 1))
    >>> sdpid.BaseMotion(orientation=level, position=np.zeros((100, 3)))
    BaseMotion(100 samples, orientation, position)
    """

    orientation: Array
    position: Array | None = None
    linear_velocity: Array | None = None
    angular_velocity: Array | None = None
    velocity_frame: Literal["world", "base"] | None = None
    imu: Imu | None = None
    _sampled: ClassVar[tuple[str, ...]] = ("orientation", "position", *_VELOCITIES)

    def __post_init__(self) -> None:
        if self.orientation is None:
            raise DataError("base.orientation: is missing; give unit quaternions x, y, z, w.")
        quaternions = keep_samples(
            self, "orientation", (4,), "unit quaternions x, y, z, w", called="base.orientation"
        )
        assert quaternions is not None
        object.__setattr__(self, "orientation", frozen_view(_continuous(_unit(quaternions))))
        keep_samples(self, "position", (3,), "x, y, z in m", called="base.position")
        for name, unit in (("linear_velocity", "m/s"), ("angular_velocity", "rad/s")):
            keep_samples(self, name, (3,), f"x, y, z in {unit}", called=f"base.{name}")
        self._require_equal_lengths("base")
        moving = [name for name in _VELOCITIES if name in self.channels]
        if moving and self.velocity_frame not in _FRAMES:
            raise DataError(
                f"base.velocity_frame: is {self.velocity_frame!r}, expected 'world' or 'base': "
                f"the axes of {' and '.join(moving)}. Where that is not known, leave the "
                "velocities out."
            )
        if not moving and self.velocity_frame is not None:
            raise DataError("base.velocity_frame: is given without a velocity; leave it out.")
        if self.imu is not None:
            if not isinstance(self.imu, Imu):
                raise DataError(f"base.imu: is {type(self.imu).__name__}, expected sdpid.Imu.")
            if self.imu.n_samples != self.n_samples:
                raise DataError(
                    f"base.imu: has {self.imu.n_samples} samples, base.orientation "
                    f"{self.n_samples}; bring both to the same time stamps."
                )

    @property
    def rotations(self) -> Array:
        """Rotation matrices of the orientations, base to world, (N, 3, 3)."""
        return rotation_matrices(self.orientation)

    def sensed(self, sensor: str) -> Array | None:
        """Return what a sensor of the IMU shows in the axes of the base; None where there is none.

        Parameters
        ----------
        sensor : {"gyroscope", "accelerometer"}
            Which one.
        """
        if self.imu is None or sensor not in self.imu.channels:
            return None
        return np.asarray(self.imu.channels[sensor] @ self.imu.rotation.T)

    def __repr__(self) -> str:
        parts = [f"{self.n_samples} samples", *_given(self)]
        if self.velocity_frame is not None:
            parts.append(f"velocities in {self.velocity_frame} axes")
        return f"BaseMotion({', '.join([*parts, *([] if self.imu is None else ['IMU'])])})"

    def _repr_html_(self) -> str:
        facts: dict[str, object] = {
            "samples": self.n_samples,
            "measured": ", ".join(_given(self)),
            "axes of velocities": self.velocity_frame,
            "IMU": None if self.imu is None else ", ".join(_given(self.imu)),
        }
        return facts_html("BaseMotion", facts)


def _given(owner: Sampled) -> list[str]:
    """Return the channels that are there, in words."""
    return [name.replace("_", " ") for name in owner.channels]


def _unit(quaternions: Array) -> Array:
    """Return quaternions of norm 1, or say which are not nearly so."""
    norms = np.linalg.norm(quaternions, axis=1)
    off = np.abs(norms - 1.0)
    worst = int(off.argmax())
    if off[worst] > _OFF_UNIT:
        raise DataError(
            f"base.orientation: the quaternion of sample {worst + 1} has the norm "
            f"{norms[worst]:.6g}, off 1 by {off[worst]:.3g}, limit {_OFF_UNIT:g}; give unit "
            "quaternions x, y, z, w, not Euler angles."
        )
    if off[worst] <= _EXACT:
        return quaternions
    unit: Array = quaternions / norms[:, None]
    return unit


def _continuous(quaternions: Array) -> Array:
    """Return quaternions without changes of sign, which mean nothing, between samples."""
    turned = np.einsum("ki,ki->k", quaternions[1:], quaternions[:-1]) < 0.0
    if not turned.any():
        return quaternions
    sign = np.where(np.cumsum(turned) % 2 == 1, -1.0, 1.0)
    result = np.array(quaternions)
    result[1:] *= sign[:, None]
    return result
