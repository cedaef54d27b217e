"""Recordings that stay in their file: the same results, and never in memory as a whole."""

import pickle
import tracemalloc
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid.errors import DataError
from sdpid.experiment.processing import pipeline
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.readers.formats import parquet_file
from sdpid.experiment.readers.read import read_recording
from sdpid.experiment.recording import stored
from sdpid.experiment.recording.gaps import continuous, split_at_gaps, unwrapped
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.recording.recording import Recording, Stamps
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm

RATE, JOINTS = 100.0, 2
# Fast enough to forget within a few samples, so that records can be short.
QUICK = Processing(cutoff_hz=10.0, decimation=2, reversal_time=0.02, derivative="central4")
ARM = small_arm(JOINTS)


def make(seconds: float = 12.0, lead: float = 0.0, jitter: float = 0.0, **fields: Any) -> Recording:
    rng = np.random.default_rng(0)
    time = np.arange(round((seconds + 2 * lead) * RATE)) / RATE
    angle = 2 * np.pi * time[:, None] / 2.0 + [0.0, 1.0]
    noise = lambda: 1e-3 * rng.standard_normal(angle.shape)  # noqa: E731
    return Recording(
        time=time + jitter / RATE * rng.uniform(-0.5, 0.5, time.size),
        position=np.sin(angle) + noise(),
        velocity=np.pi * np.cos(angle) + noise(),
        effort=3.0 * np.cos(2 * angle) + 100 * noise(),
        **fields,
    )


PERIODIC = {"period": 2.0, "periods": 6}
RECORDS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "periodic": (PERIODIC, {}),
    "with a lead": ({"lead": 1.5, "start": 1.5, **PERIODIC}, {}),
    "filtered twice": (PERIODIC, {"filter_alike": False}),
    "pooled": (PERIODIC, {"covariance": "pooled", "shrinkage": 0.5, "velocity": "measured"}),
    "no covariance": (PERIODIC, {"covariance": None}),
    "without periods": ({}, {}),
    "by stamp": ({"jitter": 0.4}, {"timing": "resample"}),
    "jitter": ({"jitter": 0.2, **PERIODIC}, {}),
}


