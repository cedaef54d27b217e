"""Records with gaps, wrapped angles and late stamps."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid.errors import DataError
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.recording.gaps import continuous, split_at_gaps, unwrapped

RATE = 100.0
SETTING = sdpid.Processing(
    cutoff_hz=8.0, order=2, decimation=2, reversal_time=None, derivative="central4"
)
FIELDS = ("position", "velocity", "acceleration", "effort", "time")


def record(seconds: float = 20.0, seed: int = 0, joints: int = 2) -> sdpid.Recording:
    rng = np.random.default_rng(seed)
    time = 5.0 + np.arange(round(RATE * seconds)) / RATE
    omega = rng.uniform(1.0, 6.0, joints)
    position = np.sin(omega * time[:, None])
    noise = rng.standard_normal((2, *position.shape))
    return sdpid.Recording(
        time=time,
        position=position + 1e-4 * noise[0],
        effort=position + noise[1],
        velocity=omega * np.cos(omega * time[:, None]),
    )


def rows(log: sdpid.Recording, keep: np.ndarray | slice) -> sdpid.Recording:
    fields = {name: getattr(log, name)[keep] for name in ("time", "position", "effort", "velocity")}
    return replace(log, **fields)


def without(log: sdpid.Recording, *cuts: tuple[int, int]) -> sdpid.Recording:
    keep = np.ones(log.n_samples, dtype=bool)
    for first, stop in cuts:
        keep[first:stop] = False
    return rows(log, keep)


cuts = st.lists(st.tuples(st.integers(150, 1850), st.integers(5, 90)), min_size=1, max_size=4).map(
    lambda found: [(first, first + count) for first, count in found]
)


@settings(max_examples=25, deadline=None)
@given(cuts=cuts, seed=st.integers(0, 9), velocity=st.sampled_from(["differentiated", "measured"]))
def test_gaps_part_a_record_into_records(
    cuts: list[tuple[int, int]], seed: int, velocity: str
) -> None:
    log = without(record(seed=seed), *cuts)
    setting = replace(SETTING, velocity=velocity)
    ends = np.flatnonzero(np.diff(log.time) > 5.5 / RATE) + 1
    bounds = [0, *ends.tolist(), log.n_samples]
    apart = []
    for first, stop in pairwise(bounds):
        if stop - first < 2:
            continue
        try:
            apart.append(sdpid.process(rows(log, slice(first, stop)), setting))
        except DataError as cause:
            assert "cut off at either end" in str(cause)  # noqa: PT017 (not every piece is short)
    together = sdpid.process(log, setting)
    joined = sdpid.Samples.join(apart)
    assert together.starts == joined.starts
    assert len(together.starts) == len(apart)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(together, name), getattr(joined, name))
    if len(bounds) > 2:
        assert "split at" in together.notes[0]


@settings(max_examples=15, deadline=None)
@given(end=st.integers(200, 1700), seed=st.integers(0, 99))
def test_what_comes_after_a_gap_does_not_reach_back(end: int, seed: int) -> None:
    log = without(record(), (end, end + 40))
    rng = np.random.default_rng(seed)
    position, effort = np.array(log.position), np.array(log.effort)
    position[end:] += rng.standard_normal(position[end:].shape)
    effort[end:] += rng.standard_normal(position[end:].shape)
    changed = replace(log, position=position, effort=effort)
    one, other = sdpid.process(log, SETTING), sdpid.process(changed, SETTING)
    count = one.starts[1]
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(one, name)[:count], getattr(other, name)[:count])
    assert np.abs(one.effort[count:] - other.effort[count:]).max() > 0.1


def test_the_notes_say_what_was_lost() -> None:
    # Pieces of 600, 3, 1 and 1246 samples.
    log = without(record(), (600, 650), (653, 700), (701, 754))
    pieces, notes = continuous(log)
    assert [piece.n_samples for piece in pieces] == [600, 3, 1246]
    assert notes == [
        "split at 3 gaps of more than 5 steps of 0.01 s, the largest 0.54 s before row 605: "
        "1.53 s of 19.99 s were not measured, 1 of the samples alone between gaps left out"
    ]
    samples = sdpid.process(log, SETTING)
    assert samples.notes[0] == notes[0]
    assert samples.notes[1] == (
        "1 of 3 pieces dropped, too short to be filtered: 3 samples, 0.02 s"
    )
    assert len(samples.starts) == 2
    assert any("2 pieces joined" in note for note in samples.notes)


def test_nothing_between_gaps() -> None:
    log = record()
    keep = np.arange(log.n_samples) % 30 < 4
    with pytest.raises(DataError, match=r"split the record into 67 pieces, each too short; .* 4 s"):
        sdpid.process(rows(log, keep), SETTING)


def test_few_lost_samples_are_bridged() -> None:
    log = record()
    for lost, pieces in ((4, 1), (5, 2)):
        parts = split_at_gaps(without(log, (700, 700 + lost)))
        assert len(parts) == pieces
    bridged = sdpid.process(without(log, (700, 704)), SETTING)
    assert bridged.starts == (0,)
    assert "resampled" in bridged.notes[0]


def test_a_record_without_gaps_is_not_touched() -> None:
    log = record()
    assert split_at_gaps(log)[0] is log
    assert continuous(log) == ((log,), [])


def test_periods_with_a_gap_are_refused() -> None:
    log = without(record(), (600, 650))
    whole = replace(log, period=5.0, start=5.0, periods=3)
    assert split_at_gaps(whole) == (whole,)
    with pytest.raises(DataError, match=r"gap of 0.51 s before row 601 .* without its period"):
        sdpid.process(whole, replace(SETTING, covariance=None))


def late(log: sdpid.Recording, row: int, count: int, spacing: float = 1e-4) -> np.ndarray:
    """Return stamps of a logger that stalls, then writes what it held back in a burst."""
    time = np.array(log.time)
    stop = row + count
    time[row:stop] = time[stop] - spacing * np.arange(count, 0, -1)
    return time


@pytest.mark.parametrize("period", [None, 5.0])
@pytest.mark.parametrize("count", [6, 20])
def test_late_samples_are_taken_as_regular(period: float | None, count: int) -> None:
    """No sample is missing, and one hiccup of the clock does not cost the record."""
    log = record()
    position = np.sin(0.4 * np.pi * np.array([2.0, 3.0]) * log.time[:, None])
    log = replace(log, position=position, period=period)
    setting = replace(SETTING, covariance=None)
    stalled = replace(log, time=late(log, 500, count))
    samples, expected = sdpid.process(stalled, setting), sdpid.process(log, setting)
    assert f"stamps of {count} samples after a gap of 0." in samples.notes[0]
    assert samples.n_samples == expected.n_samples
    np.testing.assert_allclose(samples.acceleration, expected.acceleration, atol=1e-6)
    inspection = sdpid.inspect_recording(stalled)
    assert any("came late; taken as regular" in each.message for each in inspection.findings)


def test_late_samples_of_which_some_were_lost_are_left_out() -> None:
    log = record()
    stalled = replace(log, time=late(log, 500, 40))
    stalled = without(stalled, (501, 517))
    pieces, notes = continuous(stalled)
    assert notes[0].startswith("24 samples after a gap of")
    assert "16 of them were lost" in notes[0]
    assert [piece.n_samples for piece in pieces] == [500, 1460]


def test_a_hiccup_of_5_ms_at_1_khz_is_bridged() -> None:
    """Five samples are missing: less than any motion of an arm needs to be seen."""
    time = np.arange(8000) / 1000.0
    position = np.sin(np.pi * time)[:, None]
    log = sdpid.Recording(time=time, position=position, effort=position, period=2.0)
    keep = np.r_[0:3000, 3005:8000]
    fields = {name: getattr(log, name)[keep] for name in ("time", "position", "effort")}
    lost = replace(log, **fields)
    setting = replace(SETTING, covariance=None)
    samples, expected = sdpid.process(lost, setting), sdpid.process(log, setting)
    np.testing.assert_allclose(samples.acceleration, expected.acceleration, atol=1e-3)
    assert sdpid.process(replace(lost, period=None), setting).starts == (0,)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 99), slower=st.sampled_from([1.0, 1.4, 2.0]), end=st.integers(60, 700))
def test_lost_samples_are_not_taken_for_late_ones(seed: int, slower: float, end: int) -> None:
    """Stamps jitter, and the rate changes half-way."""
    rng = np.random.default_rng(seed)
    steps = np.where(np.arange(800) < 400, 1.0, slower) / RATE
    steps += rng.choice([-0.2, 0.2], 800) / RATE
    time = np.cumsum(steps)
    time[end:] += 0.2
    log = sdpid.Recording(time=time, position=time[:, None], effort=time[:, None])
    assert [piece.n_samples for piece in split_at_gaps(log)] == [end, 800 - end]


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 99),
    speed=st.floats(0.1, 15.0),
    low=st.floats(-4.0, 0.0),
    noise=st.sampled_from([0.0, 1e-4, 0.02]),
)
def test_wrapped_angles_are_continued(seed: int, speed: float, low: float, noise: float) -> None:
    rng = np.random.default_rng(seed)
    time = np.arange(600) / 50.0
    angle = np.cumsum(rng.standard_normal(600)) * 0.01 + speed * time
    angle = angle + noise * rng.standard_normal(600)
    wrapped = (angle - low) % (2.0 * np.pi) + low
    still = 0.1 * np.sin(time)
    log = sdpid.Recording(
        time=time, position=np.column_stack([wrapped, still]), effort=np.zeros((600, 2))
    )
    found, jumps = unwrapped(log)
    assert jumps[1] == 0
    assert jumps[0] == np.count_nonzero(np.abs(np.diff(wrapped)) > np.pi)
    np.testing.assert_allclose(np.diff(found.position[:, 0]), np.diff(angle), atol=1e-9)
    np.testing.assert_array_equal(found.position[:, 1], still)
    if not jumps.any():
        assert found is log


def test_wrapped_angles_are_processed_as_the_others() -> None:
    log = record()
    turning = np.array(log.position)
    turning[:, 1] = 2.0 * (log.time - 5.0) + 0.2 * turning[:, 1]
    log = replace(log, position=turning)
    wrapped = np.array(turning)
    wrapped[:, 1] = np.mod(wrapped[:, 1], 2.0 * np.pi)
    samples, expected = (
        sdpid.process(replace(log, position=position), SETTING) for position in (wrapped, turning)
    )
    jumps = np.count_nonzero(np.abs(np.diff(wrapped[:, 1])) > np.pi)
    assert jumps > 3
    assert samples.notes[0] == (
        f"angles that wrap continued by whole turns; jumps of joint 2 {jumps}"
    )
    for name in FIELDS[1:]:
        np.testing.assert_allclose(getattr(samples, name), getattr(expected, name), atol=1e-9)
    # It begins where it was recorded, which may be a turn away.
    away = samples.position - expected.position - [0.0, wrapped[0, 1] - turning[0, 1]]
    np.testing.assert_allclose(away, 0.0, atol=1e-9)
    # The cut-off follows the motion, not the jumps.
    chosen = default_processing(replace(log, position=wrapped))
    assert chosen.cutoff_hz == pytest.approx(default_processing(log).cutoff_hz, rel=1e-9)


def test_degrees_are_no_turns() -> None:
    log = record()
    degrees = replace(log, position=np.degrees(2.5 * log.position))
    assert np.abs(np.diff(degrees.position, axis=0)).max() > 2.0 * np.pi - 1.0
    assert unwrapped(degrees)[0] is degrees
    spike = np.array(log.position)
    spike[300, 0] += 4.0
    spike[700, 0] += 2.0 * np.pi
    assert unwrapped(replace(log, position=spike))[1].tolist() == [0, 0]


def test_the_longest_piece_chooses() -> None:
    log = record()
    # The joints are elsewhere after the gap: a jump is no fast motion.
    position = np.array(log.position)
    position[1200:] += 1.5
    gapped = without(replace(log, position=position), (1200, 1260))
    chosen = default_processing(gapped)
    assert replace(chosen, reasons=()) == default_processing(rows(log, slice(0, 1200)))


def test_a_stored_record_is_split_and_continued_as_well(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    log = without(record(), (900, 960))
    position = np.array(log.position)
    position[:, 1] = np.mod(2.0 * log.time + position[:, 1], 2.0 * np.pi)
    log = replace(log, position=position)
    log.to_parquet(tmp_path / "log.parquet")
    stored = sdpid.read_recording(tmp_path / "log.parquet", stored=True)
    assert stored.stored
    samples, expected = (sdpid.process(each, default_processing(each)) for each in (stored, log))
    assert samples.notes == expected.notes
    assert len(samples.starts) == 2
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(samples, name), getattr(expected, name))
