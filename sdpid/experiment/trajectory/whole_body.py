"""`WholeBodyMotion`: what all of a robot with a floating base is to do, sample by sample."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid._common.files import read_regular
from sdpid._common.tables import Table
from sdpid.errors import DataError
from sdpid.experiment.recording.floating import EACH_JOINT, XYZ, XYZW, Sampled, samples

# Minutes of a humanoid's motion have less.
_MOST_BYTES = 256 * 2**20


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class WholeBodyMotion(Sampled):
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
    time: Array = samples("time", what="stamps in s", needed=True)
    position: Array = samples("position", "joint_names", what=EACH_JOINT, needed=True)
    velocity: Array = samples("velocity", "joint_names", what=EACH_JOINT, needed=True)
    acceleration: Array = samples("acceleration", "joint_names", what=EACH_JOINT, needed=True)
    effort: Array = samples("effort", "joint_names", what=EACH_JOINT, needed=True)
    base_position: Array = samples("base_position", XYZ, what="x, y, z in m", needed=True)
    base_orientation: Array = samples("base_orientation", XYZW, what="x, y, z, w", needed=True)
    frames: tuple[str, ...]
    down: Mask = samples("contact", "frames", what="one flag a foot", needed=True, flags=True)
    forces: Array = samples("contact_force", "frames", XYZ, what="x, y, z in N", needed=True)

    def __post_init__(self) -> None:
        self._keep_samples()

    @property
    def duration(self) -> float:
        """Length in s."""
        return float(self.time[-1])

    def __repr__(self) -> str:
        return (
            f"WholeBodyMotion({len(self.joint_names)} joints, {len(self.frames)} feet, "
            f"{self.duration:g} s)"
        )

    def _shown(self) -> dict[str, object]:
        return {"joints": ", ".join(self.joint_names)}

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
        feet = [name for name in names if name.startswith("contact_")]
        known = SimpleNamespace(
            joint_names=[name[9:] for name in names if name.startswith("position_")],
            frames=[name[8:] for name in feet if not name.startswith("contact_force_")],
        )
        values: dict[str, Any] = {}
        for field, columns in cls.layout(known).items():
            if missing := [name for name in columns if name not in names]:
                raise DataError(
                    f"{path}: has no column '{missing[0]}'; give a motion of a whole robot, such "
                    "as trajectory.csv of sdpid excite --stand."
                )
            values[field] = table[:, [names.index(name) for name in columns]]
        values["time"] = values["time"][:, 0]
        values["forces"] = values["forces"].reshape(len(table), len(known.frames), len(XYZ))
        return cls(joint_names=tuple(known.joint_names), frames=tuple(known.frames), **values)
