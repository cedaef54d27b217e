"""The local solver in log-Cholesky coordinates: its map, its derivatives, its results."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid.errors import DataError
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.constraints.mass import CenterOfMassInEllipsoid, TotalMass
from sdpid.estimation.estimate import FEASIBLE
from sdpid.estimation.local.log_cholesky import LogCholesky, _Run, solve_log_cholesky
from sdpid.estimation.local.starts import random_start
from sdpid.estimation.local.stationarity import STATIONARY, stationarity_gap
from sdpid.estimation.prior.prior import Prior, PriorKind
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.robot.inertia import Consistency
from sdpid.robot.model.model import RobotModel
from sdpid.workflow.comparison import compare
from tests.helpers.data import flat_links, make_samples, random_links, random_theta, relative_error
from tests.helpers.robots import planar_arm, small_arm
from tests.helpers.strategies import SEEDS
from tests.helpers.tolerances import LOCAL_PARAMETERS, SAME_OPTIMUM

BOTH: tuple[Consistency, ...] = ("pseudo_inertia", "spatial_inertia")
STARTS = 6
# The boundary is reached from inside only: the cost that a result called optimal may be above
# the optimum, relative: what its own test lets pass, which is an upper bound of the excess.
ABOVE = 1.001 * STATIONARY


def noisy(robot: RobotModel, seed: int, consistency: Consistency, **limits: float) -> Problem:
    """Return a problem whose optimum lies on the boundary."""
    rng = np.random.default_rng(seed)
    theta = random_theta(robot, rng)
    theta[: 10 * robot.n_links] = flat_links(rng, robot.n_links).ravel()
    samples = make_samples(robot, theta, rng, noise=0.5)
    constraints = Constraints(**{"margin": 0.002, "mass_max": 10.0, **limits})  # type: ignore[arg-type]
    return build_problem(robot, samples, consistency=consistency, constraints=constraints)


PROBLEMS = {kind: noisy(small_arm(3), 1, kind) for kind in BOTH}
problems = st.sampled_from(BOTH).map(PROBLEMS.__getitem__)


@pytest.fixture(scope="module", params=BOTH)
def planar(request: pytest.FixtureRequest) -> Problem:
    return noisy(planar_arm(), 0, request.param)


@given(problems, SEEDS)
def test_round_trip(problem: Problem, seed: int) -> None:
    coordinates = LogCholesky.of(problem)
    theta = random_start(problem, np.random.default_rng(seed))
    back = coordinates.theta(coordinates.from_theta(theta))
    np.testing.assert_allclose(back, theta, rtol=0, atol=1e-10 * np.abs(theta).max())


@given(problems, SEEDS)
def test_every_point_is_consistent(problem: Problem, seed: int) -> None:
    coordinates = LogCholesky.of(problem)
    x = np.random.default_rng(seed).normal(0.0, 1.0, problem.n_theta)
    theta = coordinates.theta(x)
    margins = problem.feasible.margins(theta)
    assert np.all(margins >= problem.constraints.margin - 1e-12 * np.abs(theta).max())


@given(problems, SEEDS)
def test_derivatives(problem: Problem, seed: int) -> None:
    """The Jacobian, and the curvature of a fixed combination, against central differences."""
    coordinates = LogCholesky.of(problem)
    rng = np.random.default_rng(seed)
    x = coordinates.from_theta(random_start(problem, rng))
    weights = rng.standard_normal(problem.n_theta)
    links, step = problem.feasible.n_links, 1e-5
    J = coordinates.link_jacobians(x)
    H = coordinates.curvatures(x, weights)
    bodies = problem.feasible.bodies(weights)
    size, bend = np.abs(J).max(), max(float(np.abs(H).max()), 1.0)
    for k in range(10 * links):
        change = np.zeros(problem.n_theta)
        change[k] = step
        ends = [x + change, x - change]
        slope = np.subtract(*(coordinates.theta(e) for e in ends)) / (2 * step)
        own = np.zeros_like(slope)
        own[10 * (k // 10) : 10 * (k // 10) + 10] = J[k // 10, :, k % 10]
        np.testing.assert_allclose(own, slope, rtol=0, atol=1e-7 * max(size, 1.0))
        slopes = [np.einsum("lk,lkj->lj", bodies, coordinates.link_jacobians(e)) for e in ends]
        second = (slopes[0] - slopes[1]) / (2 * step)
        np.testing.assert_allclose(H[k // 10, k % 10], second[k // 10], rtol=0, atol=1e-6 * bend)


@pytest.mark.parametrize("consistency", BOTH)
def test_jacobian_of_the_residual(consistency: Consistency) -> None:
    program = _Run(PROBLEMS[consistency])
    start = random_start(program.problem, np.random.default_rng(3))
    x = program.coordinates.from_theta(start)[program.free]
    J, rows, step = program.jacobian(x), len(program.rhs), 1e-6
    for k in range(len(x)):
        change = step * np.eye(len(x))[k]
        slope = (program.residual(x + change) - program.residual(x - change)) / (2 * step)
        np.testing.assert_allclose(J[:rows, k], slope[:rows], rtol=1e-5, atol=1e-8)
        # The rows that only add curvature have a residual that never changes.
        np.testing.assert_array_equal(slope[rows:], 0.0)


@pytest.mark.parametrize("consistency", BOTH)
def test_exact_data(consistency: Consistency) -> None:
    rng = np.random.default_rng(4)
    robot = small_arm(2)
    theta = random_theta(robot, rng)
    samples = make_samples(robot, theta, rng)
    problem = build_problem(robot, samples, consistency=consistency)
    estimate = solve_log_cholesky(problem, seed=5)
    error = relative_error(estimate.base, problem.base_of(theta), problem.base.units)
    assert error <= LOCAL_PARAMETERS


def test_hidden_convexity_from_many_starts(planar: Problem) -> None:
    best = solve_sdp(planar)
    converged = 0
    for seed in range(STARTS):
        local = solve_log_cholesky(planar, seed=seed)
        assert local.violation is not None
        assert local.violation <= FEASIBLE
        # Feasible to rounding, so never below the optimum by more than its own accuracy.
        assert best.cost <= local.cost * (1.0 + SAME_OPTIMUM)
        if local.status == "optimal":
            converged += 1
            assert local.cost <= best.cost * (1.0 + ABOVE)
    assert converged >= STARTS // 2


def test_the_optimum_promises_nothing_and_a_start_does(planar: Problem) -> None:
    best = solve_sdp(planar)
    assert stationarity_gap(planar, np.asarray(best.theta)) <= 0.01 * STATIONARY
    start = random_start(planar, np.random.default_rng(0))
    assert stationarity_gap(planar, start) > STATIONARY


def test_a_start_on_the_boundary(planar: Problem) -> None:
    """The optimum itself, where the coordinates end."""
    best = solve_sdp(planar)
    estimate = solve_log_cholesky(planar, start=np.asarray(best.theta))
    assert estimate.feasible
    assert best.cost <= estimate.cost * (1.0 + SAME_OPTIMUM)


@pytest.mark.parametrize("consistency", BOTH)
def test_masses_and_signs_are_respected(consistency: Consistency) -> None:
    problem = noisy(planar_arm(), 2, consistency, mass_min=1.0, mass_max=1.0)
    estimate = solve_log_cholesky(problem)
    theta = np.asarray(estimate.theta)
    assert estimate.feasible
    np.testing.assert_allclose(problem.feasible.bodies(theta)[:, 0], 1.0, rtol=1e-12)
    assert np.all(theta[10 * problem.feasible.n_links :] >= 0.0)


def test_an_estimate_tells_how_it_came_about(planar: Problem) -> None:
    estimate = solve_log_cholesky(planar, seed=3, max_iterations=40)
    assert estimate.method == "log_cholesky"
    assert estimate.message
    history = estimate.history
    assert len(history) == estimate.iterations + 1
    # Each of the four stages spends an evaluation on where it starts, which is no step.
    assert estimate.iterations <= 36
    assert all(a.cost > b.cost for a, b in itertools.pairwise(history))
    assert history[0].cost == pytest.approx(planar.cost_of(np.asarray(estimate.start)))
    assert history[-1].cost == pytest.approx(estimate.cost)
    assert all(a.seconds <= b.seconds for a, b in itertools.pairwise(history))
    again = solve_log_cholesky(planar, seed=3, max_iterations=40)
    np.testing.assert_array_equal(np.asarray(estimate.theta), np.asarray(again.theta))


def test_an_iteration_limit_is_no_optimum(planar: Problem) -> None:
    assert solve_log_cholesky(planar, seed=4, max_iterations=2).status == "iteration limit"


def test_bad_input(planar: Problem) -> None:
    with pytest.raises(DataError, match=r"start: shape \(3,\)"):
        solve_log_cholesky(planar, start=np.ones(3))
    with pytest.raises(DataError, match="nothing constrains"):
        solve_log_cholesky(planar.constrained(consistency="none"))
    with pytest.raises(DataError, match="'newton' is not known"):
        compare(planar, local=("newton",))


def test_compare_runs_both_local_solvers_from_the_same_starts(planar: Problem) -> None:
    comparison = compare(planar, starts=1, n_jobs=1, max_iterations=50, show_progress=False)
    assert [row.solver for row in comparison.rows] == ["wls", "sdp", "slsqp", "log_cholesky"]
    first, second = (e for e in comparison.estimates[2:] if e is not None)
    np.testing.assert_array_equal(np.asarray(first.start), np.asarray(second.start))


def test_what_the_coordinates_cannot_express_is_refused(planar: Problem) -> None:
    name = planar.robot.link_names[1]
    others = (TotalMass(2.0), CenterOfMassInEllipsoid(name, (0.0, 0.0, 0.0), (0.3, 0.3, 0.3)))
    limits = planar.constraints.replace(others=others)
    problem = planar.constrained(constraints=limits)
    with pytest.raises(DataError, match=f"total mass, center of mass of {name} in an ellipsoid"):
        solve_log_cholesky(problem)
    comparison = compare(problem, starts=1, n_jobs=1, max_iterations=200, show_progress=False)
    assert [row.solver for row in comparison.rows] == ["wls", "sdp", "slsqp", "log_cholesky"]
    assert [row.status for row in comparison.rows[1:]] == ["optimal", "optimal", "error"]
    assert "solve_slsqp" in comparison.rows[-1].message
    assert comparison.estimates[-1] is None
    assert "error" in comparison.table()
    pytest.importorskip("matplotlib")
    labels = [text.get_text() for text in comparison.plot().get_legend().get_texts()]
    assert "end of a start (1)" in labels
    with pytest.raises(DataError, match="'log_cholesky' has a history"):
        comparison.plot("log_cholesky")


@pytest.mark.parametrize("kind", ["pullback", "entropic"])
def test_compare_with_a_prior(kind: PriorKind) -> None:
    rng = np.random.default_rng(1)
    robot = small_arm(2)
    samples = make_samples(robot, random_theta(robot, rng), rng, noise=0.5)
    prior = Prior(kind=kind, bodies=random_links(rng, 2))
    others = (TotalMass(3.0, tolerance=1.0),) if kind == "entropic" else ()
    problem = build_problem(robot, samples, prior=prior, constraints=Constraints(others=others))
    comparison = compare(problem, starts=1, n_jobs=1, max_iterations=200, show_progress=False)
    last = "error" if kind == "entropic" else "optimal"
    assert [row.status for row in comparison.rows[1:]] == ["optimal", "optimal", last]
    if kind == "entropic":
        plain = problem.constrained(constraints=Constraints())
        with pytest.raises(DataError, match="log-det prior"):
            solve_log_cholesky(plain)
