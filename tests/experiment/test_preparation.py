"""Recordings prepared for a robot: what is chosen for them, and other motions beside them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError
from sdpid.experiment.preparation.for_robot import default_friction, friction_of, prepare
from sdpid.experiment.preparation.overview import gaps, noise
from sdpid.experiment.preparation.several import prepare_recordings
from sdpid.experiment.preparation.twin import Twin
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.motion import joint_frequencies
from sdpid.experiment.recording.recording import Recording
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm

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


RATE = 200.0
T = np.arange(2000) / RATE


def test_noise_is_told_from_motion():
    rng = np.random.default_rng(0)
    motion = np.sin(2.0 * np.pi * T)
    for sigma in (1e-4, 1e-2):
        assert noise(motion + rng.normal(0.0, sigma, T.size)) == pytest.approx(sigma, rel=0.1)
    assert noise(motion) < 1e-5
    assert noise(np.zeros(3)) == 0.0


def test_spectrum_of_two_tones():
    column = 3.0 + np.sin(2.0 * np.pi * 2.0 * T) + 0.5 * np.sin(2.0 * np.pi * 8.0 * T)
    position = np.column_stack([column, np.ones_like(column)])
    (dominant, below), still = joint_frequencies(
        Recording(time=T, position=position, effort=position)
    )
    assert dominant == pytest.approx(2.0, abs=0.11)
    assert below == pytest.approx(8.0, abs=0.2)
    assert still is None


def test_gaps_are_counted():
    log = Recording(time=T, position=np.sin(T)[:, None], effort=np.sin(T)[:, None])
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


# Another motion of a recording, aligned row by row with the measured one.


@pytest.fixture(scope="module")
def arm() -> sdpid.RobotModel:
    return small_arm(2)


def moved(time: np.ndarray, slow: float = 1.0) -> np.ndarray:
    """Return a motion with a period of 2 s."""
    angle = np.pi * slow * time
    return np.stack([np.sin(angle) + 0.3 * np.sin(3.0 * angle), np.cos(2.0 * angle)], axis=1)


def recorded(time: np.ndarray, arm: sdpid.RobotModel, **fields: object) -> sdpid.Recording:
    rng = np.random.default_rng(0)
    position = moved(time) + 1e-3 * rng.standard_normal((len(time), 2))
    names = arm.joint_names
    effort = rng.standard_normal((len(time), 2))
    return sdpid.Recording(time=time, position=position, effort=effort, joint_names=names, **fields)


CLOCK = np.arange(2000) / 200.0
JITTERY = CLOCK + 5e-4 * np.random.default_rng(1).uniform(-1.0, 1.0, CLOCK.size)


@pytest.mark.parametrize(
    ("logs", "processing"),
    [
        pytest.param([(CLOCK, {"period": 2.0})], None, id="periods"),
        pytest.param([(CLOCK, {"period": 2.0})], sdpid.Processing.paper(), id="paper"),
        pytest.param([(CLOCK, {})], None, id="one record"),
        # The second piece is too short to be filtered.
        pytest.param([(np.delete(CLOCK, np.r_[600:640, 660:700]), {})], None, id="gaps"),
        pytest.param([(CLOCK, {}), (JITTERY[:1500], {})], {"cutoff_hz": 12.0}, id="several"),
        pytest.param(
            [(JITTERY, {})], sdpid.Processing(timing="resample", decimation=3), id="interpolated"
        ),
    ],
)
def test_a_twin_is_what_processing_that_motion_gives(
    arm: sdpid.RobotModel, logs: list, processing: sdpid.Processing | None
) -> None:
    records = [recorded(time, arm, **fields) for time, fields in logs]
    prepared = prepare_recordings(arm, records, processing)
    twin = Twin.of(arm, records, prepared.processing, measured=prepared.samples)
    measured = twin.measured
    # The measured motion is its own twin, to the last bit.
    same = twin.samples([log.position for log in records])
    # Another motion, with efforts of its own, is what it would be on its own.
    motion = [1.1 * moved(log.time, 0.5 if log.period is None else 1.0) for log in records]
    efforts = [np.cos(q) for q in motion]
    other = twin.samples(motion, effort=efforts)
    alone = prepare_recordings(
        arm,
        [
            replace(log, position=q, effort=e)
            for log, q, e in zip(records, motion, efforts, strict=True)
        ],
        prepared.processing,
    ).samples
    for name in ("position", "velocity", "acceleration", "effort"):
        np.testing.assert_array_equal(getattr(same, name), getattr(measured, name))
        np.testing.assert_allclose(getattr(other, name), getattr(alone, name), atol=1e-12)
    if measured.wide is not None:
        for mine, theirs in zip(other.wide, alone.wide, strict=True):
            np.testing.assert_allclose(mine.velocity, theirs.velocity, atol=1e-12)
    # What is not motion is the measurement's.
    for name in ("mask", "covariance", "time", "block", "starts", "periods", "notes"):
        np.testing.assert_array_equal(getattr(other, name), getattr(measured, name))
    assert (same.effort_periods is None) == (measured.effort_periods is None)
    assert other.effort_periods is None


def test_a_measured_velocity_is_replaced_too(arm: sdpid.RobotModel) -> None:
    time = np.arange(900) / 30.0
    log = replace(recorded(time, arm), velocity=np.gradient(moved(time), time, axis=0))
    twin = Twin.of(arm, log)
    assert twin.processing.velocity == "measured"
    motion = moved(time, 0.5)
    rate = np.gradient(motion, time, axis=0, edge_order=2)
    given, splined = twin.samples(motion, velocity=rate), twin.samples(motion)
    assert np.abs(given.velocity - splined.velocity).max() < 0.02
    assert np.abs(splined.velocity - twin.measured.velocity).max() > 1.0


def test_what_does_not_belong_together_is_refused(arm: sdpid.RobotModel) -> None:
    log = recorded(CLOCK, arm)
    samples = sdpid.process(log, {"cutoff_hz": 10.0})
    with pytest.raises(DataError, match=r"recording: its position, processed.*same processing"):
        Twin.of(arm, log, {"cutoff_hz": 9.0, "decimation": 2}, measured=of_another_cut_off(log))
    with pytest.raises(DataError, match=r"is processed to .* samples, the problem's pieces have"):
        Twin.of(arm, log, {"decimation": 7}, measured=samples)
    twin = Twin.of(arm, log, {"cutoff_hz": 10.0}, measured=samples)
    assert repr(twin).startswith("Twin(1 recordings of ")
    with pytest.raises(DataError, match=r"position: has shape \(10, 2\), expected \(2000, 2\)"):
        twin.samples(np.zeros((10, 2)))
    with pytest.raises(DataError, match="position: has 2 arrays for 1 recordings"):
        twin.samples([log.position, log.position])
    refuses(DataError, "position", twin.samples, np.full((2000, 2), np.nan))


def of_another_cut_off(log: sdpid.Recording) -> sdpid.Samples:
    """Return samples of another cut-off with as many samples."""
    trimmed = sdpid.process(log, {"cutoff_hz": 9.0, "decimation": 2})
    trim = float(trimmed.time[0])
    return sdpid.process(log, {"cutoff_hz": 10.0, "decimation": 2, "trim_s": trim})
