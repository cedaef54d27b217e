"""Instruments from a closed loop whose encoders are noisy, and output error."""

import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.linalg import fractional_matrix_power

import sdpid
from sdpid import Samples, Trajectory
from sdpid._common.arrays import Array
from sdpid.errors import DataError, IdentifiabilityError, SolverError
from sdpid.estimation.closed_loop.bias import contrast, hotelling
from sdpid.estimation.closed_loop.instruments import FirstStage, paired
from sdpid.estimation.closed_loop.loop import ClosedLoop, ControllerCheck
from sdpid.estimation.cluster_robust import ScoreBlocks
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import whiten
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.twin import Twin
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics
from tests.helpers.arm import ARM
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.data import random_theta
from tests.helpers.identified import FRICTION, arm_theta, moved
from tests.helpers.motions import spline_motion
from tests.helpers.refusals import refuses

VISCOUS = ("viscous",)
THETA = random_theta(ARM, np.random.default_rng(7), VISCOUS)
TRUTH = RobotDynamics(
    robot=ARM, terms=FrictionModel.from_terms(VISCOUS, ARM.joint_names), theta=THETA
)
STIFF = sdpid.controllers.PD(kp=np.array([400.0, 60.0]), kd=np.array([30.0, 5.0]))
RATE = 200.0

# Of the encoders, rad.
NOISE = 5e-5

# High enough to let the noise in.
OPEN = sdpid.Processing(cutoff_hz=25.0, order=4, reversal_time=None, decimation=4)


def motion(seconds: float = 20.0) -> Trajectory:
    return spline_motion(ARM.joint_names, 3, duration=seconds, size=1.0, rate_hz=RATE)


def recorded(noise: float, seed: int = 0, seconds: float = 20.0) -> sdpid.Recording:
    """Return a log of a loop that feeds the noise of its encoders (rad) back."""
    way, fed = motion(seconds), {}
    if noise:
        fed = {"position_noise": np.full(2, noise), "control_hz": 2000.0, "seed": seed}
    moved = sdpid.simulate_closed_loop(TRUTH, way, STIFF, **fed)
    effort = moved.effort
    effort = effort + 0.02 * np.random.default_rng(seed).standard_normal(effort.shape)
    return sdpid.Recording(
        time=moved.time,
        position=moved.measured if noise else moved.position,
        effort=effort,
        joint_names=ARM.joint_names,
        reference=way.sample()[0][: len(moved.time)],
    )


@pytest.fixture(scope="module")
def felt() -> sdpid.Recording:
    return recorded(NOISE)


def problem_of(logs: Any) -> Problem:
    return sdpid.build_problem(ARM, logs, friction=VISCOUS, weighting="residual", processing=OPEN)


def off(base: np.ndarray, problem: Problem) -> float:
    """Return the error of efforts on the motion without noise, as a share of them."""
    samples = sdpid.process(recorded(0.0), OPEN)
    truth = problem.predict(problem.base_of(THETA), samples)
    return float(np.linalg.norm(problem.predict(base, samples) - truth) / np.linalg.norm(truth))


def test_instruments_take_the_bias_of_a_noisy_loop_away(felt: sdpid.Recording) -> None:
    problem = problem_of(felt)
    options: dict[str, Any] = {"processing": OPEN}
    least = sdpid.solve_sdp(problem)
    right = sdpid.solve_instrumental(problem, felt, controller=STIFF, **options)
    assert right.feasible
    assert right.rounds > 1
    assert right.instruments == "the motion of the model in closed loop"
    error = off(least.base, problem)
    assert off(right.base, problem) < 0.3 * error
    # A controller that is 5 % wrong hardly moves the estimate.
    wrong = sdpid.controllers.PD(kp=1.05 * STIFF.kp, kd=1.05 * STIFF.kd)
    other = sdpid.solve_instrumental(problem, felt, controller=wrong, **options)
    assert off(other.base, problem) < 0.3 * error
    # What was commanded may be given beside the log, as a trajectory too.
    bare = replace(felt, reference=None)
    again = sdpid.solve_instrumental(problem, bare, reference=motion(), controller=STIFF, **options)
    np.testing.assert_allclose(again.base, right.base, rtol=1e-3)
    # The test says so, and so it does of the commanded motion.
    for instruments in ("simulated", "reference"):
        test = sdpid.check_bias(least, felt, controller=STIFF, instruments=instruments, **options)
        assert test.biased
        assert test.verdict.startswith("Noise in the motion biases least squares: ")
        assert "sdpid.solve_instrumental, or a lower cut-off" in test.verdict


