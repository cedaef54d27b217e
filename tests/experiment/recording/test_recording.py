import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sdpid.errors import DataError, ExportError
from sdpid.experiment.readers.read import read_recording
from sdpid.experiment.recording.degrees import require_plausible_units, suspect_units
from sdpid.experiment.recording.recording import Recording
from tests.helpers.refusals import refuses

N, JOINTS = 12, 2


def fields(**changes: Any) -> dict[str, Any]:
    rng = np.random.default_rng(1)
    return {
        "time": 5.0 + 0.01 * np.arange(N),
        "position": rng.standard_normal((N, JOINTS)),
        "effort": rng.standard_normal((N, JOINTS)),
    } | changes


def with_value(values: np.ndarray, index: Any, value: float) -> np.ndarray:
    values = values.copy()
    values[index] = value
    return values


def test_large_arrays_are_kept_as_read_only_views():
    given_fields = fields()
    recording = Recording(**given_fields)
    for name, array in given_fields.items():
        kept = getattr(recording, name)
        assert np.shares_memory(kept, array)
        assert not kept.flags.writeable
        assert array.flags.writeable
    assert (recording.n, recording.n_samples) == (JOINTS, N)
    assert recording.rate_hz == pytest.approx(100.0, rel=1e-9)
    assert recording.duration == pytest.approx(0.11)
    assert repr(recording) == "Recording(12 samples, 2 joints, 100 Hz)"


def test_lists_and_other_orders_become_contiguous_floats():
    position = np.asfortranarray(fields()["position"])
    recording = Recording(**fields(position=position, time=list(range(N))))
    assert recording.position.flags.c_contiguous
    assert recording.time.dtype == np.float64


