"""Postures and runs of single joints: at rest and at speed where they should be, within limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdpid.errors import DataError
from sdpid.experiment.trajectory.curve import is_closed, rests_at_ends
from sdpid.experiment.trajectory.runs import joint_runs, through_postures

VELOCITY, ACCELERATION, JERK = np.array([1.0, 2.0]), np.array([3.0, 2.0]), np.array([30.0, 9.0])
LIMITS = {"velocity": VELOCITY, "acceleration": ACCELERATION, "jerk": JERK}


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), hold=st.sampled_from([0.0, 0.7]))
def test_postures_are_held_and_limits_met(seed: int, hold: float) -> None:
    postures = np.random.default_rng(seed).uniform(-2.0, 2.0, size=(4, 2))
    curve = through_postures([*postures, postures[0]], hold=hold, **LIMITS)
    assert is_closed(curve)
    assert rests_at_ends(curve)
    for order, limit in enumerate(LIMITS.values(), 1):
        lower, upper = curve.enclose(np.linspace(0.0, curve.duration, 5001), derivative=order)
        bound = np.maximum(-lower, upper).max(axis=0)
        # Bounds by control points exceed the extremes a little where cells are cut.
        assert (bound <= limit * (1.0 + 1e-3)).all()
    if hold:
        assert not curve.evaluate(curve.breaks[:-1:2] + 0.5 * hold, derivative=1).any()
    # Some joint is at a limit in every move.
    dense = np.linspace(0.0, curve.duration, 20001)
    shares = [
        np.abs(curve.evaluate(dense, derivative=k + 1)) / x for k, x in enumerate(LIMITS.values())
    ]
    fastest = np.max(shares, axis=(0, 2))
    for start, end in zip(curve.breaks, curve.breaks[1:], strict=False):
        inside = (dense >= start) & (dense <= end)
        moves = np.ptp(curve.evaluate(np.array([start, end])), axis=0).max() > 0.0
        assert not moves or fastest[inside].max() > 0.98


def test_joints_run_at_the_speeds_both_ways() -> None:
    start, ranges = np.array([0.2, -0.5]), np.array([[-1.0, 1.0], [-1.0, 0.4]])
    speeds = [0.1, 0.5, 1.5]
    curve = joint_runs(start, ranges, speeds, **LIMITS)
    assert is_closed(curve)
    time = np.linspace(0.0, curve.duration, 50001)
    q, v, a = (curve.evaluate(time, derivative=order) for order in range(3))
    # 1.5 rad/s is above the first joint's limit and out of reach within the second's range.
    for j in range(2):
        cruising = (np.abs(a[:, j]) < 1e-9) & (np.abs(v[:, j]) > 1e-3)
        assert set(np.round(v[cruising, j], 6)) == {-0.5, -0.1, 0.1, 0.5}
        assert np.abs(a[:, 1 - j][np.abs(v[:, j]) > 1e-9]).max() < 1e-9
        np.testing.assert_allclose([q[:, j].min(), q[:, j].max()], ranges[j], atol=1e-9)
    for values, limit in (
        (v, VELOCITY),
        (a, ACCELERATION),
        (curve.evaluate(time, derivative=3), JERK),
    ):
        assert (np.abs(values).max(axis=0) <= limit * (1.0 + 1e-9)).all()
    only = joint_runs(start, ranges, speeds, joints=[1], **LIMITS)
    assert np.ptp(only.evaluate(np.linspace(0.0, only.duration, 999))[:, 0]) < 1e-15


def test_what_cannot_be_run_is_refused() -> None:
    with pytest.raises(DataError, match="give two or more"):
        through_postures([[0.0]], velocity=1.0, acceleration=1.0)
    with pytest.raises(DataError, match="positive"):
        through_postures([[0.0], [1.0]], velocity=1.0, acceleration=-1.0)
    with pytest.raises(DataError, match="at least two"):
        through_postures([[0.0], [0.0]], velocity=1.0, acceleration=1.0, hold=0.0)
    with pytest.raises(DataError, match="joint 1"):
        joint_runs([0.0], [[0.0, 0.1]], [5.0], acceleration=1.0)
