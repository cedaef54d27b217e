"""Find the columns of a floating base and its contacts in a log."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid.errors import DataError
from sdpid.experiment.readers.column_names import Columns, spelled
from sdpid.experiment.readers.floating.quantities import NAMES, PARTS

_BETWEEN = r"[_./\s\[-]*"
_FRAMES = ("world", "base")
# Words that tell another quantity from a foot that is named behind ``contact_``.
_OTHERS = re.compile(r"(?:forces?|wrench(?:es)?|states?|torques?|moments?)(?:[_./\s-].*)?", re.I)
# Words in the names of what turns and is no base.
_NO_BASE = re.compile(
    r"tcp|tool|eef?\b|ee_|tip|flange|hand|grip|object|target|desired|cmd|camera", re.I
)


@dataclass(kw_only=True)
class Floating:
    """What a log holds of a base and its contacts, in the units of the file.

    Attributes
    ----------
    tables : dict of (N, m) ndarray
        By quantity; contacts one after the other. Empty where there is no base.
    order : str or None
        The order of the quaternions' parts, where the names say it.
    velocity_frames : dict
        The axes of velocities, where their names say them.
    frames : tuple of str or None
        The contacts' names, where columns carry them.
    stated : dict
        What the file says of ``base``, ``imu`` and ``contacts``.
    left_out : dict
        Why a quantity is left out that is there.
    """

    tables: dict[str, NDArray[Any]] = field(default_factory=dict)
    order: str | None = None
    velocity_frames: dict[str, str] = field(default_factory=dict)
    frames: tuple[str, ...] | None = None
    stated: dict[str, Any] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)


def find_floating(
    file: Path, log: Columns, stated: Mapping[str, Any], settings: Mapping[str, Any]
) -> Floating:
    """Find the quantities of a base; nothing where there is no orientation.

    Parameters
    ----------
    file : Path
        For messages.
    log : Columns
        Joints are read already.
    stated : mapping
        What the file says of base, IMU and contacts.
    settings : mapping
        What was said of them, which wins.

    Raises
    ------
    DataError
        When something of a base was asked for and there is no orientation, or columns are not
        there.
    """
    found = Floating(stated={key: dict(value) for key, value in stated.items()})
    for quantity in NAMES:
        table = _read(log, quantity, found)
        if table is not None:
            found.tables[quantity] = _flat(file, quantity, table)
        elif quantity == "base_orientation":
            asked = [name for name in NAMES if log.given(name)[1] is not None]
            asked += sorted(name for name, value in settings.items() if value)
            if asked and not log.given(quantity)[0]:
                raise DataError(
                    f"{file}: {', '.join(asked)} is given, but base_orientation is missing: none "
                    f"of {', '.join(NAMES[quantity])} is there. Name it with "
                    "columns={'base_orientation': ...}."
                )
            unnamed = None if log.given(quantity)[0] else _unnamed(log)
            if unnamed is not None:
                found.left_out[quantity] = unnamed
            return found
    _leave_unknown_axes(log, found, settings)
    return found


def _unnamed(log: Columns) -> str | None:
    """Return which columns may be quaternions of a base, by another name; not those of tools."""
    groups = [
        log.like("base_orientation", rf"(.*(?:quat|orient).*?){_BETWEEN}q?{part}\]?")
        for part in PARTS["base_orientation"]
    ]
    for label, first in groups[0].items():
        if all(label in group for group in groups) and not _NO_BASE.search(label):
            return (
                f"{first} ... {groups[-1][label]} may be those of a floating base; then say "
                f"columns={{'base_orientation': {label!r}}} (--column base_orientation={label})"
            )
    return None


def _leave_unknown_axes(log: Columns, found: Floating, settings: Mapping[str, Any]) -> None:
    """Leave velocities out whose axes nobody says: they are not needed, and never guessed."""
    said = {**found.stated.get("base", {}), **settings.get("base", {})}.get("velocity_frame")
    for quantity in ("base_linear_velocity", "base_angular_velocity"):
        if quantity not in found.tables or said or quantity in found.velocity_frames:
            continue
        if log.given(quantity)[0]:
            continue  # The base refuses it by name.
        del found.tables[quantity]
        name = log.used[quantity][0]
        log.forget(quantity)
        found.left_out[quantity] = (
            f"{name}: its axes are not known; say base={{'velocity_frame': 'world'}} or 'base'"
        )


def _read(log: Columns, quantity: str, found: Floating) -> NDArray[Any] | None:
    """Read one quantity, if it is there."""
    known, given = log.given(quantity)
    if known and given is None:
        return None
    if known and not isinstance(given, str):
        names = list(given)
        if quantity == "base_orientation":
            found.order = _order_of(names)
        return log.read(quantity, None, dict(zip(names, names, strict=True)))
    for key in [given] if known else NAMES[quantity]:
        table = _of_name(log, quantity, key, found)
        if table is not None:
            return table
    if known:
        raise log.absent(quantity, given)
    return None


def _of_name(log: Columns, quantity: str, key: str, found: Floating) -> NDArray[Any] | None:
    """Read an array of a name, or columns that begin with it."""
    parts = PARTS[quantity]
    if quantity.endswith("_velocity"):
        for frame in _FRAMES:
            table = _of_parts(log, quantity, f"{key}_{frame}", parts)
            if table is not None:
                found.velocity_frames[quantity] = frame
                return table
    places = log.places(key, quantity)
    if len(places) == 1:
        return log.read(quantity, None, {"": places[0]})
    if quantity.startswith("contact"):
        return _of_contacts(log, quantity, key, found)
    table = _of_parts(log, quantity, key, parts)
    if table is not None and quantity == "base_orientation":
        found.order = "xyzw"
    return table


def _of_parts(log: Columns, quantity: str, key: str, parts: tuple[str, ...]) -> NDArray[Any] | None:
    """Read the columns ``key_x``, ``key_y`` and so on, if all are there."""
    sign = "q?" if quantity == "base_orientation" else ""
    group = log.like(quantity, rf"{spelled(key)}{_BETWEEN}{sign}({'|'.join(parts)})\]?")
    by_part = {part.lower(): name for part, name in group.items()}
    if set(by_part) != set(parts):
        return None
    return log.read(quantity, None, {part: by_part[part] for part in parts})


def _of_contacts(log: Columns, quantity: str, key: str, found: Floating) -> NDArray[Any] | None:
    """Read the columns ``key_foot``, or ``key_foot_x`` and so on, of every foot."""
    parts = PARTS[quantity]
    end = rf"{_BETWEEN}(?:{'|'.join(parts)})\]?" if parts else r"\]?"
    labels = log.like(quantity, rf"{spelled(key)}{_BETWEEN}(.+?){end}")
    labels = {label: name for label, name in labels.items() if not _OTHERS.fullmatch(label)}
    if not labels:
        return None
    frames = tuple(labels) if found.frames is None else found.frames
    if set(frames) != set(labels):
        raise log.absent(quantity, f"{key}_<foot>' of the feet '{', '.join(frames)}")
    names: list[str] = []
    for frame in frames:
        if not parts:
            names.append(labels[frame])
            continue
        group = log.like(
            quantity, rf"{spelled(key)}{_BETWEEN}{re.escape(frame)}{_BETWEEN}({'|'.join(parts)})\]?"
        )
        if set(group) != set(parts):
            return None
        names += [group[part] for part in parts]
    found.frames = frames
    return log.read(quantity, None, dict(zip(names, names, strict=True)))


def _order_of(names: list[str]) -> str | None:
    """Return the order of quaternions that the last letters of names tell, None where none."""
    letters = "".join(name.rstrip("])")[-1:].lower() for name in names)
    return letters if sorted(letters) == ["w", "x", "y", "z"] else None


def _flat(file: Path, quantity: str, table: NDArray[Any]) -> NDArray[Any]:
    """Return samples × columns of numbers."""
    if table.dtype.kind not in "fiub":
        raise DataError(f"{file}: {quantity}: holds {table.dtype}, expected numbers.")
    if table.ndim not in (1, 2, 3):
        raise DataError(f"{file}: {quantity}: has the shape {table.shape}, expected 2 or 3 axes.")
    return np.asarray(table).reshape(len(table), -1)
