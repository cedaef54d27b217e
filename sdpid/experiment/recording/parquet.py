"""Tables in Parquet files, written without loss and in pieces, so that memory stays small."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid._common.files import atomic_path
from sdpid.experiment.recording.stored import ROWS

# Where the metadata of a recording stand in the file, and their version.
KEY = b"sdpid"
FORMAT = 1


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
