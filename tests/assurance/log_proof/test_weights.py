"""Diagonal weights are at least the covariance's power."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid.assurance.log_proof.weights import diagonal_weights, lesser_weights
from tests.helpers.data import matrix_power, random_covariance
from tests.helpers.strategies import SEEDS

# Of the powers of covariances with a condition number of some hundred.
ROUNDING = 1e-10


@given(SEEDS, st.integers(1, 7), st.sampled_from([-1.0, -0.5]))
def test_the_difference_is_positive(seed: int, n: int, exponent: float) -> None:
    rng = np.random.default_rng(seed)
    many = random_covariance(rng, n, 3) * 10.0 ** rng.uniform(-6.0, 6.0)
    weights = diagonal_weights(many, exponent)
    used = rng.uniform(size=n) < 0.7
    for sigma, w in zip(many, weights, strict=True):
        np.testing.assert_array_equal(diagonal_weights(sigma, exponent), w)
        for part in (np.ones(n, dtype=bool), used):
            if not part.any():
                continue
            power = matrix_power(sigma[np.ix_(part, part)], exponent)
            least = np.linalg.eigvalsh(np.diag(w[part] ** 2) - power)[0]
            assert least >= -ROUNDING * np.abs(power).max()
            lesser = lesser_weights(sigma, exponent)[part]
            least = np.linalg.eigvalsh(power - np.diag(lesser**2))[0]
            assert least >= -ROUNDING * np.abs(power).max()


def test_variances_that_are_independent_are_kept() -> None:
    weights = diagonal_weights(np.diag([4.0, 0.25]), -1.0)
    np.testing.assert_allclose(weights, [0.5, 2.0], rtol=1e-5)


@pytest.mark.parametrize("off", [1.0, -1.0, 1.5])
def test_without_proof_they_are_infinite(off: float) -> None:
    assert np.all(np.isinf(diagonal_weights(np.array([[1.0, off], [off, 1.0]]), -1.0)))
    assert np.all(np.isinf(diagonal_weights(np.zeros((2, 2)), -1.0)))
