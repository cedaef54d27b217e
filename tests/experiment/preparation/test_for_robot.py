"""Defaults chosen from a recording, and what they predict on five real robots."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid.experiment.preparation.for_robot import default_friction, friction_of, prepare
from sdpid.experiment.processing.choose import default_processing

# Relative residual in % that default settings must reach on motion that was not trained on.
TARGETS = {
    "ur10_unisa/ur10": (("ur10_exciting",), 7.7),
    "panda_unisa/panda": (("panda_exciting",), 1.80),
    "kuka_lwr4plus/kuka_lwr4": (("measurements_1", "measurements_2"), 2.7),
    "staubli_tx40/tx40": (("tx40_rows_0_24750",), 7.0),
    "kinova_gen3_dynamapp/gen3": (("opti_traj_testing1", "opti_traj_testing2"), 16.0),
}

# The user's own knowledge: the TX40's efforts are those of motors, two of which share joints.
WRIST = ("rotor_inertia", sdpid.friction.Coupling("joint_5", "joint_6", width=0.05))


def sine(rate: float, seconds: float, hertz: float, joints: int = 2) -> sdpid.Recording:
    time = np.arange(round(rate * seconds)) / rate
    position = np.sin(2.0 * np.pi * hertz * time)[:, None] * np.ones(joints)
    return sdpid.Recording(time=time, position=position, effort=position)


def first(log: sdpid.Recording, count: int) -> sdpid.Recording:
    velocity = None if log.velocity is None else log.velocity[:count]
    cut = {"time": log.time[:count], "position": log.position[:count]}
    return replace(log, **cut, effort=log.effort[:count], velocity=velocity)


def test_the_cut_off_follows_the_motion() -> None:
    slow = default_processing(sine(1000.0, 20.0, 0.5))
    # 95 % of a windowed sine lie below its frequency and one or two steps of the spectrum, 0.05 Hz.
    assert 25.0 * 0.5 <= slow.cutoff_hz <= 25.0 * 0.61
    assert (slow.order, slow.derivative, slow.velocity) == (4, "central4", "differentiated")
    assert slow.reversal_time == pytest.approx(0.1 / slow.cutoff_hz)
    fast = default_processing(sine(1000.0, 20.0, 10.0))
    assert fast.cutoff_hz == pytest.approx(1000.0 / 7.5)


def test_default_among_friction_terms_stands_for_the_default_ones() -> None:
    log = sine(100.0, 10.0, 0.5)
    usual = default_friction(log)
    assert friction_of(log, None) == friction_of(log, ("default",)) == usual
    assert friction_of(log, ("default", "stribeck")) == (*usual, "stribeck")
    assert friction_of(log, ("viscous",)) == ("viscous",)


def test_what_stands_still_has_no_cut_off() -> None:
    log = sine(100.0, 10.0, 0.5)
    with pytest.raises(sdpid.errors.DataError, match="no joint moves"):
        default_processing(replace(log, position=np.ones_like(log.position)))


@pytest.mark.parametrize(("rate", "expected"), [(30.0, "measured"), (200.0, "differentiated")])
def test_a_measured_velocity_serves_at_low_rates(rate: float, expected: str) -> None:
    log = sine(rate, 20.0, 0.2)
    velocity = np.gradient(log.position, log.time, axis=0)
    assert default_processing(replace(log, velocity=velocity)).velocity == expected
    # What is no velocity of these positions does not serve.
    wrong = default_processing(replace(log, velocity=log.position))
    assert wrong.velocity == "differentiated"
    assert default_processing(log).velocity == "differentiated"


def test_friction_of_records_with_and_without_periods() -> None:
    log = sine(100.0, 10.0, 0.5)
    assert default_friction(replace(log, period=2.0)) == ("coulomb", "viscous")
    sign, sigmoid, *others = default_friction(log)
    assert sign == sdpid.friction.Coulomb(width=0.005)
    assert sigmoid == sdpid.friction.SigmoidFriction(velocity=None)
    assert others == ["viscous", "offset"]


def test_a_joint_that_rests_does_not_stop_the_default() -> None:
    robot = sdpid.load_robot("denso_vp6242")
    robot = replace(robot, prior=np.tile([3.0, 0, 0, 0.3, 0.1, 0, 0.1, 0, 0, 0.1], (6, 1)))
    time = np.arange(0.0, 20.0, 0.01)
    phase = time[:, None] * np.array([1.0, 1.3, 1.7, 0.0, 2.1, 2.6])
    state = np.sin(phase), np.gradient(np.sin(phase), 0.01, axis=0)
    effort = robot.inverse_dynamics(robot.prior, *state, np.gradient(state[1], 0.01, axis=0))
    effort += 2.0 * np.tanh(state[1] / 0.3)
    log = sdpid.Recording(time=time, position=state[0], effort=effort)
    result = sdpid.identify(robot, log)
    assert result.certificate.passed
    assert result.training.relative < 0.01


@pytest.mark.parametrize("case", TARGETS)
def test_held_out_motion_of_real_robots(data_folder: Path, case: str) -> None:
    runs, target = TARGETS[case]
    urdf = data_folder / f"{case}.urdf"
    logs = [sdpid.read_recording(urdf.parent / f"{run}.npz") for run in runs]
    log, other = logs[0], logs[-1]
    if len(logs) == 1:
        log = first(log, round(0.6 * log.n_samples))
    robot = sdpid.load_robot(urdf)
    friction = (*default_friction(log), *(WRIST if "tx40" in case else ()))
    # Everything is chosen from, and only from, what is trained on.
    result = sdpid.identify(robot, log, friction=friction)
    fresh = prepare(robot, other, default_processing(log))
    if len(logs) == 1:
        assert fresh.time is not None
        begin = int(np.searchsorted(fresh.time, log.time[-1], side="right"))
        fresh = fresh.between(begin, fresh.n_samples)
    assert result.certificate.passed
    assert 100.0 * sdpid.validate(result.estimate, fresh).relative <= target
