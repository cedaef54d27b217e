"""The log-det divergence: its definition, derivatives, invariance and lower bounds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid.errors import DataError
from sdpid.estimation.prior.log_det import LogDetTerm
from sdpid.robot.inertia import from_pseudo_inertia, pseudo_inertia, transform
from tests.helpers.data import random_links
from tests.helpers.strategies import SEEDS

# Friction terms behind the links, of which the divergence knows nothing.
EXTRA = 3

# Relative error of formulas that lose a few hundred roundings to the conditioning of P.
FORMULA = 1e-8

# Central differences with a relative step of 1e-6.
DIFFERENCE = 1e-5


def make(seed: int, *, strength: float = 1.0) -> tuple[LogDetTerm, np.ndarray, np.ndarray]:
    """Return the divergence of links 0 and 2 of three, its P0 and a theta."""
    rng = np.random.default_rng(seed)
    believed, bodies = random_links(rng, 2), random_links(rng, 3)
    theta = np.concatenate([bodies.ravel(), rng.normal(size=EXTRA)])
    return (
        LogDetTerm.around([0, 2], believed, strength, len(theta)),
        pseudo_inertia(believed),
        theta,
    )


@given(SEEDS, st.floats(0.01, 100.0))
def test_it_is_its_definition(seed: int, strength: float):
    entropy, P0, theta = make(seed, strength=strength)
    P = pseudo_inertia(theta[:30].reshape(3, 10))[[0, 2]]
    total = 0.0
    for p, p0 in zip(P, P0, strict=True):
        ratio = np.linalg.solve(p0, p)
        # log det as written: no factor of P0, no eigenvalue.
        total += np.trace(ratio) - np.log(np.linalg.det(p) / np.linalg.det(p0)) - 4.0
    assert entropy.value(theta) == pytest.approx(2.0 * strength * total, rel=FORMULA)
    assert entropy.value(theta[:30].reshape(3, 10)) == entropy.value(theta)


def test_it_is_twice_the_relative_entropy_of_normal_distributions():
    # Known covariances: diagonal in a common basis, where the integral splits into four of one
    # variable, log(s0/s) + s²/(2·s0²) − 1/2 with standard deviations s and s0.
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    s, s0 = rng.uniform(0.5, 2.0, (2, 4))
    kullback = np.sum(np.log(s0 / s) + 0.5 * (s / s0) ** 2 - 0.5)
    body, believed = (from_pseudo_inertia(basis @ np.diag(d**2) @ basis.T) for d in (s, s0))
    entropy = LogDetTerm.around([0], believed[None], 1.0, 10)
    assert entropy.divergences(body)[0] == pytest.approx(2.0 * kullback, rel=1e-10)


@given(SEEDS)
def test_zero_at_the_belief_and_positive_elsewhere(seed: int):
    entropy, P0, theta = make(seed)
    assert entropy.value(theta) > 0.0
    there = theta.copy()
    there[:10], there[20:30] = from_pseudo_inertia(P0)
    # Each eigenvalue is 1 up to rounding times the condition number, and enters squared.
    assert entropy.value(there) < 1e-16
    # Half way it is less, since the divergence is convex.
    assert entropy.value(0.5 * (theta + there)) <= 0.5 * entropy.value(theta) + 1e-12


@given(SEEDS)
def test_infinite_outside_the_cone(seed: int):
    entropy, _, theta = make(seed)
    outside = theta.copy()
    outside[20] = -1.0
    assert entropy.value(outside) == np.inf
    with pytest.raises(DataError, match="can exist"):
        entropy.gradient(outside)
    # A link that nothing is believed of may be anything.
    unbelieved = theta.copy()
    unbelieved[10:20] = -1.0
    assert entropy.value(unbelieved) == entropy.value(theta)


@given(SEEDS)
def test_gradient_and_second_derivative(seed: int):
    entropy, P0, theta = make(seed, strength=0.7)
    # In coordinates where the bodies have size one differences of all entries are as good.
    L = np.linalg.cholesky(P0)
    rng = np.random.default_rng(seed)
    step = np.zeros_like(theta)
    for block, root in zip((slice(0, 10), slice(20, 30)), L, strict=True):
        change = rng.normal(size=(4, 4))
        P = pseudo_inertia(theta[block])
        size = np.linalg.eigvalsh(np.linalg.solve(root, np.linalg.solve(root, P).T))[0]
        step[block] = size * from_pseudo_inertia(root @ (change + change.T) @ root.T)
    step[10:20], step[30:] = rng.normal(size=10), rng.normal(size=EXTRA)
    small = 1e-5
    up, down = entropy.value(theta + small * step), entropy.value(theta - small * step)
    slope = float(entropy.gradient(theta) @ step)
    scale = float(np.linalg.norm(entropy.curvature_rows(theta) @ step))
    assert abs((up - down) / (2.0 * small) - slope) <= DIFFERENCE * (abs(slope) + scale)
    change = entropy.gradient(theta + small * step) - entropy.gradient(theta - small * step)
    curvature = float(step @ entropy.hessian(theta) @ step)
    assert change @ step / (2.0 * small) == pytest.approx(curvature, rel=1e-4)
    assert curvature == pytest.approx(2.0 * scale**2, rel=1e-10)
    assert not entropy.gradient(theta)[10:20].any()
    assert not entropy.gradient(theta)[30:].any()


@given(SEEDS)
def test_the_pullback_is_its_second_order_expansion(seed: int):
    entropy, P0, theta = make(seed, strength=2.0)
    there = theta.copy()
    there[:10], there[20:30] = from_pseudo_inertia(P0)
    rng = np.random.default_rng(seed)
    U = rng.normal(size=(2, 4, 4))
    U = U + np.swapaxes(U, 1, 2)
    L = np.linalg.cholesky(P0)
    for size in (1e-2, 1e-3):
        moved = there.copy()
        moved[:10], moved[20:30] = from_pseudo_inertia(P0 + size * L @ U @ np.swapaxes(L, 1, 2))
        quadratic = 2.0 * size**2 * float(np.sum(U**2))
        assert np.sum((entropy.curvature_rows(there) @ (moved - there)) ** 2) == pytest.approx(
            quadratic
        )
        # The remainder of x − log(1 + x) after x²/2, at eigenvalues up to this large.
        largest = size * float(np.abs(np.linalg.eigvalsh(U)).max())
        allowed = 2.0 / 3.0 * largest / (1.0 - largest) + FORMULA / size
        assert abs(entropy.value(moved) - quadratic) <= allowed * quadratic


@given(SEEDS)
def test_the_same_in_every_frame(seed: int):
    entropy, P0, theta = make(seed)
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    shift = rng.normal(size=3)
    believed = transform(from_pseudo_inertia(P0), rotation, shift)
    bodies = transform(theta[:30].reshape(3, 10), rotation, shift)
    moved = LogDetTerm.around([0, 2], believed, 1.0, len(theta))
    assert moved.value(bodies) == pytest.approx(entropy.value(theta), rel=1e-6)


@given(SEEDS, st.floats(0.1, 10.0), st.floats(-3.0, 3.0))
def test_the_support_is_below_everywhere_and_tight_at_its_point(
    seed: int, strength: float, exponent: float
):
    entropy, _, theta = make(seed, strength=strength)
    rng = np.random.default_rng(seed)
    root = 10.0**exponent * rng.normal(size=(2, 4, 4))
    W = root @ np.swapaxes(root, 1, 2) + 10.0 ** (2.0 * exponent) * 1e-3 * np.eye(4)
    points = [theta, make(seed + 1)[2], make(seed + 2)[2]]
    constant, linear = entropy.support(W)
    for point in points:
        size = abs(constant) + float(np.abs(linear) @ np.abs(point))
        assert entropy.value(point) >= constant + linear @ point - 1e-12 * size
    constant, linear = entropy.support(entropy.multiplier(theta))
    size = abs(constant) + float(np.abs(linear) @ np.abs(theta))
    value = entropy.value(theta)
    assert constant + linear @ theta == pytest.approx(value, rel=1e-9, abs=1e-9 * size)
    assert np.allclose(linear, entropy.gradient(theta), rtol=1e-9, atol=1e-9 * np.abs(linear).max())


def test_what_makes_no_sense_is_refused():
    entropy, _, _ = make(0)
    with pytest.raises(DataError, match="W number 1"):
        entropy.support(np.array([np.eye(4), -np.eye(4)]))
    with pytest.raises(DataError, match="shape"):
        entropy.support(np.eye(4))
    with pytest.raises(DataError, match="strength"):
        LogDetTerm(np.array([0]), np.eye(4)[None], 0.0, 20)
    with pytest.raises(DataError, match="shape"):
        LogDetTerm(np.array([0, 1]), np.eye(4)[None], 1.0, 20)
    with pytest.raises(DataError, match="positive definite"):
        LogDetTerm(np.array([0]), -np.eye(4)[None], 1.0, 20)
