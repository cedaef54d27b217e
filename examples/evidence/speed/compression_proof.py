"""Proving a compression for every theta, against compressing the same rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from harness import Bench, Row
from kernels import FRICTION, problem_rows

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.compression import prove_compression
from sdpid.estimation.compression.covariance import WEIGHTINGS, Weighting
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import build_problem

# A covariance a sample is one of so many periods.
_PERIODS = 12


def measure(bench: Bench) -> Iterator[Row]:
    """Measure `prove_compression`: of a million rows, and of a smaller log in every weighting."""
    rows, _ = problem_rows(bench.size(166_667, 1_000))
    yield _measured(rows, "gls", bench)
    rows, sigma = problem_rows(bench.size(10_000, 500))
    for weighting in WEIGHTINGS:
        own = rows
        if weighting not in ("gls", "residual"):
            each = _covariances(sigma, rows.samples.n_samples)
            own = rows.on(replace(rows.samples, covariance=each))
        yield _measured(own, weighting, bench)


def _covariances(sigma: Array, count: int) -> Array:
    rng = np.random.default_rng(1)
    errors = rng.multivariate_normal(np.zeros(len(sigma)), sigma, (count, _PERIODS))
    left = errors - errors.mean(axis=1, keepdims=True)
    return np.asarray(np.swapaxes(left, 1, 2) @ left / (_PERIODS - 1))


def _measured(rows: RowSource, weighting: Weighting, bench: Bench) -> Row:
    problem = build_problem(
        rows.robot, rows.samples, friction=FRICTION, base=rows.base, weighting=weighting
    )
    found = bench.seconds(
        proof=lambda: prove_compression(problem), once=lambda: Factor.of(rows, weighting)
    )
    what = f"prove the compression, {weighting}, {problem.n_rows} rows"
    return Row.of(what, found["proof"], "compress them", found["once"])
