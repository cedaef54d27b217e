"""Proving a compression for every theta, against compressing the same rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.compression import prove_compression
from sdpid.estimation.compression.covariance import WEIGHTINGS, Weighting
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import build_problem
from tests.benchmarks.kernels import FRICTION, problem_rows
from tests.benchmarks.timing import Row, side_by_side

# Samples of six axes: a million rows, and a smaller log for every weighting.
MANY, FEW = 166_667, 10_000

# A covariance a sample is one of so many periods.
_PERIODS = 12


def proofs(repeats: int) -> Iterator[Row]:
    """Measure `prove_compression` against the compression alone."""
    rows, _ = problem_rows(MANY)
    yield _measured(rows, "gls", repeats)
    rows, sigma = problem_rows(FEW)
    for weighting in WEIGHTINGS:
        own = rows
        if weighting not in ("gls", "residual"):
            own = rows.on(replace(rows.samples, covariance=_covariances(sigma)))
        yield _measured(own, weighting, repeats)


def _covariances(sigma: Array) -> Array:
    rng = np.random.default_rng(1)
    errors = rng.multivariate_normal(np.zeros(len(sigma)), sigma, (FEW, _PERIODS))
    left = errors - errors.mean(axis=1, keepdims=True)
    return np.asarray(np.swapaxes(left, 1, 2) @ left / (_PERIODS - 1))


def _measured(rows: RowSource, weighting: Weighting, repeats: int) -> Row:
    problem = build_problem(
        rows.robot, rows.samples, friction=FRICTION, base=rows.base, weighting=weighting
    )
    proof, once = side_by_side(
        (lambda: prove_compression(problem), lambda: Factor.of(rows, weighting)), repeats
    )
    what = f"prove the compression, {weighting}, {problem.n_rows} rows"
    return Row.of(what, proof, "compress them", once)
