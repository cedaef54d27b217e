"""Arrays of samples that belong to a base or to contacts: checked once, then read-only."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array, Mask, frozen, frozen_view, real_array
from sdpid.errors import DataError

T = TypeVar("T", bound="Sampled")

# A rotation matrix typed with three digits is off by this much; a larger error is another matrix.
_OFF_ROTATION = 2e-3
# A matrix this near to orthonormal is kept to the bit.
_EXACT = 1e-14


class Sampled:
    """A frozen dataclass with channels of as many samples each, of which some may be missing."""

    _sampled: ClassVar[tuple[str, ...]]

    @property
    def channels(self) -> dict[str, Any]:
        """The channels that there are, by their names."""
        given = {name: getattr(self, name) for name in self._sampled}
        return {name: table for name, table in given.items() if table is not None}

    @property
    def n_samples(self) -> int:
        """Number of samples, N."""
        return next(len(table) for table in self.channels.values())

    def rows(self: T, rows: slice | NDArray[Any]) -> T:
        """Return some samples."""
        taken: Any = {name: table[rows] for name, table in self.channels.items()}
        for name, part in vars(self).items():
            if isinstance(part, Sampled):
                taken[name] = part.rows(rows)
        return replace(self, **taken)  # type: ignore[type-var]

    def _require_equal_lengths(self, where: str) -> None:
        """Refuse channels of different lengths."""
        lengths = {name: len(table) for name, table in self.channels.items()}
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise DataError(f"{where}: its channels have different numbers of samples: {listed}.")


def keep_samples(
    owner: Any, name: str, tail: tuple[int, ...], what: str, *, called: str | None = None
) -> Array | None:
    """Check the array of samples in a field, (N, ...), and put it back read-only.

    Parameters
    ----------
    owner : frozen dataclass
        Whose field it is.
    name : str
        The field; None is left alone.
    tail : tuple of int
        The shape of one sample.
    what : str
        What the columns are, for the message.
    called : str, optional
        The name in messages.
    """
    given = getattr(owner, name)
    if given is None:
        return None
    called = called or name
    array = np.ascontiguousarray(real_array(given, called, ndim=1 + len(tail)))
    if array.shape[1:] != tail or not array.size:
        wanted = ", ".join(["N", *map(str, tail)])
        raise DataError(f"{called}: has shape {array.shape}, expected ({wanted}): {what}.")
    object.__setattr__(owner, name, frozen_view(array))
    return array


def keep_flags(owner: Any, name: str, columns: int, *, called: str) -> Mask | None:
    """Check flags (N, columns), True or False, or 1 and 0, and put them back read-only."""
    given = getattr(owner, name)
    if given is None:
        return None
    array = np.asarray(given)
    if array.dtype != np.bool_:
        numbers = real_array(given, called, ndim=2)
        if not np.isin(numbers, (0.0, 1.0)).all():
            other = numbers[~np.isin(numbers, (0.0, 1.0))][0]
            raise DataError(
                f"{called}: holds {other:.6g}, expected True or False (or 1 and 0); compare "
                "forces or probabilities with a threshold first."
            )
        array = numbers == 1.0
    if array.ndim != 2 or array.shape[1] != columns or not array.size:
        raise DataError(
            f"{called}: has shape {array.shape}, expected (N, {columns}): one column for each "
            "frame."
        )
    flags: NDArray[np.bool_] = np.ascontiguousarray(array)
    object.__setattr__(owner, name, frozen_view(flags))
    return flags


def keep_vector(owner: Any, name: str, *, called: str) -> None:
    """Check a vector (3,) in a field and put it back read-only."""
    vector = frozen(real_array(getattr(owner, name), called, ndim=1))
    if vector.shape != (3,):
        raise DataError(f"{called}: has shape {vector.shape}, expected (3,): x, y, z in m.")
    object.__setattr__(owner, name, vector)


def rotation_matrix(given: Any, *, called: str) -> Array:
    """Return the rotation matrix that is nearest to a given one, which must be near to it."""
    matrix = real_array(given, called, ndim=2)
    if matrix.shape != (3, 3):
        raise DataError(f"{called}: has shape {matrix.shape}, expected (3, 3): a rotation matrix.")
    off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if off > _OFF_ROTATION or np.linalg.det(matrix) < 0.0:
        raise DataError(
            f"{called}: is no rotation matrix: R·Rᵀ is off the unit matrix by {off:.3g}, limit "
            f"{_OFF_ROTATION:g}, and its determinant is {np.linalg.det(matrix):.4g}, expected 1. "
            "Its columns are the sensor's axes in the axes of the base."
        )
    if off > _EXACT:
        left, _, right = np.linalg.svd(matrix)
        matrix = left @ right
    return frozen(matrix)
