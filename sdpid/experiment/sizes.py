"""How much a file may ask for: what a header claims is checked before memory is given to it."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from pathlib import Path

from sdpid.errors import DataError

__all__ = ["Budget"]

# The arrays of one log, at most: an hour of a six-axis arm at 4 kHz with ten quantities has
# 7 GB; logs beyond this limit should be cut or thinned before they are read.
_MOST_BYTES = 1 << 33
# Neither may they take more than this share of the machine's memory, for they are copied once.
_SHARE_OF_MEMORY = 0.4
# Deflate compresses at most 1032 times; measured numbers hardly twice. Run lengths have no such
# bound, so a small file that claims much more is taken for damaged or hostile ...
_MOST_COMPRESSION = 1100
# ... but for arrays so small that they do no harm.
_HARMLESS_BYTES = 1 << 25


class Budget:
    """The bytes that the arrays of one file may take.

    Parameters
    ----------
    path : Path
        The file, or the folder whose files are read together.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = _size(path)
        self._taken: dict[str, int] = {}
        self._limit = min(_MOST_BYTES, int(_SHARE_OF_MEMORY * _memory()))

    def take(self, name: str, shape: Iterable[int], itemsize: int) -> None:
        """Account for an array before it is read; a second reading of it is not counted.

        Parameters
        ----------
        name : str
            What the file calls the array.
        shape : iterable of int
            The shape that the file claims.
        itemsize : int
            Bytes an entry.

        Raises
        ------
        DataError
            When the claim is larger than what the file can hold, or than memory allows.
        """
        shape = tuple(shape)
        size = self.plausible(name, shape, itemsize)
        self._taken[name] = size
        if (total := sum(self._taken.values())) > self._limit:
            raise DataError(
                f"{self._path}: with '{name}' ({_amount(shape)}) the arrays take {_mega(total)}, "
                f"more than the limit of {_mega(self._limit)}; cut the log into parts, or thin it."
            )

    def plausible(self, name: str, shape: Iterable[int], itemsize: int) -> int:
        """Return the bytes of an array that is read in pieces, as it may be larger than memory.

        Raises
        ------
        DataError
            When the claim is larger than what the file can hold.
        """
        shape = tuple(int(size) for size in shape)
        size = math.prod(shape) * max(1, itemsize)
        if min(shape, default=0) < 0:
            raise DataError(f"{self._path}: '{name}' claims the shape {shape}.")
        if size > _HARMLESS_BYTES and size > _MOST_COMPRESSION * self._file:
            raise DataError(
                f"{self._path}: '{name}' claims {_amount(shape)}, {_mega(size)}, in a file of "
                f"{_mega(self._file)}: the file is damaged, or its header is not honest."
            )
        return size


def _size(path: Path) -> int:
    """Return the bytes of a file, or of the files in a folder."""
    try:
        if path.is_dir():
            return sum(file.stat().st_size for file in path.iterdir() if file.is_file())
        return path.stat().st_size
    except OSError as cause:
        raise DataError(f"cannot read {path}: {cause.strerror}.") from None


def _memory() -> float:
    """Return the bytes of the machine's memory; infinite where it does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):
        return math.inf


def _amount(shape: tuple[int, ...]) -> str:
    """Return a shape in words."""
    return " × ".join(f"{size:,}" for size in shape) + " values" if shape else "one value"


def _mega(size: int) -> str:
    """Return bytes in MB."""
    return f"{size / 1e6:,.3g} MB" if size < 1e9 else f"{size / 1e9:,.4g} GB"
