"""With contacts the Huber cost is one of samples, and is minimized as that of rows is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import null_space

import sdpid
from sdpid import Samples
from sdpid._common.arrays import Array
from sdpid.assurance.certificate.certificate import GAP
from sdpid.estimation.compression.whitening import compress
from sdpid.estimation.problem import Problem
from sdpid.estimation.robust.huber import HuberLoss
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from tests.helpers.legged import FEET, NOISE, RADIUS, Gait, gait, quadruped


def spoiled(made: Gait, seed: int = 0) -> Samples:
    """Return samples, a tenth of which have a wrong torque."""
    rng = np.random.default_rng(seed)
    samples = made.noisy(seed)
    effort = samples.effort.copy()
    hit = np.flatnonzero(rng.random(len(effort)) < 0.1)
    effort[hit, 6 + rng.integers(12, size=len(hit))] += 3.0
    return replace(samples, effort=effort, covariance=np.diag(NOISE**2))


def problem(samples: Samples) -> Problem:
    return sdpid.build_problem(
        quadruped(), samples, friction=(), weighting="gls", prior=sdpid.Prior()
    )


def sizes(found: Problem, base: Array) -> tuple[Array, Array]:
    """Return norms of whitened residuals of samples, and how many rows each has, by null spaces."""
    samples = found.samples
    assert samples.contacts is not None
    J = contact_jacobians(quadruped(), samples.position, FEET, RADIUS)
    residual = found.rows.regressor(slice(None)) @ base - samples.effort  # type: ignore[union-attr]
    size, count = [], []
    for k, down in enumerate(samples.contacts.down):
        N = null_space(J[k, down, :3].reshape(-1, 18)) if down.any() else np.eye(18)
        r = N.T @ residual[k]
        size.append(np.sqrt(r @ np.linalg.solve(N.T @ found.sigma @ N, r)))
        count.append(N.shape[1])
    return np.array(size), np.array(count)


def test_the_cost_is_that_of_samples_projected_densely() -> None:
    made = gait(60)
    found = problem(spoiled(made))
    base = found.base_of(made.theta)
    loss = HuberLoss.of(found, threshold=1.345, deviations=1.0)
    size, count = sizes(found, base)
    t = loss.thresholds[:, 0]
    # As many samples of normal errors are beyond as single rows are.
    draws = np.random.default_rng(1).normal(size=(20_000, 18))
    for m in np.unique(count):
        beyond = np.mean(np.linalg.norm(draws[:, :m], axis=1) > t[count == m][0])
        assert beyond == pytest.approx(0.179, abs=0.01)
    expected = np.where(size <= t, size**2, 2.0 * t * size - t**2).sum()
    assert loss.cost(base) == pytest.approx(expected, rel=1e-9)
    weighted = loss.majorized(base)
    assert weighted.cost(base) == pytest.approx(
        loss.cost(base) + weighted.cost(base) - weighted.cost(base)
    )
    rng, h = np.random.default_rng(2), 1e-5
    for _ in range(3):
        other = base + 0.01 * np.abs(base).max() * rng.normal(size=base.shape)
        assert weighted.cost(other) >= loss.cost(other) * (1.0 - 1e-12)
    step = rng.normal(size=base.shape)
    second = sum(c * loss.cost(base + i * h * step) for i, c in ((-1, 1.0), (0, -2.0), (1, 1.0)))
    own = loss.curvature(base, step[:, None])
    assert own.item() == pytest.approx(second / (2.0 * h**2), rel=1e-2)


@pytest.mark.parametrize("measured", [False, True])
def test_outliers_do_little(measured: bool) -> None:
    made = gait(400, seed=3)
    samples = spoiled(made, 4)
    if measured:
        felt = made.forces + 0.1 * np.random.default_rng(5).normal(size=made.forces.shape)
        samples = replace(samples, contacts=made.measured(0.01 * np.eye(6), felt).contacts)
    found = problem(samples)
    robust, plain = sdpid.solve_robust(found), sdpid.solve_sdp(found)
    assert robust.robust_gap is not None
    assert robust.robust_gap <= GAP
    assert sdpid.certify(robust).passed
    # The weighted problem is one of other covariances, so that certificates are of it.
    A = robust.problem.A
    again = compress(robust.problem.rows, robust.problem.sigma)[0].split()[0]  # type: ignore[arg-type]
    np.testing.assert_allclose(again.T @ again, A.T @ A, atol=1e-8 * np.abs(A.T @ A).max())
    clean = gait(200, seed=6).samples
    errors = [sdpid.validate(each, clean).relative for each in (robust, plain)]
    assert errors[0] < 0.5 * errors[1]
