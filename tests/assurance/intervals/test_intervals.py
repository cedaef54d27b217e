"""Intervals against brute force, Gauss-Markov's closed form, and what is known to be unknowable."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import t

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.intervals.intervals import FROM_DATA, FROM_PHYSICS, FROM_PRIOR
from sdpid.assurance.intervals.profile_likelihood import ProfileLikelihood
from sdpid.errors import DataError
from sdpid.estimation.cluster_robust import ScoreBlocks
from sdpid.estimation.conic.solve import ConicFamily, ConicProgram, solve_conic
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.posterior import Groups
from sdpid.estimation.problem import Problem, build_problem
from sdpid.robot.inertia import Consistency
from sdpid.robot.model.model import RobotModel
from tests.helpers.arm import ARM, BOTH, CONDITIONS, LIGHT, arm_problem
from tests.helpers.data import make_samples, random_links, random_theta, raw_rows

# Interior-point solutions of problems of order one.
SOLVED = 1e-5


@cache
def pressed() -> Estimate:
    """Return an estimate that constraints hold back."""
    return sdpid.solve_sdp(arm_problem(LIGHT))


@cache
def relaxed() -> Estimate:
    """Return an estimate that no constraint costs anything, of samples in blocks of four."""
    rng = np.random.default_rng(8)
    theta = np.concatenate([np.tile([2.0, 0.1, 0.05, 0.1, 0.5, 0, 0.5, 0, 0, 0.5], 2), np.ones(4)])
    samples = make_samples(ARM, theta, rng, count=120, noise=0.05, block=4)
    limits = sdpid.Constraints(mass_max=20.0, theta_max=500.0)
    return sdpid.solve_sdp(build_problem(ARM, samples, constraints=limits))


def test_a_linear_cost_in_a_ball_is_least_at_its_rim() -> None:
    rng = np.random.default_rng(0)
    M, m, cost = np.diag([1.0, 2.0, 3.0]), rng.standard_normal(3), rng.standard_normal(3)
    program = ConicProgram(
        M=M,
        m=m,
        cost=cost,
        C=np.zeros((0, 3)),
        lower=np.zeros(0),
        upper=np.zeros(0),
        radius=0.7,
    )
    found = solve_conic(program)
    pull = np.linalg.solve(M.T, cost)
    assert found.x is not None
    np.testing.assert_allclose(M @ found.x + m, -0.7 * pull / np.linalg.norm(pull), atol=SOLVED)
    # The multipliers: of the radius the rate at which it helps, of the residual the pull.
    np.testing.assert_allclose(found.ball, [np.linalg.norm(pull), *pull], atol=SOLVED)


def test_a_family_gives_what_its_programs_give() -> None:
    rng = np.random.default_rng(1)
    rows = {"C": np.eye(4), "lower": -np.ones(4), "upper": np.full(4, 0.3)}
    program = ConicProgram(M=rng.standard_normal((4, 4)), m=np.zeros(4), radius=1.0, **rows)
    family = ConicFamily(program)
    for radius in (0.5, 2.0):
        cost = rng.standard_normal(4)
        alone = ConicProgram(M=program.M, m=program.m, cost=cost, radius=radius, **rows)
        expected = solve_conic(alone)
        found = family.solve(cost, radius)
        assert found.x is not None
        assert expected.x is not None
        np.testing.assert_allclose(found.x, expected.x, atol=SOLVED)


def dense_blocks(problem: Problem) -> tuple[Array, list[Array], list[Array]]:
    """Return H^(-1), whitened rows and whitened residuals of every block, the long way."""
    W, effort, mask = raw_rows(problem)
    assert mask.all()
    root = np.linalg.inv(np.linalg.cholesky(problem.sigma))
    X, y = root @ W, effort @ root.T
    size = problem.samples.block
    parts = [slice(k, k + size) for k in range(0, len(X), size)]
    rows = [X[part].reshape(-1, X.shape[2]) for part in parts]
    everything = np.vstack(rows)
    fit = np.linalg.lstsq(everything, y.ravel(), rcond=None)[0]
    residuals = [y[part].ravel() - X @ fit for part, X in zip(parts, rows, strict=True)]
    return np.linalg.inv(everything.T @ everything), rows, residuals


def test_leverage_is_corrected_as_the_long_formula_does() -> None:
    problem = relaxed().problem
    inverse, rows, residuals = dense_blocks(problem)
    errors = []
    for X, e in zip(rows, residuals, strict=True):
        values, vectors = np.linalg.eigh(np.eye(len(X)) - X @ inverse @ X.T)
        errors.append(inverse @ X.T @ (vectors / np.sqrt(values)) @ vectors.T @ e)
    expected = np.array(errors).T @ np.array(errors)
    blocks = ScoreBlocks.of(problem)
    np.testing.assert_allclose(blocks.covariance, expected, rtol=1e-6, atol=1e-12)


def test_degrees_of_freedom_are_satterthwaites() -> None:
    problem = relaxed().problem
    inverse, rows, _ = dense_blocks(problem)
    starts = np.cumsum([0, *map(len, rows)])
    everything = np.vstack(rows)
    left = np.eye(len(everything)) - everything @ inverse @ everything.T
    c = np.zeros(len(inverse))
    c[2] = 1.0
    weights = []
    for X, start, stop in zip(rows, starts[:-1], starts[1:], strict=True):
        values, vectors = np.linalg.eigh(np.eye(len(X)) - X @ inverse @ X.T)
        weights.append(
            (c @ inverse @ X.T @ (vectors / np.sqrt(values)) @ vectors.T) @ left[start:stop]
        )
    gamma = np.array(weights) @ np.array(weights).T
    expected = np.trace(gamma) ** 2 / np.sum(gamma**2)
    blocks = ScoreBlocks.of(problem)
    assert blocks.freedom(c[None] @ blocks.root)[0] == pytest.approx(expected, rel=1e-6)


def test_without_active_constraints_profile_bounds_are_gauss_markovs() -> None:
    estimate = relaxed()
    names = estimate.problem.base.names
    profile = sdpid.confidence_intervals(estimate, parameters=names)
    closed = sdpid.confidence_intervals(estimate, parameters=names, method="gauss_markov")
    width = closed.width
    assert set(profile.label) == {FROM_DATA}
    np.testing.assert_allclose(profile.lower, closed.lower, atol=1e-3 * width.max())
    np.testing.assert_allclose(profile.width, width, rtol=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_no_feasible_parameters_within_the_level_are_outside_of_a_proven_end(seed: int) -> None:
    estimate = pressed()
    problem, theta = estimate.problem, np.array(estimate.theta)
    rng = np.random.default_rng(seed)
    bounds = ProfileLikelihood(problem, theta, ScoreBlocks.of(problem), 0.95)
    c = rng.standard_normal(problem.n_theta)
    end = bounds.minimum(c)
    feasible = problem.feasible
    least = bounds.proven(c, end, (feasible.lower, feasible.upper))
    # What the solver found is one at its own level, and as near as the solver is accurate.
    at_its_level = bounds.proven(c, end, (feasible.lower, feasible.upper), end.solved)
    assert at_its_level <= end.found + 1e-9
    width = abs(float(c @ theta) - end.found)
    assert end.found - at_its_level <= 0.01 * width
    for _ in range(20):
        # Extremes of other functions are feasible; so is what is between them and the estimate.
        other = bounds.family.solve(rng.standard_normal(bounds.family.program.n), 1.0)
        assert other.x is not None
        there = bounds.program.coordinates.theta(other.x)
        share = rng.uniform()
        point = theta + share * (there - theta)
        excess = problem.cost_of(point) - problem.cost_of(theta)
        if excess <= end.rise and feasible.violation(point) <= 1e-9:
            assert c @ point >= least - 1e-6 * width


def test_intervals_hold_the_estimate_and_are_narrower_with_physics() -> None:
    estimate = pressed()
    found = sdpid.confidence_intervals(estimate)
    size = np.maximum(found.width, 1e-9)
    assert np.all(found.lower <= found.estimate + 1e-6 * size)
    assert np.all(found.upper >= found.estimate - 1e-6 * size)
    assert found.slack is not None
    assert np.all(found.slack <= 0.01 * size[:, None])
    closed = sdpid.confidence_intervals(estimate, method="gauss_markov")
    ratio = found.width[: len(estimate.base)] / closed.width[: len(estimate.base)]
    assert ratio.min() < 0.9


def test_labels_say_what_bounds_a_parameter() -> None:
    def labels(estimate: Estimate) -> dict[str, str]:
        found = sdpid.confidence_intervals(estimate, parameters=("m_2", "my_2", "Fv1", "mz_1"))
        return dict(zip(found.names, found.label, strict=True))

    bounded = labels(pressed())
    assert bounded["m_2"] == FROM_PHYSICS
    assert bounded["Fv1"] == FROM_DATA
    free = labels(sdpid.solve_sdp(relaxed().problem.constrained(consistency="none")))
    assert free["m_2"] == free["mz_1"] == FROM_PRIOR
    assert free["Fv1"] == FROM_DATA


@pytest.mark.parametrize("name", ["fixed", "ellipsoid", "pair"])
@pytest.mark.parametrize("consistency", BOTH)
def test_further_conditions_are_obeyed(name: str, consistency: Consistency) -> None:
    estimate = sdpid.solve_sdp(arm_problem(*CONDITIONS[name], consistency=consistency))
    found = sdpid.confidence_intervals(estimate, parameters=("m_2", "my_2", "Fv1"))
    room = 1e-6
    assert np.all(found.lower <= found.estimate + room)
    assert np.all(found.upper >= found.estimate - room)
    if name == "fixed":
        assert found.width[[0, 2]].max() < room


def test_a_prior_is_a_part_of_the_cost(denso: RobotModel) -> None:
    rng = np.random.default_rng(9)
    samples = make_samples(denso, random_theta(denso, rng), rng, noise=0.1)
    bodies = random_links(rng, 6)
    names = ("m_1", "my_6")
    problem = build_problem(denso, samples, prior=sdpid.Prior(bodies=bodies))
    found = sdpid.confidence_intervals(sdpid.solve_sdp(problem), parameters=names)
    assert found.label[0] != FROM_DATA
    assert found.label[1] == FROM_DATA
    assert np.all(np.abs([found.lower, found.upper]) < 50.0)
    entropic = build_problem(denso, samples, prior=sdpid.Prior(bodies=bodies, kind="entropic"))
    with pytest.raises(DataError, match="log-det"):
        sdpid.confidence_intervals(sdpid.solve_sdp(entropic), parameters=names)


def test_coverage_of_autocorrelated_noise() -> None:
    rng = np.random.default_rng(5)
    estimate = relaxed()
    problem, theta = estimate.problem, np.array(estimate.theta)
    truth = problem.base_of(theta)
    s = problem.samples
    exact = problem.predict(truth)
    held = []
    for _ in range(60):
        white = rng.standard_normal((len(exact) + 3, ARM.n))
        noise = 0.1 * (white[3:] + white[2:-1] + 0.5 * white[1:-2])
        again = sdpid.Samples(
            position=s.position,
            velocity=s.velocity,
            acceleration=s.acceleration,
            effort=exact + noise,
            block=4,
        )
        fit = sdpid.solve_wls(build_problem(ARM, again, base=problem.base))
        found = sdpid.confidence_intervals(
            fit, method="gauss_markov", parameters=problem.base.names
        )
        held.append(found.contains(truth).mean())
    # Neighboring blocks share some noise, so it is a little less than the nominal 95 %.
    error = np.std(held) / np.sqrt(len(held))
    assert 0.92 - 2.0 * error < np.mean(held) < 0.97 + 2.0 * error


def test_gauss_markov_is_students_t_about_the_estimate() -> None:
    estimate = pressed()
    found = sdpid.confidence_intervals(
        estimate, method="gauss_markov", level=0.8, parameters=("Fv1",)
    )
    errors = NoiseSpectrum.of(estimate.problem)
    at = estimate.problem.base.names.index("Fv1")
    unit = np.eye(len(estimate.base))[at]
    freedom = errors.freedom(unit[None] @ errors.root)[0]
    half = t.ppf(0.9, freedom) * np.sqrt(errors.covariance[at, at])
    assert found.estimate[0] == pytest.approx(estimate.base[at])
    assert found.upper[0] - found.estimate[0] == pytest.approx(half)


@pytest.mark.parametrize("groups", ["frequencies", "blocks"])
def test_gauss_markov_intervals_hold_the_estimate_and_end_at_limits(groups: Groups) -> None:
    problem = arm_problem(LIGHT)
    names = ("Fs1", "Fs2", *problem.base.names)
    for each in (problem, replace(problem, rhs=-problem.rhs)):
        # Of efforts of the wrong sign all friction is zero.
        estimate = sdpid.solve_sdp(each)
        found = sdpid.confidence_intervals(
            estimate, method="gauss_markov", parameters=names, groups=groups
        )
        assert found.contains(found.estimate).all()
        assert np.all(found.lower[:2] >= -1e-9)
    assert found.lower[:2] == pytest.approx(0.0, abs=1e-6)


def test_gauss_markov_takes_a_log_det_prior(denso: RobotModel) -> None:
    """A firm belief bounds what the data leave open."""
    rng = np.random.default_rng(9)
    samples = make_samples(denso, random_theta(denso, rng), rng, count=6, noise=0.1)
    bodies = random_links(rng, 6)
    found = {}
    for strength in (1.0, 1e4):
        belief = sdpid.Prior(bodies=bodies, kind="entropic", strength=strength)
        problem = build_problem(denso, samples, prior=belief)
        found[strength] = sdpid.confidence_intervals(
            sdpid.solve_sdp(problem), method="gauss_markov", parameters=problem.base.names
        )
    assert FROM_PRIOR in found[1e4].label
    assert np.median(found[1e4].width / found[1.0].width) < 0.1


def test_text_and_plain_values() -> None:
    found = sdpid.confidence_intervals(pressed(), parameters=["m_1", "Fv1"])
    assert [line.split()[0] for line in found.table().splitlines()] == ["parameter", "m_1", "Fv1"]
    plain = found.to_dict()
    assert plain["method"] == "profile"
    assert [each["name"] for each in plain["parameters"]] == ["m_1", "Fv1"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"level": 1.0}, "level"),
        ({"method": "bayes"}, "method"),
        ({"parameters": ["m_9"]}, "m_9"),
        ({"parameters": ["m_1"], "method": "gauss_markov"}, "m_1"),
        ({"method": "gauss_markov", "groups": "periods"}, "periods"),
        ({"method": "bootstrap", "groups": "frequencies"}, "blocks"),
    ],
)
def test_arguments_that_make_no_sense_are_named(arguments: dict[str, object], said: str) -> None:
    with pytest.raises(DataError, match=said):
        sdpid.confidence_intervals(pressed(), **arguments)  # type: ignore[arg-type]


def test_counts_of_rows_cannot_be_written_to() -> None:
    rows = sdpid.validate(pressed()).rows
    with pytest.raises(ValueError, match="read-only"):
        rows[0] = 0


def test_profile_needs_standard_parameters_and_squares() -> None:
    with pytest.raises(DataError, match="gauss_markov"):
        sdpid.confidence_intervals(sdpid.solve_wls(pressed().problem))


def test_cost_of_constraints_adds_up() -> None:
    estimate = pressed()
    price = sdpid.cost_of_constraints(estimate)
    np.testing.assert_allclose(price.rmse, sdpid.validate(estimate).rmse, rtol=1e-9)
    free = sdpid.solve_wls(estimate.problem)
    assert price.cost_free == pytest.approx(free.cost)
    # One constraint saves no more than all of them cost, and something.
    assert np.all(price.saved <= (price.cost - price.cost_free) * (1.0 + 1e-6))
    assert price.saved.max() > 0.0
    assert "consistency of link_2" in price.constraints
    assert price.table().count("\n") == 2 + len(price.constraints)
    assert len(price.to_dict()["constraints"]) == len(price.constraints)
    # Names are those of the constraints everywhere else.
    assert set(price.constraints) <= {each.name for each in estimate.problem.feasible.named}
    with pytest.raises(DataError, match="wls"):
        sdpid.cost_of_constraints(free)


def test_what_a_local_solver_missed_is_no_constraint_s_cost() -> None:
    best = pressed()
    # Stopped early, it is feasible and far from the optimum.
    short = sdpid.solve_slsqp(best.problem, max_iterations=3)
    excess = short.cost - best.cost
    assert excess > 0.1 * best.cost
    cost, expected = sdpid.cost_of_constraints(short), sdpid.cost_of_constraints(best)
    assert cost.excess == pytest.approx(excess)
    assert expected.excess == 0.0
    assert cost.constraints == expected.constraints
    np.testing.assert_allclose(cost.saved, expected.saved, rtol=1e-3, atol=1e-5 * best.cost)
    np.testing.assert_allclose(cost.rmse, expected.rmse, rtol=1e-4)
    assert "above the optimum" in cost.table()
    assert "above the optimum" not in expected.table()


def test_price_of_one_constraint_is_what_the_problem_without_it_saves() -> None:
    with_it = sdpid.solve_sdp(arm_problem(LIGHT))
    without = sdpid.solve_sdp(arm_problem())
    price = sdpid.cost_of_constraints(with_it)
    saved = dict(zip(price.constraints, price.saved.tolist(), strict=True))
    assert saved["total mass, at most 0.7"] == pytest.approx(with_it.cost - without.cost, rel=1e-3)
