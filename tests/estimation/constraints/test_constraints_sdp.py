"""Optima under every kind of condition: obeyed by matter, proven, and never cheaper."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from scipy.optimize import nnls

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.certificate import certify
from sdpid.assurance.diagnostics.active_constraints import constraint_states
from sdpid.constraints import (
    CenterOfMassInBox,
    CenterOfMassInEllipsoid,
    CenterOfMassInHull,
    MassInEllipsoid,
    TotalMass,
)
from sdpid.estimation.constraints.condition import Condition
from sdpid.estimation.estimate import FEASIBLE, Estimate
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.robot.inertia import Consistency, point_masses, pseudo_inertia
from sdpid.workflow.verify import verify
from tests.helpers.arm import (
    ARM,
    BODIES,
    BOTH,
    CONDITIONS,
    CUBE,
    FIRST,
    LAST,
    LIGHT,
    MASS,
    TURNED,
    arm_problem,
    body_of,
    limited,
)
from tests.helpers.strategies import SEEDS
from tests.helpers.tolerances import SAME_OPTIMUM

# Positions of matter are ratios of moments that are known to within FEASIBLE (kg·m) and masses of
# a fifth of a kilogram or more.
PLACE = 1e-7

# Much weaker than what the optimum does anyway.
LOOSE: dict[str, Condition] = {
    "total": TotalMass(20.0, tolerance=19.9),
    "group": TotalMass(10.0, tolerance=9.99, links=(LAST,)),
    "box": CenterOfMassInBox(LAST, (-9.0, -9.0, -np.inf), (9.0, 9.0, 9.0)),
    "ellipsoid": CenterOfMassInEllipsoid(LAST, (0, 0.1, 0), (9.0, 8.0, 7.0)),
    "all mass": MassInEllipsoid(LAST, (0, 0.1, 0), (9.0, 9.0, 9.0)),
    "hull": CenterOfMassInHull(LAST, 300.0 * CUBE),
}


def matter(body: Array, Q: Array) -> tuple[Array, Array]:
    """Return masses (4,) and positions (4, 3) of point masses that make up a body.

    With ⟨Q, J⟩ ≥ 0 each of them has ``x^T·Q·x ≥ 0`` of its own (x homogeneous): factors of J are
    turned two by two until all of them have the same (Sturm and Zhang, 2003).
    """
    values, vectors = np.linalg.eigh(pseudo_inertia(body))
    factors = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    share = float(np.sum(Q * (factors.T @ factors))) / 4.0
    for _ in range(3):
        sizes = np.einsum("ki,ij,kj->k", factors, Q, factors)
        i, j = int(np.argmin(sizes)), int(np.argmax(sizes))
        if sizes[j] - sizes[i] <= 1e-15 * abs(sizes).max():
            break
        # The turn (1, t) of the pair that has the share: a quadratic equation in t.
        a, c = sizes[j] - share, sizes[i] - share
        b = float(factors[i] @ Q @ factors[j])
        t = (-b + np.sqrt(max(b * b - a * c, 0.0))) / a
        one, other = factors[i] + t * factors[j], -t * factors[i] + factors[j]
        factors[i], factors[j] = np.array([one, other]) / np.sqrt(1.0 + t * t)
    masses = factors[:, 3] ** 2
    used = masses > 1e-12 * masses.sum()
    return masses[used], factors[used, :3] / factors[used, 3:]


def obeys_total(estimate: Estimate) -> None:
    mass = sum(matter_mass(body_of(estimate, link)) for link in ARM.link_names)
    assert abs(mass - MASS) <= 0.1 + 10.0 * FEASIBLE


def matter_mass(body: Array) -> float:
    return float(matter(body, np.diag([0.0, 0.0, 0.0, 1.0]))[0].sum())


def obeys_group(estimate: Estimate) -> None:
    assert matter_mass(body_of(estimate, LAST)) == pytest.approx(0.2, abs=10.0 * FEASIBLE)


def center(estimate: Estimate) -> Array:
    masses, points = matter(body_of(estimate, LAST), np.diag([0.0, 0.0, 0.0, 1.0]))
    return np.asarray(masses @ points / masses.sum())


def obeys_box(estimate: Estimate) -> None:
    c = center(estimate)
    assert abs(c[0]) <= 0.02 + PLACE
    assert abs(c[1]) <= PLACE
    assert c[2] <= 0.01 + PLACE


def obeys_ellipsoid(estimate: Estimate) -> None:
    inside = TURNED.T @ (center(estimate) - [0, 0.01, 0]) / [0.02, 0.05, 0.03]
    assert np.linalg.norm(inside) <= 1.0 + PLACE / 0.02


def obeys_all_mass(estimate: Estimate) -> None:
    """Matter wholly inside the ellipsoid has these ten parameters."""
    to_ball = np.zeros((4, 4))
    to_ball[:3, :3] = (TURNED / [0.1, 0.2, 0.3]).T
    to_ball[:3, 3] = -to_ball[:3, :3] @ [0, 0.1, 0]
    to_ball[3, 3] = 1.0
    Q = to_ball.T @ np.diag([-1.0, -1.0, -1.0, 1.0]) @ to_ball
    body = body_of(estimate, LAST)
    masses, points = matter(body, Q)
    np.testing.assert_allclose(point_masses(masses, points), body, atol=1e-12)
    inside = (points - [0, 0.1, 0]) @ TURNED / [0.1, 0.2, 0.3]
    # The roots of what cancels to rounding.
    assert np.linalg.norm(inside, axis=1).max() <= 1.0 + 1e-6


def obeys_hull(estimate: Estimate) -> None:
    # A combination of the corners, with the masses of matter that sits in them.
    combined = np.vstack([CUBE.T, np.ones(len(CUBE))])
    assert nnls(combined, np.append(center(estimate), 1.0))[1] <= PLACE


def obeys_fixed(estimate: Estimate) -> None:
    values = estimate.named_theta()
    assert values is not None
    assert values["m_2"] == pytest.approx(0.4, abs=FEASIBLE)
    assert values["Fv1"] == pytest.approx(0.5, abs=FEASIBLE)


def obeys_fixed_link(estimate: Estimate) -> None:
    np.testing.assert_allclose(body_of(estimate, LAST), BODIES[0], atol=FEASIBLE)


def obeys_equal(estimate: Estimate) -> None:
    masses, points = matter(body_of(estimate, FIRST), np.diag([0.0, 0.0, 0.0, 1.0]))
    np.testing.assert_allclose(
        point_masses(masses, points), body_of(estimate, LAST), atol=2.0 * FEASIBLE
    )


def obeys_symmetric(estimate: Estimate) -> None:
    body = body_of(estimate, LAST)
    masses, points = matter(body, np.diag([0.0, 0.0, 0.0, 1.0]))
    n = np.array([0.0, 1.0, 1.0]) / np.sqrt(2.0)
    image = points - 2.0 * np.outer((points - [0, 0.02, 0]) @ n, n)
    np.testing.assert_allclose(point_masses(masses, image), body, atol=10.0 * FEASIBLE)


def obeys_pair(estimate: Estimate) -> None:
    masses, points = matter(body_of(estimate, FIRST), np.diag([0.0, 0.0, 0.0, 1.0]))
    image = point_masses(masses, points * [1.0, -1.0, 1.0])
    np.testing.assert_allclose(image, body_of(estimate, LAST), atol=2.0 * FEASIBLE)


def obeys_friction(estimate: Estimate) -> None:
    found = estimate.named_theta()
    for symbol in ("Fs", "Fv"):
        one, two = found[f"{symbol}1"], found[f"{symbol}2"]
        assert abs(one - two) <= 0.1 * (one + two) + FEASIBLE


OBEYS: dict[str, Callable[[Estimate], None]] = {
    "total": obeys_total,
    "group": obeys_group,
    "box": obeys_box,
    "ellipsoid": obeys_ellipsoid,
    "all mass": obeys_all_mass,
    "hull": obeys_hull,
    "fixed": obeys_fixed,
    "fixed link": obeys_fixed_link,
    "equal": obeys_equal,
    "symmetric": obeys_symmetric,
    "pair": obeys_pair,
    "friction": obeys_friction,
}


@given(SEEDS)
def test_matter_is_found_where_it_may_be(seed: int) -> None:
    """The decomposition of these tests, of bodies made of points in the unit ball."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(6, 3))
    points *= rng.uniform(0.2, 1.0, (6, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    body = point_masses(rng.uniform(0.1, 2.0, 6), points)
    masses, found = matter(body, np.diag([-1.0, -1.0, -1.0, 1.0]))
    np.testing.assert_allclose(point_masses(masses, found), body, atol=1e-12)
    assert np.linalg.norm(found, axis=1).max() <= 1.0 + 1e-9


@pytest.mark.parametrize("name", list(CONDITIONS))
def test_the_optimum_obeys_a_condition_and_is_proven(name: str, tmp_path: Path) -> None:
    estimate = solve_sdp(arm_problem(*CONDITIONS[name]))
    assert estimate.feasible
    OBEYS[name](estimate)
    certificate = certify(estimate)
    assert certificate.passed
    certificate.to_json(tmp_path / "c.json")
    again = verify(tmp_path / "c.json")
    assert again.passed, again.problems
    assert again.lower_bound == pytest.approx(certificate.lower_bound, rel=1e-9)
    # It costs something.
    free = solve_sdp(limited(estimate.problem))
    assert estimate.cost > free.cost * (1.0 + 10.0 * SAME_OPTIMUM)
    assert certificate.lower_bound > free.cost


@pytest.mark.parametrize("name", [n for n in CONDITIONS if n != "all mass"])
def test_the_same_with_spatial_inertias(name: str) -> None:
    estimate = solve_sdp(arm_problem(*CONDITIONS[name], consistency="spatial_inertia"))
    assert estimate.feasible
    assert certify(estimate).passed
    free = solve_sdp(limited(estimate.problem))
    assert estimate.cost >= free.cost * (1.0 - SAME_OPTIMUM)


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize("name", list(LOOSE))
def test_what_does_not_bind_does_not_cost(name: str, consistency: Consistency) -> None:
    problem = arm_problem(LOOSE[name], consistency=consistency)
    estimate = solve_sdp(problem)
    free = solve_sdp(limited(problem))
    assert estimate.cost == pytest.approx(free.cost, rel=SAME_OPTIMUM)
    assert certify(estimate).passed
    for state in constraint_states(estimate)[len(constraint_states(free)) :]:
        assert state.slack is not None
        assert state.slack > 0.0
        assert not state.active
        assert state.multiplier == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("consistency", BOTH)
def test_more_conditions_never_cost_less(consistency: Consistency) -> None:
    chosen = [LIGHT, *(CONDITIONS[name][-1] for name in ("ellipsoid", "symmetric", "all mass"))]
    costs = [
        solve_sdp(arm_problem(*chosen[:k], consistency=consistency)).cost
        for k in range(len(chosen) + 1)
    ]
    assert all(b >= a * (1.0 - SAME_OPTIMUM) for a, b in itertools.pairwise(costs))
    assert costs[-1] > costs[0]
