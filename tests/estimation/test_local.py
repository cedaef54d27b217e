"""Local solvers: derivatives, honesty, and no valleys but one."""

import functools
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from sdpid import Constraints, Prior, RobotModel, compare, load_robot, solve_sdp, solve_slsqp
from sdpid import constraints as of
from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.duality.bound import cost_scale
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.local import log_cholesky, slsqp
from sdpid.estimation.local.log_cholesky import LogCholesky, solve_log_cholesky
from sdpid.estimation.local.physical import PhysicalConstraints, PhysicalVariables
from sdpid.estimation.local.run import FEASIBLE_LOCAL, OPTIMAL, least_cost, random_start
from sdpid.estimation.prior.prior import PriorKind
from sdpid.estimation.problem import Problem, build_problem
from sdpid.robot.inertia import Consistency, margin, physical_parameters
from tests.helpers import world
from tests.helpers.arm import ARM, BOTH
from tests.helpers.data import make_samples, random_links, random_theta
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, planar_arm, small_arm
from tests.helpers.small_robots import MODELS
from tests.helpers.strategies import SEEDS
from tests.helpers.tolerances import SAME_OPTIMUM


def noisy(
    robot: RobotModel, seed: int, consistency: Consistency, *, margin: float = 0.01, **limits: float
) -> Problem:
    """Return a problem whose optimum lies on the boundary."""
    constraints = Constraints(**{"margin": margin, "mass_max": 10.0, **limits})
    return world.problem(
        robot, seed, flat=True, noise=0.5, consistency=consistency, constraints=constraints
    )


def under(problem: Problem, *others: of.Condition) -> Problem:
    """Return the problem under further conditions."""
    return problem.constrained(constraints=problem.constraints.replace(others=others))


@functools.cache
def of_arm(which: tuple[str, Consistency]) -> Problem:
    arm = {"arm3": small_arm(3), "planar": planar_arm()}[which[0]]
    return noisy(arm, 1, which[1], margin=0.002)


problems = st.tuples(st.sampled_from(["arm3", "planar"]), st.sampled_from(BOTH)).map(of_arm)


def differences(function: Callable[[Array], Any], x: Array, step: float) -> Any:
    """Return central differences of a function by each number, one after the other."""
    for change in step * np.eye(len(x)):
        yield (function(x + change) - function(x - change)) / (2 * step)


@pytest.fixture(scope="module", params=BOTH)
def narrow_planar(request: pytest.FixtureRequest) -> Problem:
    return noisy(planar_arm(), 0, request.param, margin=0.002)


@given(problems, SEEDS)
def test_round_trip_and_consistency_of_the_coordinates(problem: Problem, seed: int) -> None:
    coordinates = LogCholesky(problem)
    theta = random_start(problem, np.random.default_rng(seed))
    back = coordinates.theta(coordinates.from_theta(theta))
    np.testing.assert_allclose(back, theta, rtol=0, atol=1e-10 * np.abs(theta).max())
    # Every point is consistent.
    theta = coordinates.theta(np.random.default_rng(seed).normal(0.0, 1.0, problem.n_theta))
    margins = problem.feasible.margins(theta)
    assert np.all(margins >= problem.constraints.margin - 1e-12 * np.abs(theta).max())


