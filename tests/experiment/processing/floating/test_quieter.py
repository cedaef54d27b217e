"""The noise of a pose bounds the cut-off where the base's accelerations are its differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.experiment.processing.choose import choose_processing
from sdpid.experiment.processing.floating.quieter import pose_limit
from sdpid.experiment.recording.floating.base import BaseMotion


def test_noise_of_the_pose_is_at_most_a_share_of_gravity_below_the_limit() -> None:
    rate, share = 1000.0, 2e-4
    rng = np.random.default_rng(1)
    position = 3e-4 * rng.normal(size=(2**15, 3))
    base = BaseMotion(orientation=np.tile([0.0, 0.0, 0.0, 1.0], (2**15, 1)), position=position)
    limit = pose_limit(base, rate, share)
    frequency = np.fft.rfftfreq(2**15, 1.0 / rate)
    power = 2.0 * np.abs(np.fft.rfft(position, axis=0) / 2**15) ** 2
    below = ((2.0 * np.pi * frequency[:, None]) ** 4 * power)[frequency <= limit].sum()
    assert below == pytest.approx(share * 9.81**2, rel=0.15)


def test_a_base_without_an_accelerometer_is_filtered_more() -> None:
    log = sdpid.simulate_legged("solo12", "stand", duration=2.0).recording
    assert log.base is not None
    with_imu = choose_processing(log).processing
    posed = choose_processing(replace(log, base=replace(log.base, imu=None)))
    assert posed.processing.cutoff_hz < 0.8 * with_imu.cutoff_hz
    assert "the base's position" in posed.reasons[0]
