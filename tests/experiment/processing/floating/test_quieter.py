"""The noise of a pose bounds the cut-off where the base's accelerations are its differences."""

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.experiment.processing.choose import choose_processing
from sdpid.experiment.processing.floating.quieter import base_limit
from sdpid.experiment.recording.floating.base import BaseMotion


def test_noise_of_the_pose_is_at_most_a_share_of_gravity_below_the_limit() -> None:
    rate, share = 1000.0, 2e-4
    rng = np.random.default_rng(1)
    position = 3e-4 * rng.normal(size=(2**15, 3))
    base = BaseMotion(orientation=np.tile([0.0, 0.0, 0.0, 1.0], (2**15, 1)), position=position)
    limit = base_limit(base, rate, share)
    frequency = np.fft.rfftfreq(2**15, 1.0 / rate)
    power = 2.0 * np.abs(np.fft.rfft(position, axis=0) / 2**15) ** 2
    below = ((2.0 * np.pi * frequency[:, None]) ** 4 * power)[frequency <= limit].sum()
    assert below == pytest.approx(share * 9.81**2, rel=0.15)


def test_a_base_without_an_accelerometer_is_filtered_more() -> None:
    log = sdpid.simulate_legged("solo12", "stand", duration=2.0).recording
    with_imu = choose_processing(log).processing
    posed = choose_processing(replace(log, base=replace(log.base, imu=None)))
    assert posed.processing.cutoff_hz < 0.8 * with_imu.cutoff_hz
    assert "the base's acceleration" in posed.reasons[0]
    # What stands beside the pose does not help where it is not used, or is worse.
    chosen = choose_processing(log, base_motion="pose").processing
    assert chosen.cutoff_hz == posed.processing.cutoff_hz
    rng = np.random.default_rng(1)
    velocity = np.gradient(np.array(log.base.position), log.step, axis=0)
    base = BaseMotion(
        orientation=log.base.orientation,
        position=log.base.position,
        linear_velocity=velocity + rng.normal(size=velocity.shape),
        velocity_frame="world",
    )
    beside = choose_processing(replace(log, base=base)).processing
    assert beside.cutoff_hz == posed.processing.cutoff_hz
    exact = replace(base, linear_velocity=np.zeros_like(velocity))
    assert choose_processing(replace(log, base=exact)).processing.cutoff_hz == with_imu.cutoff_hz
