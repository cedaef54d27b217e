from dataclasses import replace

import numpy as np
import pytest

from sdpid.experiment.preparation.overview import gaps, noise
from sdpid.experiment.processing.motion import joint_frequencies
from sdpid.experiment.recording.recording import Recording

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
