"""`WholeBodyMotion`: what all of a robot with a floating base is to do, sample by sample."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen, frozen_view, real_array
from sdpid._common.files import read_regular
from sdpid._common.tables import Table, facts_html
from sdpid.errors import DataError

_XYZ = ("x", "y", "z")

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
        shapes |= dict.fromkeys(("position", "velocity", "acceleration", "effort"), (k, n))
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
        found = {"time": self.time}
        for name in ("position", "velocity", "acceleration", "effort"):
            for j, joint in enumerate(self.joint_names):
                found[f"{name}_{joint}"] = getattr(self, name)[:, j]
        for i, axis in enumerate(_XYZ):
            found[f"base_position_{axis}"] = self.base_position[:, i]
        for i, axis in enumerate((*_XYZ, "w")):
            found[f"base_orientation_{axis}"] = self.base_orientation[:, i]
        for j, frame in enumerate(self.frames):
            found[f"contact_{frame}"] = self.down[:, j].astype(np.float64)
        for j, frame in enumerate(self.frames):
            for i, axis in enumerate(_XYZ):
                found[f"contact_force_{frame}_{axis}"] = self.forces[:, j, i]
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

        def columns(*wanted: str) -> Array:
            if missing := [name for name in wanted if name not in names]:
                raise DataError(
                    f"{path}: has no column '{missing[0]}'; give a motion of a whole robot, such "
                    "as trajectory.csv of sdpid excite --stand."
                )
            return np.asarray(table[:, [names.index(name) for name in wanted]])

        force = [f"contact_force_{frame}_{axis}" for frame in frames for axis in _XYZ]
        return cls(
            joint_names=tuple(joints),
            time=columns("time")[:, 0],
            **{
                quantity: columns(*(f"{quantity}_{joint}" for joint in joints))
                for quantity in ("position", "velocity", "acceleration", "effort")
            },
            base_position=columns(*(f"base_position_{axis}" for axis in _XYZ)),
            base_orientation=columns(*(f"base_orientation_{axis}" for axis in (*_XYZ, "w"))),
            frames=tuple(frames),
            down=columns(*(f"contact_{frame}" for frame in frames)) > 0.5,
            forces=columns(*force).reshape(len(table), len(frames), 3),
        )
