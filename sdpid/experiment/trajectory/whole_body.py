"""`WholeBodyMotion`: what all of a robot with a floating base is to do, sample by sample."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen, frozen_view, real_array
from sdpid._common.files import read_regular
from sdpid._common.tables import Table, facts_html
from sdpid.errors import DataError

_XYZ = ("x", "y", "z")
_OF_JOINTS = ("position", "velocity", "acceleration", "effort")

# Minutes of a humanoid's motion have less.
_MOST_BYTES = 256 * 2**20


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class WholeBodyMotion:
    """Joints, base, contacts and torques of a planned motion.

    Attributes
    ----------
    joint_names : tuple of str
        The n joints.
    time : ndarray, shape (K,)
        From zero, s.
    position, velocity, acceleration : ndarray, shape (K, n)
        Of the joints, rad and s.
    effort : ndarray, shape (K, n)
        Torques that carry the motion, N·m: what a controller adds to its feedback.
    base_position : ndarray, shape (K, 3)
        Of the base's origin, m.
    base_orientation : ndarray, shape (K, 4)
        Unit quaternions x, y, z, w, base to world.
    frames : tuple of str
        The c feet.
    down : ndarray of bool, shape (K, c)
        Which feet are on the ground.
    forces : ndarray, shape (K, c, 3)
        Planned forces of the ground on the robot, N, world axes.

    Raises
    ------
    DataError
        When shapes differ.

    Examples
    --------
    >>> from sdpid.experiment.trajectory.whole_body import WholeBodyMotion
    >>> time, still = np.linspace(0.0, 1.0, 11), np.zeros((11, 1))
    >>> motion = WholeBodyMotion(
    ...     joint_names=("knee",), time=time, position=still, velocity=still, acceleration=still,
    ...     effort=still, base_position=np.zeros((11, 3)),
    ...     base_orientation=np.tile([0.0, 0.0, 0.0, 1.0], (11, 1)), frames=("foot",),
    ...     down=np.ones((11, 1), dtype=bool), forces=np.zeros((11, 1, 3)),
    ... )
    >>> motion
    WholeBodyMotion(1 joints, 1 feet, 1 s)
    """

    joint_names: tuple[str, ...]
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    effort: Array
    base_position: Array
    base_orientation: Array
    frames: tuple[str, ...]
    down: Mask
    forces: Array

    def __post_init__(self) -> None:
        k, n, c = len(self.time), len(self.joint_names), len(self.frames)
        shapes: dict[str, tuple[int, ...]] = {"time": (k,), "base_position": (k, 3)}
        shapes |= dict.fromkeys(_OF_JOINTS, (k, n))
        shapes |= {"base_orientation": (k, 4), "forces": (k, c, 3)}
        for name, shape in shapes.items():
            values = real_array(getattr(self, name), name, ndim=len(shape))
            if values.shape != shape:
                raise DataError(f"{name}: shape {values.shape}, expected {shape}.")
            object.__setattr__(self, name, frozen(values))
        down = np.array(self.down, dtype=bool)
        if down.shape != (k, c):
            raise DataError(f"down: shape {down.shape}, expected {(k, c)}: one flag a foot.")
        object.__setattr__(self, "down", frozen_view(down))

    @property
    def duration(self) -> float:
        """Length in s."""
        return float(self.time[-1])

    def __repr__(self) -> str:
        return (
            f"WholeBodyMotion({len(self.joint_names)} joints, {len(self.frames)} feet, "
            f"{self.duration:g} s)"
        )

    def _repr_html_(self) -> str:
        return facts_html("WholeBodyMotion", {"joints": ", ".join(self.joint_names)})

    def columns(self) -> dict[str, Array]:
        """Return all columns by the names that readers of recordings find them by."""
        found: dict[str, Array] = {}
        for name, columns in _layout(self.joint_names, self.frames).items():
            values = np.asarray(getattr(self, name), dtype=np.float64)
            found |= dict(zip(columns, values.reshape(-1, len(columns)).T, strict=True))
        return found

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write all columns as CSV with all digits.

        Raises
        ------
        ExportError
            When the file cannot be written.
        """
        Table.of_columns({k: v.tolist() for k, v in self.columns().items()}).write(Path(path))

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str]) -> WholeBodyMotion:
        """Read what `to_csv` wrote.

        Raises
        ------
        DataError
            When it cannot be read, or a column is missing.
        """
        try:
            header, *lines = read_regular(path, _MOST_BYTES).decode("utf-8").splitlines()
            names, table = header.strip().split(","), np.loadtxt(lines, delimiter=",", ndmin=2)
        except ValueError as cause:
            raise DataError(f"{path}: is no table of numbers ({cause}).") from None
        joints = [name[9:] for name in names if name.startswith("position_")]
        frames = [
            name[8:]
            for name in names
            if name.startswith("contact_") and not name.startswith("contact_force_")
        ]

        values: dict[str, Any] = {}
        for field, columns in _layout(joints, frames).items():
            if missing := [name for name in columns if name not in names]:
                raise DataError(
                    f"{path}: has no column '{missing[0]}'; give a motion of a whole robot, such "
                    "as trajectory.csv of sdpid excite --stand."
                )
            values[field] = table[:, [names.index(name) for name in columns]]
        values["time"], values["down"] = values["time"][:, 0], values["down"] > 0.5
        values["forces"] = values["forces"].reshape(len(table), len(frames), 3)
        return cls(joint_names=tuple(joints), frames=tuple(frames), **values)


def _layout(joints: Sequence[str], frames: Sequence[str]) -> dict[str, list[str]]:
    """Return the columns of each field, by the names that readers of recordings find them by."""
    found = {"time": ["time"]}
    for name in _OF_JOINTS:
        found[name] = [f"{name}_{joint}" for joint in joints]
    found["base_position"] = [f"base_position_{axis}" for axis in _XYZ]
    found["base_orientation"] = [f"base_orientation_{axis}" for axis in (*_XYZ, "w")]
    found["down"] = [f"contact_{frame}" for frame in frames]
    found["forces"] = [f"contact_force_{frame}_{axis}" for frame in frames for axis in _XYZ]
    return found
