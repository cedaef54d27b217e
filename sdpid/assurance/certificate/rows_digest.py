"""Hash the samples that a problem was made of."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import Problem

# What the rows are made of, in the order in which it is hashed.
_FIELDS = ("position", "velocity", "acceleration", "effort", "mask", "covariance")


def rows_digest(problem: Problem) -> str | None:
    """Return the SHA-256 of the samples: shape and little-endian doubles of each array.

    Of several pieces it is that of their digests, one behind the other. None where the rows were
    not kept.
    """
    if problem.rows is None:
        return None
    digests = problem.rows.map(_digest)
    if len(digests) == 1:
        return digests[0]
    return hashlib.sha256("".join(digests).encode()).hexdigest()


def _digest(rows: RowSource) -> str:
    """Return the SHA-256 of the samples of one piece."""
    found = hashlib.sha256()
    for name in _FIELDS:
        values: Any = getattr(rows.samples, name)
        if values is None:
            found.update(f"{name}: none\n".encode())
            continue
        array = np.ascontiguousarray(values, dtype="<f8")
        found.update(f"{name}: {array.shape}\n".encode())
        found.update(array.data)
    return found.hexdigest()
