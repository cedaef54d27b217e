"""What a recording writes: Parquet files, and mappings beside CSV files."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid._common.files import atomic_path, atomic_write_text
from sdpid._common.tables import plain
from sdpid.errors import ExportError
from sdpid.experiment.recording.floating import BaseMotion, Contacts
from sdpid.experiment.recording.stored import ROWS

# Where the metadata of a recording stand in the file, and their version.
KEY = b"sdpid"
FORMAT = 1
# The first line of mappings that are written beside CSV files, and may be replaced.
_MADE = "# What the columns of the log beside it cannot tell; written with it."
# A number this near to one of nine decimals, in m or a cosine, was that one before rounding: radii
# of feet are measured in meshes, and rotations are made of cosines.
_DECIMALS, _ROUNDED = 9, 1e-10


def base_metadata(base: BaseMotion | None, contacts: Contacts | None) -> dict[str, Any]:
    """Return what a file says of base and contacts beside their columns."""
    imu = None if base is None else base.imu
    tables: dict[str, tuple[object, tuple[str, ...]]] = {
        "imu": (imu, ("translation", "rotation")),
        "contacts": (contacts, ("frames", "kind", "offset")),
    }
    return {
        name: {key: plain(getattr(part, key)) for key in keys}
        for name, (part, keys) in tables.items()
        if part is not None
    }


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
    import tomli_w

    file, text = mapping_beside(log), tomli_w.dumps(_in_decimals(base_metadata(base, contacts)))
    there = file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""
    ours = there.startswith(_MADE)
    if text and there and not ours:
        raise ExportError(
            f"{file}: is a mapping of another log, and would tell how {log.name} is read; move it "
            f"away, or write to another name than {log.name}."
        )
    if text or ours:
        atomic_write_text(file, f"{_MADE}\n{text}")


def _in_decimals(value: Any) -> Any:
    """Return nested values whose numbers are decimals where they all but are."""
    if isinstance(value, dict):
        return {key: _in_decimals(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_in_decimals(each) for each in value]
    if isinstance(value, float) and abs(value - (near := round(value, _DECIMALS))) < _ROUNDED:
        return near + 0.0
    return value


def write_columns(
    path: str | os.PathLike[str], columns: Mapping[str, Array], metadata: Mapping[str, Any]
) -> None:
    """Write columns of numbers, and metadata beside them, whole or not at all.

    Parameters
    ----------
    path : path-like
        The file.
    columns : mapping of (N,) ndarrays
        Their names and values.
    metadata : mapping
        Plain values, kept as JSON.

    Raises
    ------
    ExportError
        When the file cannot be written.
    MissingExtraError
        When pyarrow is not installed (extra ``io``).
    """
    pa = require("pyarrow", extra="io")
    pq = require("pyarrow.parquet", extra="io")
    schema = pa.schema([pa.field(name, pa.float64(), nullable=False) for name in columns])
    stated = json.dumps({"format": FORMAT, **metadata})
    schema = schema.with_metadata({KEY: stated.encode()})
    # Noisy doubles do not repeat, so a dictionary is a waste; splitting their bytes compresses.
    options = {"compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True}
    count = len(next(iter(columns.values())))
    with atomic_path(path) as temporary, pq.ParquetWriter(temporary, schema, **options) as writer:
        for begin in range(0, count, ROWS):
            parts = (values[begin : begin + ROWS] for values in columns.values())
            arrays = [pa.array(np.ascontiguousarray(part)) for part in parts]
            writer.write_batch(pa.record_batch(arrays, schema=schema))
