"""Late channels of legged robots are found to 1 ms, and none where there is none."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sdpid
from sdpid import Recording
from sdpid.experiment.inspection.delays.dynamic import FreeRows, first_scale
from sdpid.experiment.inspection.delays.find import channel_delays
from sdpid.experiment.inspection.delays.lag import lag
from sdpid.experiment.inspection.inspect import inspect_recordings
from sdpid.experiment.plant.legged.sensors import Sensors
from sdpid.experiment.preparation.several import prepare_recordings
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples
from sdpid.experiment.recording.recording import rows_of
from sdpid.robot.model.contacts.jacobians import contact_jacobians, frame_axes

pytest.importorskip("mujoco")

# 20 % of the weight.
THRESHOLD = Sensors(flag_threshold=5.0)
LATE = {"effort": 0.002, "imu": 0.004, "contacts": 0.006}


@cache
def robot() -> sdpid.RobotModel:
    return sdpid.load_robot("solo12", root="free_flyer")


@cache
def recorded(late: bool, *, forces: bool = False) -> Recording:
    """Return a trot, with or without late channels."""
    delays = LATE if late else {}
    sensors = Sensors(delays=delays, forces=forces)
    return sdpid.simulate_legged(robot(), "trot", duration=4.0, seed=3, sensors=sensors).recording


def found(log: Recording) -> dict[str, float]:
    return {name: delay.value for name, delay in channel_delays(robot(), log).items()}


def test_each_channel_is_found_to_a_millisecond() -> None:
    assert found(recorded(late=True)) == pytest.approx({**LATE, "base": 0.0}, abs=1e-3)


@pytest.mark.parametrize("names", [("FL_KFE",), ("FL_KFE", "HR_HFE")])
def test_joints_without_effort_hide_no_delay(names: tuple[str, ...]) -> None:
    log, own = recorded(late=True), robot().joint_names[robot().n_base :]
    effort = np.array(log.effort)
    noise = np.random.default_rng(0).standard_normal(len(effort))
    for name in names:
        effort[:, own.index(name)] = 5.0 * noise
    log = replace(log, effort=effort)
    delays = {name: each.value for name, each in channel_delays(robot(), log, names).items()}
    assert delays == pytest.approx({**LATE, "base": 0.0}, abs=1e-3)
    processing = prepare_recordings(robot(), log, without_effort=names).processing
    assert processing.imu_delay_s == pytest.approx(LATE["imu"], abs=5e-4)
    told = {each.kind for each in inspect_recordings([log], robot(), without_effort=names)}
    assert {"imu_late", "contacts_late"} <= told


def test_good_recordings_have_no_delay() -> None:
    kinds = {each.kind for each in sdpid.inspect_recording(recorded(late=False), robot()).findings}
    assert not {kind for kind in kinds if kind.endswith("_late")}
    processing = prepare_recordings(robot(), recorded(late=False)).processing
    assert (processing.effort_delay_s, processing.imu_delay_s) == (0.0, 0.0)


def test_flags_with_a_threshold_make_no_delays() -> None:
    log = sdpid.simulate_legged(robot(), "walk", duration=3.0, seed=3, sensors=THRESHOLD).recording
    kinds = {each.kind for each in sdpid.inspect_recording(log, robot()).findings}
    assert not {kind for kind in kinds if kind.endswith("_late")}


def test_findings_tell_what_processing_takes_off() -> None:
    log = recorded(late=True)
    findings = {each.kind: each for each in sdpid.inspect_recording(log, robot()).findings}
    assert findings["effort_late"].numbers["delay"] == pytest.approx(0.002, abs=1e-3)
    assert "are late by" in findings["effort_late"].message
    prepared = prepare_recordings(robot(), log, {"imu_delay_s": 0.0})
    assert prepared.processing.effort_delay_s == pytest.approx(0.002, abs=1e-3)
    # What is given stands as it is.
    assert prepared.processing.imu_delay_s == 0.0
    assert any("effort_delay_s" in note for note in prepared.samples.notes)


def test_without_an_imu_the_pose_is_compared_with_legs_that_stand() -> None:
    log = recorded(late=True)
    base = replace(
        log.base,
        imu=None,
        position=np.roll(log.base.position, 3, axis=0),
        orientation=np.roll(log.base.orientation, 3, axis=0),
    )
    log = replace(log, base=base)
    delays = found(rows_of(log, slice(3, None)))
    assert delays["base"] == pytest.approx(0.003, abs=1e-3)
    assert delays["effort"] == pytest.approx(0.002, abs=1e-3)


def test_forces_are_compared_with_efforts() -> None:
    assert found(recorded(late=True, forces=True))["contacts"] == pytest.approx(0.006, abs=1e-3)


def test_without_a_robot_the_imu_is_compared_with_the_pose() -> None:
    findings = {each.kind: each for each in sdpid.inspect_recording(recorded(late=True)).findings}
    assert findings["imu_late"].numbers["delay"] == pytest.approx(0.004, abs=5e-4)


def test_free_rows_hold_no_contact_force() -> None:
    samples = prepare_recordings(robot(), recorded(late=False)).samples
    contacts = samples.contacts
    rows = np.arange(0, samples.n_samples, 40)
    free = FreeRows.of(robot(), samples, rows, first_scale(robot(), samples.effort))
    J = contact_jacobians(robot(), samples.position[rows], contacts.frames, contacts.offset)
    force = np.random.default_rng(0).normal(size=(len(rows), contacts.n, 3))
    force *= contacts.down[rows][:, :, None]
    pushed = np.einsum("kcin,kci->kn", J[:, :, :3], force)
    assert np.abs(free.apply(pushed)).max() < 1e-9 * np.abs(pushed).max()
    independent = robot().n - 3 * contacts.down[rows].sum(axis=1)
    np.testing.assert_array_equal(np.bincount(free.sample), independent)


def test_free_rows_hold_no_moment_across_a_line() -> None:
    rng = np.random.default_rng(1)
    turned = rng.normal(size=(5, 4))
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    position = np.hstack([np.zeros((5, 3)), turned, rng.normal(size=(5, 12))])
    still = np.zeros((5, 18))
    edge = ContactSamples(frames=["FL_FOOT"], kind="line", down=np.ones((5, 1), dtype=bool))
    samples = sdpid.Samples(
        position=position, velocity=still, acceleration=still, effort=still, contacts=edge
    )
    free = FreeRows.of(robot(), samples, np.arange(5), np.ones(18))
    moments = contact_jacobians(robot(), position, edge.frames)[:, 0, 3:]
    across = frame_axes(robot(), position, edge.frames)[:, 0][:, :, [0, 2]]
    twisted = np.einsum("kin,kij->kn", moments, across)
    assert np.abs(free.apply(twisted)).max() < 1e-9 * np.abs(twisted).max()


@pytest.mark.parametrize("delay", [-0.013, 0.0004, 0.02])
def test_lag_of_two_signals(delay: float) -> None:
    time = 0.01 * np.arange(800)
    phases = np.array([0.0, 1.0])
    wave = np.sin(4.0 * time[:, None] + phases) + np.sin(7.3 * time[:, None])
    late = np.sin(4.0 * (time - delay)[:, None] + phases) + np.sin(7.3 * (time - delay)[:, None])
    found = lag(late, 1.3 * wave + 2.0, 0.01, gain=True)
    assert found.value == pytest.approx(delay, abs=1e-4)
