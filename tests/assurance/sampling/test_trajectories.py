"""Trajectories have the laws that random matrices are known to have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, kstest

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.sampling.density import Density, Matrices
from sdpid.assurance.sampling.trajectories import (
    Trajectories,
    _fall,
    _fall_of_bodies,
    relative_eigenvalues,
)
from sdpid.estimation.conic.standard_form import symmetric_basis
from tests.helpers.arm import CONDITIONS, arm_problem

CHAINS, EACH = 50, 40

# A test of Kolmogorov and Smirnov fails this often where the law is right.
FALSE_ALARM = 1e-4


def cone(size: int, scale: Array | None = None, power: float = 0.0) -> Density:
    """Return a density of positive definite matrices: of trace up to one, or Wishart's."""
    units = symmetric_basis(size)
    n = len(units)
    matrices = Matrices(np.zeros((1, size, size)), units[:, None])
    nothing = Matrices(np.zeros((0, size, size)), np.zeros((n, 0, size, size)))
    empty = Density.of(sdpid.solve_sdp(arm_problem(*CONDITIONS["pair"])))
    flat = replace(
        empty,
        mean=np.zeros(n),
        slope=np.zeros(n),
        precision=np.zeros((n, n)),
        walls=matrices,
        bodies=nothing,
        rows=np.einsum("kii->k", units)[None],
        lower=np.array([-1.0]),
        upper=np.array([1.0]),
    )
    if scale is None:
        return flat
    slope = 0.5 * np.einsum("ij,kij->k", np.linalg.inv(scale), units)
    return replace(
        flat, slope=slope, bodies=matrices, strength=power, upper=np.array([1e3]), walls=nothing
    )


def matrices_of(density: Density, start: Array, covariance: Array) -> Array:
    """Return matrices (k, s, s) drawn from a density."""
    x = np.einsum("kij,ij->k", symmetric_basis(len(start)), start)
    walk = Trajectories(density, np.tile(x, (CHAINS, 1)), np.random.default_rng(5))
    ends = walk.run(EACH + 10, 3.0, covariance)[10:].reshape(-1, density.n)
    assert walk.lost == 0
    return np.einsum("ck,kij->cij", ends, symmetric_basis(len(start)))


@pytest.mark.parametrize("size", [4, 6])
def test_uniform_in_a_cone(size: int) -> None:
    density = cone(size)
    start = np.eye(size) / (size + 1.0)
    found = matrices_of(density, start, np.eye(density.n) / density.n**2)
    trace = np.einsum("cii->c", found)
    assert kstest(trace**density.n, "uniform").pvalue > FALSE_ALARM
    # Apart from their size they are those of a Wishart distribution of s + 1 degrees of freedom.
    nu = size + 1.0
    expected = (size + nu + 1.0) / (size * nu + 2.0)
    squares = np.einsum("cij,cij->c", found, found) / trace**2
    assert squares.mean() == pytest.approx(expected, abs=5.0 * squares.std() / np.sqrt(500))


@pytest.mark.parametrize("power", [0.5, 3.0])
def test_wishart_with_a_power_of_the_determinant(power: float) -> None:
    scale = np.diag([0.1, 0.2, 0.5, 1.0]) + 0.05
    nu = 5.0 + 2.0 * power
    density = cone(4, scale, power)
    root = np.linalg.cholesky(scale)
    units = np.linalg.inv(root) @ symmetric_basis(4) @ np.linalg.inv(root).T
    flat = units.reshape(10, 16)
    found = matrices_of(density, nu * scale, 2.0 * nu * np.linalg.inv(flat @ flat.T))
    ratios = np.linalg.inv(root) @ found @ np.linalg.inv(root).T
    # The trace, and by Bartlett's decomposition every pivot, is that of chi-square variables.
    assert kstest(np.einsum("cii->c", ratios), chi2(4.0 * nu).cdf).pvalue > FALSE_ALARM
    pivots = np.einsum("cii->ci", np.linalg.cholesky(ratios)) ** 2
    for i in range(4):
        assert kstest(pivots[:, i], chi2(nu - i).cdf).pvalue > FALSE_ALARM


def risen(slope: Callable[[Array], Array], end: float) -> float:
    """Return the integral of the positive part of a slope, closer points nearer to the end."""
    t = end * (1.0 - np.linspace(1.0, 0.0, 100_001) ** 3)
    return float(np.trapezoid(np.maximum(slope(t), 0.0), t))


@given(
    slope=st.floats(-5.0, 5.0),
    curvature=st.floats(0.1, 5.0),
    drop=st.floats(1e-3, 3.0),
    rates=st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=4),
    strength=st.floats(0.5, 5.0),
)
def test_the_density_falls_by_what_was_drawn(
    slope: float, curvature: float, drop: float, rates: list[float], strength: float
) -> None:
    one = np.ones(1)
    found = _fall(slope * one, curvature * one, drop * one)[0]
    assert risen(lambda t: slope + curvature * t, found) == pytest.approx(drop, rel=1e-4)
    values = np.array(rates)
    among = slope * one, curvature * one, strength, values[None], drop * one
    found = _fall_of_bodies(*among, 100.0 * one)[0]
    assert _fall_of_bodies(*among, 0.9 * found * one)[0] == np.inf

    def slope_at(t: Array) -> Array:
        inner = values / (1.0 + t[:, None] * values)
        return np.asarray(slope + curvature * t - strength * inner.sum(axis=1))

    assert np.all(1.0 + found * values > 0.0)
    assert risen(slope_at, found) == pytest.approx(drop, rel=1e-2)


@given(seed=st.integers(0, 10**6), size=st.sampled_from([4, 6]))
def test_a_line_leaves_the_cone_where_an_eigenvalue_says(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    X, D = rng.standard_normal((2, size, size))
    F, D = X @ X.T + 0.01 * np.eye(size), D + D.T
    values = relative_eigenvalues(F[None], D[None])[0]
    far = np.linalg.eigvalsh(F - D / values[0])
    assert np.abs(far).min() == pytest.approx(0.0, abs=1e-9 * np.abs(far).max())
    if values[0] < 0.0:
        assert np.linalg.eigvalsh(F - (1.0 - 1e-6) * D / values[0])[0] > 0.0
