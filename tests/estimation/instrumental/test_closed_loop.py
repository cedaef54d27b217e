"""Instruments from a closed loop whose encoders are noisy, and the test of bias on its logs."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError, SolverError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.instrumental.hausman import Hotelling
from sdpid.estimation.problem import Problem
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics
from tests.helpers.data import random_theta
from tests.helpers.motions import spline_motion
from tests.helpers.robots import small_arm

ARM = small_arm(2)
FRICTION = ("viscous",)
THETA = random_theta(ARM, np.random.default_rng(7), FRICTION)
TRUTH = RobotDynamics(
    robot=ARM, terms=FrictionModel.from_terms(FRICTION, ARM.joint_names), theta=THETA
)
LAW = sdpid.controllers.PD(kp=np.array([400.0, 60.0]), kd=np.array([30.0, 5.0]))
RATE = 200.0

# Of the encoders, rad.
NOISE = 5e-5

# High enough to let the noise in.
PROCESSING = sdpid.Processing(cutoff_hz=25.0, order=4, reversal_time=None, decimation=4)


def motion(seconds: float = 20.0) -> Trajectory:
    return spline_motion(ARM.joint_names, 3, duration=seconds, size=1.0, rate_hz=RATE)


def recorded(noise: float, seed: int = 0, seconds: float = 20.0) -> sdpid.Recording:
    """Return a log of a loop that feeds the noise of its encoders (rad) back."""
    way, fed = motion(seconds), {}
    if noise:
        fed = {"position_noise": np.full(2, noise), "control_hz": 2000.0, "seed": seed}
    moved = sdpid.simulate_closed_loop(TRUTH, way, LAW, **fed)
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
def noisy() -> sdpid.Recording:
    return recorded(NOISE)


def problem_of(logs: Any) -> Problem:
    return sdpid.build_problem(
        ARM, logs, friction=FRICTION, weighting="residual", processing=PROCESSING
    )


def off(base: np.ndarray, problem: Problem) -> float:
    """Return the error of efforts on the motion without noise, as a share of them."""
    samples = sdpid.process(recorded(0.0), PROCESSING)
    truth = problem.predict(problem.base_of(THETA), samples)
    return float(np.linalg.norm(problem.predict(base, samples) - truth) / np.linalg.norm(truth))


def test_instruments_take_the_bias_of_a_noisy_loop_away(noisy: sdpid.Recording) -> None:
    problem = problem_of(noisy)
    options: dict[str, Any] = {"processing": PROCESSING}
    least = sdpid.solve_sdp(problem)
    right = sdpid.solve_instrumental(problem, noisy, controller=LAW, **options)
    assert right.feasible
    assert right.rounds > 1
    assert right.instruments == "the motion of the model in closed loop"
    error = off(least.base, problem)
    assert off(right.base, problem) < 0.3 * error
    # A controller that is 5 % wrong hardly moves the estimate.
    wrong = sdpid.controllers.PD(kp=1.05 * LAW.kp, kd=1.05 * LAW.kd)
    other = sdpid.solve_instrumental(problem, noisy, controller=wrong, **options)
    assert off(other.base, problem) < 0.3 * error
    # What was commanded may be given beside the log, as a trajectory too.
    bare = replace(noisy, reference=None)
    again = sdpid.solve_instrumental(problem, bare, reference=motion(), controller=LAW, **options)
    np.testing.assert_allclose(again.base, right.base, rtol=1e-3)
    # The test says so, and so it does of the commanded motion.
    for instruments in ("simulated", "reference"):
        test = sdpid.check_bias(least, noisy, controller=LAW, instruments=instruments, **options)
        assert test.biased
        assert test.verdict.startswith("Noise in the motion biases least squares: ")
        assert "sdpid.solve_instrumental, or a lower cut-off" in test.verdict


def test_several_recordings_have_one_estimate(noisy: sdpid.Recording) -> None:
    logs = [noisy, recorded(NOISE, 1, 15.0)]
    problem = problem_of(logs)
    second = sdpid.solve_instrumental(problem, logs, processing=PROCESSING, controller=LAW)
    assert off(second.base, problem) < 0.3 * off(sdpid.solve_sdp(problem).base, problem)


def test_a_log_without_noise_shows_no_bias() -> None:
    log = recorded(0.0)
    test = sdpid.check_bias(
        problem_of(log), log, processing=PROCESSING, instruments="reference", level=1e-3
    )
    assert not test.biased
    assert test.shift < 1e-3
    assert test.to_dict()["verdict"] == test.verdict
    assert "does not bias" in test.verdict


def test_identify_tells(noisy: sdpid.Recording) -> None:
    options: dict[str, Any] = {"friction": FRICTION, "effects": "none", "prior": False}
    settings = {"cutoff_hz": 25.0, "reversal_time": None, "decimation": 4}
    result = sdpid.identify(ARM, noisy, processing=settings, **options)
    assert result.bias is not None, result.bias_note
    assert result.bias.biased
    assert result.bias.verdict in result.verdict
    assert result.bias.verdict in result.summary()
    assert result.to_dict()["bias"]["biased"] is True
    silent = sdpid.identify(ARM, replace(noisy, reference=None), processing=settings, **options)
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
    assert len(plain.weak) > 10
    test = sdpid.check_bias(problem, log, processing=processing)
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
def test_commands_of_other_times_are_told(noisy: sdpid.Recording, late: int) -> None:
    shifted = np.roll(noisy.reference, late, axis=0)
    shifted[:late] = noisy.reference[0] if late > 0 else shifted[:late]
    problem = problem_of(noisy)
    options: dict[str, Any] = {"processing": PROCESSING, "controller": LAW}
    found = sdpid.solve_instrumental(problem, noisy, reference=shifted, **options)
    told = re.search(r"(lags|runs) ([\d.]+) ms", found.message)
    assert told is not None
    assert told[1] == ("runs" if late > 0 else "lags")
    assert float(told[2]) == pytest.approx(1e3 * abs(late) / RATE, rel=0.4)
    plain = sdpid.solve_instrumental(problem, noisy, **options)
    assert " ms " not in plain.message


def test_rounds_that_do_not_settle_say_how_far_they_are(noisy: sdpid.Recording) -> None:
    options: dict[str, Any] = {"processing": PROCESSING, "controller": LAW, "max_iterations": 2}
    with pytest.raises(SolverError, match=r"not settled after 2 rounds: .* changed by") as caught:
        sdpid.solve_instrumental(problem_of(noisy), noisy, tolerance=1e-9, **options)
    assert isinstance(caught.value.found, Estimate)


@pytest.mark.parametrize(("count", "blocks"), [(3, 20), (6, 11)])
def test_block_sums_without_a_mean_are_rejected_as_often_as_stated(count: int, blocks: int) -> None:
    rng = np.random.default_rng(0)
    mixed = rng.standard_normal((count, count))
    found = [Hotelling.of(rng.standard_normal((blocks, count)) @ mixed) for _ in range(2000)]
    rejected = np.mean([each.p < 0.05 for each in found if each is not None])
    # Three standard deviations of a share of 5 % in 2000.
    assert abs(rejected - 0.05) < 0.015
    shifted = [Hotelling.of(rng.standard_normal((blocks, count)) + 2.0) for _ in range(50)]
    assert all(each is not None and each.p < 0.05 for each in shifted)
    assert Hotelling.of(np.ones((7, 2))) is None
    assert Hotelling.of(np.zeros((20, 2))) is None


def test_what_cannot_be_an_instrument_is_refused(noisy: sdpid.Recording) -> None:
    problem, bare = problem_of(noisy), replace(noisy, reference=None)

    def refused(match: str, log: Any = noisy, **options: Any) -> None:
        with pytest.raises(DataError, match=match):
            sdpid.solve_instrumental(problem, log, processing=PROCESSING, **options)

    refused("neither commanded positions nor two periods", bare)
    refused("instruments='reference' needs what was commanded", bare, instruments="reference")
    refused("needs the controller that followed", instruments="simulated")
    refused("controller is 'magic'", controller="magic")
    refused(r"reference: has shape \(10, 2\), expected", bare, reference=np.zeros((10, 2)))
    refused("reference: 2 for 1 recordings", bare, reference=[noisy.reference] * 2)
    refused("the trajectory ends after", bare, reference=motion(3.0))
    others = spline_motion(("a", "b"), 3, duration=20.0, rate_hz=RATE)
    refused("reference: moves a, b; the recording has", bare, reference=others)
    runaway = sdpid.controllers.PD(kp=np.full(2, 1e7), kd=np.zeros(2))
    refused("cannot make the model follow the reference", controller=runaway)
    refused("start: is 'magic'", controller=LAW, start="magic")
    with pytest.raises(DataError, match="same processing"):
        sdpid.solve_instrumental(problem, noisy, processing={"cutoff_hz": 5.0})