def test_a_log_without_noise_shows_no_bias() -> None:
    log, options = recorded(0.0), {"processing": OPEN, "instruments": "reference"}
    test = sdpid.check_bias(problem_of(log), log, level=1e-3, **options)
    assert not test.biased
    assert test.shift < 1e-3
    assert test.to_dict()["verdict"] == test.verdict
    assert "does not bias" in test.verdict


def test_identify_tells(felt: sdpid.Recording) -> None:
    options: dict[str, Any] = {"friction": VISCOUS, "effects": "none", "prior": False}
    settings = {"cutoff_hz": 25.0, "reversal_time": None, "decimation": 4}
    result = sdpid.identify(ARM, felt, processing=settings, **options)
    assert result.bias is not None, result.bias_note
    assert result.bias.biased
    assert result.bias.verdict in result.verdict
    assert result.bias.verdict in result.summary()
    assert result.to_dict()["bias"]["biased"] is True
    silent = sdpid.identify(ARM, replace(felt, reference=None), processing=settings, **options)
    assert silent.bias is None
    assert "neither commanded positions nor two periods" in str(silent.bias_note)


def test_a_robot_far_behind_its_commands_is_tested_by_its_model() -> None:
    way = sdpid.paper_excitation("denso_vp6242", seed=0, periods=1, period=10.0)
    log = sdpid.simulate(sdpid.load_robot("denso_vp6242"), way, seed=1)
    processing = sdpid.Processing(cutoff_hz=15.0, decimation=60, covariance=None)
    problem = sdpid.build_problem(
        sdpid.load_robot("denso_vp6242"), log, weighting="residual", processing=processing
    )
    plain = sdpid.check_bias(problem, log, processing=processing, instruments="reference")
    test = sdpid.check_bias(problem, log, processing=processing)
    assert len(plain.weak) > 10
    assert test.instruments == "the motion of the model in closed loop, its controller fitted"
    assert not test.weak
    assert not test.biased
    # Where no controller can be fitted, it says why and what to give.
    other = replace(log, effort=np.roll(log.effort, 3000, axis=0))
    again = sdpid.check_bias(problem, other, processing=processing)
    assert again.weak == plain.weak
    assert "a fitted controller is no better instrument: " in str(again.note)
    assert "Give it, as one of sdpid.controllers" in str(again.note)


@pytest.mark.parametrize("late", [-8, 6])
def test_commands_of_other_times_are_told(felt: sdpid.Recording, late: int) -> None:
    shifted = np.roll(felt.reference, late, axis=0)
    shifted[:late] = felt.reference[0] if late > 0 else shifted[:late]
    problem = problem_of(felt)
    options: dict[str, Any] = {"processing": OPEN, "controller": STIFF}
    found = sdpid.solve_instrumental(problem, felt, reference=shifted, **options)
    told = re.search(r"(lags|runs) ([\d.]+) ms", found.message)
    assert told[1] == ("runs" if late > 0 else "lags")
    assert float(told[2]) == pytest.approx(1e3 * abs(late) / RATE, rel=0.4)
    plain = sdpid.solve_instrumental(problem, felt, **options)
    assert " ms " not in plain.message


