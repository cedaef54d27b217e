"""What a fit of positions finds: drives of every joint, one delay, and where each motion starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Indices

# Numbers of every joint, in the order of the rows of `DriveNumbers.values`, and their units.
UNITS = {
    "armature": "kg.m2",
    "damping": "N.m.s/rad",
    "friction": "N.m",
    "slope": "N.m/rad",
    "curve": "N.m/rad2",
    "offset": "N.m",
    "kp": "N.m/rad",
    "kd": "N.m.s/rad",
}
ROW = {name: k for k, name in enumerate(UNITS)}

# Physics forbids that these are negative.
_NOT_NEGATIVE = ("armature", "damping", "friction", "kp", "kd")

# The longest delay (s) that is looked for: drives answer within a few periods of their loop.
LONGEST_DELAY = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveNumbers:
    """Numbers of the drives of n joints.

    Attributes
    ----------
    values : ndarray, shape (8, n)
        One row a kind, as `UNITS` lists them. Dry friction at the position q is
        ``friction + slope·z + curve·z²`` with ``z = q − middle``, and never below zero.
    middle : ndarray, shape (n,)
        Middle of the positions, rad (m).
    delay : float
        Time from a command to its effort, s.
    """

    values: Array
    middle: Array
    delay: float

    def __getitem__(self, name: str) -> Array:
        return np.asarray(self.values[ROW[name]])

    def dry(self, position: Array) -> Array:
        """Return the level (..., n) of dry friction at positions, N·m (N)."""
        z = position - self.middle
        level = self["friction"] + z * (self["slope"] + z * self["curve"])
        return np.asarray(np.maximum(level, 0.0))

    def with_rows(self, **rows: Array | float) -> DriveNumbers:
        """Return a copy with other values of these kinds."""
        values = self.values.copy()
        for name, row in rows.items():
            values[ROW[name]] = row
        return replace(self, values=values)


@dataclass(frozen=True, kw_only=True, eq=False)
class Unknowns:
    """Which numbers a fit moves, as one vector.

    The vector has the free drives row by row, the delay, then of every motion its positions and
    velocities at the start.

    Attributes
    ----------
    rows : tuple of str
        Kinds that are free.
    delay : bool
        Whether the delay is.
    motions, n : int
        Number of motions and joints.
    """

    rows: tuple[str, ...]
    delay: bool
    motions: int
    n: int

    @property
    def count(self) -> int:
        """Length of the vector."""
        return len(self.rows) * self.n + self.delay + 2 * self.motions * self.n

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the drives' numbers, the delay's last: those that are reported."""
        drives = [f"{row}{j + 1}" for row in self.rows for j in range(self.n)]
        return (*drives, *(["delay"] if self.delay else []))

    def at(self, motion: int, joints: Indices) -> Indices:
        """Return where the numbers of these joints and of a motion's start stand."""
        n, size = self.n, len(self.names)
        rows = n * np.arange(len(self.rows))[:, None] + joints
        starts = size + n * (2 * motion + np.arange(2))[:, None] + joints
        delay = [size - 1] * self.delay
        return np.concatenate([rows.ravel(), delay, starts.ravel()]).astype(np.intp)

    def pack(self, drives: DriveNumbers, starts: Sequence[Array]) -> Array:
        """Return the vector of these drives and starts, (2, n) a motion."""
        rows = [drives[name] for name in self.rows]
        return np.concatenate([*rows, [drives.delay] * self.delay, *(s.ravel() for s in starts)])

    def unpack(self, x: Array, drives: DriveNumbers) -> tuple[DriveNumbers, list[Array]]:
        """Return drives and starts of a vector; what is not free stays as in `drives`."""
        rows, delay, starts = np.split(x, [len(self.rows) * self.n, len(self.names)])
        found = drives.with_rows(**dict(zip(self.rows, rows.reshape(-1, self.n), strict=True)))
        if self.delay:
            found = replace(found, delay=float(delay[0]))
        return found, list(starts.reshape(self.motions, 2, self.n))

    def bounds(self) -> tuple[Array, Array]:
        """Return the least and largest values that the numbers may have, (count,) each."""
        low, high = np.full(self.count, -np.inf), np.full(self.count, np.inf)
        least = [0.0 if name in _NOT_NEGATIVE else -np.inf for name in self.rows]
        size = len(self.rows) * self.n
        low[:size], delay = np.repeat(least, self.n), slice(size, size + self.delay)
        low[delay], high[delay] = 0.0, LONGEST_DELAY
        return low, high
