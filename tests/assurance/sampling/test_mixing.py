"""Effective sample size and R-hat of chains whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from sdpid._common.arrays import Array
from sdpid.assurance.sampling.mixing import effective_sizes, split_r_hat

COUNT, CHAINS = 2000, 20

# Of 40 000 draws the effective sample size is uncertain by a few percent.
COUNTED = 0.1


def chains(correlation: float, seed: int = 0) -> Array:
    """Return stationary AR(1) chains (count, chains, 1) of variance one."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((COUNT, CHAINS, 1))
    noise[1:] *= np.sqrt(1.0 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], noise, axis=0))


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.8])
def test_effective_size_of_autoregressive_chains(correlation: float) -> None:
    expected = COUNT * CHAINS * (1.0 - correlation) / (1.0 + correlation)
    (found,) = effective_sizes(chains(correlation))
    assert found == pytest.approx(expected, rel=COUNTED)


def test_chains_that_agree_and_that_do_not() -> None:
    values = chains(0.3)
    assert split_r_hat(values)[0] < 1.005
    apart, wider = values.copy(), values.copy()
    apart[:, 0] += 3.0
    # The same mean and another spread: only the distances from the median tell.
    wider[:, :5] *= 4.0
    assert split_r_hat(apart)[0] > 1.05
    assert split_r_hat(wider)[0] > 1.05


def test_ranks_alone_count() -> None:
    values = chains(0.5)
    assert effective_sizes(np.exp(3.0 * values)) == pytest.approx(effective_sizes(values))


def test_a_parameter_that_is_fixed_is_known_as_well_as_can_be() -> None:
    values = np.full((16, 4, 1), 2.0)
    assert effective_sizes(values) == 64.0
    assert split_r_hat(values) == 1.0