def test_rounds_that_do_not_settle_say_how_far_they_are(felt: sdpid.Recording) -> None:
    options: dict[str, Any] = {"processing": OPEN, "controller": STIFF, "tolerance": 1e-9}
    with pytest.raises(SolverError, match=r"not settled after 2 rounds: .* changed by") as caught:
        sdpid.solve_instrumental(problem_of(felt), felt, max_iterations=2, **options)
    assert isinstance(caught.value.found, Estimate)


@pytest.mark.parametrize(("count", "blocks"), [(3, 20), (6, 11)])
def test_block_sums_without_a_mean_are_rejected_as_often_as_stated(count: int, blocks: int) -> None:
    rng = np.random.default_rng(0)
    mixed = rng.standard_normal((count, count))
    found = [hotelling(rng.standard_normal((blocks, count)) @ mixed) for _ in range(2000)]
    rejected = np.mean([each[2] < 0.05 for each in found if each is not None])
    # Three standard deviations of a share of 5 % in 2000.
    assert abs(rejected - 0.05) < 0.015
    shifted = [hotelling(rng.standard_normal((blocks, count)) + 2.0) for _ in range(50)]
    assert all(each is not None and each[2] < 0.05 for each in shifted)
    assert hotelling(np.ones((7, 2))) is None
    assert hotelling(np.zeros((20, 2))) is None


def test_what_cannot_be_an_instrument_is_refused(felt: sdpid.Recording) -> None:
    problem, bare = problem_of(felt), replace(felt, reference=None)

    def refused(match: str, log: Any = felt, **options: Any) -> None:
        given = {"processing": OPEN, **options}
        refuses(DataError, match, sdpid.solve_instrumental, problem, log, **given)

    refused("neither commanded positions nor two periods", bare)
    refused("instruments='reference' needs what was commanded", bare, instruments="reference")
    refused("needs the controller that followed", instruments="simulated")
    refused("controller is 'magic'", controller="magic")
    refused(r"reference: has shape \(10, 2\), expected", bare, reference=np.zeros((10, 2)))
    refused("reference: 2 for 1 recordings", bare, reference=[felt.reference] * 2)
    refused("the trajectory ends after", bare, reference=motion(3.0))
    others = spline_motion(("a", "b"), 3, duration=20.0, rate_hz=RATE)
    refused("reference: moves a, b; the recording has", bare, reference=others)
    runaway = sdpid.controllers.PD(kp=np.full(2, 1e7), kd=np.zeros(2))
    refused("cannot make the model follow the reference", controller=runaway)
    refused("start: is 'magic'", controller=STIFF, start="magic")
    refused("same processing", processing={"cutoff_hz": 5.0})


# ---- Two-stage least squares as an ordinary problem, against its textbook form on dense rows.


SIGMA = np.array([[1.0, 0.3], [0.3, 2.0]])
PRIOR = sdpid.Prior(bodies=arm_theta()[:20].reshape(2, 10))
USED = np.random.default_rng(0).random((1000, 2)) > 0.2


def shaken(samples: Samples, seed: int, size: float = 0.02) -> Samples:
    """Return the samples with noise on their states, the more on the higher derivatives."""
    noise = size * np.random.default_rng(seed).standard_normal((3, *samples.effort.shape))
    return replace(
        samples,
        position=samples.position + noise[0],
        velocity=samples.velocity + 5.0 * noise[1],
        acceleration=samples.acceleration + 20.0 * noise[2],
    )


@pytest.fixture(scope="module")
def clean() -> Samples:
    joined = [moved(arm_theta(), seed, noise=0.05, seconds=10.0) for seed in (1, 2)]
    return replace(Samples.join(joined), block=20, mask=USED, covariance=SIGMA)


@pytest.fixture(scope="module")
def shaken_fit(clean: Samples) -> Problem:
    return sdpid.build_problem(ARM, shaken(clean, 3), friction=FRICTION)


