"""No local solver ends above the global optimum by more than its own stationarity error.

Let a solver end in theta with physical variables x, theta = Phi(x), let theta* be any feasible
point, and w = DPhi(x)^(-1)·(theta* − theta). The cost f is a convex quadratic in theta, with
F = f∘Phi in x,

    f(theta) − f(theta*) = −∇F(x)·w − ‖G·(theta* − theta)‖² ≤ −∇F(x)·w.

Every constraint is C_i(theta) ≥ 0 with C_i concave in theta: bounds and rows are linear, cones are
``axis·body − ‖V·body‖``, and the matrix inequalities are ``u^T·(N − margin·E)·u ≥ 0`` for all unit
u, where ``u^T·I_g·u = u^T·I_o·u − |u×h|²/m`` and ``u^T·Sigma_g·u = u^T·Sigma_o·u − (u·h)²/m`` with
m > 0. So C_i(theta*) ≤ C_i(theta) + ∇c_i(x)·w with c_i = C_i∘Phi: the segment from theta to theta*
stays feasible although it is curved in x. With any λ ≥ 0 (and free signs for equations, which are
affine) and the residual r = ∇F − Σ λ_i·∇c_i of the KKT equations,

    f(theta) − f(theta*) ≤ |r·w| + Σ λ_i·(C_i(theta) − C_i(theta*)).          (*)

The right side is what the local end point fails to be stationary by: the residual and the slacks
of constraints with multipliers (C_i(theta*) ≥ 0, to rounding). (*) holds wherever a solver
stops; it is checked with multipliers and derivatives computed here, from nothing but Phi.

Minimized over λ for the worst w, the same inequality says that `stationarity_gap` is an upper
bound of the excess, but for the curvature that it adds to directions that the effort does not
show (docs/theory, section 5).
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from sdpid._common.arrays import Array
from sdpid.estimation.constraints.condition import Condition
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.constraints.mass import (
    CenterOfMassInBox,
    CenterOfMassInEllipsoid,
    TotalMass,
)
from sdpid.estimation.duality.bound import cost_scale
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.local.log_cholesky import solve_log_cholesky
from sdpid.estimation.local.run import FEASIBLE_LOCAL
from sdpid.estimation.local.slsqp import solve_slsqp
from sdpid.estimation.local.stationarity import STATIONARY, stationarity_gap
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.robot.inertia import (
    Consistency,
    inertia_tensor,
    physical_parameters,
    tensor_entries,
    theta_from_physical,
)
from tests.helpers.data import flat_links, make_samples, random_theta
from tests.helpers.robots import planar_arm, small_arm
from tests.helpers.small_robots import MODELS
from tests.helpers.strategies import SEEDS

ROBOTS = {"planar": planar_arm(), "arm2": small_arm(2), **MODELS}
BOTH: tuple[Consistency, ...] = ("pseudo_inertia", "spatial_inertia")
MARGINS = (0.0, 0.01)
# Rounding of costs and of the products in (*), as a share of the squared efforts.
ROUNDING = 1e-10
ITERATIONS = 300


def conditions(problem: Problem, kind: str) -> tuple[Condition, ...]:
    first, last = problem.robot.link_names[0], problem.robot.link_names[-1]
    return {
        "none": (),
        "equation": (TotalMass(1.5),),
        "rows": (
            TotalMass(2.0, tolerance=0.1),
            CenterOfMassInBox(last, (-0.05, -0.05, -0.05), (0.05, 0.05, np.inf)),
        ),
        "cone": (
            CenterOfMassInEllipsoid(first, (0.05, 0.0, 0.0), (0.1, 0.05, 0.1)),
            CenterOfMassInEllipsoid(last, (0.0, 0.0, 0.0), (0.03, 0.05, 0.1)),
        ),
    }[kind]


@functools.cache
def solved(name: str, consistency: Consistency, margin: float, kind: str) -> Estimate:
    """Return the optimum of a problem whose optimum lies on the boundary."""
    robot = ROBOTS[name]
    rng = np.random.default_rng(11)
    theta = random_theta(robot, rng)
    theta[: 10 * robot.n_links] = flat_links(rng, robot.n_links).ravel()
    samples = make_samples(robot, theta, rng, noise=0.5)
    limits = Constraints(margin=margin, mass_max=10.0)
    problem = build_problem(robot, samples, consistency=consistency, constraints=limits)
    others = conditions(problem, kind)
    return solve_sdp(problem.constrained(constraints=limits.replace(others=others)))


def split(theta: Array, links: int) -> tuple[Array, Array, Array]:
    return physical_parameters(theta[: 10 * links].reshape(links, 10))


def phi(x: Array, links: int) -> Array:
    """Return theta of (m, r, I_g) link by link, and friction."""
    each = x[: 10 * links].reshape(links, 10)
    bodies = theta_from_physical(each[:, 0], each[:, 1:4], inertia_tensor(each))
    return np.concatenate([bodies.ravel(), x[10 * links :]])


def physical(theta: Array, links: int) -> Array:
    mass, com, inertia = split(theta, links)
    each = np.concatenate([mass[:, None], com, tensor_entries(inertia)], axis=1)
    return np.concatenate([each.ravel(), theta[10 * links :]])


def derivative(x: Array, links: int) -> Array:
    """Return DPhi: central differences are exact, as no variable enters beyond its square."""
    steps = np.eye(len(x))
    return np.stack([0.5 * (phi(x + e, links) - phi(x - e, links)) for e in steps], axis=1)


def along(problem: Problem, theta: Array, link: int, u: Array) -> float:
    """Return ``u^T·(N − margin·E)·u`` of a link."""
    inertia = split(theta, problem.robot.n_links)[2][link]
    value = float(u @ inertia @ u)
    if problem.consistency == "pseudo_inertia":
        value = 0.5 * float(np.trace(inertia)) - value
    return value - problem.constraints.margin


def explained(problem: Problem, theta: Array, best: Array) -> float:
    """Return the right side of (*)."""
    links, feasible = problem.robot.n_links, problem.feasible
    x = physical(theta, links)
    D = derivative(x, links)
    np.testing.assert_allclose(phi(x, links), theta, atol=1e-12 * np.abs(theta).max())
    w = np.linalg.solve(D, best - theta)
    G, h = problem.squared.matrix, problem.squared.rhs
    gradient = D.T @ (2.0 * G.T @ (G @ theta - h))

    slopes: list[Array] = []
    here: list[float] = []
    there: list[float] = []

    def add(slope: Array, value: float, other: float) -> None:
        slopes.append(slope)
        here.append(value)
        there.append(other)

    for link in range(links):
        inertia = split(theta, links)[2][link]
        asked = inertia_tensor(gradient[10 * link : 10 * link + 10])
        asked = asked * (0.5 + 0.5 * np.eye(3))
        for u in np.concatenate([np.linalg.eigh(inertia)[1].T, np.linalg.eigh(asked)[1].T]):
            outer = tensor_entries(np.outer(u, u)) * np.array([1.0, 2.0, 1.0, 2.0, 2.0, 1.0])
            if problem.consistency == "pseudo_inertia":
                outer = np.array([0.5, 0.0, 0.5, 0.0, 0.0, 0.5]) - outer
            slope = np.zeros(len(x))
            slope[10 * link + 4 : 10 * link + 10] = outer
            add(slope, along(problem, theta, link, u), along(problem, best, link, u))
    identity = np.eye(len(x))
    for j in np.flatnonzero(feasible.bounded):
        for sign, limit in ((1.0, feasible.lower[j]), (-1.0, feasible.upper[j])):
            add(sign * identity[j] @ D, sign * (theta[j] - limit), sign * (best[j] - limit))
    for row, low, high in zip(feasible.rows, feasible.row_lower, feasible.row_upper, strict=True):
        for sign, limit in ((1.0, low), (-1.0, high)):
            if np.isfinite(limit):
                values = (sign * (float(row @ point) - limit) for point in (theta, best))
                add(sign * row @ D, *values)
    rooms, best_rooms = feasible.slacks(theta), feasible.slacks(best)
    for k, room in enumerate(rooms):
        F = feasible.block_basis[feasible.n_own + k]
        link = int(feasible.block_links[feasible.n_own + k])
        own = slice(10 * link, 10 * link + 10)
        v = theta[own] @ F[:, -1, :3]
        slope = np.zeros(len(x))
        slope[own] = F[:, -1, -1] - F[:, -1, :3] @ v / np.linalg.norm(v)
        add(slope @ D, float(room), float(best_rooms[k]))

    A, values = np.array(slopes), np.array(here)
    size = np.sqrt(problem.cost_of(theta) + cost_scale(problem))
    curvature = np.linalg.norm(G @ D, axis=0)
    weights = 1.0 / np.maximum(curvature, 1e-3 * curvature.max())
    # Least squares of the residual, and of what slacks cost; (*) holds whatever it finds.
    system = np.vstack([weights[:, None] * A.T, np.abs(values) / size])
    multipliers, _ = nnls(system, np.concatenate([weights * gradient, [0.0]]))
    residual = gradient - A.T @ multipliers
    return abs(float(residual @ w)) + float(multipliers @ (values - np.array(there)))


@given(
    st.sampled_from(sorted(ROBOTS)),
    st.sampled_from(BOTH),
    st.sampled_from(MARGINS),
    st.sampled_from(["log_cholesky", "none", "equation", "rows", "cone"]),
    SEEDS,
)
@settings(max_examples=10)
def test_nothing_ends_above_the_optimum_unexplained(
    name: str, consistency: Consistency, margin: float, what: str, seed: int
) -> None:
    kind = "none" if what == "log_cholesky" else what
    best = solved(name, consistency, margin, kind)
    problem, optimum = best.problem, np.asarray(best.theta)
    solve = solve_log_cholesky if what == "log_cholesky" else solve_slsqp
    local = solve(problem, seed=seed, max_iterations=ITERATIONS)
    event(f"{what}: {local.status}")
    theta = np.asarray(local.theta)
    excess = local.cost - best.cost
    rounding = ROUNDING * float(problem.squared.rhs @ problem.squared.rhs + problem.floor)
    assert excess <= explained(problem, theta, optimum) + rounding
    if problem.feasible.violation(theta) > FEASIBLE_LOCAL:
        return
    # What the solver itself reports explains it too, and its word is kept.
    scale = max(local.cost, cost_scale(problem))
    assert excess <= stationarity_gap(problem, theta) * scale * 1.001 + rounding
    if local.status == "optimal":
        assert excess <= STATIONARY * scale * 1.001 + rounding
    # Nothing feasible is below the optimum, but for what violations buy.
    assert excess >= -1e-5 * scale


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize("kind", ["none", "equation", "rows", "cone"])
def test_the_optimum_is_stationary(consistency: Consistency, kind: str) -> None:
    """The inequality is no idle one: at the optimum both of its sides vanish.

    What is promised is an upper bound: where active constraints all but agree, the rounding of a
    point whose cost is known to 1e-11 leaves up to 3e-4 of it.
    """
    best = solved("arm2", consistency, 0.01, kind)
    theta = np.asarray(best.theta)
    assert stationarity_gap(best.problem, theta) <= 1e-3
    assert explained(best.problem, theta, theta) == 0.0


@pytest.mark.parametrize("kind", ["none", "equation", "rows", "cone"])
def test_starts_do_converge(kind: str) -> None:
    """Or there would be nothing to see."""
    best = solved("arm2", "spatial_inertia", 0.01, kind)
    ends = [solve_slsqp(best.problem, seed=seed, max_iterations=ITERATIONS) for seed in range(3)]
    assert sum(end.status == "optimal" for end in ends) >= 2
