"""Output error on simulated logs, whose truth is known."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError, SolverError
from sdpid.estimation.closed_loop.loop import ClosedLoop, ControllerCheck
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.twin import Twin
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.refusals import refuses

FRICTION = ("coulomb", "viscous")
LAW = sdpid.controllers.PD(np.array([300.0, 80.0]), np.array([30.0, 8.0]))
PROCESSING = sdpid.Processing(
    cutoff_hz=25.0, order=4, decimation=4, reversal_time=0.04, reversal_speed=0.05
)


@cache
def truth() -> RobotDynamics:
    robot = sdpid.load_robot(ARM_URDF)
    terms = FrictionModel.from_terms(FRICTION, robot.joint_names)
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
        truth().robot, samples, friction=FRICTION, weighting="residual",
        constraints=sdpid.Constraints.of_size(truth().robot),
    )  # fmt: skip


def right() -> Any:
    return problem().base_of(truth().theta)


def solve(**options: Any) -> Any:
    options = {"controller": LAW, "processing": PROCESSING, **options}
    return sdpid.solve_output_error(problem(), log(), **options)


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


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "cloe"}, "method is 'cloe': use 'didim' or 'closed_loop'"),
        ({"controller": "lqr"}, "controller is 'lqr': give one of sdpid.controllers"),
        ({"controller": sdpid.controllers.PD(np.ones(3), np.ones(3))}, "gains of 3 joints"),
        ({"reference": np.zeros((7, 2))}, r"reference: has shape \(7, 2\)"),
        ({"start": np.zeros(5)}, r"start: has shape \(5,\); give an Estimate"),
        ({"max_iterations": 0}, "at least 1"),
        ({"processing": sdpid.Processing(cutoff_hz=10.0)}, "give the recordings"),
    ],
)
def test_bad_input_is_told_before_a_solve(options: Any, message: str) -> None:
    refuses(DataError, message, solve, **options)


def test_other_problems_and_divergence_are_told() -> None:
    with pytest.raises(DataError, match="not that of the measured samples"):
        sdpid.solve_output_error(solved(), log(), controller=LAW)
    refuses(DataError, "give a Problem", sdpid.solve_output_error, log(), log())
    wild = sdpid.controllers.PD(np.array([8e5, 8e5]), np.array([0.0, 0.0]))
    refuses(SolverError, "diverges under PD", solve, controller=wild, control_hz=50.0)


@pytest.mark.parametrize(
    ("term", "words"),
    [(sdpid.friction.LoadFriction(), "friction of the load"), (None, "together without a width")],
)
def test_friction_without_derivatives_is_refused(term: Any, words: str) -> None:
    first = problem()
    names = first.robot.joint_names
    chosen = ("viscous", term or sdpid.friction.Coupling(*names[:2]))
    own = sdpid.build_problem(first.robot, first.samples, friction=chosen)
    with pytest.raises(DataError, match=words):
        sdpid.solve_output_error(own, log(), method="closed_loop", controller=LAW)


def test_sensitivities_at_few_instants_are_those_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    told = 0.4 * np.sin(np.arange(0.0, 2.0, 5e-4)[:, None] * [3.0, 7.0])
    loop = ClosedLoop(twin_of(LAW, told, 2000.0), LAW)
    given = truth(), problem().base, loop.follow(truth())
    few = loop.slopes(*given)
    monkeypatch.setattr("sdpid.estimation.closed_loop.loop._LINEARIZED", 5e-4)
    exact = loop.slopes(*given)
    assert 0.0 < np.abs(few - exact).max() < 0.02 * np.abs(exact).max()