def dense(shaken_fit: Problem, samples: Samples) -> Array:
    """Return whitened rows (K n, b + 1), efforts last."""
    rows = RowSource(ARM, shaken_fit.friction, shaken_fit.base, samples).rows(slice(None))
    return whiten(rows, SIGMA, USED).reshape(-1, shaken_fit.base.count + 1)


def fitted(problem: Problem, instruments: Samples) -> tuple[Array, Array, Array, Array]:
    """Return whitened rows, efforts and instruments, and the fit of instrumental variables."""
    own, Z = dense(problem, problem.samples), dense(problem, instruments)[:, :-1]
    W, y = own[:, :-1], own[:, -1]
    return W, y, Z, np.linalg.solve(Z.T @ W, Z.T @ y)


def test_the_second_stage_is_two_stage_least_squares(shaken_fit: Problem, clean: Samples) -> None:
    instruments = shaken(clean, 4)
    stage = FirstStage(shaken_fit, [paired(shaken_fit, shaken_fit.samples, instruments)])
    found = stage.second_stage("of a test")
    W, y, Z, fit = fitted(shaken_fit, instruments)
    X = Z @ np.linalg.lstsq(Z, W, rcond=None)[0]
    np.testing.assert_allclose(sdpid.solve_wls(found).base, fit, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.A.T @ found.A, X.T @ X, rtol=1e-9, atol=1e-9)
    # Its cost is that of the projected residuals, and the rest of the residuals' at its own fit.
    for base in (fit, 1.1 * fit):
        projected = np.sum((X @ np.linalg.solve(X.T @ X, X.T @ (y - W @ base))) ** 2)
        expected = projected + np.sum((y - W @ fit) ** 2)
        assert found.cost(base) == pytest.approx(expected, rel=1e-9)
    # The sandwich of instruments and residuals; blocks do not cross from piece to piece.
    scores = (X * (y - W @ fit)[:, None]).reshape(-1, 40, X.shape[1]).sum(axis=1)
    inverse = np.linalg.inv(X.T @ X)
    plain = np.sqrt(np.diag(inverse @ scores.T @ scores @ inverse))
    errors = np.sqrt(np.diag(ScoreBlocks.of(found).covariance))
    # Blocks of 20 samples; what is left over of the leverage correction is a few per cent.
    assert np.all((errors > 0.9 * plain) & (errors < 1.5 * plain))
    # Shea's partial R²: the variance of least squares over that with instruments.
    ratio = np.diag(np.linalg.inv(W.T @ W)) / np.diag(inverse)
    np.testing.assert_allclose(stage.relevance, ratio, rtol=1e-6)
    assert stage.weak == ()


def test_block_sums_of_the_test_of_bias_are_corrected_for_leverage(
    shaken_fit: Problem, clean: Samples
) -> None:
    instruments = shaken(clean, 4)
    first = FirstStage(shaken_fit, [paired(shaken_fit, shaken_fit.samples, instruments)])
    found = contrast(first, 20)[0]
    W, y, Z, fit = fitted(shaken_fit, instruments)
    rows = RowSource(ARM, shaken_fit.friction, shaken_fit.base, shaken_fit.samples)
    unseen = rows.regressor(slice(None)) @ fit
    others = rows.on(instruments).regressor(slice(None))
    unseen -= others @ np.linalg.lstsq(Z, W, rcond=None)[0] @ fit
    v = whiten(unseen[:, :, None] * np.eye(2), SIGMA, USED).reshape(-1, 2)
    v -= W @ np.linalg.lstsq(W, v, rcond=None)[0]
    hat = W @ np.linalg.pinv(W)
    residual = y - hat @ y
    plain, freed = [], []
    for start in range(0, len(W), 40):
        rows_of = slice(start, start + 40)
        root = fractional_matrix_power(np.eye(40) - hat[rows_of, rows_of], -0.5).real
        plain.append(v[rows_of].T @ residual[rows_of])
        freed.append(v[rows_of].T @ root @ residual[rows_of])
    np.testing.assert_allclose(found.sum(axis=0), np.sum(plain, axis=0), rtol=1e-6)
    expected = np.array(freed) - np.mean(freed, axis=0)
    np.testing.assert_allclose(found - found.mean(axis=0), expected, rtol=1e-6, atol=1e-6)


