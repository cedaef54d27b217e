"""Put what was found of a base and its contacts together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.readers.mapping import Arguments
from sdpid.experiment.readers.names import QUANTITIES
from sdpid.experiment.readers.selection import Selection
from sdpid.experiment.recording.floating import BaseMotion, Contacts, Imu

_FIELDS = {"contact": "down", "contact_force": "forces", "contact_wrench": "wrenches"}


def base_of(file: Path, found: Selection, tables: Mapping[str, Array]) -> BaseMotion | None:
    """Return the motion of the base, None without one.

    Parameters
    ----------
    file : Path
        For messages.
    found : Selection
        Tables by their names, and the settings of ``base`` and ``imu``.
    tables : mapping of (N, m) ndarray
        The values in SI units.

    Raises
    ------
    DataError
        When nothing says the order of quaternions, two velocities have different axes, or a
        table has another number of columns.
    """
    if "base_orientation" not in tables:
        return None
    for quantity, table in tables.items():
        parts = QUANTITIES[quantity].parts
        if parts and not quantity.startswith("contact") and table.shape[1] != len(parts):
            raise DataError(
                f"{file}: {quantity}: has {table.shape[1]} columns, expected {len(parts)}: "
                f"{', '.join(parts)}."
            )
    base, imu = found.said["base"], found.said["imu"]
    order = base.get("quaternion") or found.labels.get("base_orientation")
    if order is None:
        raise DataError(
            f"{file}: base_orientation: the order of its quaternions is not known; say "
            "base={'quaternion': 'xyzw'} or 'wxyz' (quaternion in the table [base] of a mapping), "
            "or leave the base out with columns={'base_orientation': None}."
        )
    velocities = [name for name in tables if name.startswith("base") and name.endswith("velocity")]
    said = (base.get("velocity_frame"),)
    frames = [next(iter(found.labels.get(name, said))) for name in velocities]
    if len(set(frames)) > 1:
        raise DataError(
            f"{file}: {' and '.join(velocities)} have different axes; leave one out, as with "
            f"columns={{'{velocities[0]}': None}}."
        )
    placed = {key: imu[key] for key in ("translation", "rotation") if key in imu}
    sensors = {name: tables[name] for name in ("gyroscope", "accelerometer") if name in tables}
    return BaseMotion(
        orientation=tables["base_orientation"][:, [order.index(part) for part in "xyzw"]],
        position=tables.get("base_position"),
        linear_velocity=tables.get("base_linear_velocity"),
        angular_velocity=tables.get("base_angular_velocity"),
        velocity_frame=frames[0] if frames else None,
        imu=Imu(**sensors, **placed) if sensors else None,
    )


def contacts_of(
    file: Path, found: Selection, tables: Mapping[str, Array], arguments: Arguments
) -> Contacts | None:
    """Return the contacts, None without any.

    Raises
    ------
    DataError
        When the frames are not known, or are another number than there are columns.
    """
    there = {name: tables[name] for name in _FIELDS if name in tables}
    said = found.said["contacts"]
    if not there:
        if arguments.contacts:
            raise DataError(
                f"{file}: contacts is given, but there are no columns of contacts; name them with "
                "columns={'contact': ...}, or 'contact_force' or 'contact_wrench'."
            )
        return None
    columns = next((found.labels[name] for name in there if name in found.labels), None)
    frames, order = _frames(file, columns, said.get("frames"), list(there))
    shaped: dict[str, Any] = {}
    for quantity, table in there.items():
        size = len(QUANTITIES[quantity].parts) or 1
        if table.shape[1] != size * len(frames):
            raise DataError(
                f"{file}: {quantity}: has {table.shape[1]} columns, expected {size} for each of "
                f"the {len(frames)} frames {', '.join(map(str, frames))}."
            )
        values: NDArray[Any] = table.reshape(len(table), len(frames), size)
        values = values if order is None else values[:, order]
        if quantity == "contact":
            # Flags, or what is above the threshold where contacts are closed.
            values, threshold = values[:, :, 0], said.get("threshold")
            values = values if threshold is None else np.asarray(values > float(threshold))
        shaped[_FIELDS[quantity]] = values
    placed = {key: said[key] for key in ("kind", "offset") if key in said}
    return Contacts(frames=frames, **shaped, **placed)


def _frames(
    file: Path, columns: Sequence[str] | None, said: Any, there: list[str]
) -> tuple[tuple[str, ...], list[int] | None]:
    """Return the contacts' frames, and which columns are theirs where they are in another order."""
    if columns is not None and all(label.isdigit() for label in columns):
        columns = None  # Numbers are no names.
    if isinstance(said, str):
        raise DataError(f"{file}: contacts.frames: is {said!r}, expected a list of names.")
    if said is None and columns is None:
        raise DataError(
            f"{file}: {', '.join(there)}: say which frame of the robot each column is of, "
            "contacts={'frames': [...]}."
        )
    if said is None or columns is None:
        return tuple(columns or said), None
    frames = tuple(said)
    same = set(frames) == set(columns)
    return frames, [columns.index(frame) for frame in frames] if same else None
