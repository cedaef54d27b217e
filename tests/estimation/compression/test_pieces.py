"""Several recordings in one problem: pieces add up, and no pair of samples reaches across."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.estimation.compression.covariance import WEIGHTINGS, JointRows, LaggedSums, Weighting
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import build_problem
from sdpid.experiment.processing.samples import Samples
from tests.helpers.data import make_samples, random_covariance, random_theta
from tests.helpers.robots import small_arm
from tests.helpers.strategies import SEEDS

ARM = small_arm(2)
THETA = random_theta(ARM, np.random.default_rng(0))

# Sums of the same numbers in another order, relative to the largest.
ORDER = 1e-12


def pieces(seed: int, counts: tuple[int, ...] = (90, 40, 70), **fields: Any) -> list[Samples]:
    rng = np.random.default_rng(seed)
    return [make_samples(ARM, THETA, rng, count=k, noise=0.1, **fields) for k in counts]


class Together(RowSource):
    """Rows that are looked at without regard to their pieces."""

    def map(self, function: Callable[..., Any], *args: object, sigma: Any = None) -> list[Any]:
        """Return what a function says of all rows."""
        return [function(self, *(() if sigma is None else (sigma,)), *args)]


def same(found: Array, expected: Array) -> None:
    scale = float(np.abs(expected).max())
    np.testing.assert_allclose(found, expected, rtol=0, atol=ORDER * scale)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("masked", [False, True])
def test_a_sequence_of_samples_is_one_problem(weighting: Weighting, masked: bool) -> None:
    rng = np.random.default_rng(1)
    made = [
        replace(p, covariance=np.stack([random_covariance(rng, 2) for _ in p.effort]))
        for p in pieces(1)
    ]
    if masked:
        made = [replace(p, mask=rng.random(p.effort.shape) < 0.8) for p in made]
    together = build_problem(ARM, made, weighting=weighting)
    assert together.samples.starts == (0, 90, 130)
    assert together.n_rows == sum(p.n_rows for p in made)
    whole = together.rows
    once = Factor.of(Together(whole.robot, whole.friction, whole.base, whole.samples), weighting)
    same(once.sigma, together.sigma)
    same(once.A.T @ once.A, together.A.T @ together.A)
    same(once.A.T @ once.rhs, together.A.T @ together.rhs)
    same(np.array(once.floor), np.array(together.floor))
    assert once.used == together.n_rows


@given(SEEDS, st.lists(st.integers(1, 60), min_size=1, max_size=4))
def test_lagged_pairs_stay_inside_their_piece(seed: int, counts: list[int]) -> None:
    rng = np.random.default_rng(seed)
    ends = np.cumsum([0, *counts])
    parts = [slice(int(a), int(b)) for a, b in pairwise(ends)]
    signal, mask = rng.standard_normal((ends[-1], 2)), rng.random((ends[-1], 2)) < 0.7
    found = LaggedSums.of(signal, mask, parts)
    products, pairs = np.zeros((2, 2, max(counts)))
    for part in parts:
        for j in range(2):
            x, m = signal[part, j] * mask[part, j], mask[part, j].astype(float)
            for lag in range(len(x)):
                products[j, lag] += x[: len(x) - lag] @ x[lag:]
                pairs[j, lag] += m[: len(m) - lag] @ m[lag:]
    np.testing.assert_allclose(found.products, products, atol=1e-12 * ends[-1])
    np.testing.assert_array_equal(found.pairs, pairs)
    alone = [LaggedSums.of(signal[p], mask[p], [slice(0, p.stop - p.start)]) for p in parts]
    merged = LaggedSums.merged(alone)
    np.testing.assert_allclose(merged.products, found.products, atol=1e-12 * ends[-1])
    np.testing.assert_array_equal(merged.pairs, found.pairs)


def test_the_mean_residual_needs_no_rows() -> None:
    rows = build_problem(ARM, pieces(3)).rows
    base = np.random.default_rng(4).standard_normal(rows.base.count)
    expected = np.mean(rows.samples.effort - rows.regressor(slice(None)) @ base, axis=0)
    found = JointRows.of(rows).mean_residual(base)
    np.testing.assert_allclose(found, expected, rtol=1e-10)