def test_two_halves_correct_least_squares_for_their_difference(
    shaken_fit: Problem, clean: Samples
) -> None:
    halves = shaken(clean, 5), replace(shaken(clean, 6), effort=clean.effort[::-1])
    names = ("position", "velocity", "acceleration", "effort")
    means = {name: np.mean([getattr(half, name) for half in halves], axis=0) for name in names}
    mean = replace(clean, **means)
    whole = sdpid.build_problem(ARM, mean, friction=FRICTION, base=shaken_fit.base)
    pairs = [paired(whole, *halves), paired(whole, *halves[::-1])]
    found = FirstStage(whole, pairs).second_stage("of a test")
    A, B = (dense(shaken_fit, half) for half in halves)
    cross = A[:, :-1].T @ B[:, :-1]
    target = B[:, :-1].T @ A[:, -1] + A[:, :-1].T @ B[:, -1]
    fit = np.linalg.solve(cross + cross.T, target)
    np.testing.assert_allclose(sdpid.solve_wls(found).base, fit, rtol=1e-8, atol=1e-10)


def test_constraints_prior_and_proof_are_those_of_any_problem(
    shaken_fit: Problem, clean: Samples
) -> None:
    with_prior = sdpid.build_problem(
        ARM, shaken_fit.samples, friction=FRICTION, weighting="residual", prior=PRIOR
    )
    second = sdpid.solve_instrumental(with_prior, instruments=shaken(clean, 4))
    assert (second.method, second.rounds, second.status) == ("instrumental", 1, "optimal")
    assert second.feasible
    certificate = sdpid.certify(second)
    assert certificate.passed
    assert certificate.summary().startswith("of the problem of the last instruments (the motion")
    again = sdpid.certify(sdpid.solve_instrumental(with_prior, instruments=shaken(clean, 5)))
    digests = [each.to_dict()["origin"]["rows_sha256"] for each in (certificate, again)]
    assert digests[0] != digests[1]
    assert len(sdpid.confidence_intervals(second, method="gauss_markov")) > 0
    assert second.compare_to(sdpid.solve_sdp(with_prior)).table()
    assert "no more" in second.problem._repr_html_()


def test_what_the_data_do_not_show_is_left_to_the_prior(clean: Samples) -> None:
    mask = clean.used.copy()
    mask[:, 1] = False
    own = replace(shaken(clean, 3), mask=mask, covariance=None)
    problem = sdpid.build_problem(ARM, own, friction=FRICTION, weighting="residual", prior=PRIOR)
    second = sdpid.solve_instrumental(problem, instruments=shaken(clean, 4))
    relevance = dict(zip(problem.base.names, second.relevance, strict=True))
    assert relevance["Fv2"] == 0.0
    assert relevance["Fv1"] > 0.8
    assert second.weak == ()


def test_weak_instruments_are_named_and_those_of_another_motion_refused(
    shaken_fit: Problem, clean: Samples
) -> None:
    noisy = shaken(clean, 7, size=0.6)
    second = sdpid.solve_instrumental(shaken_fit, instruments=noisy, solver=sdpid.solve_wls)
    assert second.weak
    assert "weak for" in second.message
    other, words = shaken(clean, 0, size=1e6), "not move with the measured motion"
    refuses(IdentifiabilityError, words, sdpid.solve_instrumental, shaken_fit, instruments=other)


