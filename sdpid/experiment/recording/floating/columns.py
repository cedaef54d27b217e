"""The columns of a base and its contacts in files, by their names."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.files import atomic_write_text
from sdpid.errors import ExportError
from sdpid.experiment.recording.floating.base import BaseMotion
from sdpid.experiment.recording.floating.contacts import Contacts

# The first line of mappings that are written beside CSV files, and may be replaced.
_MADE = "# What the columns of the log beside it cannot tell; written with it."
_XYZ, _WRENCH = ("x", "y", "z"), ("fx", "fy", "fz", "mx", "my", "mz")


# A number this near to one of nine decimals, in m or a cosine, was that one before rounding: radii
# of feet are measured in meshes, and rotations are made of cosines.
_DECIMALS, _ROUNDED = 9, 1e-10


def base_columns(base: BaseMotion | None, contacts: Contacts | None) -> dict[str, Array]:
    """Return the columns of a base and of contacts, by the names that readers find them by.

    Velocities carry the frame of their axes in their names: ``base_linear_velocity_world_x``.
    """
    found: dict[str, Any] = {}
    if base is not None:
        frame = base.velocity_frame
        found |= _columns("base_position", base.position, _XYZ)
        found |= _columns("base_orientation", base.orientation, (*_XYZ, "w"))
        found |= _columns(f"base_linear_velocity_{frame}", base.linear_velocity, _XYZ)
        found |= _columns(f"base_angular_velocity_{frame}", base.angular_velocity, _XYZ)
        if base.imu is not None:
            found |= _columns("gyroscope", base.imu.gyroscope, _XYZ)
            found |= _columns("accelerometer", base.imu.accelerometer, _XYZ)
    if contacts is not None:
        down = contacts.down
        found |= _columns(
            "contact", None if down is None else down.astype(np.float64), contacts.frames
        )
        for i, contact in enumerate(contacts.frames):
            for name, table, parts in (
                ("contact_force", contacts.forces, _XYZ),
                ("contact_wrench", contacts.wrenches, _WRENCH),
            ):
                found |= _columns(
                    f"{name}_{contact}", None if table is None else table[:, i], parts
                )
    return found


def base_metadata(base: BaseMotion | None, contacts: Contacts | None) -> Mapping[str, Any]:
    """Return what a file says of base and contacts beside their columns."""
    found: dict[str, Any] = {}
    if base is not None and base.imu is not None:
        imu = base.imu
        found["imu"] = {
            "translation": imu.translation.tolist(),
            "rotation": imu.rotation.tolist(),
        }
    if contacts is not None:
        found["contacts"] = {
            "frames": list(contacts.frames),
            "kind": list(contacts.kind),
            "offset": contacts.offset.tolist(),
        }
    return found


def mapping_beside(log: Path) -> Path:
    """Return where the mapping of a log lies: `run.toml` for `run.csv`, `run.csv.gz` or `run`."""
    unpacked = log.with_suffix("") if log.suffix.lower() == ".gz" else log
    return log.parent / f"{unpacked.stem}.toml"


def write_mapping(log: Path, base: BaseMotion | None, contacts: Contacts | None) -> None:
    """Write beside a CSV file what its columns cannot tell, unless there is nothing.

    Raises
    ------
    ExportError
        When a mapping that was not written so lies there.
    """
    file, text = mapping_beside(log), _base_mapping(base, contacts)
    there = file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""
    ours = there.startswith(_MADE)
    if text and there and not ours:
        raise ExportError(
            f"{file}: is a mapping of another log, and would tell how {log.name} is read; move it "
            f"away, or write to another name than {log.name}."
        )
    if text or ours:
        atomic_write_text(file, f"{_MADE}\n{text}")


def _base_mapping(base: BaseMotion | None, contacts: Contacts | None) -> str:
    """Return the text of a mapping, which tells beside a CSV file what its columns cannot."""
    lines = []
    for table, content in base_metadata(base, contacts).items():
        lines.append(f"[{table}]")
        lines += [f"{key} = {json.dumps(_in_decimals(value))}" for key, value in content.items()]
    return "".join(f"{line}\n" for line in lines)


def _in_decimals(value: Any) -> Any:
    """Return nested lists whose numbers are decimals where they all but are."""
    if isinstance(value, list):
        return [_in_decimals(each) for each in value]
    if isinstance(value, float) and abs(value - (near := round(value, _DECIMALS))) < _ROUNDED:
        return near + 0.0
    return value


def _columns(name: str, table: Array | None, parts: tuple[str, ...]) -> dict[str, Array]:
    """Return the columns of a table by name and part."""
    if table is None:
        return {}
    return {f"{name}_{part}": table[:, i] for i, part in enumerate(parts)}
