"""Another motion of a recording, aligned row by row with the measured one."""

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError
from sdpid.experiment.preparation.several import prepare_recordings
from sdpid.experiment.preparation.twin import Twin
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm


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