def test_other_problems_are_refused_before_a_solve(shaken_fit: Problem, clean: Samples) -> None:
    second = sdpid.solve_instrumental(shaken_fit, instruments=clean).problem
    robust = sdpid.solve_robust(shaken_fit).problem
    printed = shaken_fit.with_origin(weighting="eq9")
    given = {"instruments": clean}
    for problem, options, words in (
        (shaken_fit.without_rows(), given, "solve_instrumental: the rows of the 1000 samples"),
        (printed, given, "the cost of weighting 'eq9' is that of normal equations"),
        (second, given, "not that of the measured samples"),
        (robust, given, "robust loss"),
        (shaken_fit, {}, "needs the recording that the problem was built of"),
        (shaken_fit, {"instruments": "magic"}, "instruments: is 'magic'"),
        (shaken_fit, {"instruments": clean.between(0, 500)}, "do not stand beside"),
        (shaken_fit, {**given, "max_iterations": 0}, "max_iterations: is 0"),
    ):
        refuses(DataError, words, sdpid.solve_instrumental, problem, **options)


# ---- Output error on simulated logs, whose truth is known.


DRY = ("coulomb", "viscous")
LAW = sdpid.controllers.PD(np.array([300.0, 80.0]), np.array([30.0, 8.0]))
PROCESSING = sdpid.Processing(
    cutoff_hz=25.0, order=4, decimation=4, reversal_time=0.04, reversal_speed=0.05
)


@cache
def truth() -> RobotDynamics:
    robot = sdpid.load_robot(ARM_URDF)
    terms = FrictionModel.from_terms(DRY, robot.joint_names)
    friction = [1.5, 0.6, 2.0, 0.8]
    return RobotDynamics(robot=robot, terms=terms, theta=np.append(robot.prior.ravel(), friction))


@cache
def log(noise: float = 1e-3, seed: int = 0) -> sdpid.Recording:
    t, rng = np.arange(0.0, 8.5, 0.002), np.random.default_rng(5)
    w = np.array([1.3, 2.9, 4.7, 7.1])[:, None, None]
    c = rng.uniform(0.0, 6.0, (4, 1, 2))
    told = 0.35 * np.sin(w * t[:, None] + c).sum(axis=0) * np.minimum(t, 1.0)[:, None] ** 3
    moved = sdpid.simulate_closed_loop(truth(), told, LAW, rate_hz=500.0)
    # The log begins in the midst of the motion.
    rng, later = np.random.default_rng(seed), slice(250, None)
    return sdpid.Recording(
        time=t[later],
        position=(moved.position + noise * rng.standard_normal(told.shape))[later],
        effort=(moved.effort + 0.02 * rng.standard_normal(told.shape))[later],
        reference=told[later],
        joint_names=truth().robot.joint_names,
    )


@cache
def problem(noise: float = 1e-3, seed: int = 0) -> Problem:
    samples = sdpid.process(log(noise, seed), PROCESSING)
    return sdpid.build_problem(
        truth().robot, samples, friction=DRY, weighting="residual",
        constraints=sdpid.Constraints.of_size(truth().robot),
    )  # fmt: skip


def right() -> Any:
    return problem().base_of(truth().theta)


def solve(given: Any = None, **options: Any) -> Any:
    options = {"controller": LAW, "processing": PROCESSING, **options}
    return sdpid.solve_output_error(given or problem(), log(), **options)


@cache
def solved(method: Any = "didim") -> Any:
    return solve(method=method)


def error(estimate: Any) -> float:
    return float(np.linalg.norm(estimate.base - right()) / np.linalg.norm(right()))


@pytest.mark.parametrize("method", ["didim", "closed_loop"])
def test_noise_of_encoders_does_not_bias_it(method: Any) -> None:
    found = solved(method)
    assert (found.status, found.feasible) == ("optimal", True)
    assert error(found) < 0.5 * error(sdpid.solve_sdp(problem()))
    assert np.abs((found.base - right()) / found.standard_errors).max() < 4.0
    assert found.position_error.max() < 5e-4
    certificate = sdpid.certify(found)
    assert certificate.passed
    assert certificate.summary().startswith("of the last linearized problem, and no more: ")
    assert "of the last linearized problem, and no more" in repr(found)
    inside = sdpid.confidence_intervals(found, method="gauss_markov")
    assert np.all(inside.lower < inside.upper)


