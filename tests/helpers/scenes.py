"""What a page holds for its player, read back."""

import base64
from typing import Any

import numpy as np

from sdpid._common.arrays import Array


def unpacked(found: dict[str, Any]) -> Array:
    """Return the array that `sdpid.output.charts.packed.packed` made text of, NaN if missing."""
    steps = np.frombuffer(base64.b64decode(found["data"]), dtype="<u2")
    low, high = np.array(found["low"]), np.array(found["high"])
    known = np.where(steps == 65535, np.nan, steps).reshape(-1, len(low))
    return low + (high - low) * known / 65534.0
