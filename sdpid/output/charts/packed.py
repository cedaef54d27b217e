"""Arrays as text that a page holds and its scripts read: quantized, little-endian, base64."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array, Indices

# Steps between the least and the largest value of a column: 15 µm of a meter. One more number of 16
# bits stands for what is missing.
_STEPS = 65534


def packed(values: Array) -> dict[str, Any]:
    """Return an array (N, C) as numbers of 16 bits between the ends of its columns.

    What is not finite is missing.
    """
    known = np.ma.masked_invalid(values)
    low = np.ma.filled(known.min(axis=0), 0.0)
    spans = np.ma.filled(known.max(axis=0) - low, 0.0)
    spans = np.where(spans > 0.0, spans, 1.0)
    steps = np.ma.filled(np.rint((known - low) / spans * _STEPS), _STEPS + 1).astype("<u2")
    return {"low": low.tolist(), "high": (low + spans).tolist(), "data": text_of(steps)}


def packed_indices(values: Indices) -> str:
    """Return indices as text, numbers of 32 bits."""
    return text_of(values.astype("<u4"))


def text_of(values: NDArray[Any]) -> str:
    """Return the bytes of an array in base64."""
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
