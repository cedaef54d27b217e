"""The local solver: derivatives, honesty, and no valleys but one."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdpid.errors import DataError
from sdpid.estimation.constraints.condition import Condition
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.constraints.equalities import Fixed, FixedLink
from sdpid.estimation.constraints.mass import (
    CenterOfMassInBox,
    CenterOfMassInEllipsoid,
    TotalMass,
)
from sdpid.estimation.local.physical_constraints import PhysicalConstraints
from sdpid.estimation.local.physical_variables import PhysicalVariables
from sdpid.estimation.local.run import FEASIBLE_LOCAL
from sdpid.estimation.local.slsqp import _Run, solve_slsqp
from sdpid.estimation.local.starts import random_start
from sdpid.estimation.local.stationarity import STATIONARY
from sdpid.estimation.prior.prior import Prior, PriorKind
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.robot.inertia import Consistency, physical_parameters
from sdpid.robot.model.model import RobotModel
from tests.helpers.data import flat_links, make_samples, random_links, random_theta
from tests.helpers.robots import planar_arm, small_arm
from tests.helpers.small_robots import MODELS
from tests.helpers.strategies import SEEDS
from tests.helpers.tolerances import LOCAL_COST

BOTH: tuple[Consistency, ...] = ("pseudo_inertia", "spatial_inertia")
STARTS = 8
# Where the scaled cost has long settled on these small arms.
ENOUGH = 400


def noisy(
    robot: RobotModel, seed: int, consistency: Consistency, *, margin: float = 0.01
) -> Problem:
    """Return a problem whose optimum lies on the boundary."""
    rng = np.random.default_rng(seed)
    theta = random_theta(robot, rng)
    theta[: 10 * robot.n_links] = flat_links(rng, robot.n_links).ravel()
    samples = make_samples(robot, theta, rng, noise=0.5)
    limits = Constraints(margin=margin, mass_max=10.0)
    return build_problem(robot, samples, consistency=consistency, constraints=limits)


@pytest.fixture(scope="module", params=BOTH)
def planar(request: pytest.FixtureRequest) -> Problem:
    return noisy(planar_arm(), 0, request.param)


def conditions(robot: RobotModel) -> tuple[Condition, ...]:
    """Return equations, one of them twice, rows with one and two limits, and cones."""
    first, last = robot.link_names[0], robot.link_names[-1]
    return (
        TotalMass(2.0),
        TotalMass(2.0),
        TotalMass(1.0, tolerance=0.5, links=(last,)),
        CenterOfMassInBox(first, (-0.2, -0.2, -np.inf), (0.2, 0.2, np.inf)),
        CenterOfMassInEllipsoid(last, (0.05, 0.0, 0.0), (0.1, 0.05, 0.1)),
    )


@pytest.mark.parametrize("robot", [planar_arm(), small_arm(3), MODELS["hinge"], MODELS["slider"]])
@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize("more", ["alone", "conditions", "entropic"])
def test_derivatives(robot: RobotModel, consistency: Consistency, more: str) -> None:
    problem = noisy(robot, 1, consistency)
    if more == "conditions":
        others = conditions(robot)
        problem = problem.constrained(constraints=problem.constraints.replace(others=others))
    if more == "entropic":
        problem = believed(robot, consistency)
    program = _Run(problem)
    variables, constraints = program.variables, program.constraints
    rng = np.random.default_rng(2)
    step = 1e-6
    for _ in range(3):
        x = variables.from_theta(random_start(problem, rng))
        _, gradient = program.cost(x)
        jacobian = constraints.at_least_jacobian(x)
        for k in range(variables.count):
            forward, backward = x.copy(), x.copy()
            forward[k] += step
            backward[k] -= step
            slope = (program.cost(forward)[0] - program.cost(backward)[0]) / (2 * step)
            # Central differences of a function of order one: step² and rounding/step.
            assert gradient[k] == pytest.approx(slope, rel=1e-5, abs=1e-7)
            slopes = (constraints.at_least(forward) - constraints.at_least(backward)) / (2 * step)
            np.testing.assert_allclose(jacobian[:, k], slopes, rtol=1e-5, atol=1e-7)
            slopes = (constraints.zero(forward) - constraints.zero(backward)) / (2 * step)
            zero = constraints.zero_jacobian(x)[:, k]
            np.testing.assert_allclose(zero, slopes, rtol=1e-5, atol=1e-7)


def believed(robot: RobotModel, consistency: Consistency, kind: PriorKind = "entropic") -> Problem:
    """Return a problem with a prior."""
    rng = np.random.default_rng(1)
    theta = random_theta(robot, rng)
    samples = make_samples(robot, theta, rng, noise=0.5)
    prior = Prior(kind=kind, bodies=random_links(rng, robot.n_links))
    limits = Constraints(margin=0.002, mass_max=10.0)
    return build_problem(robot, samples, consistency=consistency, constraints=limits, prior=prior)


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize("margin", [0.0, 0.01])
def test_further_conditions(consistency: Consistency, margin: float) -> None:
    """The optimum under equations, rows and cones is the semidefinite program's."""
    robot = planar_arm()
    problem = noisy(robot, 0, consistency, margin=margin)
    constraints = problem.constraints.replace(others=conditions(robot))
    problem = problem.constrained(constraints=constraints)
    # Equations that are said twice are kept once.
    assert len(PhysicalConstraints.of(problem, PhysicalVariables.of(problem)).equations) == 1
    best = solve_sdp(problem)
    for seed in range(2):
        local = solve_slsqp(problem, seed=seed, max_iterations=ENOUGH)
        assert local.status == "optimal"
        assert local.cost == pytest.approx(best.cost, rel=STATIONARY)
        assert problem.feasible.violation(np.asarray(local.theta)) <= FEASIBLE_LOCAL