@given(problems, SEEDS)
def test_derivatives_of_the_coordinates(problem: Problem, seed: int) -> None:
    """The Jacobian, and the curvature of a fixed combination, against central differences."""
    coordinates = LogCholesky(problem)
    rng = np.random.default_rng(seed)
    x = coordinates.from_theta(random_start(problem, rng))
    weights = rng.standard_normal(problem.n_theta)
    J = coordinates.link_jacobians(x)
    H = coordinates.curvatures(x, weights)
    bodies = problem.feasible.bodies(weights)
    size, bend = np.abs(J).max(), max(float(np.abs(H).max()), 1.0)
    slopes = differences(coordinates.theta, x, 1e-5)
    seconds = differences(
        lambda x: np.einsum("lk,lkj->lj", bodies, coordinates.link_jacobians(x)), x, 1e-5
    )
    links = range(10 * problem.feasible.n_links)
    for k, slope, second in zip(links, slopes, seconds, strict=False):
        own = np.zeros_like(slope)
        own[10 * (k // 10) : 10 * (k // 10) + 10] = J[k // 10, :, k % 10]
        np.testing.assert_allclose(own, slope, rtol=0, atol=1e-7 * max(size, 1.0))
        np.testing.assert_allclose(H[k // 10, k % 10], second[k // 10], rtol=0, atol=1e-6 * bend)


@pytest.mark.parametrize("consistency", BOTH)
def test_jacobian_of_the_residual(consistency: Consistency) -> None:
    program = log_cholesky._LogCholeskyRun(of_arm(("arm3", consistency)))
    start = random_start(program.problem, np.random.default_rng(3))
    x = program.coordinates.from_theta(start)[program.free]
    J, rows = program.jacobian(x), len(program.rhs)
    for k, slope in enumerate(differences(program.residual, x, 1e-6)):
        np.testing.assert_allclose(J[:rows, k], slope[:rows], rtol=1e-5, atol=1e-8)
        # The rows that only add curvature have a residual that never changes.
        np.testing.assert_array_equal(slope[rows:], 0.0)


def test_a_start_on_the_boundary(narrow_planar: Problem) -> None:
    """The optimum itself, where the coordinates end."""
    best = solve_sdp(narrow_planar)
    estimate = solve_log_cholesky(narrow_planar, start=np.asarray(best.theta))
    assert estimate.feasible
    assert best.cost <= estimate.cost * (1.0 + SAME_OPTIMUM)


@pytest.mark.parametrize("consistency", BOTH)
def test_masses_and_signs_are_respected(consistency: Consistency) -> None:
    problem = noisy(planar_arm(), 2, consistency, margin=0.002, mass_min=1.0, mass_max=1.0)
    estimate = solve_log_cholesky(problem)
    theta = np.asarray(estimate.theta)
    assert estimate.feasible
    np.testing.assert_allclose(problem.feasible.bodies(theta)[:, 0], 1.0, rtol=1e-12)
    assert np.all(theta[10 * problem.feasible.n_links :] >= 0.0)


@pytest.mark.parametrize("solve", [solve_log_cholesky, solve_slsqp])
def test_an_estimate_tells_how_it_came_about(narrow_planar: Problem, solve: Any) -> None:
    estimate = solve(narrow_planar, seed=3, max_iterations=40)
    assert f"solve_{estimate.method}" == solve.__name__
    assert estimate.message
    assert estimate.solve_time > 0.0
    assert estimate.multipliers is None
    history = estimate.history
    # The start and one entry an iteration.
    assert len(history) == estimate.iterations + 1
    assert all(a.seconds <= b.seconds for a, b in itertools.pairwise(history))
    assert history[0].cost == pytest.approx(narrow_planar.cost_of(np.asarray(estimate.start)))
    assert history[-1].cost == pytest.approx(estimate.cost)
    if solve is solve_log_cholesky:
        # Each of the four stages spends an evaluation on where it starts, which is no step.
        assert estimate.iterations <= 36
        assert all(a.cost > b.cost for a, b in itertools.pairwise(history))
    again = solve(narrow_planar, seed=3, max_iterations=40)
    np.testing.assert_array_equal(np.asarray(estimate.theta), np.asarray(again.theta))
    other = solve(narrow_planar, seed=6, max_iterations=2)
    assert not np.array_equal(np.asarray(estimate.start), np.asarray(other.start))
    assert other.iterations <= 2
    assert other.status in ("iteration limit", "infeasible")
    refuses(DataError, r"start: shape \(3,\)", solve, narrow_planar, start=np.ones(3))
    bad = np.array(other.start)
    bad[10] = -1.0
    refuses(DataError, r"link 2 has mass -1\.0 kg", solve, narrow_planar, start=bad)
    refuses(DataError, "start", solve, narrow_planar, start=np.full(len(bad), np.nan))
    refuses(DataError, "nothing constrains", solve, narrow_planar.constrained(consistency="none"))


def test_what_the_coordinates_cannot_express_is_refused(narrow_planar: Problem) -> None:
    name = narrow_planar.robot.link_names[1]
    ellipsoid = of.CenterOfMassInEllipsoid(name, (0.0, 0.0, 0.0), (0.3, 0.3, 0.3))
    problem = under(narrow_planar, of.TotalMass(2.0), ellipsoid)
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
    refuses(DataError, "'log_cholesky' has a history", comparison.plot, "log_cholesky")


@pytest.mark.parametrize("kind", ["pullback", "entropic"])
def test_compare_with_a_prior(kind: PriorKind) -> None:
    others = (of.TotalMass(3.0, tolerance=1.0),) if kind == "entropic" else ()
    problem = believed(ARM, kind=kind, constraints=Constraints(others=others))
    comparison = compare(problem, starts=1, n_jobs=1, max_iterations=200, show_progress=False)
    last = "error" if kind == "entropic" else "optimal"
    assert [row.status for row in comparison.rows[1:]] == ["optimal", "optimal", last]
    refuses(DataError, "'newton' is not known", compare, problem, local=("newton",))
    if kind == "pullback":
        # Both start from the same parameters.
        first, second = (np.asarray(each.start) for each in comparison.estimates[2:])
        np.testing.assert_array_equal(first, second)
    if kind == "entropic":
        plain = problem.constrained(constraints=Constraints())
        refuses(DataError, "log-det prior", solve_log_cholesky, plain)


# ---- The local solver: derivatives, honesty, and no valleys but one.


# Where the scaled cost has long settled on these small arms.
ENOUGH = 400


def conditions(robot: RobotModel) -> tuple[of.Condition, ...]:
    """Return equations, one of them twice, rows with one and two limits, and cones."""
    first, last = robot.link_names[0], robot.link_names[-1]
    return (
        of.TotalMass(2.0),
        of.TotalMass(2.0),
        of.TotalMass(1.0, tolerance=0.5, links=(last,)),
        of.CenterOfMassInBox(first, (-0.2, -0.2, -np.inf), (0.2, 0.2, np.inf)),
        of.CenterOfMassInEllipsoid(last, (0.05, 0.0, 0.0), (0.1, 0.05, 0.1)),
    )


@pytest.mark.parametrize("robot", [planar_arm(), small_arm(3), MODELS["hinge"], MODELS["slider"]])
@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize("more", ["alone", "conditions", "entropic"])
def test_derivatives(robot: RobotModel, consistency: Consistency, more: str) -> None:
    problem = noisy(robot, 1, consistency)
    if more == "conditions":
        problem = under(problem, *conditions(robot))
    if more == "entropic":
        problem = believed(robot, consistency=consistency)
    program = slsqp._SlsqpRun(problem)
    variables, constraints = program.variables, program.constraints
    rng = np.random.default_rng(2)
    for _ in range(3):
        x = variables.from_theta(random_start(problem, rng))
        _, gradient = program.cost(x)
        # Central differences of a function of order one: step² and rounding/step.
        slopes = list(differences(lambda x: program.cost(x)[0], x, 1e-6))
        assert gradient == pytest.approx(slopes, rel=1e-5, abs=1e-7)
        for values, jacobian in (
            (constraints.at_least, constraints.at_least_jacobian(x)),
            (constraints.zero, constraints.zero_jacobian(x)),
        ):
            slopes = list(differences(values, x, 1e-6))
            np.testing.assert_allclose(np.transpose(jacobian), slopes, rtol=1e-5, atol=1e-7)


def believed(
    robot: RobotModel,
    kind: PriorKind = "entropic",
    constraints: Constraints = Constraints(margin=0.002, mass_max=10.0),  # noqa: B008
    **options: Any,
) -> Problem:
    """Return a problem with a prior."""
    rng = np.random.default_rng(1)
    samples = make_samples(robot, random_theta(robot, rng), rng, noise=0.5)
    prior = Prior(kind=kind, bodies=random_links(rng, robot.n_links))
    return build_problem(robot, samples, constraints=constraints, prior=prior, **options)


def converging(problem: Problem, seeds: int = 2) -> list[Estimate]:
    """Return ends of several starts, all of them at the optimum."""
    best = solve_sdp(problem)
    found = [solve_slsqp(problem, seed=k, max_iterations=ENOUGH) for k in range(seeds)]
    for local in found:
        assert local.status == "optimal"
        assert local.cost == pytest.approx(best.cost, rel=OPTIMAL)
    return found


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize("margin", [0.0, 0.01])
def test_further_conditions(consistency: Consistency, margin: float) -> None:
    """The optimum under equations, rows and cones is the semidefinite program's."""
    robot = planar_arm()
    problem = under(noisy(robot, 0, consistency, margin=margin), *conditions(robot))
    # Equations that are said twice are kept once.
    assert len(PhysicalConstraints(PhysicalVariables(problem)).equations) == 1
    for local in converging(problem):
        assert problem.feasible.violation(np.asarray(local.theta)) <= FEASIBLE_LOCAL


def test_a_fixed_link() -> None:
    """Ten equations, a few of them about variables that the effort does not show."""
    robot = planar_arm()
    problem = noisy(robot, 0, "pseudo_inertia", margin=0.0)
    body = random_links(np.random.default_rng(2), 1)[0]
    (local,) = converging(under(problem, of.FixedLink(robot.link_names[0], body)), seeds=1)
    np.testing.assert_allclose(np.asarray(local.theta)[:10], body, atol=1e-7)


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize("kind", ["entropic", "pullback"])
def test_priors(consistency: Consistency, kind: PriorKind) -> None:
    converging(believed(ARM, kind, consistency=consistency))


def test_first_link_variables_are_left_out_unless_a_condition_asks() -> None:
    problem = noisy(small_arm(2), 0, "pseudo_inertia")
    name = problem.robot.link_names[0]
    asks: list[tuple[of.Condition, int]] = [
        (of.TotalMass(2.0), 6),
        (of.CenterOfMassInEllipsoid(name, (0.0, 0.0, 0.0), (0.1, 0.1, 0.1)), 0),
        (of.Fixed({"xy_1": 0.0}), 0),
    ]
    for other, left_out in asks:
        variables = PhysicalVariables(under(problem, other))
        assert problem.n_theta - len(variables.free) == left_out


def test_eigenvalues_that_meet_do_not_stall() -> None:
    """At an optimum with two active eigenvalues in one link nothing is promised."""
    problem = noisy(planar_arm(), 0, "spatial_inertia", margin=0.002)
    local = solve_slsqp(problem, seed=0, max_iterations=1500)
    assert local.status == "optimal"
    _, _, inertia = physical_parameters(problem.feasible.bodies(np.asarray(local.theta)))
    assert np.any(np.sum(np.linalg.eigvalsh(inertia) < 0.002 + 1e-6, axis=1) >= 2)


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


# ---- The paper's variables: how many, how they map to theta, and back.


def test_the_denso_has_the_papers_66(denso: RobotModel) -> None:
    variables = PhysicalVariables(world.problem(denso))
    # All but zz of the first inertia, and z of the first center of mass, are gone.
    gone = sorted(set(range(72)) - set(variables.free.tolist()))
    assert gone == [0, 1, 2, 3, 4, 8]


@pytest.mark.parametrize(
    ("robot", "left_out"),
    [(small_arm(3), 6), (planar_arm(), 6), (TREE, 0), ("denso_vp6242", 6), ("ur5_robot", 6)],
    ids=["vertical", "horizontal", "prismatic", "tilted", "ur5"],
)
def test_how_many_are_left_out(robot: RobotModel | str, left_out: int) -> None:
    if isinstance(robot, str):
        robot = load_robot(robot, gravity=(3.0, 0.0, -9.0) if "denso" in robot else None)
    problem = world.problem(robot)
    assert len(PhysicalVariables(problem).free) == problem.n_theta - left_out


@given(problems, SEEDS)
def test_what_is_left_out_has_no_influence(problem: Problem, seed: int) -> None:
    """The way to the variables and back keeps the base parameters."""
    variables = PhysicalVariables(problem)
    theta = random_start(problem, np.random.default_rng(seed))
    x = variables.from_theta(theta)
    back = variables.theta(x)
    np.testing.assert_allclose(variables.from_theta(back), x, rtol=0, atol=1e-9)
    expected = problem.base_of(theta)
    np.testing.assert_allclose(
        problem.base_of(back), expected, rtol=0, atol=1e-10 * np.abs(expected).max()
    )
    # The completed first link is consistent whenever any completion is.
    bodies, filled = (problem.feasible.bodies(x) for x in (theta, back))
    before, after = margin(bodies, problem.consistency), margin(filled, problem.consistency)
    assert np.all(after >= before - 1e-9 * np.abs(bodies).max())
    # Inertias are what the margin is taken of.
    matrices = variables.above_margin(x)
    smallest: Array = np.linalg.eigvalsh(matrices)[:, 0]
    np.testing.assert_allclose(smallest, after, rtol=0, atol=1e-9 * np.abs(matrices).max())


# ---- A local solver that ends at an optimum ends at the global one, whatever the conditions
# (docs/theory, section 5).


ROBOTS = {"planar": planar_arm(), "arm2": small_arm(2), **MODELS}
MARGINS = (0.0, 0.01)


def conditions_of(problem: Problem, kind: str) -> tuple[of.Condition, ...]:
    first, last = problem.robot.link_names[0], problem.robot.link_names[-1]
    return {
        "none": (),
        "equation": (of.TotalMass(1.5),),
        "rows": (
            of.TotalMass(2.0, tolerance=0.1),
            of.CenterOfMassInBox(last, (-0.05, -0.05, -0.05), (0.05, 0.05, np.inf)),
        ),
        "cone": (
            of.CenterOfMassInEllipsoid(first, (0.05, 0.0, 0.0), (0.1, 0.05, 0.1)),
            of.CenterOfMassInEllipsoid(last, (0.0, 0.0, 0.0), (0.03, 0.05, 0.1)),
        ),
    }[kind]


@functools.cache
def solved(name: str, consistency: Consistency, margin: float, kind: str) -> Estimate:
    """Return the optimum of a problem whose optimum lies on the boundary."""
    problem = noisy(ROBOTS[name], 11, consistency, margin=margin)
    return solve_sdp(under(problem, *conditions_of(problem, kind)))


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
    problem = best.problem
    solve = solve_log_cholesky if what == "log_cholesky" else solve_slsqp
    local = solve(problem, seed=seed, max_iterations=300)
    event(f"{what}: {local.status}")
    excess = local.cost - best.cost
    if problem.feasible.violation(np.asarray(local.theta)) > FEASIBLE_LOCAL:
        return
    # As a share of the squared efforts.
    rounding = 1e-10 * float(problem.squared.rhs @ problem.squared.rhs + problem.floor)
    scale = max(local.cost, cost_scale(problem))
    if local.status == "optimal":
        assert excess <= OPTIMAL * scale * 1.001 + rounding
    else:
        assert excess > 0.9 * OPTIMAL * scale
    # Nothing feasible is below the optimum, but for what violations buy.
    assert excess >= -1e-5 * scale


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize("kind", ["none", "equation", "rows", "cone"])
def test_an_optimum_is_one_and_a_start_is_not(consistency: Consistency, kind: str) -> None:
    best = solved("arm2", consistency, 0.01, kind)
    problem, scale = best.problem, max(best.cost, cost_scale(best.problem))
    assert -1e-12 <= (best.cost - least_cost(problem)) / scale <= 1e-6
    start = random_start(problem, np.random.default_rng(0))
    assert problem.cost_of(start) - least_cost(problem) > OPTIMAL * problem.cost_of(start)
    # Of what cannot hold nothing is known.
    assert least_cost(under(problem, of.TotalMass(1.0), of.TotalMass(2.0))) == -np.inf
