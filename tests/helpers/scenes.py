"""What a page holds for its player, read back."""

import base64
from typing import Any

import numpy as np

from sdpid._common.arrays import Array


def unpacked(found: dict[str, Any]) -> Array:
    """Return the array that `sdpid.output.scene.packed.packed` made text of."""
    steps = np.frombuffer(base64.b64decode(found["data"]), dtype="<u2")
    low, high = np.array(found["low"]), np.array(found["high"])
    return low + (high - low) * steps.reshape(-1, len(low)) / 65535.0