def test_a_fixed_link() -> None:
    """Ten equations, a few of them about variables that the effort does not show."""
    robot = planar_arm()
    problem = noisy(robot, 0, "pseudo_inertia", margin=0.0)
    body = random_links(np.random.default_rng(2), 1)[0]
    fixed = FixedLink(robot.link_names[0], body)
    problem = problem.constrained(constraints=problem.constraints.replace(others=(fixed,)))
    local = solve_slsqp(problem, seed=0, max_iterations=ENOUGH)
    assert local.status == "optimal"
    np.testing.assert_allclose(np.asarray(local.theta)[:10], body, atol=1e-7)
    assert local.cost == pytest.approx(solve_sdp(problem).cost, rel=STATIONARY)


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize("kind", ["entropic", "pullback"])
def test_priors(consistency: Consistency, kind: PriorKind) -> None:
    problem = believed(small_arm(2), consistency, kind)
    best = solve_sdp(problem)
    for seed in range(2):
        local = solve_slsqp(problem, seed=seed, max_iterations=ENOUGH)
        assert local.status == "optimal"
        assert local.cost == pytest.approx(best.cost, rel=STATIONARY)


def test_first_link_variables_are_left_out_unless_a_condition_asks() -> None:
    problem = noisy(small_arm(2), 0, "pseudo_inertia")
    name = problem.robot.link_names[0]
    asks: list[tuple[Condition, int]] = [
        (TotalMass(2.0), 6),
        (CenterOfMassInEllipsoid(name, (0.0, 0.0, 0.0), (0.1, 0.1, 0.1)), 0),
        (Fixed({"xy_1": 0.0}), 0),
    ]
    for other, left_out in asks:
        limits = problem.constraints.replace(others=(other,))
        variables = PhysicalVariables.of(problem.constrained(constraints=limits))
        assert problem.n_theta - variables.count == left_out


def test_eigenvalues_that_meet_do_not_stall() -> None:
    """At an optimum with two active eigenvalues in one link nothing is promised."""
    problem = noisy(planar_arm(), 0, "spatial_inertia", margin=0.002)
    local = solve_slsqp(problem, seed=0, max_iterations=1500)
    assert local.status == "optimal"
    _, _, inertia = physical_parameters(problem.feasible.bodies(np.asarray(local.theta)))
    assert np.any(np.sum(np.linalg.eigvalsh(inertia) < 0.002 + 1e-6, axis=1) >= 2)