@pytest.fixture(params=["small", "one group"])
def file_of(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Write a recording with small or large row groups, which are then decoded in small pieces."""
    rows = {"small": 101, "one group": 1 << 20}[request.param]

    def write(log: Recording) -> Path:
        file = tmp_path / "log.parquet"
        log.to_parquet(file)
        schema = pq.read_schema(file)
        table = pq.read_table(file)
        pq.write_table(table.replace_schema_metadata(schema.metadata), file, row_group_size=rows)
        return file

    monkeypatch.setattr(stored, "ROWS", 37)
    monkeypatch.setattr(parquet_file, "ROWS", 37)
    monkeypatch.setattr(parquet_file, "_BUFFER", 1000)
    monkeypatch.setattr(pipeline, "CHUNK", 250)
    return write


@pytest.mark.parametrize("case", RECORDS)
def test_samples_are_the_same_to_the_last_bit(case: str, file_of: Any):
    log, processing = make(**RECORDS[case][0]), replace(QUICK, **RECORDS[case][1])
    again = read_recording(file_of(log), stored=True)
    assert again.stored
    assert not log.stored
    expected, samples = process(log, processing), process(again, processing)
    require_same(samples, expected, 1)
    for name in ("covariance", "mask"):
        a, b = getattr(samples, name), getattr(expected, name)
        assert (a is None) == (b is None)
        np.testing.assert_array_equal(a, b, err_msg=name)
    assert samples.notes == expected.notes
    assert (samples.effort_periods is None) == (expected.effort_periods is None)


def test_memory_does_not_grow_with_the_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The most that NumPy is given for a record, and for one ten times as long."""
    monkeypatch.setattr(pipeline, "_MOST_KEPT", 0)
    monkeypatch.setattr(stored, "ROWS", 10_000)
    peaks = []
    for periods in (8, 80):
        file = tmp_path / f"{periods}.parquet"
        make(200.0 * periods, period=200.0).to_parquet(file)
        tracemalloc.start()
        log = read_recording(file, stored=True)
        samples = process(log, Processing(cutoff_hz=10.0, covariance=None))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert samples.effort_periods is None
    values = 8 * 200 * 100 * (80 - 8) * (1 + 3 * JOINTS)
    # The steps of all stamps: one of seven channels.
    assert peaks[1] - peaks[0] < 0.2 * values


def test_a_full_disk_is_a_data_error(monkeypatch: pytest.MonkeyPatch):
    full = OSError(28, "No space left on device")
    monkeypatch.setattr(stored.tempfile, "TemporaryFile", Mock(side_effect=full))
    words = r"does not fit .*No space left on device.* set TMPDIR"
    refuses(DataError, words, stored.store, 10, 2, [])


COLUMNS = make().columns()


def spoilt(name: str, row: int, value: Any) -> dict[str, Any]:
    values: list[Any] = COLUMNS[name].tolist()
    values[row] = value
    return {name: values}


BAD = [
    (spoilt("position_2", 703, np.nan), r"row 704: position: 'position_2' has no value"),
    (spoilt("effort_1", 5, -np.inf), r"row 6: effort: 'effort_1' is -inf, not finite"),
    (spoilt("effort_2", 99, 3e13), r"row 100: effort: 'effort_2' is 3e\+13, more than"),
    ({"effort_1": ["a"] * 1200}, "'effort_1' holds object, expected numbers"),
    (spoilt("time", 100, np.nan), "row 101: time: 'time' has no value"),
    # Bytes that are damaged.
    ({}, "not a readable Parquet file"),
]


@pytest.mark.parametrize(("changes", "message"), BAD, ids=[message for _, message in BAD])
def test_bad_values_are_refused_as_they_are_read(
    changes: dict[str, Any], message: str, tmp_path: Path
):
    file = tmp_path / "log.parquet"
    pq.write_table(pa.table(COLUMNS | changes), file, row_group_size=100)
    if not changes:
        content = bytearray(file.read_bytes())
        content[2000:40000] = bytes(38000)
        file.write_bytes(content)
    refuses(DataError, message, read_recording, file, stored=True)


def test_large_files_stay_on_disk_by_default(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    file = tmp_path / "log.parquet"
    log = make(**PERIODIC)
    log.to_parquet(file)
    assert not read_recording(file).stored
    monkeypatch.setattr(parquet_file, "LARGE", 8 * 1200 * 7 - 1)
    assert read_recording(file).stored
    assert not read_recording(file, stored=False).stored
    assert read_recording(file, periods=4).period_layout == (0, 200, 4)
    monkeypatch.setattr(parquet_file, "LARGE", 8 * 1200 * 7)
    assert not read_recording(file).stored
    turned = read_recording(file, stored=True, units={"position": "deg"}, effort_scale=[2.0, 3.0])
    assert turned.stored
    np.testing.assert_array_equal(turned.position, log.position * (np.pi / 180.0))
    np.testing.assert_array_equal(turned.effort, log.effort * [2.0, 3.0])
    np.savez(tmp_path / "log.npz", t=log.time, q=log.position, tau=log.effort)
    words = "stored=True keeps the values of Parquet files"
    refuses(DataError, words, read_recording, tmp_path / "log.npz", stored=True)


def test_it_can_be_written_matched_and_sent(tmp_path: Path):
    file, copy = tmp_path / "log.parquet", tmp_path / "copy.parquet"
    names = ARM.joint_names[::-1]
    log = make(joint_names=names, **PERIODIC)
    log = replace(log, reference=0.9 * log.position)
    log.to_parquet(file)
    picked = read_recording(file, joint_names=names[1:], stored=True)
    np.testing.assert_array_equal(picked.reference, log.reference[:, 1:])
    kept = read_recording(file, stored=True)
    assert not kept.position.flags.writeable
    assert not (2.0 * kept.position).mapped
    # Some rows are arrays in memory.
    rows = log.position[:, 0] > 0.0
    np.testing.assert_array_equal(kept.position[rows], log.position[rows])
    again = pickle.loads(pickle.dumps(kept))
    again.to_parquet(copy)
    assert copy.read_bytes() == file.read_bytes()
    matched = match_joints(ARM, again)
    assert matched.stored
    assert matched.joint_names == ARM.joint_names
    for name in ("position", "velocity", "effort", "reference"):
        np.testing.assert_array_equal(getattr(matched, name), getattr(log, name)[:, ::-1])
    assert repr(matched) == repr(log)


@settings(max_examples=60, deadline=None)
@given(steps=st.lists(st.sampled_from([0.5, 1.0, 2.0, 3.0]), min_size=1, max_size=30))
def test_stamps_are_counted(steps: list[float]):
    time = np.cumsum([10.0, *steps])
    found = Stamps.of(time)
    assert (found.first, found.last) == (10.0, time[-1])
    assert (found.least, found.most) == (min(steps), max(steps))
    assert found.row == 1 + steps.index(max(steps))
    for row in range(1, time.size):
        wrong = time.copy()
        wrong[row:] -= steps[row - 1]
        words = rf"time repeats at row {row + 1}: .*\(1 such rows\)"
        refuses(DataError, words, Stamps.of, wrong)


def test_noise_that_the_filter_removes_is_no_wrong_period():
    log = make(40.0, period=2.0)
    angle = 2 * np.pi * log.time[:, None] / 2.0 + [0.0, 1.0]
    draw = np.random.default_rng(0).standard_normal(angle.shape)
    slow = Processing(cutoff_hz=0.8, decimation=2, reversal_time=None, covariance=None)
    # Two periods of noise, apart by far more than the limit of a hundredth before the filter.
    few, much = (replace(log, position=0.01 * np.sin(angle) + a * draw) for a in (0.03, 0.3))
    process(few, slow)
    refuses(DataError, r"do not repeat: their positions spread by 0\.0", process, much, slow)


# Records with gaps, wrapped angles and late stamps.


GAP_RATE = 100.0
SETTING = sdpid.Processing(
    cutoff_hz=8.0, order=2, decimation=2, reversal_time=None, derivative="central4"
)
FIELDS = ("position", "velocity", "acceleration", "effort", "time")


def record(seconds: float = 20.0, seed: int = 0, joints: int = 2) -> sdpid.Recording:
    rng = np.random.default_rng(seed)
    time = 5.0 + np.arange(round(GAP_RATE * seconds)) / GAP_RATE
    omega = rng.uniform(1.0, 6.0, joints)
    position = np.sin(omega * time[:, None])
    noise = rng.standard_normal((2, *position.shape))
    return sdpid.Recording(
        time=time,
        position=position + 1e-4 * noise[0],
        effort=position + noise[1],
        velocity=omega * np.cos(omega * time[:, None]),
    )


def require_same(samples: sdpid.Samples, expected: sdpid.Samples, pieces: int) -> None:
    assert len(samples.starts) == pieces
    assert samples.starts == expected.starts
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(samples, name), getattr(expected, name))


def without(log: sdpid.Recording, *cuts: tuple[int, int]) -> sdpid.Recording:
    keep = np.ones(log.n_samples, dtype=bool)
    for first, stop in cuts:
        keep[first:stop] = False
    return log.rows(keep)


cuts = st.lists(st.tuples(st.integers(150, 1850), st.integers(5, 90)), min_size=1, max_size=4).map(
    lambda found: [(first, first + count) for first, count in found]
)


@settings(max_examples=25, deadline=None)
@given(cuts=cuts, seed=st.integers(0, 9), velocity=st.sampled_from(["differentiated", "measured"]))
def test_gaps_part_a_record_into_records(cuts: list[tuple[int, int]], seed: int, velocity: str):
    log = without(record(seed=seed), *cuts)
    setting = replace(SETTING, velocity=velocity)
    ends = np.flatnonzero(np.diff(log.time) > 5.5 / GAP_RATE) + 1
    bounds = [0, *ends.tolist(), log.n_samples]
    apart = []
    for first, stop in pairwise(bounds):
        if stop - first < 2:
            continue
        try:
            apart.append(sdpid.process(log.rows(slice(first, stop)), setting))
        except DataError as cause:
            assert "cut off at either end" in str(cause)  # noqa: PT017 (not every piece is short)
    together = sdpid.process(log, setting)
    require_same(together, sdpid.Samples.join(apart), len(apart))
    if len(bounds) > 2:
        assert "split at" in together.notes[0]


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
    dropped = "1 of 3 pieces dropped, too short to be filtered: 3 samples, 0.02 s"
    assert samples.notes[:2] == (notes[0], dropped)
    assert len(samples.starts) == 2
    assert any("2 pieces joined" in note for note in samples.notes)
    few = record().rows(np.arange(2000) % 30 < 4)
    words = r"split the record into 67 pieces, each too short; .* 4 s"
    refuses(DataError, words, sdpid.process, few, SETTING)


def test_few_lost_samples_are_bridged() -> None:
    log = record()
    assert split_at_gaps(log)[0] is log
    assert continuous(log) == ((log,), [])
    for lost, pieces in ((4, 1), (5, 2)):
        assert len(split_at_gaps(without(log, (700, 700 + lost)))) == pieces
    bridged = sdpid.process(without(log, (700, 704)), SETTING)
    assert bridged.starts == (0,)
    assert "resampled" in bridged.notes[0]
    # At 1 kHz five samples are less than any motion of an arm needs to be seen.
    time = np.arange(8000) / 1000.0
    position = np.sin(np.pi * time)[:, None]
    log = sdpid.Recording(time=time, position=position, effort=position, period=2.0)
    lost, setting = without(log, (3000, 3005)), replace(SETTING, covariance=None)
    samples, expected = sdpid.process(lost, setting), sdpid.process(log, setting)
    np.testing.assert_allclose(samples.acceleration, expected.acceleration, atol=1e-3)
    assert sdpid.process(replace(lost, period=None), setting).starts == (0,)


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


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 99), slower=st.sampled_from([1.0, 1.4, 2.0]), end=st.integers(60, 700))
def test_lost_samples_are_not_taken_for_late_ones(seed: int, slower: float, end: int) -> None:
    """Stamps jitter, and the rate changes half-way."""
    rng = np.random.default_rng(seed)
    steps = np.where(np.arange(800) < 400, 1.0, slower) / GAP_RATE
    steps += rng.choice([-0.2, 0.2], 800) / GAP_RATE
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
    both = np.column_stack([wrapped, still])
    log = sdpid.Recording(time=time, position=both, effort=np.zeros((600, 2)))
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
    assert samples.notes[0].endswith(f"by whole turns; jumps of joint 2 {jumps}")
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
    assert replace(chosen, reasons=()) == default_processing(log.rows(slice(0, 1200)))


def test_a_stored_record_is_split_and_continued_as_well(tmp_path: Path) -> None:
    log = without(record(), (900, 960))
    position = np.array(log.position)
    position[:, 1] = np.mod(2.0 * log.time + position[:, 1], 2.0 * np.pi)
    log = replace(log, position=position)
    log.to_parquet(tmp_path / "log.parquet")
    stored = sdpid.read_recording(tmp_path / "log.parquet", stored=True)
    assert stored.stored
    require_same(*(sdpid.process(each, default_processing(each)) for each in (stored, log)), 2)
