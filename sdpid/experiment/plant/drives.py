"""Drives and sensors of a simulated robot, and effects that no linear model has."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.files import load_toml
from sdpid.errors import DataError
from sdpid.experiment.simulation.law import keep_per_joint
from sdpid.robot.description.catalog import bundled_folder, bundled_robots


@dataclass(frozen=True, kw_only=True, eq=False)
class Unmodeled:
    """Losses and ripple that a model linear in its parameters cannot hold.

    They are losses between motor and joint that the drive's inner loop makes up for: the motion
    is that of the robot without them, and the current shows them. To identification this is a
    robot whose effort has these terms beside the modeled ones.

    Attributes
    ----------
    ripple_amplitude, ripple_cycles : ndarray, shape (n,)
        N·m, and cycles a turn of the joint.
    eccentricity_amplitude : ndarray, shape (n,)
        N·m, twice a turn of the joint.
    stribeck_torque, stribeck_velocity : ndarray, shape (n,)
        N·m that friction at rest exceeds Coulomb friction, and the speed (rad/s) by which that
        has fallen to 1/e.
    coulomb_asymmetry : ndarray, shape (n,)
        N·m that friction is larger forwards and smaller backwards.
    viscous_curvature : ndarray, shape (n,)
        N·m·s²/rad², times ``v·|v|``.
    """

    ripple_amplitude: Array
    ripple_cycles: Array
    eccentricity_amplitude: Array
    stribeck_torque: Array
    stribeck_velocity: Array
    coulomb_asymmetry: Array
    viscous_curvature: Array

    def __post_init__(self) -> None:
        ripples = ("ripple_amplitude", "eccentricity_amplitude")
        signed = (*ripples, "coulomb_asymmetry", "viscous_curvature")
        names = [each.name for each in fields(self)]
        what, zero = "unmodeled effects", ("stribeck_torque",)
        keep_per_joint(self, what, names, signed=signed, not_negative=zero)

    def torque(self, position: Array, velocity: Array) -> Array:
        """Return what the motors supply for them, shape (K, n), in N·m."""
        stribeck = self.stribeck_torque * np.exp(-((velocity / self.stribeck_velocity) ** 2))
        return np.asarray(
            self.ripple_amplitude * np.sin(self.ripple_cycles * position)
            + self.eccentricity_amplitude * np.sin(2.0 * position)
            + stribeck * np.sign(velocity)
            + self.coulomb_asymmetry
            + self.viscous_curvature * velocity * np.abs(velocity)
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Drives:
    """Motors, controller and sensors of the n joints.

    For a prismatic joint read N for N·m and m for rad; its gear ratio is in rad/m.

    Attributes
    ----------
    torque_constant : ndarray, shape (n,)
        Motor torque per current, N·m/A.
    gear_ratio : ndarray, shape (n,)
        Motor turns per joint turn.
    proportional_gain : ndarray, shape (n,)
        Position loop, 1/s: velocity command per position error.
    velocity_gain : ndarray, shape (n,)
        Velocity loop, N·m·s/rad: joint torque per velocity error.
    encoder_counts : ndarray, shape (n,)
        Counts a turn of the motor.
    current_noise : ndarray, shape (n,)
        Root mean square of the white noise on measured currents, A.
    unmodeled : Unmodeled, optional
        Effects added on request.

    Raises
    ------
    DataError
        When a value is not finite or not positive, or lengths differ.

    Examples
    --------
    >>> from sdpid.experiment.plant.drives import load_drives
    >>> drives = load_drives("denso_vp6242")
    >>> drives.n, drives.effort_scale.round(2)
    (6, array([45.6, 60.8, 26.4, 21. , 21. , 21. ]))
    """

    torque_constant: Array
    gear_ratio: Array
    proportional_gain: Array
    velocity_gain: Array
    encoder_counts: Array
    current_noise: Array
    unmodeled: Unmodeled | None = None

    def __post_init__(self) -> None:
        names = [each.name for each in fields(self) if each.name != "unmodeled"]
        keep_per_joint(self, "drives", names, not_negative=("current_noise",))
        if self.unmodeled is not None and len(self.unmodeled.ripple_cycles) != self.n:
            raise DataError(
                f"drives: {self.n} joints, but unmodeled effects of "
                f"{len(self.unmodeled.ripple_cycles)}."
            )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.torque_constant)

    @property
    def effort_scale(self) -> Array:
        """Joint torque per current, N·m/A, shape (n,)."""
        return np.asarray(self.torque_constant * self.gear_ratio)

    @property
    def resolution(self) -> Array:
        """Smallest step of a measured joint position, rad, shape (n,)."""
        return np.asarray(2.0 * np.pi / (self.encoder_counts * self.gear_ratio))

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], *, what: str = "drives") -> Drives:
        """Build from the content of a TOML file (see ``models/denso_vp6242/drives.toml``).

        Raises
        ------
        DataError
            When an entry is missing or unknown.
        """
        values = dict(data)
        extra = values.pop("unmodeled", None)
        try:
            effects = None if extra is None else Unmodeled(**extra)
            return cls(**values, unmodeled=effects)
        except TypeError as cause:
            raise DataError(f"{what}: not understood ({cause}).") from None


def load_drives(folder: str | os.PathLike[str]) -> Drives:
    """Read ``drives.toml`` of a bundled robot, or of a folder.

    Raises
    ------
    DataError
        When the file is missing or not understood.
    """
    path = plant_folder(folder) / "drives.toml"
    return Drives.from_mapping(load_toml(path), what=str(path))


def plant_folder(folder: str | os.PathLike[str]) -> Path:
    """Return the folder of a bundled robot, or the path as it is."""
    if isinstance(folder, str) and folder in bundled_robots():
        return bundled_folder(folder)
    return Path(folder)
