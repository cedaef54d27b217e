from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.experiment.overview import overview
from sdpid.experiment.recording import Recording
from sdpid.experiment.signals import bandwidth, gaps, noise, signal_warnings

RATE = 200.0
T = np.arange(2000) / RATE


@pytest.fixture(scope="module")
def robot() -> sdpid.RobotModel:
    return sdpid.load_robot("ur_description/ur5_robot")


@pytest.fixture(scope="module")
def log(robot: sdpid.RobotModel) -> Recording:
    """A slow motion, efforts as the description says."""
    rate = 2.0 * np.pi * np.linspace(0.2, 0.5, robot.n)
    swing = 0.5 * np.sin(rate * T[:, None])
    # Half raised, where the torque of gravity follows the angle.
    position = swing - 1.2
    velocity = 0.5 * rate * np.cos(rate * T[:, None])
    effort = robot.inverse_dynamics(robot.prior, position, velocity, -(rate**2) * swing)
    return Recording(
        time=T,
        position=position,
        effort=effort,
        velocity=velocity,
        joint_names=robot.joint_names,
    )


def changed(log: Recording, quantity: str, j: int, factor: float) -> Recording:
    values = getattr(log, quantity).copy()
    values[:, j] *= factor
    return replace(log, **{quantity: values})


def test_noise_is_told_from_motion():
    rng = np.random.default_rng(0)
    motion = np.sin(2.0 * np.pi * T)
    for sigma in (1e-4, 1e-2):
        assert noise(motion + rng.normal(0.0, sigma, T.size)) == pytest.approx(sigma, rel=0.1)
    assert noise(motion) < 1e-5
    assert noise(np.zeros(3)) == 0.0


def test_spectrum_of_two_tones():
    column = 3.0 + np.sin(2.0 * np.pi * 2.0 * T) + 0.5 * np.sin(2.0 * np.pi * 8.0 * T)
    dominant, below = bandwidth(column, RATE)
    assert dominant == pytest.approx(2.0, abs=0.11)
    assert below == pytest.approx(8.0, abs=0.2)
    assert bandwidth(np.ones(9), RATE) is None


def test_gaps_are_counted(log: Recording):
    assert gaps(log)["gaps"] == 0
    keep = np.ones(T.size, dtype=bool)
    keep[100:103] = keep[500:502] = False
    holed = replace(
        log,
        time=T[keep],
        position=log.position[keep],
        effort=log.effort[keep],
        velocity=None,
    )
    found = gaps(holed)
    assert (found["gaps"], found["longest_step_row"]) == (2, 100)
    assert found["longest_step_s"] == pytest.approx(4.0 / RATE)


def test_what_is_right_raises_no_alarm(log: Recording, robot: sdpid.RobotModel):
    assert signal_warnings(log, robot) == []
    facts = overview(log, robot)
    assert facts["warnings"] == []
    assert facts["joints"][0]["motion_hz"] == pytest.approx(0.2, abs=0.06)


@pytest.mark.parametrize(
    ("quantity", "factor", "words"),
    [
        ("velocity", 180.0 / np.pi, "57.3 times the rate of its position (deg instead of rad)"),
        ("velocity", 30.0 / np.pi, "(rpm instead of rad/s)"),
        ("velocity", -1.0, "velocity of {} has the sign opposite"),
        ("velocity", 1e3, "(a factor of 1000: time or velocity in thousandths)"),
        ("effort", 1e-2, "effort of {} is 0.0119 times the gravity"),
        ("effort", 1e3, "times the gravity it should bear: currents"),
        ("effort", -1.0, "effort of {} has the sign opposite to the gravity"),
        ("effort", 0.0, "effort of {} never changes"),
        ("position", 0.0, "{} never moves"),
        ("position", 50.0, "rad/s: an outlier, or wrong units"),
    ],
)
def test_slips_are_named(
    log: Recording, robot: sdpid.RobotModel, quantity: str, factor: float, words: str
):
    wrong = changed(log, quantity, 1, factor)
    if quantity == "position" and factor:
        position = log.position.copy()
        position[700, 1] += 0.7
        wrong = replace(log, position=position)
    warnings = signal_warnings(wrong, robot)
    assert any(words.format(log.names[1]) in warning for warning in warnings), warnings


def test_wrapped_angles_are_named(log: Recording):
    turning = np.angle(np.exp(1j * 4.0 * np.pi * 0.2 * T))[:, None]
    wrapped = Recording(time=T, position=turning, effort=log.effort[:, 1:2])
    (warning,) = signal_warnings(wrapped)
    assert "position of 1 jumps by 6.27" in warning
    assert warning.endswith("the angle wraps")


ROBOTS = {
    "kinova_gen3_dynamapp": ("opti_traj_testing1", "gen3"),
    "kuka_lwr4plus": ("measurements_1", "kuka_lwr4"),
    "panda_unisa": ("panda_exciting", "panda"),
    "staubli_tx40": ("tx40_rows_0_24750", "tx40"),
    "ur10_unisa": ("ur10_exciting", "ur10"),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_real_logs_raise_no_alarm(data_folder, name: str):
    log, urdf = ROBOTS[name]
    record = sdpid.read_recording(data_folder / name / f"{log}.npz")
    robot = sdpid.load_robot(data_folder / name / f"{urdf}.urdf")
    assert [w for w in overview(record, robot)["warnings"] if "named differently" not in w] == []
