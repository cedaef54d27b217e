"""Put what was found of a base and its contacts together."""

from __future__ import annotations

from collections.abc import Mapping
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


def base_of(found: Selection, tables: Mapping[str, Array]) -> BaseMotion | None:
    """Return the motion of the base, None without one.

    Parameters
    ----------
    found : Selection
        What the columns of tables are called, and the settings of ``base`` and ``imu``.
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
                f"{quantity}: has {table.shape[1]} columns, expected {len(parts)}: "
                f"{', '.join(parts)}."
            )
    base, imu = found.said["base"], found.said["imu"]
    order = base.get("quaternion") or found.labels.get("base_orientation")
    if order is None:
        raise DataError(
            "base_orientation: the order of its quaternions is not known; say "
            "base={'quaternion': 'xyzw'} or 'wxyz' (quaternion in the table [base] of a mapping), "
            "or leave the base out with columns={'base_orientation': None}."
        )
    velocities = [name for name in tables if name.startswith("base") and name.endswith("velocity")]
    said = (base.get("velocity_frame"),)
    frames: list[Any] = [found.labels.get(name, said)[0] for name in velocities]
    if len(set(frames)) > 1:
        raise DataError(
            f"{' and '.join(velocities)} have different axes; leave one out, as with "
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
    found: Selection, tables: Mapping[str, Array], arguments: Arguments
) -> Contacts | None:
    """Return the contacts, None without any.

    Raises
    ------
    DataError
        When the frames are not known, or are another number than there are columns.
    """
    there, said = [name for name in _FIELDS if name in tables], found.said["contacts"]
    if not there and arguments.contacts:
        raise DataError(
            "contacts is given, but there are no columns of contacts; name them with "
            "columns={'contact': ...}, or 'contact_force' or 'contact_wrench'."
        )
    if not there:
        return None
    feet = next((found.labels[name] for name in there if name in found.labels), None)
    if feet is not None and all(label.isdigit() for label in feet):
        feet = None  # Numbers are no names.
    frames = said.get("frames", feet)
    if frames is None:
        raise DataError(
            f"{', '.join(there)}: say which frame of the robot each column is of, "
            "contacts={'frames': [...]}."
        )
    if isinstance(frames, str):
        raise DataError(f"contacts.frames: is {frames!r}, expected a list of names.")
    # Frames may be told in another order than the columns have.
    turned = feet is not None and set(feet) == set(frames)
    order = [feet.index(frame) for frame in frames] if feet and turned else slice(None)
    shaped: dict[str, Any] = {}
    for quantity in there:
        table, size = tables[quantity], len(QUANTITIES[quantity].parts) or 1
        if table.shape[1] != size * len(frames):
            raise DataError(
                f"{quantity}: has {table.shape[1]} columns, expected {size} for each of "
                f"the {len(frames)} frames {', '.join(map(str, frames))}."
            )
        values: NDArray[Any] = table.reshape(len(table), len(frames), size)[:, order]
        if quantity == "contact":
            # Flags, or what is above the threshold where contacts are closed.
            values, threshold = values[:, :, 0], said.get("threshold")
            values = values if threshold is None else np.asarray(values > float(threshold))
        shaped[_FIELDS[quantity]] = values
    placed = {key: said[key] for key in ("kind", "offset") if key in said}
    return Contacts(frames=tuple(frames), **shaped, **placed)
