"""Recordings: what they hold and refuse, their joints, bases and velocities."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import t

import sdpid
from sdpid.assurance.recipe.inputs import recording_digest
from sdpid.assurance.rollouts.rollout import _prepared
from sdpid.errors import DataError, ExportError
from sdpid.experiment.preparation.twin import Twin
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.readers.read import read_recording
from sdpid.experiment.recording.gaps import continuous
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.recording.plausible import (
    disagreement,
    require_plausible_units,
    suspect_units,
    velocity_fit,
)
from sdpid.experiment.recording.recording import Recording, rows_of
from tests.helpers.arm_files import ARM_URDF
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
    "no joints": ({"position": np.zeros((N, 0))}, r"position: .*expected \(12, 1\)"),
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
    table = pa.table({"time": [0.0, 1.0], "position_1": [0, None], "effort_1": [0, 1]})
    pq.write_table(table, file)
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


# Joints of a recording matched with those of a robot.


def log_of(names: tuple[str, ...] | None, joints: int | None = None) -> sdpid.Recording:
    """A recording whose column j holds j everywhere, but for its motion in time."""
    n = joints or len(names or ())
    time = np.arange(20) / 10.0
    columns = np.arange(n) + 0.01 * time[:, None]
    return sdpid.Recording(
        time=time,
        position=columns,
        effort=columns,
        velocity=columns,
        joint_names=names,
    )


def columns_of(robot: sdpid.RobotModel, log: sdpid.Recording) -> list[int]:
    matched = match_joints(robot, log)
    assert matched.joint_names == robot.joint_names
    assert matched.velocity is not None
    np.testing.assert_array_equal(matched.position, matched.effort)
    np.testing.assert_array_equal(matched.position, matched.velocity)
    return matched.position[0].astype(int).tolist()


@pytest.fixture(scope="module")
def ur5() -> sdpid.RobotModel:
    return sdpid.load_robot("ur_description/ur5_robot")


# The order of the Universal Robots driver's /joint_states: alphabetical, the elbow first.
DRIVER = (
    "elbow_joint",
    "shoulder_lift_joint",
    "shoulder_pan_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)


def test_driver_order_with_a_prefix(ur5: sdpid.RobotModel) -> None:
    prefixed = tuple(f"left_{name}" for name in DRIVER)
    assert columns_of(ur5, log_of(prefixed)) == [2, 1, 0, 3, 4, 5]
    assert columns_of(ur5, log_of(DRIVER)) == [2, 1, 0, 3, 4, 5]


@given(
    order=st.permutations(range(6)),
    prefix=st.text("abc_/1", max_size=4),
    suffix=st.sampled_from(["", "_joint", "_position", "7"]),
)
def test_one_prefix_and_one_suffix_do_not_matter(
    ur5: sdpid.RobotModel, order: list[int], prefix: str, suffix: str
) -> None:
    cores = [name.removesuffix("_joint") for name in ur5.joint_names]
    names = tuple(f"{prefix}{cores[j]}{suffix}" for j in order)
    assert columns_of(ur5, log_of(names)) == [order.index(j) for j in range(6)]


def test_columns_of_other_joints_are_left_out(ur5: sdpid.RobotModel) -> None:
    assert columns_of(ur5, log_of(("finger_joint", *DRIVER))) == [3, 2, 1, 4, 5, 6]
    arm = tuple(f"ur_{name}" for name in DRIVER)
    assert columns_of(ur5, log_of(("ur_finger_joint", *arm))) == [3, 2, 1, 4, 5, 6]


def test_two_arms_are_refused_unless_one_has_the_names(ur5: sdpid.RobotModel) -> None:
    arms = tuple(f"{side}_{name}" for side in ("left", "right") for name in DRIVER)
    with pytest.raises(DataError, match=r"in 2 ways: left_shoulder_pan_joint, .*; right_"):
        match_joints(ur5, log_of(arms))
    assert columns_of(ur5, log_of((*arms, *DRIVER))) == [14, 13, 12, 15, 16, 17]


@pytest.mark.parametrize(
    "names",
    [
        # Each ends in t, as the robot's do.
        ("a_joint", "b_joint", "c_joint", "d_joint", "e_joint", "f_joint"),
        (*DRIVER[:5], "wrist_joint"),
        ("left_elbow_joint", *DRIVER[1:]),
    ],
)
def test_other_names_are_refused(ur5: sdpid.RobotModel, names: tuple[str, ...]) -> None:
    refuses(DataError, "not even with another prefix or suffix", match_joints, ur5, log_of(names))


def test_without_names_the_columns_are_taken_in_order(ur5: sdpid.RobotModel) -> None:
    assert columns_of(ur5, log_of(None, 6)) == [0, 1, 2, 3, 4, 5]
    refuses(DataError, "has 7 joints, the robot 'ur5", match_joints, ur5, log_of(None, 7))


def test_too_few_columns_are_refused(ur5: sdpid.RobotModel) -> None:
    refuses(DataError, "has 5 joints, the robot 'ur5", match_joints, ur5, log_of(DRIVER[:5]))


def test_a_log_in_driver_order_is_identified_as_in_the_robot_s(ur5: sdpid.RobotModel) -> None:
    time = np.arange(2000) / 100.0
    rate = 2.0 * np.pi * np.linspace(0.2, 0.5, 6)
    position = 0.5 * np.sin(rate * time[:, None]) - 1.2
    velocity = 0.5 * rate * np.cos(rate * time[:, None])
    effort = ur5.inverse_dynamics(ur5.prior, position, velocity, -(rate**2) * (position + 1.2))
    log = sdpid.Recording(time=time, position=position, effort=effort, joint_names=ur5.joint_names)
    order = [ur5.joint_names.index(name) for name in DRIVER]
    driver = replace(
        log,
        position=log.position[:, order],
        effort=log.effort[:, order],
        joint_names=tuple(f"left_{name}" for name in DRIVER),
    )
    found = [sdpid.identify(ur5, each, friction=(), intervals=False) for each in (log, driver)]
    np.testing.assert_array_equal(found[0].estimate.base, found[1].estimate.base)


# What a recording has of a floating base: checked when made, kept wherever rows are.


ROWS = 40


def base(**changes: Any) -> sdpid.BaseMotion:
    turns = Rotation.from_rotvec(np.linspace(0.0, 7.0, ROWS)[:, None] * [0.2, 0.5, -0.8])
    rng = np.random.default_rng(0)
    given = {
        "orientation": turns.as_quat(canonical=True),
        "position": rng.standard_normal((ROWS, 3)),
        "angular_velocity": rng.standard_normal((ROWS, 3)),
        "velocity_frame": "world",
        "imu": sdpid.Imu(accelerometer=rng.standard_normal((ROWS, 3)), translation=(0.1, 0.0, 0.0)),
    }
    return sdpid.BaseMotion(**{**given, **changes})


def contacts(**changes: Any) -> sdpid.Contacts:
    rng = np.random.default_rng(1)
    given = {
        "frames": ("left", "right"),
        "down": rng.random((ROWS, 2)) > 0.5,
        "forces": rng.standard_normal((ROWS, 2, 3)),
        "offset": (0.0, 0.0, -0.02),
    }
    return sdpid.Contacts(**{**given, **changes})


def log(**changes: Any) -> Recording:
    rng = np.random.default_rng(2)
    given = {
        "time": 0.01 * np.arange(ROWS),
        "position": np.sin(0.05 * np.arange(ROWS)[:, None] + [0.0, 1.0]),
        "effort": rng.standard_normal((ROWS, 2)),
        "base": base(),
        "contacts": contacts(),
    }
    return Recording(**{**given, **changes})


def test_orientations_are_unit_quaternions_without_changes_of_sign() -> None:
    given = Rotation.from_rotvec(np.linspace(0.0, 7.0, ROWS)[:, None] * [0.2, 0.5, -0.8])
    rounded = np.round(given.as_quat(canonical=True), 4)
    found = base(orientation=rounded)
    assert np.abs(np.linalg.norm(found.orientation, axis=1) - 1.0).max() < 1e-15
    assert np.einsum("ki,ki->k", found.orientation[1:], found.orientation[:-1]).min() > 0.9
    assert found.rotations == pytest.approx(given.as_matrix(), abs=2e-4)
    assert not found.orientation.flags.writeable


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: base(orientation=np.ones((ROWS, 4))),
            "sample 1 has the norm 2.*off 1 by 1, limit",
        ),
        (lambda: base(orientation=np.ones((ROWS, 3))), r"\(40, 3\), expected \(40, 4\)"),
        (lambda: base(position=np.zeros((ROWS - 1, 3))), r"\(39, 4\).*as many rows as position"),
        (lambda: base(velocity_frame=None), "'world' or 'base': the axes of angular_velocity"),
        (lambda: base(angular_velocity=None), "without a velocity"),
        (lambda: base(imu=sdpid.Imu(gyroscope=np.zeros((3, 3)))), "base.imu: has 3 samples"),
        (lambda: sdpid.Imu(), "neither gyroscope nor accelerometer"),
        (lambda: sdpid.Imu(gyroscope=np.zeros((3, 3)), rotation=-np.eye(3)), "determinant is -1"),
        (lambda: contacts(frames=("a", "a")), "a is there more than once"),
        (lambda: contacts(kind="blob"), "'blob' is not known; known are point, line, plane"),
        (lambda: contacts(down=np.full((ROWS, 2), 0.5)), "holds 0.5, expected True or False"),
        (lambda: contacts(forces=np.zeros((ROWS, 2, 6))), r"expected \(40, 2, 3\)"),
        (lambda: contacts(wrenches=np.zeros((ROWS, 2, 6))), "not both"),
        (lambda: contacts(down=None, forces=None), "nothing is known of contacts"),
        (lambda: contacts(offset=np.zeros((3, 3))), r"expected \(3,\) or \(2, 3\)"),
        (lambda: log(base=None), "contacts: are given without a base"),
        (lambda: log(contacts=contacts().rows(slice(5))), "contacts: has 5 samples"),
        (lambda: log(base=5), "base: is int, expected sdpid.BaseMotion"),
    ],
)
def test_what_cannot_be_is_refused(make: Any, message: str) -> None:
    refuses(DataError, message, make)


def test_one_kind_and_one_offset_are_those_of_all_contacts() -> None:
    assert contacts().kind == ("point", "point")
    assert contacts().offset.tolist() == [[0.0, 0.0, -0.02]] * 2
    assert repr(contacts(kind=("point", "plane"))) == (
        "Contacts(40 samples, 1 point, 1 plane, flags, forces)"
    )
    assert repr(log()).endswith("floating base with IMU, 2 contacts)")


def test_rows_of_a_recording_keep_base_and_contacts() -> None:
    whole = log()
    part = rows_of(whole, slice(10, 30))
    assert part.base.orientation.tobytes() == whole.base.orientation[10:30].tobytes()
    assert part.base.imu.translation.tolist() == [0.1, 0.0, 0.0]
    assert (part.contacts.down == whole.contacts.down[10:30]).all()
    late = whole.time + np.where(np.arange(ROWS) < 20, 0.0, 1.0)
    pieces, _ = continuous(replace(whole, time=late))
    assert [piece.base.n_samples for piece in pieces] == [20, 20]


def test_the_digest_counts_base_and_contacts() -> None:
    digests = {
        recording_digest(log(**changes))
        for changes in (
            {},
            {"contacts": None},
            {"contacts": contacts(kind="plane")},
            {"base": base(position=None)},
            {"base": base(imu=None)},
        )
    }
    assert len(digests) == 5
    assert recording_digest(log()) in digests


def test_columns_in_files_carry_the_frame_of_velocities(tmp_path: Path) -> None:
    log().to_csv(tmp_path / "run.csv")
    header = (tmp_path / "run.csv").read_text().split("\n")[0].split(",")
    assert "base_angular_velocity_world_x" in header
    assert {"base_orientation_w", "accelerometer_z", "contact_left"} < set(header)
    assert "contact_force_right_z" in header


def commanded() -> Recording:
    return log(reference=np.zeros((ROWS, 2)), joint_names=("a", "b"))


TWO_JOINTS = sdpid.load_robot(ARM_URDF)


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda: sdpid.controllers.fit_controller(commanded(), "pd"), "fit_controller"),
        (lambda: sdpid.identify_payload(TWO_JOINTS, commanded()), "payload"),
        (lambda: sdpid.identify_drive_gains(TWO_JOINTS, log(currents=True)), "gains"),
        (lambda: Twin.of(TWO_JOINTS, commanded()), "simulated motion"),
        (lambda: _prepared(TWO_JOINTS, commanded(), None), "rollout"),
    ],
)
def test_what_knows_fixed_robots_only_refuses_a_floating_base(call: Any, what: str) -> None:
    refuses(DataError, f"{what}.*this recording has a floating base", call)


# Recorded velocities held against positions.


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
    chosen = default_processing(log)
    velocity = [text for text in chosen.why if text.startswith("velocity")]
    assert len(velocity) == 1
    if said is None:
        assert chosen.velocity == "measured"
        assert "agrees with positions" in velocity[0]
    else:
        assert chosen.velocity == "differentiated"
        assert re.search(said, velocity[0])


def test_a_joint_that_rests_says_nothing() -> None:
    log = moving()
    position, velocity = np.array(log.position), np.array(log.velocity)
    position[:, 1] = 0.3 + 1e-6 * np.sin(log.time)
    velocity[:, 1] = 1e-3 * np.random.default_rng(0).standard_normal(log.n_samples)
    resting = replace(log, position=position, velocity=velocity)
    assert velocity_fit(resting, 1) is None
    assert disagreement(resting, 1.0) is None
    assert default_processing(resting).velocity == "measured"


def test_too_few_samples_say_nothing() -> None:
    log = moving(seconds=0.1)
    assert log.n_samples == 5
    assert velocity_fit(log, 0) is None


def test_noise_of_positions_is_no_scale() -> None:
    log = moving()
    rate = np.sqrt(np.mean(log.velocity[:, 1] ** 2))
    # As much noise as makes the slope of the velocity over the rate 1 / (1 + 0.4²) = 0.86.
    noise = 0.4 * rate / (np.sqrt(2.0) * log.rate_hz)
    noisy = log.position + noise * np.random.default_rng(0).standard_normal(log.position.shape)
    log = replace(log, position=noisy)
    fit = velocity_fit(log, 1)
    assert fit.scale == pytest.approx(np.sqrt(1.0 / 1.16), abs=0.02)
    assert disagreement(log, 0.5) is None


# Drive gains: their errors, and the file that keeps them.


def some(seed: int = 0, n: int = 3) -> sdpid.DriveGains:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n))
    return sdpid.DriveGains(
        joint_names=[f'joint "{k}" \x7f 🦾' for k in range(n)],
        gains=rng.uniform(1.0, 20.0, n),
        covariance=root @ root.T / 100.0,
        freedom=[*rng.uniform(3.0, 50.0, n - 1), np.inf],
        basis="a load of 2 kg",
        sources={"a.csv": "00ff", "b c.csv": "11"},
        notes=("one", "two\nlines"),
    )


def test_a_file_keeps_every_digit(tmp_path: Path) -> None:
    gains = some()
    gains.to_toml(tmp_path / "gains.toml")
    read = sdpid.DriveGains.from_toml(tmp_path / "gains.toml")
    assert read.source.name == "gains.toml"
    assert {**read.to_dict(), "file": None} == gains.to_dict()
    assert sdpid.DriveGains.from_dict(read.to_dict()).to_dict() == read.to_dict()
    np.testing.assert_array_equal(read.covariance, gains.covariance)
    np.testing.assert_array_equal(read.freedom, gains.freedom)


def test_a_file_of_a_user_is_short(tmp_path: Path) -> None:
    (tmp_path / "g.toml").write_text('joint_names = ["a"]\ngains = [2]\n')
    gains = sdpid.DriveGains.from_toml(tmp_path / "g.toml")
    np.testing.assert_array_equal(gains.intervals(), [[2.0, 2.0]])
    assert gains.common_factor == 0.0


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 6))
def test_the_common_factor_is_the_largest(seed: int, n: int) -> None:
    gains = some(seed, n)
    C, c = gains.relative_covariance, gains.common_factor
    scale = np.linalg.eigvalsh(C)[-1]
    least = [np.linalg.eigvalsh(C - (c * s) ** 2)[0] for s in (0.99, 1.01)]
    assert least[0] > -1e-9 * scale
    assert least[1] < 0.0


def test_a_factor_alone_is_all_common() -> None:
    gains = np.array([10.0, 5.0, 1.0])
    one = sdpid.DriveGains(
        joint_names=("a", "b", "c"), gains=gains, covariance=0.01**2 * np.outer(gains, gains)
    )
    assert one.common_factor == pytest.approx(0.01)


def test_intervals_are_those_of_the_logarithm() -> None:
    gains = some()
    lower, upper = gains.intervals(0.9).T
    np.testing.assert_allclose(lower * upper, gains.gains**2)
    half = t.ppf(0.95, gains.freedom) * gains.standard_errors / gains.gains
    np.testing.assert_allclose(np.log(upper / lower), 2.0 * half)


def test_joints_are_taken_by_name() -> None:
    gains = some()
    last, first = gains.joint_names[2], gains.joint_names[0]
    two = gains.of_joints([last, first])
    np.testing.assert_array_equal(two.gains, gains.gains[[2, 0]])
    assert two.covariance[0, 1] == gains.covariance[2, 0]
    np.testing.assert_allclose(two.torque(np.ones((4, 2))), np.tile(two.gains, (4, 1)))
    refuses(DataError, "none for elbow", gains.of_joints, ["elbow"])


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"gains": [1.0, -2.0]}, "that of b is -2 N·m/A"),
        ({"gains": [1.0]}, "shape"),
        ({"joint_names": ("a", "a")}, "each joint a name"),
        ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "covariance is none"),
        ({"freedom": [1.0, 0.0]}, "positive"),
        ({"gains": [1.0, np.nan]}, "not finite"),
        ({"gains": [1e308, 1e-308], "covariance": np.full((2, 2), 1e308)}, "too large beside"),
        ({"sources": ["a.csv"]}, "names and digests"),
    ],
)
def test_what_are_no_gains_is_told(changed: dict[str, object], said: str) -> None:
    given = {"joint_names": ("a", "b"), "gains": [1.0, 2.0], **changed}
    refuses(DataError, said, sdpid.DriveGains, **given)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gains = [1.0]", "no joint_names"),
        ('joint_names = ["a"]\ngains = [1.0]\ngain = 2', "gain is not known"),
        ('joint_names = ["a"]\ngains = [1.0]\nunit = "A"', "expected 'N.m/A'"),
        ('joint_names = ["a"]\ngains = [true, 2.0]', "shape"),
    ],
)
def test_a_file_that_holds_none_is_told(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "g.toml"
    path.write_text(text)
    refuses(DataError, said, sdpid.DriveGains.from_toml, path)


def test_what_a_file_says_drives_no_terminal() -> None:
    gains = sdpid.DriveGains(
        joint_names=("a\x1b[2J",), gains=[1.0], basis="b\x1b[2J", notes=["c\x1b[2J"]
    )
    assert not {"\x1b"} & {*gains.describe(), *gains.in_words, *repr(gains)}
