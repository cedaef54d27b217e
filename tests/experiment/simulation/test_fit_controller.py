"""Gains of controllers from logs of loops whose gains are known."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.controllers import PD, PID, ComputedTorque, P, fit_controller
from sdpid.errors import DataError
from sdpid.experiment.plant.drives import load_drives
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics
from tests.helpers.refusals import refuses

RATE = 500.0
T = np.arange(0.0, 12.0, 1.0 / RATE)
# Kinds by their laws; the third argument of computed torque is a model with other friction.
KP, KD = np.array([900.0, 300.0]), np.array([60.0, 12.0])
LAWS = {
    "p": P(np.array([6.0, 9.0]), KD),
    "pd": PD(KP, KD),
    "pd damped": PD(KP, KD, feedforward=False),
    "pid": PID(KP, 3.0 * KP, KD),
}


@pytest.fixture(scope="module")
def model() -> RobotDynamics:
    robot = sdpid.RobotModel.from_mdh(
        [{"r": 0.3, "alpha": 0.4}, {"alpha": -np.pi / 2, "d": 0.4}], name="arm"
    )
    links = []
    for mass, center in ((12.0, [0.1, 0.02, 0.0]), (5.0, [0.05, 0.0, 0.15])):
        c = np.array(center)
        spread = 0.04 * mass * np.eye(3) + mass * (c @ c * np.eye(3) - np.outer(c, c))
        xx, xy, xz, yy, yz, zz = spread[np.triu_indices(3)]
        links += [mass, *(mass * c), xx, xy, yy, xz, yz, zz]
    theta = np.array([*links, 4.0, 2.0, 3.0, 1.5])
    terms = FrictionModel.from_terms(("coulomb", "viscous"), robot.joint_names)
    return RobotDynamics(robot=robot, terms=terms, theta=theta)


def logged(
    model: RobotDynamics, law: Any, *, noise: float = 1e-5, seen: bool = False, seed: int = 0
) -> sdpid.Recording:
    """Return a log with noise on positions, which the controller saw or not, and on efforts."""
    rng = np.random.default_rng(seed)
    omega = 2.0 * np.pi * np.array([[0.21, 0.43], [0.64, 0.33]])
    told = 0.5 * sum(np.sin(np.outer(T, w) + k) for k, w in enumerate(omega))
    loop = {"control_hz": RATE, "position_noise": noise, "seed": seed} if seen else {}
    moved = sdpid.simulate_closed_loop(model, told, law, rate_hz=RATE, **loop)
    white = rng.standard_normal((2, *told.shape))
    return sdpid.Recording(
        time=moved.time,
        position=moved.measured if seen else moved.position + noise * white[0],
        effort=moved.effort + 0.01 * moved.effort.std(axis=0) * white[1],
        reference=told,
        joint_names=model.robot.joint_names,
    )


@pytest.mark.parametrize("name", LAWS)
def test_gains_are_found_within_their_deviations(model: RobotDynamics, name: str):
    law, kind = LAWS[name], name.split()[0]
    fitted = fit_controller(logged(model, law), kind)
    assert fitted.usable, fitted.reasons
    assert type(fitted.require()) is type(law)
    assert fitted.feedforward == law.feedforward
    for gain, found in fitted.gains.items():
        off = np.abs(found / getattr(law, gain) - 1.0)
        # The integral of the simulated loop is a step of 1 ms ahead.
        assert np.all(off < 4.0 * fitted.deviations[gain] + (4e-3 if name == "pid" else 1e-3))
        assert np.all(off < 0.03)


def test_deviations_are_those_of_many_logs(model: RobotDynamics):
    law = LAWS["pd"]
    log = logged(model, law, noise=0.0)
    rng = np.random.default_rng(4)
    scores = []
    for _ in range(30):
        noisy = log.position + 1e-3 * rng.standard_normal(log.position.shape)
        efforts = log.effort + 0.02 * log.effort.std(axis=0) * rng.standard_normal(noisy.shape)
        fitted = fit_controller(replace(log, position=noisy, effort=efforts), "pd")
        for gain, found in fitted.gains.items():
            scores.append((found / getattr(law, gain) - 1.0) / fitted.deviations[gain])
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.6


def test_noise_that_the_controller_saw_does_no_harm(model: RobotDynamics):
    fitted = fit_controller(logged(model, LAWS["pd"], noise=1e-4, seen=True), "pd")
    assert fitted.usable
    # The loop holds its efforts for 2 ms, and takes velocities from differences: another law.
    np.testing.assert_allclose(fitted.gains["kp"], KP, rtol=0.03)
    np.testing.assert_allclose(fitted.gains["kd"], KD, rtol=0.1)


def test_much_noise_is_told_and_refused(model: RobotDynamics):
    fitted = fit_controller(logged(model, LAWS["pd"], noise=0.1), "pd")
    assert fitted.method == "instrumental"
    assert fitted.bias.max() > 0.02
    assert not fitted.usable
    refuses(DataError, r"not known well enough: .*(deviation of|explains)", fitted.require)


@pytest.mark.parametrize(("name", "kind"), [("pid", "pd"), ("pid", "p"), ("p", "computed_torque")])
def test_other_kinds_are_refused(model: RobotDynamics, name: str, kind: str):
    of_model = {"model": model} if kind == "computed_torque" else {}
    fitted = fit_controller(logged(model, LAWS[name]), kind, **of_model)
    assert not fitted.usable
    if name == "pid":
        assert "fit kind='pid'" in fitted.reasons[-1]


def test_computed_torque_by_a_model_that_is_not_the_robot(model: RobotDynamics):
    heavier = replace(model, theta=np.concatenate([1.3 * model.theta[:-4], 0.5 * model.theta[-4:]]))
    law = ComputedTorque(heavier, kp=np.full(2, 80.0), kd=np.full(2, 14.0))
    log = logged(model, law)
    fitted = fit_controller(log, "computed_torque", model=heavier)
    assert fitted.usable, fitted.reasons
    np.testing.assert_allclose(fitted.gains["kp"], 80.0, rtol=0.02)
    np.testing.assert_allclose(fitted.gains["kd"], 14.0, rtol=0.1)
    assert not fit_controller(log, "pd").usable


def test_the_loop_of_the_simulated_robot_is_found():
    robot, drives = sdpid.load_robot("denso_vp6242"), load_drives("denso_vp6242")
    motion = sdpid.paper_excitation("denso_vp6242", seed=0, periods=1, period=10.0)
    fitted = fit_controller(sdpid.simulate(robot, motion, seed=1), "p")
    assert fitted.usable
    # Joint 6 is the noisiest: its deviations are some percent.
    for gain, rtol in (("proportional_gain", 2e-3), ("velocity_gain", 5e-3)):
        found = fitted.gains[gain]
        np.testing.assert_allclose(found[:5], getattr(drives, gain)[:5], rtol=rtol)
        assert abs(found[5] / getattr(drives, gain)[5] - 1.0) < 4.0 * fitted.deviations[gain][5]
    assert fitted.to_dict()["usable"] is True
    assert "usable" in fitted.describe()
    assert len(repr(fitted)) < 160
    assert "<table" in fitted._repr_html_()


def test_what_cannot_be_fitted_is_told_before(model: RobotDynamics):
    log = logged(model, LAWS["pd"])
    wrong: list[tuple[Any, str]] = [
        (lambda: fit_controller(log, "lqr"), "'lqr' is not known; known are p, pd"),
        (lambda: fit_controller(replace(log, reference=None)), "no commanded positions"),
        (lambda: fit_controller(replace(log, currents=True)), "efforts are currents in A"),
        (lambda: fit_controller(log, "computed_torque"), "needs the model"),
        (lambda: fit_controller(log, cutoff_hz=400.0), "expected at most 50 Hz"),
        (
            lambda: fit_controller(
                sdpid.Recording(**{k: getattr(log, k)[:400] for k in (
                    "time", "position", "effort", "reference")})
            ),
            "at least 200 are needed",
        ),
    ]  # fmt: skip
    for call, words in wrong:
        refuses(DataError, words, call)
