"""Compare the compressed cost of a problem with the sum over its rows, and hash the samples."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import whitened_chunks
from sdpid.estimation.problem import Problem

# What the rows are made of, in the order in which it is hashed.
_FIELDS = ("position", "velocity", "acceleration", "effort", "mask", "covariance")


def summed_cost(problem: Problem, base: ArrayLike) -> float:
    """Return the cost of base parameters (b,), summed over the rows themselves."""
    printed = problem.weighting in ("eq9", "eq18")
    values = np.append(np.asarray(base, dtype=np.float64), -1.0)
    exponent = -0.25 if problem.weighting == "eq9" else -0.5
    rows = problem.require_rows("summed cost")
    sums = rows.map(_sums, exponent, values, sigma=problem.sigma)
    normal = np.sum([normal for normal, _ in sums], axis=0)
    return float(normal @ normal) if printed else float(sum(square for _, square in sums))


def _sums(rows: RowSource, sigma: Array, exponent: float, values: Array) -> tuple[Array, float]:
    """Return the normal equations' residual (b,) and the squared residuals of whitened rows."""
    normal, total = np.zeros(rows.base.count), 0.0
    for _, weighted, _ in whitened_chunks(rows, sigma, exponent):
        residual = weighted @ values
        normal += np.einsum("kib,ki->b", weighted[:, :, :-1], residual)
        total += float(np.sum(residual**2))
    return normal, total


def compression_error(problem: Problem, base: ArrayLike) -> float | None:
    """Return the relative error of the compressed cost of base parameters (b,).

    None where the rows were not kept.
    """
    if problem.rows is None:
        return None
    summed = summed_cost(problem, base)
    # Exact data cost nothing but rounding; that is measured against the weighted efforts.
    efforts = float(problem.rhs @ problem.rhs) + problem.floor
    scale = max(summed, np.finfo(float).eps * efforts, np.finfo(float).tiny)
    return abs(problem.cost(base) - summed) / scale


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
