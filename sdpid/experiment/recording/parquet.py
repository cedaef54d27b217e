"""Recordings in Parquet files, without loss and in pieces, so that memory stays small."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sdpid._common.extras import require
from sdpid._common.files import atomic_path
from sdpid.errors import DataError
from sdpid.experiment.recording.memory_budget import check_claim
from sdpid.experiment.recording.stored import StoredTable
from sdpid.experiment.recording.stored_file import ROWS, StoredFile, numbers, readable

if TYPE_CHECKING:
    from sdpid.experiment.recording.recording import Recording

__all__ = ["LARGE", "read_metadata", "read_parquet", "write_parquet"]

# Values that would take more bytes than that stay in their file.
LARGE = 1 << 28
_KEY = b"sdpid"
_FORMAT = 1
_MOST_JOINTS = 10_000
_QUANTITIES = ("position", "effort", "velocity")


def write_parquet(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording; see `Recording.to_parquet`."""
    pa = require("pyarrow", extra="io")
    pq = require("pyarrow.parquet", extra="io")
    columns = {"time": recording.time}
    for quantity in _QUANTITIES:
        table = getattr(recording, quantity)
        if table is not None:
            columns |= {f"{quantity}_{name}": table[:, j] for j, name in enumerate(recording.names)}
    scale = recording.effort_scale
    metadata = {
        "format": _FORMAT,
        "n": recording.n,
        "joint_names": recording.joint_names,
        "period": recording.period,
        "start": recording.start,
        "periods": recording.periods,
        "effort_scale": None if scale is None else scale.tolist(),
    }
    schema = pa.schema([pa.field(name, pa.float64(), nullable=False) for name in columns])
    schema = schema.with_metadata({_KEY: json.dumps(metadata).encode()})
    # Noisy doubles do not repeat, so a dictionary is a waste; splitting their bytes compresses.
    options = {"compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True}
    with atomic_path(path) as temporary, pq.ParquetWriter(temporary, schema, **options) as writer:
        for begin in range(0, recording.n_samples, ROWS):
            rows = slice(begin, begin + ROWS)
            arrays = [pa.array(np.ascontiguousarray(values[rows])) for values in columns.values()]
            writer.write_batch(pa.record_batch(arrays, schema=schema))


def read_parquet(path: str | os.PathLike[str], *, stored: bool | None = None) -> Recording:
    """Read a recording; see `Recording.from_parquet`."""
    from sdpid.experiment.recording.recording import Recording

    if not Path(path).is_file():
        raise DataError(f"{path}: there is no such file.")
    # Buffered ahead, the whole file would be in memory beside the arrays.
    with readable(path) as pq, pq.ParquetFile(path, pre_buffer=False) as file:
        metadata = read_metadata(file.schema_arrow.metadata, path)
        names = list(file.schema_arrow.names)
        layout = _layout(names, metadata, path)
        size = 8 * file.metadata.num_rows * sum(len(where) for where in layout.values())
        found: dict[str, Any]
        if size > LARGE if stored is None else stored:
            found = _columns(file, layout, path)
        else:
            found = _arrays(file, layout, path)
    joint_names = metadata.get("joint_names")
    if not metadata:
        joint_names = _suffixes(names)
        if all(name.isdigit() for name in joint_names):
            joint_names = None
    return Recording(
        **found,
        joint_names=joint_names,
        period=metadata.get("period"),
        start=metadata.get("start"),
        periods=metadata.get("periods"),
        effort_scale=metadata.get("effort_scale"),
    )


def _columns(file: Any, layout: dict[str, list[int]], path: Any) -> dict[str, Any]:
    """Return the columns of a recording, left where they are."""
    names = file.schema_arrow.names
    if file.metadata.num_columns != len(names):
        raise DataError(f"{path}: has columns of more than one number; read it with stored=False.")
    for where in layout.values():
        for index in where:
            check_claim(Path(path), names[index], (file.metadata.num_rows,), 8, loaded=False)
    source = StoredFile.of(path, file.metadata, names)
    tables = {quantity: StoredTable(source, where) for quantity, where in layout.items()}
    return tables | {"time": tables["time"].column(0)}


def _arrays(file: Any, layout: dict[str, list[int]], path: Any) -> dict[str, Any]:
    """Return the arrays of a recording, filled piece by piece."""
    names, rows = file.schema_arrow.names, file.metadata.num_rows
    check_claim(Path(path), "all columns", (rows, len(names)), 8)
    arrays = {
        quantity: np.empty((rows, len(where)), dtype=np.float64)
        for quantity, where in layout.items()
    }
    begin = 0
    for batch in file.iter_batches(batch_size=ROWS, use_threads=False):
        end = begin + batch.num_rows
        for quantity, where in layout.items():
            for j, index in enumerate(where):
                values = numbers(batch.column(index), names[index], path)
                arrays[quantity][begin:end, j] = values
        begin = end
    if begin != rows:
        raise DataError(f"{path}: holds {begin} rows where {rows} are announced.")
    return arrays | {"time": arrays["time"][:, 0]}


def read_metadata(raw: dict[bytes, bytes] | None, path: Any) -> dict[str, Any]:
    """Return what `write_parquet` kept beside the columns; empty for other files.

    Raises
    ------
    DataError
        When the metadata is damaged, or of a later format.
    """
    if not raw or _KEY not in raw:
        return {}
    try:
        metadata = json.loads(raw[_KEY])
    except (ValueError, RecursionError):
        metadata = None
    if not isinstance(metadata, dict):
        raise DataError(f"{path}: the metadata under 'sdpid' is damaged.")
    if metadata.get("format") != _FORMAT:
        raise DataError(
            f"{path}: is of format {metadata.get('format')}, this version reads {_FORMAT}."
        )
    count, names = metadata.get("n"), metadata.get("joint_names")
    sound = isinstance(count, int) and 0 < count <= _MOST_JOINTS
    if names is not None:
        sound = isinstance(names, list) and all(isinstance(name, str) for name in names)
    if not sound:
        raise DataError(f"{path}: the metadata under 'sdpid' is damaged: it names no joints.")
    return metadata


def _layout(names: list[str], metadata: dict[str, Any], path: Any) -> dict[str, list[int]]:
    """Return the column indices of time and of each quantity, joint by joint."""
    if metadata:
        given = metadata.get("joint_names")
        joints = [str(j + 1) for j in range(int(metadata.get("n", 0)))] if given is None else given
    else:
        joints = _suffixes(names)
    layout = {"time": ["time"]} | {q: [f"{q}_{joint}" for joint in joints] for q in _QUANTITIES}
    if not any(name.startswith("velocity_") for name in names):
        del layout["velocity"]
    missing = [name for wanted in layout.values() for name in wanted if name not in names]
    if missing or not joints:
        raise DataError(
            f"{path}: lacks the columns {', '.join(missing) or 'position_<joint>'}; it has "
            f"{', '.join(names)}. Read other layouts with read_recording(path, columns=...)."
        )
    return {quantity: [names.index(name) for name in wanted] for quantity, wanted in layout.items()}


def _suffixes(names: list[str]) -> list[str]:
    """Return what follows ``position_`` in the names of columns."""
    return [name.removeprefix("position_") for name in names if name.startswith("position_")]
