"""Whether the few numbers of a compressed problem stand for its many rows."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._arrays import Array
from sdpid.estimation.problem import Problem
from sdpid.estimation.weighting import whitened

# What the rows are made of, in the order in which it is hashed.
_FIELDS = ("position", "velocity", "acceleration", "effort", "mask", "covariance")


def summed_cost(problem: Problem, base: ArrayLike) -> float:
    """Return the cost of base parameters (b,), summed over the rows themselves."""
    values = np.append(np.asarray(base, dtype=np.float64), -1.0)
    printed = problem.weighting in ("eq9", "eq18")
    normal: Array = np.zeros(problem.base.count)
    total = 0.0
    exponent = -0.25 if problem.weighting == "eq9" else -0.5
    for _, rows, _ in whitened(problem.rows, np.asarray(problem.sigma), exponent=exponent):
        residual = rows @ values
        if printed:
            normal += np.einsum("kib,ki->b", rows[:, :, :-1], residual)
        else:
            total += float(np.sum(residual**2))
    return float(normal @ normal) if printed else total


def compression_error(problem: Problem, base: ArrayLike) -> float:
    """Return by how much the compressed cost of base parameters is off, relative to the sum."""
    summed = summed_cost(problem, base)
    # Exact data cost nothing but rounding; that is measured against the weighted efforts.
    efforts = float(problem.rhs @ problem.rhs) + problem.floor
    scale = max(summed, np.finfo(float).eps * efforts, np.finfo(float).tiny)
    return abs(problem.cost(base) - summed) / scale


def rows_digest(problem: Problem) -> str:
    """Return the SHA-256 of the samples: shape and little-endian doubles of each array."""
    found = hashlib.sha256()
    for name in _FIELDS:
        values: Any = getattr(problem.samples, name)
        if values is None:
            found.update(f"{name}: none\n".encode())
            continue
        array = np.ascontiguousarray(values, dtype="<f8")
        found.update(f"{name}: {array.shape}\n".encode())
        found.update(array.data)
    return found.hexdigest()
