"""Recorded velocities held against positions."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid.experiment.processing.choose import choose_processing
from sdpid.experiment.recording.velocities import disagreement, velocity_fit


def moving(
    rate: float = 50.0,
    *,
    seconds: float = 30.0,
    scale: float = 1.0,
    lag: float = 0.0,
    noise: float = 0.0,
    seed: int = 0,
) -> sdpid.Recording:
    """Return a record whose second joint has a velocity that is wrong."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(rate * seconds)) / rate
    omega, phase = rng.uniform(0.5, 3.0, 4), rng.uniform(0.0, 6.0, 4)
    angle = time[:, None] * omega + phase
    late = angle - lag * omega
    position = np.sin(angle).sum(axis=1)
    velocity = (omega * np.cos(late)).sum(axis=1)
    right = (omega * np.cos(angle)).sum(axis=1)
    velocity = scale * velocity + noise * rng.standard_normal(time.size)
    both = np.column_stack([position, position])
    return sdpid.Recording(
        time=time, position=both, velocity=np.column_stack([right, velocity]), effort=both
    )


@settings(max_examples=40, deadline=None)
@given(
    rate=st.sampled_from([25.0, 90.0, 500.0]),
    scale=st.floats(0.3, 3.0),
    sign=st.sampled_from([-1.0, 1.0]),
    lag=st.floats(-0.02, 0.02),
    seed=st.integers(0, 50),
)
def test_scale_sign_and_lag_are_found(
    rate: float, scale: float, sign: float, lag: float, seed: int
) -> None:
    log = moving(rate, scale=sign * scale, lag=lag, seed=seed)
    fit = velocity_fit(log, 1)
    # At 25 Hz the trapezia of the mean lose (w h)²/12 = 1e-3, and a lag is only taken up to its
    # first order: (w lag)²/2 = 2e-3 of the scale.
    assert fit.scale == pytest.approx(sign * scale, rel=5e-3)
    assert fit.lag == pytest.approx(lag, abs=5e-4)
    assert fit.correlation > 0.99


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"scale": 1.05}, None),
        ({"scale": 0.93}, None),
        ({"scale": 1.15}, "joint 2 is 1.15 times d/dt of its position, limit 0.9 to 1.1"),
        ({"scale": 0.85}, "joint 2 is 0.85 times"),
        ({"scale": -1.0}, "joint 2 is -1 times"),
        ({"scale": 57.3}, "joint 2 is 57.3 times"),
        ({"lag": 0.02}, None),
        ({"lag": 0.1}, r"joint 2 is late by 0.1\d* s"),
        ({"lag": -0.1}, r"joint 2 is early by 0.1\d* s"),
        ({"noise": 0.1}, None),
        ({"scale": 0.0, "noise": 1.0}, r"joint 2 does not follow d/dt of its position"),
    ],
)
def test_what_is_wrong_is_not_used(changes: dict[str, float], said: str | None) -> None:
    log = moving(**changes)
    choice = choose_processing(log)
    velocity = [text for text in choice.reasons if text.startswith("velocity")]
    assert len(velocity) == 1
    if said is None:
        assert choice.processing.velocity == "measured"
        assert "agrees with positions" in velocity[0]
    else:
        assert choice.processing.velocity == "differentiated"
        assert re.search(said, velocity[0])


def test_a_joint_that_rests_says_nothing() -> None:
    log = moving()
    position, velocity = np.array(log.position), np.array(log.velocity)
    position[:, 1] = 0.3 + 1e-6 * np.sin(log.time)
    velocity[:, 1] = 1e-3 * np.random.default_rng(0).standard_normal(log.n_samples)
    resting = replace(log, position=position, velocity=velocity)
    assert velocity_fit(resting, 1) is None
    assert disagreement(resting, 1.0) is None
    assert choose_processing(resting).processing.velocity == "measured"


def test_too_few_samples_say_nothing() -> None:
    log = moving(seconds=0.1)
    assert log.n_samples == 5
    assert velocity_fit(log, 0) is None


def test_noise_of_positions_is_no_scale() -> None:
    log = moving()
    rate = np.sqrt(np.mean(log.velocity[:, 1] ** 2))  # type: ignore[index]
    # As much noise as makes the slope of the velocity over the rate 1 / (1 + 0.4²) = 0.86.
    noise = 0.4 * rate / (np.sqrt(2.0) * log.rate_hz)
    noisy = log.position + noise * np.random.default_rng(0).standard_normal(log.position.shape)
    log = replace(log, position=noisy)
    fit = velocity_fit(log, 1)
    assert fit.scale == pytest.approx(np.sqrt(1.0 / 1.16), abs=0.02)
    assert disagreement(log, 0.5) is None