@pytest.mark.parametrize("method", ["didim", "closed_loop"])
def test_starts_far_away_end_at_the_same_parameters(method: Any) -> None:
    near, rng = solve(method=method, tolerance=1e-4), np.random.default_rng(2)
    theta = truth().theta * (1.0 + 0.6 * rng.uniform(-1.0, 1.0, len(truth().theta)))
    far = solve(method=method, start=theta, tolerance=1e-4)
    assert far.iterations < 10
    off = np.abs(far.base - near.base) / near.standard_errors
    assert off.max() < 0.2
    # Base parameters that no bodies have are replaced by the nearest that bodies have.
    base = right() * (1.0 + 0.5 * rng.uniform(-1.0, 1.0, len(right())))
    projected = solve(method=method, start=base, max_iterations=1, tolerance=1e9)
    assert projected.feasible


def test_costs_of_iterations_are_comparable() -> None:
    theta = truth().theta * np.random.default_rng(4).uniform(0.5, 1.6, len(truth().theta))
    for method in ("didim", "closed_loop"):
        found = solve(method=method, start=theta, tolerance=1e-3)
        costs = np.array([step.cost for step in found.history])
        # Under the last variances of the joints, which those of an iteration differ from.
        assert np.all(np.diff(costs) < 1e-3 * costs[-1])
        assert costs[-1] == pytest.approx(found.cost)
        assert all(step.violation <= 1e-9 for step in found.history)


def test_a_wrong_controller_shifts_all_parameters_of_output_error_alone() -> None:
    wrong = sdpid.controllers.PD(1.05 * LAW.kp, 1.05 * LAW.kd)
    words = r"not that of this log: measured efforts of joint . are 0\.9"
    refuses(DataError, words, solve, method="closed_loop", controller=wrong)
    shifted = solve(method="closed_loop", controller=wrong, controller_tolerance=np.inf)
    exact = solved("closed_loop")
    np.testing.assert_allclose(shifted.base, 1.05 * exact.base, rtol=5e-3, atol=1e-4)
    np.testing.assert_allclose(shifted.effort_ratio, 1.0 / 1.05, rtol=5e-3)
    direct, other = solved(), solve(controller=wrong)
    # By as much as the tracking errors, which the gains decide, are of the motion.
    shift = np.linalg.norm(other.base - direct.base) / np.linalg.norm(direct.base)
    assert shift < 0.01


def twin_of(law: Any, told: Any, rate_hz: float = 500.0, **options: Any) -> Twin:
    """Return a log that is simulated."""
    moved = sdpid.simulate_closed_loop(truth(), told, law, rate_hz=rate_hz, **options)
    own = sdpid.Recording(
        time=moved.time, position=moved.measured, effort=moved.effort, reference=told,
        joint_names=truth().robot.joint_names,
    )  # fmt: skip
    return Twin.of(truth().robot, own, PROCESSING)


def test_noise_that_the_loop_feeds_back_does_not_hide_the_controller() -> None:
    noisy = twin_of(LAW, log().reference, control_hz=2000.0, position_noise=1e-4, seed=3)

    def check(factor: float) -> ControllerCheck:
        law = sdpid.controllers.PD(factor * LAW.kp, factor * LAW.kd)
        return ControllerCheck(ClosedLoop(noisy, law, control_hz=2000.0))

    exact = check(1.0)
    assert exact.misfit.min() > 0.1
    assert np.all(np.abs(exact.ratio - 1.0) < 4.0 * exact.error)
    exact.require(0.03)
    for factor in (0.9, 1.1):
        refuses(DataError, "standard error", check(factor).require, 0.03)


