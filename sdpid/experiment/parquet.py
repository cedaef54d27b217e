"""Recordings in Parquet files, without loss and in pieces, so that memory stays small."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sdpid._arrays import Array
from sdpid._extras import require
from sdpid._files import atomic_path
from sdpid.errors import DataError
from sdpid.experiment.sizes import Budget

if TYPE_CHECKING:
    from sdpid.experiment.recording import Recording

__all__ = ["read_metadata", "read_parquet", "write_parquet"]

# Rows converted at a time: a few tens of MB for a six-axis arm.
_ROWS = 1 << 17
_KEY = b"sdpid"
_FORMAT = 1
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
        for begin in range(0, recording.n_samples, _ROWS):
            rows = slice(begin, begin + _ROWS)
            arrays = [pa.array(np.ascontiguousarray(values[rows])) for values in columns.values()]
            writer.write_batch(pa.record_batch(arrays, schema=schema))


def read_parquet(path: str | os.PathLike[str]) -> Recording:
    """Read a recording; see `Recording.from_parquet`."""
    from sdpid.experiment.recording import Recording

    pa = require("pyarrow", extra="io")
    pq = require("pyarrow.parquet", extra="io")
    if not Path(path).is_file():
        raise DataError(f"{path}: there is no such file.")
    try:
        # Buffered ahead, the whole file would be in memory beside the arrays.
        with pq.ParquetFile(path, pre_buffer=False) as file:
            metadata = read_metadata(file.schema_arrow.metadata, path)
            names = list(file.schema_arrow.names)
            layout = _layout(names, metadata, path)
            rows = file.metadata.num_rows
            Budget(Path(path)).take("all columns", (rows, len(names)), 8)
            arrays = {quantity: _empty(rows, where) for quantity, where in layout.items()}
            begin = 0
            for batch in file.iter_batches(batch_size=_ROWS, use_threads=False):
                end = begin + batch.num_rows
                for quantity, where in layout.items():
                    for j, index in enumerate(where):
                        column = batch.column(index)
                        if column.null_count:
                            raise DataError(f"{path}: column '{names[index]}' has missing values.")
                        values = column.to_numpy(zero_copy_only=False)
                        if values.dtype.kind not in "fiu":
                            raise DataError(f"{path}: column '{names[index]}' is not numeric.")
                        arrays[quantity][begin:end, j] = values
                begin = end
            if begin != rows:
                raise DataError(f"{path}: holds {begin} rows where {rows} are announced.")
    except (pa.lib.ArrowException, OSError, ValueError, MemoryError) as cause:
        raise DataError(f"{path}: not a readable Parquet file ({_first_line(cause)}).") from None
    joint_names = metadata.get("joint_names")
    if not metadata:
        joint_names = _suffixes(names)
        if all(name.isdigit() for name in joint_names):
            joint_names = None
    return Recording(
        time=arrays["time"][:, 0],
        position=arrays["position"],
        effort=arrays["effort"],
        velocity=arrays.get("velocity"),
        joint_names=joint_names,
        period=metadata.get("period"),
        start=metadata.get("start"),
        periods=metadata.get("periods"),
        effort_scale=metadata.get("effort_scale"),
    )


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
    except ValueError:
        metadata = None
    if not isinstance(metadata, dict):
        raise DataError(f"{path}: the metadata under 'sdpid' is damaged.")
    if metadata.get("format") != _FORMAT:
        raise DataError(
            f"{path}: is of format {metadata.get('format')}, this version reads {_FORMAT}."
        )
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


def _empty(rows: int, where: list[int]) -> Array:
    """Return an array to be filled column by column."""
    return np.empty((rows, len(where)), dtype=np.float64)


def _first_line(cause: BaseException) -> str:
    """Return the first line of a library's message."""
    return (str(cause).splitlines() or [type(cause).__name__])[0]