TIME = fields()["time"]
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "not finite": (
        {"position": with_value(fields()["position"], (3, 1), np.nan)},
        r"position: 1 of 24 values are not finite, the first at index \(3, 1\)",
    ),
    "infinite": ({"effort": with_value(fields()["effort"], (0, 0), np.inf)}, "effort.*not finite"),
    "ragged": ({"position": [[1.0, 2.0], [1.0]] * 6}, "position: not a rectangular array"),
    "text": ({"position": [["a", "b"]] * N}, "position: not a rectangular array of real"),
    "backwards": ({"time": with_value(TIME, 4, 5.0)}, "time runs backwards at row 5"),
    "repeated": ({"time": with_value(TIME, 4, TIME[3])}, "time repeats at row 5"),
    "one axis": ({"position": np.zeros(N)}, "position: has 1 axes"),
    "rows": ({"effort": np.zeros((N - 1, 2))}, r"effort: has shape \(11, 2\), expected \(12, 2\)"),
    "joints": ({"effort": np.zeros((N, 3))}, r"effort: has shape \(12, 3\)"),
    "velocity": ({"velocity": np.zeros((N, 3))}, r"velocity: has shape \(12, 3\)"),
    "no joints": ({"position": np.zeros((N, 0))}, "position: has no joints"),
    "no effort": ({"effort": None}, "effort is missing"),
    "one sample": (
        {"time": [0.0], "position": [[0.0, 0.0]], "effort": [[0.0, 0.0]]},
        "1 samples, at least 2",
    ),
    "names repeat": ({"joint_names": ("a", "a")}, "joint_names: a is there more than once"),
    "names count": ({"joint_names": ("a", "b", "c")}, r"3 names \(a, b, c\) for 2 joints"),
    "names kind": ({"joint_names": (1, 2)}, "not a name"),
    "names text": ({"joint_names": "ab"}, "expected a sequence"),
    "period": ({"period": 0.05}, r"period: 0.05 s \(5 samples\) does not divide the record: .* 12"),
    "period long": ({"period": 1.0}, "does not divide"),
    "period short": ({"period": 0.01}, "shorter than 2 steps"),
    "period sign": ({"period": -1.0}, "positive"),
    "period nan": ({"period": np.nan}, "period: is nan, expected a finite"),
    "period text": ({"period": "long"}, "period: is 'long', expected a finite"),
    "start text": ({"period": 0.04, "start": "now"}, "start: is 'now'"),
    "periods fraction": ({"period": 0.04, "periods": 1.5}, "periods: is 1.5"),
    "period fraction": ({"period": 0.0242, "periods": 4}, "not a whole number"),
    "periods": ({"period": 0.04, "periods": 4}, "4 periods of 4 samples do not fit"),
    "periods zero": ({"period": 0.04, "periods": 0}, "periods: is 0"),
    "periods alone": ({"periods": 3}, "without a period"),
    "start alone": ({"start": 5.0}, "without a period"),
    "start early": ({"period": 0.04, "start": 4.9}, "start: 4.9 s is outside the record"),
    "start late": ({"period": 0.04, "start": 6.0}, "start: 6 s is outside the record"),
    "start inside": ({"period": 0.06, "start": 5.01}, "does not divide"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused(case: str):
    changes, message = BAD[case]
    refuses(DataError, message, Recording, **fields(**changes))


@pytest.mark.parametrize(
    ("changes", "layout"),
    [
        ({}, None),
        ({"period": 0.04}, (0, 4, 3)),
        ({"period": 0.04, "start": 5.04}, (4, 4, 2)),
        ({"period": 0.04, "start": 5.01, "periods": 2}, (1, 4, 2)),
        ({"period": 0.12}, (0, 12, 1)),
    ],
)
def test_whole_periods_are_found(changes: dict[str, Any], layout: tuple[int, int, int] | None):
    assert Recording(**fields(**changes)).period_layout == layout


def test_nominal_step_withstands_heavy_jitter():
    rng = np.random.default_rng(0)
    time = 0.01 * np.arange(4000) + rng.uniform(-3e-3, 3e-3, 4000)
    table = np.zeros((time.size, 1))
    step = Recording(time=time, position=table, effort=table).step
    assert step == pytest.approx((time[-1] - time[0]) / 3999, rel=1e-12)


def test_nominal_step_counts_lost_samples():
    time = np.delete(0.01 * np.arange(1000), [3, 7, 100, 500, 501, 505, 996])
    table = np.zeros((time.size, 1))
    step = Recording(time=time, position=table, effort=table).step
    assert step == pytest.approx(0.01, rel=1e-12)


def test_nominal_step_withstands_lost_samples_and_jitter():
    rng = np.random.default_rng(0)
    time = 0.01 * np.arange(1000) + rng.uniform(-2e-3, 2e-3, 1000)
    time = np.delete(time, [100, 500, 501])
    table = np.zeros((time.size, 1))
    assert Recording(time=time, position=table, effort=table).step == pytest.approx(0.01, rel=4e-4)


names = st.text(min_size=1, max_size=8).filter(lambda text: text.isprintable())


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_parquet_keeps_everything(tmp_path: Path, data: st.DataObject):
    n = data.draw(st.integers(1, 3))
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    size = data.draw(st.sampled_from([4, 12]))
    draw = lambda: rng.standard_normal((size, n)) * 10.0 ** rng.integers(-300, 10)  # noqa: E731
    periodic = data.draw(st.booleans())
    recording = Recording(
        time=data.draw(st.floats(-1e9, 1e9)) + 0.25 * np.arange(size),
        position=draw(),
        effort=draw(),
        velocity=draw() if data.draw(st.booleans()) else None,
        joint_names=data.draw(
            st.none() | st.lists(names, min_size=n, max_size=n, unique=True).map(tuple)
        ),
        period=1.0 if periodic else None,
        periods=1 if periodic else None,
    )
    file = tmp_path / "log.parquet"
    recording.to_parquet(file)
    again = read_recording(file)
    for name in ("time", "position", "effort", "velocity"):
        before, after = getattr(recording, name), getattr(again, name)
        assert (before is None) == (after is None)
        if before is not None:
            assert before.tobytes() == after.tobytes()
    for name in ("joint_names", "period", "start", "periods"):
        assert getattr(recording, name) == getattr(again, name)
    assert [entry.name for entry in tmp_path.iterdir()] == ["log.parquet"]


def test_parquet_has_readable_columns(tmp_path: Path):
    file = tmp_path / "log.parquet"
    Recording(**fields(joint_names=("waist", "elbow"), period=0.04, start=5.0)).to_parquet(file)
    table = pq.read_table(file)
    assert table.column_names == [
        "time", "position_waist", "position_elbow", "effort_waist", "effort_elbow",
    ]  # fmt: skip
    assert json.loads(table.schema.metadata[b"sdpid"])["period"] == 0.04


def test_parquet_without_metadata(tmp_path: Path):
    file = tmp_path / "log.parquet"
    columns = {"effort_b": [1, 2], "time": [0, 1], "position_b": [3.0, 4.0]}
    pq.write_table(pa.table(columns), file)
    recording = read_recording(file)
    assert recording.joint_names == ("b",)
    assert recording.effort.tolist() == [[1.0], [2.0]]


def test_parquet_failures_are_data_errors(tmp_path: Path):
    file = tmp_path / "log.parquet"
    refuses(DataError, "no such file", read_recording, file)
    file.write_bytes(b"PAR1 not really")
    refuses(DataError, "not a readable Parquet file", read_recording, file)
    Recording(**fields()).to_parquet(file)
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    refuses(DataError, "not a readable Parquet file", read_recording, file)
    pq.write_table(pa.table({"time": [0.0], "position_1": [0.0]}), file)
    refuses(DataError, "effort is missing", read_recording, file)
    pq.write_table(
        pa.table({"time": [0.0, 1.0], "position_1": [0, None], "effort_1": [0, 1]}), file
    )
    refuses(DataError, "row 2: position: 'position_1' has no value", read_recording, file)
    pq.write_table(pa.table({"time": ["a"], "position_1": [0], "effort_1": [0]}), file)
    refuses(DataError, "time: holds object, expected numbers", read_recording, file)
    for raw, message in ((b"{", "damaged"), (b'{"format": 99}', "is of format 99")):
        table = pa.table({"time": [0.0]}).replace_schema_metadata({b"sdpid": raw})
        pq.write_table(table, file)
        refuses(DataError, message, read_recording, file)


def test_parquet_to_a_missing_folder(tmp_path: Path):
    with pytest.raises(ExportError):
        Recording(**fields()).to_parquet(tmp_path / "absent" / "log.parquet")


def motion(*ranges: tuple[float, float]) -> Recording:
    position = np.linspace(*np.array(ranges).T, 50)
    names = tuple("abcdef"[: len(ranges)])
    return Recording(
        time=np.arange(50.0), position=position, effort=np.zeros_like(position), joint_names=names
    )


ARM = (-2.8, 2.8)
FREE = (-np.inf, np.inf)
TURN = (-2 * np.pi, 2 * np.pi)
UNITS = {
    "radians": (motion((-2.5, 2.5), (-1, 1)), [ARM, ARM], ()),
    "degrees": (motion((-140, 140), (-60, 10)), [ARM, ARM], ("a", "b")),
    "only what is clear": (motion((-140, 140), (-2, 2)), [ARM, ARM], ("a",)),
    "small motion far from zero": (motion((89, 91)), [ARM], ("a",)),
    "small range in degrees": (motion((-6, 6)), [ARM], ("a",)),
    "beyond a narrow range": (motion((-1.0, 1.0)), [(-1.57, -0.7)], ()),
    "a little beyond": (motion((-3.0, 3.0)), [ARM], ()),
    "wrapped by a turn": (motion((5.0, 8.0)), [ARM], ()),
    "one full turn": (motion((-6.2, 6.2)), [TURN], ()),
    "free joint turns": (motion((0, 500), (-1, 1)), [FREE, ARM], ()),
    "free joint with a clear one": (motion((0, 500), (-90, 90)), [FREE, ARM], ("a", "b")),
    "all free": (motion((-120, 170), (0, 300)), [FREE, FREE], ("a", "b")),
    "wheels": (motion((0, 5000), (0, 3000)), [FREE, FREE], ()),
    "nonsense is not degrees": (motion((-1e4, 1e4)), [ARM], ()),
    "limits unknown": (motion((-140, 140), (-60, 10), (-2, 2)), None, ("a", "b")),
    "limits unknown, one turns": (motion((-140, 140), (-1, 1), (-2, 2)), None, ()),
    "limits unknown, one joint": (motion((-140, 140)), None, ()),
}


@pytest.mark.parametrize("case", UNITS)
def test_degrees_are_suspected(case: str):
    recording, limits, expected = UNITS[case]
    assert suspect_units(recording, limits) == expected
    if not expected:
        require_plausible_units(recording, limits)
        return
    with pytest.raises(DataError, match=r"looks like degrees.*units=") as caught:
        require_plausible_units(recording, limits)
    for name in expected:
        assert f"{name} from" in str(caught.value)


def test_limits_of_another_shape():
    refuses(DataError, "position_limits", suspect_units, motion((0, 1)), [1.0, 2.0])


def test_absurd_sizes_are_refused():
    time, table = 0.01 * np.arange(20), np.ones((20, 2))
    wrong = table.copy()
    wrong[7, 1] = -2e18
    with pytest.raises(DataError, match=r"effort: is -2e\+18 at index \(7, 1\)"):
        Recording(time=time, position=table, effort=wrong)
    refuses(DataError, "say their unit", Recording, time=1e-12 * time, position=table, effort=table)
    for period in (1e308, 10**400, 10**5000):
        with pytest.raises(DataError, match=r"period: is .*finite number of at most"):
            Recording(time=time, position=table, effort=table, period=period)
