"""Proofs that a distance is never small, on functions whose least value is known."""

import numpy as np
import pytest

from sdpid._common.arrays import Array
from sdpid.excitation.geometry.proof import proven_apart

LOWER, UPPER = np.full(3, -1.0), np.array([1.0, 2.0, 3.0])
REACH = np.array([1.0, 0.5, 0.0])


def wave(q: Array) -> Array:
    """Return a function of the first two joints whose least value within the limits is 0.5."""
    return np.asarray(1.25 - 0.5 * np.sin(q[:, 0] + 0.6) - 0.25 * np.cos(2.0 * q[:, 1]))


def prove(wanted: float, *, most: int = 20_000) -> int | None:
    return proven_apart(wave, REACH, LOWER, UPPER, wanted, most=most)


def test_what_is_true_is_proven_and_what_is_not_is_not() -> None:
    assert prove(0.49) is not None
    assert prove(0.51) is None


def test_more_room_takes_fewer_distances() -> None:
    counts = [prove(wanted) for wanted in (-5.0, 0.0, 0.4, 0.49)]
    assert None not in counts
    assert counts[0] == 1
    assert counts == sorted(counts, key=lambda count: count or 0)


def test_it_gives_up() -> None:
    assert prove(0.4999, most=100) is None


@pytest.mark.parametrize("reach", [np.array([np.inf, 0.5, 0.0]), np.array([1.0, np.inf, 0.0])])
def test_no_bound_no_proof(reach: Array) -> None:
    assert proven_apart(wave, reach, LOWER, UPPER, 0.0, most=1000) is None


def test_joints_without_limits_and_joints_that_do_not_move() -> None:
    endless = np.array([1.0, np.inf, 3.0])
    assert proven_apart(wave, REACH, LOWER, endless, 0.0, most=1000) is None
    # The third joint does not matter; the second stands where the function is largest.
    half = 0.5 * np.pi
    lower, upper = np.array([-1.0, half, -np.inf]), np.array([1.0, half, np.inf])
    assert proven_apart(wave, REACH, lower, upper, 0.99, most=1000) is not None
    assert proven_apart(wave, REACH, lower, upper, 1.01, most=1000) is None
