"""The prior: its definition, its invariance, and what it does to a problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdpid.assurance.certificate.certificate import certify
from sdpid.errors import DataError, IdentifiabilityError
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.local.slsqp import solve_slsqp
from sdpid.estimation.prior.prior import Prior, prior_terms, repaired
from sdpid.estimation.problem import build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.description.dh_table import DhTable
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import (
    from_pseudo_inertia,
    margin,
    point_masses,
    pseudo_inertia,
    transform,
)
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.load import load_robot
from sdpid.workflow.verify import verify

# Round-off of a few products of numbers of order one.
ROUNDING = 1e-9


def bodies_of(seed: int, links: int = 2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    masses = rng.uniform(0.2, 1.0, (links, 8))
    return point_masses(masses, rng.normal(0.0, 0.1, (links, 8, 3)))


def robot_of(bodies: np.ndarray):
    rows = tuple({"alpha": 0.5 * np.pi * (i % 2), "d": 0.3 * i} for i in range(len(bodies)))
    table = DhTable.from_mapping({"joint": rows, "name": "arm"})
    return load_robot(table.to_urdf(bodies))


def rows_of(robot, count: int = 40, seed: int = 0, scale: float = 1.0) -> RowSource:
    rng = np.random.default_rng(seed)
    friction = FrictionModel.from_terms(("coulomb", "viscous"), robot.joint_names)
    states = {k: scale * rng.normal(size=(count, robot.n)) for k in ("position", "velocity")}
    samples = Samples(
        **states,
        acceleration=scale * rng.normal(size=(count, robot.n)),
        effort=rng.normal(size=(count, robot.n)),
    )
    return RowSource(robot, friction, structural_base(robot, friction), samples)


def penalty(robot, prior: Prior, bodies: np.ndarray) -> float:
    rows = rows_of(robot)
    found = prior_terms(prior, rows).terms[0]
    theta = np.concatenate([bodies.ravel(), np.zeros(len(rows.friction.parameters))])
    return found.value(theta)


def divergence(P: np.ndarray, P0: np.ndarray) -> float:
    """Log-det divergence of 4x4 matrices, by its definition."""
    ratio = np.linalg.solve(P0, P)
    return float(np.trace(ratio) - np.linalg.slogdet(ratio)[1] - 4.0)


@given(st.integers(0, 2**31))
def test_nothing_is_paid_at_the_prior(seed: int):
    bodies = bodies_of(seed)
    robot = robot_of(bodies)
    believed = repaired(robot.prior)[0]
    assert penalty(robot, Prior(), believed) < ROUNDING


@given(st.integers(0, 2**31), st.floats(0.1, 10.0))
def test_second_order_expansion_of_the_divergence(seed: int, strength: float):
    bodies = bodies_of(seed)
    robot = robot_of(bodies)
    believed = repaired(robot.prior)[0]
    rng = np.random.default_rng(seed)
    L = np.linalg.cholesky(pseudo_inertia(believed))
    step = rng.normal(size=(len(bodies), 4, 4))
    step = 1e-3 * (step + np.swapaxes(step, 1, 2))
    P = L @ (np.eye(4) + step) @ np.swapaxes(L, 1, 2)
    moved = from_pseudo_inertia(P)
    exact = sum(divergence(p, p0) for p, p0 in zip(P, pseudo_inertia(believed), strict=True))
    # Twice the divergence, up to the third order of a step of some 1e-3.
    expected = 2.0 * strength * exact
    assert penalty(robot, Prior(strength=strength), moved) == pytest.approx(expected, rel=0.05)


@given(st.integers(0, 2**31))
def test_the_same_in_every_frame(seed: int):
    rng = np.random.default_rng(seed)
    P0, P = (pseudo_inertia(bodies_of(seed + k, 1)[0]) for k in (0, 1))
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    shift = rng.normal(size=3)

    def distance(a: np.ndarray, b: np.ndarray) -> float:
        inverse = np.linalg.inv(np.linalg.cholesky(b))
        return float(np.linalg.norm(inverse @ a @ inverse.T - np.eye(4)))

    moved = [pseudo_inertia(transform(from_pseudo_inertia(M), rotation, shift)) for M in (P, P0)]
    assert distance(*moved) == pytest.approx(distance(P, P0), rel=1e-6)


@given(st.integers(0, 2**31), st.floats(0.1, 10.0))
def test_euclidean_kinds_are_squared_distances(seed: int, strength: float):
    bodies = bodies_of(seed)
    robot = robot_of(bodies)
    believed = repaired(robot.prior)[0]
    moved = bodies_of(seed + 1)
    raw = penalty(robot, Prior(strength=strength, kind="euclidean"), moved)
    assert raw == pytest.approx(strength * np.sum((moved - believed) ** 2))
    scaled = 0.0
    for body, reference in zip(moved, believed, strict=True):
        mass = reference[0]
        # tr(I) is twice the second moment about the origin.
        length = np.sqrt(0.5 * (reference[4] + reference[6] + reference[9]) / mass)
        units = mass * length ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
        scaled += strength * np.sum(((body - reference) / units) ** 2)
    prior = Prior(strength=strength, kind="scaled_euclidean")
    assert penalty(robot, prior, moved) == pytest.approx(scaled)


@pytest.mark.parametrize("kind", ["scaled_euclidean", "pullback"])
def test_scaled_kinds_do_not_depend_on_units(kind):
    bodies, moved = bodies_of(0), bodies_of(1)
    units = 3.0 * 7.0 ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    robot = robot_of(bodies)

    def cost(factor: np.ndarray) -> float:
        # Bodies far above the least size, which is a length that does not scale with them.
        return penalty(robot, Prior(kind=kind, bodies=bodies * factor), moved * factor)

    assert cost(units) == pytest.approx(cost(np.ones(10)), rel=1e-9)


@given(st.integers(0, 2**31), st.floats(0.1, 10.0))
def test_entropic_kind_is_the_divergence(seed: int, strength: float):
    bodies = bodies_of(seed)
    robot = robot_of(bodies)
    rows = rows_of(robot)
    found = prior_terms(Prior(strength=strength, kind="entropic"), rows)
    quadratic = prior_terms(Prior(strength=strength), rows)
    (squared, entropic), (quadratic_squared,) = found.terms, quadratic.terms
    # The rows are those of the friction terms.
    assert np.array_equal(squared.matrix, quadratic_squared.matrix[20:])
    assert np.array_equal(squared.rhs, quadratic_squared.rhs[20:])
    assert found.strength == quadratic.strength == strength
    theta = np.concatenate([bodies_of(seed + 1).ravel(), np.ones(4)])
    pairs = zip(*map(pseudo_inertia, (theta[:20].reshape(2, 10), repaired(bodies)[0])), strict=True)
    exact = 2.0 * strength * sum(divergence(P, P0) for P, P0 in pairs)
    assert entropic.value(theta) == pytest.approx(exact, rel=1e-6)
    alone = prior_terms(Prior(kind="entropic", friction=False), rows)
    assert alone.terms[0].matrix.shape == (0, 24)
    assert alone.terms[0].rhs.shape == (0,)


@pytest.mark.parametrize("kind", ["euclidean", "scaled_euclidean", "pullback", "entropic"])
def test_every_kind_repairs_first_and_hardly_believes_what_has_no_mass(kind):
    bodies = bodies_of(0, 3)
    bodies[1, 4:] = [1.0, 0.0, 0.1, 0.0, 0.0, 0.1]
    bodies[2] = 0.0
    found = prior_terms(
        Prior(kind=kind, bodies=bodies, friction=False), rows_of(robot_of(bodies_of(1, 3)))
    )
    assert any("link_2 could not exist as described" in note for note in found.notes)
    assert any("next to no information about link_3" in note for note in found.notes)
    squared, *others = found.terms
    theta = np.concatenate([repaired(bodies)[0].ravel(), np.ones(6)])
    theta[20:30] = np.linalg.lstsq(squared.matrix[-10:, 20:30], squared.rhs[-10:], rcond=None)[0]
    assert theta[20] == pytest.approx(np.mean(bodies[:2, 0]))
    assert np.linalg.norm(squared.residual(theta)) < ROUNDING
    # Doubling it costs a hundredth of what doubling a described link costs.
    doubled = theta.copy()
    doubled[20:30] *= 2.0
    if kind == "pullback":
        assert squared.value(doubled) == pytest.approx(0.04)
    if kind == "entropic":
        (log_det,) = others
        assert log_det.value(theta) < ROUNDING
        assert log_det.links.tolist() == [0, 1]


def test_impossible_links_are_repaired_and_named():
    bodies = bodies_of(0)
    bodies[1, 4:] = [1.0, 0.0, 0.1, 0.0, 0.0, 0.1]  # triangle inequality violated
    fixed, wrong, thin = repaired(bodies)
    assert (wrong, thin) == ((1,), ())
    assert np.all(margin(fixed, "pseudo_inertia") > 0.0)
    notes = prior_terms(Prior(bodies=bodies), rows_of(robot_of(bodies_of(1)))).notes
    assert any("link_2" in note for note in notes)


def test_a_description_without_masses_is_no_prior():
    robot = robot_of(bodies_of(0))
    with pytest.raises(DataError, match="no link a mass"):
        prior_terms(Prior(bodies=np.zeros((2, 10))), rows_of(robot))
    for strength in (0.0, -1.0, np.inf, np.nan, "often", True):
        with pytest.raises(DataError, match="strength"):
            Prior(strength=strength)
    with pytest.raises(DataError, match="kind"):
        Prior(kind="flat")


@pytest.mark.parametrize("consistency", ["pseudo_inertia", "spatial_inertia"])
def test_data_that_do_not_excite_are_enough_with_a_prior(consistency, tmp_path):
    bodies = bodies_of(3, 3)
    robot = robot_of(bodies)
    count = 60
    rest = np.zeros((count, robot.n))
    samples = Samples(
        position=np.tile([0.1, 0.2, 0.3], (count, 1)), velocity=rest, acceleration=rest, effort=rest
    )
    with pytest.raises(IdentifiabilityError):
        build_problem(robot, samples)
    problem = build_problem(robot, samples, prior=Prior(), consistency=consistency)
    estimate = solve_sdp(problem)
    certificate = certify(estimate)
    assert certificate.passed, certificate.summary()
    certificate.to_json(tmp_path / "c.json")
    assert verify(tmp_path / "c.json").passed


def test_a_strong_prior_wins_and_a_weak_one_does_not():
    truth, belief = bodies_of(5), bodies_of(6)
    robot = robot_of(belief)
    rng = np.random.default_rng(0)
    q, v, a = (rng.normal(size=(200, robot.n)) for _ in range(3))
    effort = robot.inverse_dynamics(truth.ravel(), q, v, a) + 0.01 * rng.normal(size=q.shape)
    samples = Samples(position=q, velocity=v, acceleration=a, effort=effort)
    options = {"weighting": "residual"}
    free = solve_wls(build_problem(robot, samples, **options))
    believed = repaired(robot.prior)[0]
    strong = solve_sdp(build_problem(robot, samples, prior=Prior(strength=1e11), **options))
    assert np.allclose(strong.theta[:20], believed.ravel(), atol=1e-3)
    weak = solve_sdp(build_problem(robot, samples, prior=Prior(strength=1e-6), **options))
    assert weak.problem.cost(weak.base) <= 1.01 * free.cost


def test_local_and_global_solvers_share_the_prior():
    robot = robot_of(bodies_of(7))
    rows = rows_of(robot, 200)
    problem = build_problem(robot, rows.samples, prior=Prior(), weighting="residual")
    best = solve_sdp(problem)
    local = solve_slsqp(problem, seed=1)
    assert local.feasible or local.violation < 1e-6
    assert best.cost <= local.cost * (1.0 + 1e-6)
    # With a prior the parameters are unique: both find the same ones.
    assert local.cost == pytest.approx(best.cost, rel=1e-3)


def test_thin_bodies_are_widened_and_named():
    bodies = bodies_of(0)
    rod = point_masses(np.array([1.0, 1.0]), np.array([[0.0, 0.0, -0.3], [0.0, 0.0, 0.3]]))
    # A rod along z, 1 mm across.
    bodies[1] = rod + 2e-6 * np.array([0, 0, 0, 0, 1, 0, 1, 0, 0, 2])
    assert margin(bodies[1], "pseudo_inertia") > 0.0
    _, wrong, thin = repaired(bodies)
    assert (wrong, thin) == ((), (1,))
    notes = prior_terms(Prior(bodies=bodies), rows_of(robot_of(bodies_of(1)))).notes
    assert [note for note in notes if "widened" in note and "link_2" in note]
    # What was widened once is not thin.
    assert repaired(repaired(bodies)[0])[1:] == ((), ())


@pytest.mark.parametrize("weighting", ["eq9", "eq18"])
def test_costs_that_are_no_likelihood_take_no_prior(weighting):
    robot = robot_of(bodies_of(0))
    with pytest.raises(DataError, match=f"'{weighting}' is no likelihood.*no prior"):
        build_problem(robot, rows_of(robot).samples, weighting=weighting, prior=Prior())


def test_a_likelihood_without_a_covariance_says_its_unit():
    robot = robot_of(bodies_of(0))
    samples = rows_of(robot, 200).samples
    known = replace(samples, covariance=np.eye(2))
    assert "unit" in " ".join(build_problem(robot, samples, prior=Prior()).prior.notes)
    assert build_problem(robot, known, prior=Prior()).prior.notes == ()
    assert build_problem(robot, samples, prior=Prior(), weighting="residual").prior.notes == ()


def test_a_prior_is_a_value():
    given_bodies = bodies_of(0)
    prior, same = Prior(bodies=given_bodies), Prior(bodies=given_bodies.tolist())
    assert prior == same
    assert hash(prior) == hash(same)
    assert prior != Prior(bodies=bodies_of(1))
    assert prior != Prior()
    assert Prior() == Prior()
    assert prior != "prior"
    given_bodies[0, 0] = 7.0
    assert prior == same
    with pytest.raises(ValueError, match="read-only"):
        prior.bodies[0, 0] = 7.0


@pytest.mark.parametrize(
    ("bodies", "says"),
    [
        (np.full((2, 10), np.nan), "20 of 20 values are not finite"),
        (np.ones((2, 9)), r"shape \(2, 9\)"),
        (np.ones(10), "1 axes"),
        ([["heavy"] * 10], "not a rectangular array of real numbers"),
    ],
)
def test_bodies_that_are_none(bodies, says):
    with pytest.raises(DataError, match=says):
        Prior(bodies=bodies)


@given(st.integers(0, 2**31), st.floats(0.01, 100.0), st.booleans())
@settings(max_examples=20, deadline=None)
def test_least_squares_counts_a_log_det_prior(seed: int, strength: float, known: bool):
    """The unconstrained minimum has a body for every link, no slope, and costs no more."""
    belief, truth = bodies_of(seed), bodies_of(seed + 1)
    robot = robot_of(belief)
    rng = np.random.default_rng(seed)
    q, v, a = (rng.normal(size=(60, robot.n)) for _ in range(3))
    effort = robot.inverse_dynamics(truth.ravel(), q, v, a) + 0.1 * rng.normal(size=q.shape)
    samples = Samples(position=q, velocity=v, acceleration=a, effort=effort)
    if not known:
        belief[0] = 0.0
    problem = build_problem(
        robot,
        samples,
        prior=Prior(kind="entropic", strength=strength, bodies=belief),
        weighting="residual",
    )
    estimate = solve_wls(problem)
    assert np.isfinite(estimate.cost)
    assert np.all(margin(estimate.theta[:20].reshape(2, 10), "pseudo_inertia")[~known:] > 0.0)
    slope = problem.gradient(estimate.theta)
    rows = np.vstack(
        [term.curvature_rows(estimate.theta) for term in (problem.squared, problem.log_det)]
    )
    # What a further Newton step would bring, beside the cost.
    scale = np.linalg.norm(rows, axis=0)
    step = np.linalg.lstsq((rows / scale).T @ (rows / scale), slope / scale, rcond=None)[0] / scale
    assert abs(slope @ step) < 1e-10 * max(estimate.cost, float(problem.rhs @ problem.rhs))
    assert estimate.cost <= solve_sdp(problem).cost * (1.0 + 1e-9)
    # The same optimum is proven where nothing but the prior keeps links bodies.
    proven = solve_sdp(problem.constrained(consistency="none"))
    assert proven.cost == pytest.approx(estimate.cost, rel=1e-5)
