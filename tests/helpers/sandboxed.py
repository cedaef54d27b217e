"""Functions that tests run in a child process."""

import os
import time
from typing import Any

import numpy as np

from sdpid.errors import ModelError


def echo(*arguments: Any) -> dict[str, Any]:
    """Return the arguments beside arrays of several kinds."""
    return {
        "arguments": arguments,
        "arrays": [np.arange(6.0).reshape(2, 3), np.array(["ä", "b"]), np.empty((0, 2))],
        "large": np.arange(200_000),
        "scalar": np.float64(1.5),
    }


def take(size: int) -> int:
    """Fill so many bytes."""
    return int(np.ones(size, dtype=np.uint8).size)


def crash() -> None:
    """End the process as a library does that fails badly."""
    os.abort()


def hang() -> None:
    """Do nothing for long."""
    time.sleep(60.0)


def refuse(message: str) -> None:
    """Raise an error of ours."""
    raise ModelError(message)


def fail() -> None:
    """Raise what a library may raise."""
    raise KeyError("inside\nmore")


def leave() -> None:
    """End the process without a word."""
    os._exit(3)


def hand_back_object() -> Any:
    """Return what only a pickle could hold."""
    return np.array([{}], dtype=object)
