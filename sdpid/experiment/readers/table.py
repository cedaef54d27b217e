"""The named arrays of a log file, each read when it is needed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from sdpid.errors import DataError


class NoNumbersError(DataError):
    """A name of a log stands for something else than numbers or text."""


# A name, and how to read what it names. Only what is wanted is read, so an array that cannot be
# used does no harm to the rest.
Arrays = Mapping[str, Callable[[], NDArray[Any]]]


def row_number(sample: int) -> str:
    """Return where a sample stands, rows counted from 1."""
    return f"row {sample + 1}"


@dataclass(frozen=True)
class LogTable:
    """The named arrays of a log.

    Attributes
    ----------
    arrays : mapping
        Names, and how to read what they name. Parts of a path are separated by ``/``.
    place : callable
        Says where sample k, counted from 0, stands in the file; for messages.
    unnamed : bool
        Whether columns have numbers from 1 instead of names.
    columns : callable, optional
        Reads several plain columns at once, as a table.
    plain : frozenset of str
        Names that are known to be columns of numbers.
    units : mapping
        Units that are known for some names.
    stated : mapping
        What the file says of ``base``, ``imu`` and ``contacts``.
    """

    arrays: Arrays
    place: Callable[[int], str] = row_number
    unnamed: bool = False
    columns: Callable[[Sequence[str]], NDArray[Any]] | None = None
    plain: frozenset[str] = frozenset()
    units: Mapping[str, str] = field(default_factory=dict)
    stated: Mapping[str, Any] = field(default_factory=dict)
