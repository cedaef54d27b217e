"""Clocks that speeds tell."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.experiment.recording.gaps import continuous, retimed, told_clock
from tests.helpers.strategies import SEEDS

STEP, ROWS = 0.005, 3000


def motion(time: Array) -> tuple[Array, Array, Array]:
    """Return positions, speeds and efforts of three joints."""
    rates = np.array([1.3, 2.1, 3.4])
    return (
        np.sin(rates * time[:, None]),
        rates * np.cos(rates * time[:, None]),
        np.cos(time)[:, None] * [1.0, 2.0, 3.0],
    )


def log(seed: int, *, jitter: float = 0.6, wrong: bool = False) -> tuple[sdpid.Recording, Array]:
    """Return a log whose driver is read at times of its own, in steps, and those times."""
    rng = np.random.default_rng(seed)
    stamps = STEP * np.arange(ROWS)
    read = np.maximum.accumulate(stamps + jitter * STEP * rng.normal(size=ROWS))
    # A driver that has nothing new repeats its row.
    repeats = np.r_[False, rng.random(ROWS - 1) < (0.1 if jitter else 0.0)]
    read = read[np.maximum.accumulate(np.where(repeats, 0, np.arange(ROWS)))]
    q, v, tau = motion(read)
    if wrong:
        v[:, 2] *= 0.8
    return sdpid.Recording(time=stamps, position=q, velocity=v, effort=tau), read


@given(seed=SEEDS, wrong=st.booleans())
def test_the_clock_is_found_and_positions_are_those_of_regular_times(seed: int, wrong: bool):
    recorded, read = log(seed, wrong=wrong)
    clock = told_clock(recorded)
    assert clock is not None
    assert clock.joints.tolist() == ([0, 1] if wrong else [0, 1, 2])
    late = clock.time - read[clock.rows]
    assert late.std() < 0.1 * STEP
    again = retimed(recorded, clock)
    q, _, tau = motion(np.asarray(again.time))
    # Of regular stamps positions are off by the jitter: 0.6 of a step.
    assert np.sqrt(np.mean((again.position - q) ** 2)) < 0.15 * STEP * 3.4
    assert np.abs(again.effort - tau).max() < 6.0 * STEP
    pieces, notes = continuous(recorded)
    assert len(pieces) == 1
    assert "times taken from the speeds of joints 1, 2" in notes[0]


@pytest.mark.parametrize(
    "change",
    [
        {"velocity": None},
        {"period": STEP * ROWS},
        {"time": np.r_[0.0, STEP * 1.6 + STEP * np.arange(ROWS - 1)]},
    ],
    ids=["no speeds", "periods", "stamps of their own"],
)
def test_stamps_stay_where_speeds_do_not_tell(change: dict[str, object]):
    recorded, _ = log(0)
    assert told_clock(replace(recorded, **change)) is None  # type: ignore[arg-type]


def test_regular_logs_and_logs_whose_speeds_disagree_keep_their_stamps():
    regular, _ = log(1, jitter=0.0)
    assert told_clock(regular) is None
    assert continuous(regular)[0] == (regular,)
    recorded, _ = log(1)
    assert told_clock(replace(recorded, velocity=0.8 * np.asarray(recorded.velocity))) is None
