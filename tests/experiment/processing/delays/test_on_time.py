"""Channels that were recorded late are taken at their time."""

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid import Recording
from sdpid.experiment.processing.delays.on_time import on_time

STEP = 0.002
# Whole and half steps, late and early.
DELAYS = {
    "effort_delay_s": 0.005,
    "imu_delay_s": -0.003,
    "base_delay_s": 0.004,
    "contacts_delay_s": 0.01,
}


def recorded(delays: dict[str, float]) -> Recording:
    """Return smooth channels, each as much later as is said."""
    time = STEP * np.arange(1000)

    def wave(name: str, columns: int) -> np.ndarray:
        late = time - delays.get(f"{name}_delay_s", 0.0)
        return np.sin(late[:, None] * np.linspace(3.0, 9.0, columns))

    turned = np.column_stack([0.3 * wave("base", 3), np.ones(len(time))])
    feet = wave("contacts", 2)
    return Recording(
        time=time,
        position=wave("joints", 2),
        effort=wave("effort", 2),
        base=sdpid.BaseMotion(
            orientation=turned / np.linalg.norm(turned, axis=1, keepdims=True),
            position=wave("base", 3),
            imu=sdpid.Imu(gyroscope=wave("imu", 3), accelerometer=wave("imu", 3)),
        ),
        contacts=sdpid.Contacts(frames=["a", "b"], down=feet > 0.2),
    )


def test_channels_are_those_of_a_recording_without_delays() -> None:
    found = on_time(recorded(DELAYS), sdpid.Processing(**DELAYS))
    # What no channel lacks: 10 ms at the end, 3 ms (of 2 ms steps) at the beginning.
    assert (found.time[0], found.time[-1]) == pytest.approx((0.004, 1.988))
    wanted = recorded({})
    rows = slice(2, 995)
    np.testing.assert_array_equal(found.position, wanted.position[rows])
    np.testing.assert_allclose(found.effort, wanted.effort[rows], atol=1e-8)
    for base, other in ((found.base, wanted.base),):
        np.testing.assert_allclose(base.orientation, other.orientation[rows], atol=1e-8)
        np.testing.assert_allclose(base.position, other.position[rows], atol=1e-8)
        np.testing.assert_allclose(base.imu.gyroscope, other.imu.gyroscope[rows], atol=1e-8)
    np.testing.assert_array_equal(found.contacts.down, wanted.contacts.down[rows])


def test_a_periodic_record_goes_on_with_its_beginning() -> None:
    time = 0.01 * np.arange(400)
    wave = np.sin(2.0 * np.pi * time)[:, None]
    late = np.sin(2.0 * np.pi * (time - 0.025))[:, None]
    log = Recording(time=time, position=wave, effort=late, period=1.0)
    found = on_time(log, sdpid.Processing(effort_delay_s=0.025))
    assert found.n_samples == 400
    np.testing.assert_allclose(found.effort, wave, atol=1e-6)


def test_process_takes_efforts_on_time_and_says_so() -> None:
    log = replace(recorded(DELAYS), base=None, contacts=None)
    samples = sdpid.process(log, {"effort_delay_s": 0.005, "imu_delay_s": 0.1})
    right = sdpid.process(replace(recorded({}), base=None, contacts=None))
    shared = np.intersect1d(samples.time.round(6), right.time.round(6))
    rows = [np.isin(each.time.round(6), shared) for each in (samples, right)]
    inner = slice(50, -50)
    np.testing.assert_allclose(
        samples.effort[rows[0]][inner], right.effort[rows[1]][inner], atol=1e-5
    )
    assert "efforts recorded 5 ms too late: taken on time" in samples.notes


def test_a_delay_longer_than_a_quarter_of_a_piece_is_refused() -> None:
    log = replace(recorded({}), base=None, contacts=None)
    with pytest.raises(sdpid.errors.DataError, match="limit is a quarter"):
        sdpid.process(log, {"effort_delay_s": 0.6})