def test_a_controller_with_an_integral_is_checked_too() -> None:
    law = sdpid.controllers.PID(LAW.kp, LAW.kd, np.array([200.0, 60.0]))
    loop = ClosedLoop(twin_of(law, log().reference), law)
    np.testing.assert_allclose(ControllerCheck(loop).ratio, 1.0, atol=1e-3)
    step = 1e-3 * truth().theta
    missed = [
        loop.missed(loop.follow(replace(truth(), theta=truth().theta + k * step))) for k in (-1, 1)
    ]
    slopes = loop.slopes(truth(), problem().base, loop.follow(truth()))
    moved_by, expected = slopes @ problem().base_of(step), 0.5 * (missed[0] - missed[1])
    np.testing.assert_allclose(moved_by, expected, atol=0.02 * np.abs(expected).max())


SOFT = sdpid.controllers.PD(np.array([5.0, 1.0]), np.array([1.0, 1.0]))


@pytest.mark.parametrize(
    ("controller", "change", "words"),
    [
        (SOFT, np.array, "gains are too low, or of another unit .* times those that it"),
        (LAW, np.degrees, "commanded positions are not those of this"),
        (LAW, np.fliplr, "not those of this recording"),
    ],
)
def test_a_start_that_moves_otherwise_is_told_before_a_solve(
    controller: Any, change: Any, words: str
) -> None:
    options = {"controller": controller, "reference": change(log().reference)}

    def never(problem: Problem) -> Any:
        raise AssertionError("solved")

    with pytest.raises(DataError, match=rf"does not follow what was .* \(limit 50 %\): .*{words}"):
        solve(start=truth().theta, solver=never, **options)


def test_a_fitted_controller_serves_where_the_log_shows_it() -> None:
    assert error(solve(controller="fit")) < 2.0 * error(solved()) + 1e-3
    other = replace(log(), reference=np.degrees(log().reference))
    for method, advised in (("didim", False), ("closed_loop", True)):
        with pytest.raises(DataError, match="not known well enough") as caught:
            sdpid.solve_output_error(problem(), other, method=method, processing=PROCESSING)
        assert ("method='didim'" in str(caught.value)) == advised


def test_bad_input_and_other_problems_are_refused() -> None:
    def refused(match: str, given: Any = None, **options: Any) -> None:
        refuses(DataError, match, solve, given, **options)

    refused("method is 'cloe': use 'didim' or 'closed_loop'", method="cloe")
    refused("controller is 'lqr': give one of sdpid.controllers", controller="lqr")
    other = sdpid.controllers.PD(np.ones(3), np.ones(3))
    refused("gains of 3 joints", controller=other)
    refused(r"reference: has shape \(7, 2\)", reference=np.zeros((7, 2)))
    refused(r"start: has shape \(5,\); give an Estimate", start=np.zeros(5))
    refused("at least 1", max_iterations=0)
    refused("give the recordings", processing=sdpid.Processing(cutoff_hz=10.0))
    refused("not that of the measured samples", solved())
    refused("give a Problem", log())
    wild = sdpid.controllers.PD(np.array([8e5, 8e5]), np.array([0.0, 0.0]))
    refuses(SolverError, "diverges under PD", solve, controller=wild, control_hz=50.0)
    robot, samples = problem().robot, problem().samples
    for term, words in (
        (sdpid.friction.LoadFriction(), "friction of the load"),
        (sdpid.friction.Coupling(*robot.joint_names[:2]), "together without a width"),
    ):
        own = sdpid.build_problem(robot, samples, friction=("viscous", term))
        refused(words, own, method="closed_loop")


def test_sensitivities_at_few_instants_are_those_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    told = 0.4 * np.sin(np.arange(0.0, 2.0, 5e-4)[:, None] * [3.0, 7.0])
    loop = ClosedLoop(twin_of(LAW, told, 2000.0), LAW)
    given = truth(), problem().base, loop.follow(truth())
    few = loop.slopes(*given)
    monkeypatch.setattr("sdpid.estimation.closed_loop.loop._LINEARIZED", 5e-4)
    exact = loop.slopes(*given)
    assert 0.0 < np.abs(few - exact).max() < 0.02 * np.abs(exact).max()
