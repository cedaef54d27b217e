"""Friction columns that pass the filter of the efforts."""

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from tests.helpers.refusals import refuses

WIDTH = 0.01


def steep(velocity: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.tanh(velocity / WIDTH)


def log_of(rate: float = 500.0, seconds: float = 30.0, period: float | None = None):
    """Return a record whose efforts are nothing but steep friction of the exact velocity."""
    time = np.arange(round(rate * seconds)) / rate
    tones = np.array([0.5, 0.7]) if period is None else np.array([0.5, 1.0])
    angle = 2.0 * np.pi * time[:, None] * tones
    position, velocity = (
        np.sin(angle) + 0.4 * np.sin(0.5 * angle + 1.0),
        2.0 * np.pi * tones * (np.cos(angle) + 0.2 * np.cos(0.5 * angle + 1.0)),
    )
    effort = steep(velocity, velocity)
    return sdpid.Recording(time=time, position=position, effort=effort, period=period)


def worst(samples: Samples, predicted: np.ndarray) -> float:
    return float(np.abs(samples.effort - predicted).max())


@pytest.mark.parametrize("rate", [200.0, 500.0, 2000.0])
def test_friction_stands_in_filtered_efforts_as_its_columns_do(rate: float) -> None:
    samples = process(log_of(rate), {"reversal_time": None})
    friction = samples.through_filter(steep, slice(None))
    smeared = worst(samples, steep(samples.velocity, samples.acceleration))
    # The reversal itself lies between two samples of the log: a hundredth of its step.
    assert worst(samples, friction) < 0.02 < 0.5 < smeared


def test_records_with_periods_and_recorded_velocities() -> None:
    periodic = log_of(1000.0, 24.0, period=4.0)
    samples = process(periodic, {"reversal_time": None, "covariance": None})
    assert worst(samples, samples.through_filter(steep, slice(None))) < 0.02
    log = log_of(80.0)
    velocity = np.gradient(log.position, log.time, axis=0, edge_order=2)
    samples = process(replace(log, velocity=velocity), {"velocity": "measured"})
    assert worst(samples, samples.through_filter(steep, slice(None))) < 0.1


def test_parts_are_those_of_the_whole() -> None:
    one, two = (process(log_of(200.0, seconds), {"cutoff_hz": 10.0}) for seconds in (30.0, 12.0))
    joined = Samples.join([one, two])
    whole = joined.through_filter(steep, slice(None), "steep")
    np.testing.assert_array_equal(whole[: one.n_samples], one.through_filter(steep, slice(None)))
    for which in (slice(100, 700), slice(one.n_samples - 5, one.n_samples + 9), slice(3, None, 7)):
        np.testing.assert_array_equal(joined.through_filter(steep, which, "steep"), whole[which])
    # The memory of the filter is cut off after 20 time constants, 2e-9 of a step.
    part = joined.between(400, one.n_samples + 500)
    np.testing.assert_allclose(
        part.through_filter(steep, slice(None)), whole[400 : one.n_samples + 500], atol=1e-8
    )
    assert part.starts == (0, one.n_samples - 400)
    thin = joined.every(3)
    assert thin.time is not None
    places = np.searchsorted(one.time, thin.pieces[1].time)
    np.testing.assert_allclose(
        thin.pieces[1].through_filter(steep, slice(None)), whole[places], atol=1e-8
    )
    refuses(DataError, "none from 9000", joined.between, 9000, 9100)


def test_without_the_filter_friction_is_that_of_the_samples() -> None:
    samples = process(log_of(), {"filter_friction": False})
    assert samples.wide is None
    expected = steep(samples.velocity, samples.acceleration)
    np.testing.assert_array_equal(samples.through_filter(steep, slice(None)), expected)
    refuses(DataError, "process all of them alike", Samples.join, [samples, process(log_of())])


def test_a_joint_that_hardly_moves_is_not_masked() -> None:
    log = log_of()
    position = np.array(log.position)
    position[:, 1] = 1.0 + 1e-3 * position[:, 1]
    samples = process(replace(log, position=position))
    assert 0.5 < samples.mask[:, 0].mean() < 1.0
    assert samples.mask[:, 1].all()
    assert any("not masked, since less than 10 % of the rows" in note for note in samples.notes)
    with pytest.raises(DataError, match="leaves no row of joint 2"):
        process(replace(log, position=position), {"kept_share": 0.0})