def test_hidden_convexity_from_many_starts(planar: Problem) -> None:
    """Starts that converge all reach the one optimum; none finds anything below it."""
    best = solve_sdp(planar)
    converged = 0
    for seed in range(STARTS):
        local = solve_slsqp(planar, seed=seed, max_iterations=ENOUGH)
        if local.status == "infeasible":
            continue
        assert best.cost <= local.cost * (1.0 + LOCAL_COST)
        if local.status == "optimal":
            converged += 1
            assert local.cost <= best.cost * (1.0 + LOCAL_COST)
    assert converged >= STARTS - 2


def test_an_estimate_tells_how_it_came_about(planar: Problem) -> None:
    estimate = solve_slsqp(planar, seed=3, max_iterations=ENOUGH)
    assert estimate.method == "slsqp"
    assert estimate.message
    assert estimate.solve_time > 0.0
    history = estimate.history
    # The start and one entry an iteration.
    assert len(history) == estimate.iterations + 1
    assert all(a.seconds <= b.seconds for a, b in itertools.pairwise(history))
    assert history[0].cost == pytest.approx(planar.cost_of(np.asarray(estimate.start)))
    assert history[-1].cost == estimate.cost
    assert estimate.multipliers is None


def test_an_estimate_is_shown_in_short(planar: Problem) -> None:
    estimate = solve_slsqp(planar, seed=3, max_iterations=5)
    assert len(repr(estimate)) < 200
    shown = estimate._repr_html_()
    assert f"<td>{planar.robot.name}</td>" in shown
    assert "<td>slsqp</td>" in shown
    assert all(name in shown for name in planar.base.names)


def test_an_iteration_limit_is_no_optimum(planar: Problem) -> None:
    estimate = solve_slsqp(planar, seed=4, max_iterations=2)
    assert estimate.status in ("iteration limit", "infeasible")
    assert estimate.iterations <= 2


def test_status_optimal_means_feasible(planar: Problem) -> None:
    for seed in range(4):
        estimate = solve_slsqp(planar, seed=seed, max_iterations=ENOUGH)
        assert estimate.violation is not None
        assert (estimate.violation <= FEASIBLE_LOCAL) == (estimate.status != "infeasible")


def test_the_same_seed_is_the_same_run(planar: Problem) -> None:
    first, second = (solve_slsqp(planar, seed=5, max_iterations=20) for _ in range(2))
    np.testing.assert_array_equal(np.asarray(first.theta), np.asarray(second.theta))
    other = solve_slsqp(planar, seed=6, max_iterations=20)
    assert not np.array_equal(np.asarray(first.start), np.asarray(other.start))


@given(SEEDS, st.sampled_from(BOTH), st.sampled_from([0.0, 0.05]), st.floats(0.001, 5.0))
@settings(max_examples=20)
def test_random_starts_are_feasible(
    seed: int, consistency: Consistency, margin: float, mass_min: float
) -> None:
    problem = noisy(small_arm(2), 7, consistency).constrained(
        constraints=Constraints(margin=margin, mass_min=mass_min, mass_max=5.5)
    )
    start = random_start(problem, np.random.default_rng(seed))
    assert problem.feasible.violation(start) == 0.0


def test_bad_starts(planar: Problem) -> None:
    with pytest.raises(DataError, match=r"start: shape \(3,\)"):
        solve_slsqp(planar, start=np.ones(3))
    start = random_start(planar, np.random.default_rng(0))
    start[10] = -1.0
    with pytest.raises(DataError, match=r"link 2 has mass -1\.0 kg"):
        solve_slsqp(planar, start=start)
    with pytest.raises(DataError, match="start"):
        solve_slsqp(planar, start=np.full(planar.n_theta, np.nan))
    with pytest.raises(DataError, match="nothing constrains"):
        solve_slsqp(planar.constrained(consistency="none"))
