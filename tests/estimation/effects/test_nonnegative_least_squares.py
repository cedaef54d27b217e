"""Signed least squares from products: as good as scipy's, many at a time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

import sdpid.estimation.effects.nonnegative_least_squares as signed
from sdpid._common.arrays import Array, Mask
from sdpid.estimation.effects.nonnegative_least_squares import least_squares_gain


def problems(seed: int, columns: int, count: int = 5) -> tuple[Array, Array, Array]:
    """Return unit columns (g, 30, c), right-hand sides (g, 30), and which signs are free."""
    rng = np.random.default_rng(seed)
    # A common part, so that signs interact.
    A = rng.standard_normal((count, 30, columns)) + rng.uniform(0, 2) * rng.standard_normal((30, 1))
    A /= np.linalg.norm(A, axis=1, keepdims=True)
    return A, rng.standard_normal((count, 30)), rng.random(columns) < 0.3


def best(A: Array, y: Array, free: Mask) -> float:
    """Return the gain as scipy has it."""
    found = lsq_linear(A, y, (np.where(free, -np.inf, 0.0), np.inf), method="bvls", tol=1e-14)
    return float(y @ y - 2.0 * found.cost)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), columns=st.integers(1, 14), start=st.booleans())
def test_the_gain_is_the_best(seed: int, columns: int, start: bool) -> None:
    A, y, free = problems(seed, columns)
    H = np.swapaxes(A, 1, 2) @ A
    b = np.einsum("gkc,gk->gc", A, y)
    gain, used = least_squares_gain(H, b, free, np.full(columns, start))
    expected = [best(A[k], y[k], free) for k in range(len(A))]
    np.testing.assert_allclose(gain, expected, rtol=1e-8, atol=1e-10)
    assert used[:, free].all()


@pytest.mark.parametrize("exchanges", [1, 2])
def test_what_has_not_settled_is_solved_one_by_one(
    exchanges: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    A, y, free = problems(3, 14, 20)
    H = np.swapaxes(A, 1, 2) @ A
    b = np.einsum("gkc,gk->gc", A, y)
    expected, used = least_squares_gain(H, b, free, np.ones(14, dtype=bool))
    calls = []
    whole = signed._one_by_one

    def one_by_one(H: Array, b: Array, free: Mask) -> tuple[float, Mask]:
        calls.append(0)
        return whole(H, b, free)

    monkeypatch.setattr(signed, "_EXCHANGES", exchanges)
    monkeypatch.setattr(signed, "_one_by_one", one_by_one)
    gain, again = least_squares_gain(H, b, free, np.ones(14, dtype=bool))
    assert calls
    np.testing.assert_allclose(gain, expected, rtol=1e-10)
    np.testing.assert_array_equal(again, used)
