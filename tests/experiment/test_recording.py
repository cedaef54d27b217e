"""Recordings: what they hold and refuse, their joints, bases and velocities."""

import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
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
from sdpid.experiment.recording.recording import Recording
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


def without_motion(time: np.ndarray, **changes: Any) -> Recording:
    return Recording(time=time, position=time[:, None], effort=time[:, None], **changes)


def test_large_arrays_are_kept_as_read_only_views_and_others_become_floats(tmp_path: Path):
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
    position = np.asfortranarray(given_fields["position"])
    other = Recording(**fields(position=position, time=list(range(N))))
    assert other.position.flags.c_contiguous
    assert other.time.dtype == np.float64
    refuses(ExportError, "absent", other.to_parquet, tmp_path / "absent" / "log.parquet")


def changed(name: str, index: Any, value: float) -> dict[str, np.ndarray]:
    values = fields()[name].copy()
    values[index] = value
    return {name: values}


BAD: list[tuple[dict[str, Any], str]] = [
    (changed("position", (3, 1), np.nan), r"position: 1 of 24 values .* at index \(3, 1\)"),
    (changed("effort", (7, 1), -2e18), r"effort: is -2e\+18 at index \(7, 1\)"),
    ({"position": [[1.0, 2.0], [1.0]] * 6}, "position: not a rectangular array"),
    (changed("time", 4, 5.0), "time runs backwards at row 5"),
    (changed("time", 4, fields()["time"][3]), "time repeats at row 5"),
    ({"time": 1e-12 * np.arange(N)}, "say their unit"),
    ({"position": np.zeros(N)}, "position: has 1 axes"),
    ({"effort": np.zeros((N - 1, 2))}, r"effort: has shape \(11, 2\), expected \(12, 2\)"),
    ({"velocity": np.zeros((N, 3))}, r"velocity: has shape \(12, 3\)"),
    ({"position": np.zeros((N, 0))}, r"position: .*expected \(12, 1\)"),
    ({"effort": None}, "effort is missing"),
    ({"time": [0.0], "position": [[0.0]], "effort": [[0.0]]}, "1 samples, at least 2"),
    ({"time": []}, r"time: has shape \(0,\), .*at least one row"),
    ({"joint_names": ("a", "a")}, "joint_names: a is there more than once"),
    ({"joint_names": ("a", "b", "c")}, r"3 names \(a, b, c\) for 2 joints"),
    ({"joint_names": (1, 2)}, "not a name"),
    ({"joint_names": "ab"}, "expected a sequence"),
    ({"period": 0.05}, r"period: 0.05 s \(5 samples\) does not divide the record: .* 12"),
    ({"period": 1.0}, "does not divide"),
    ({"period": 0.06, "start": 5.01}, "does not divide"),
    ({"period": 0.01}, "shorter than 2 steps"),
    ({"period": -1.0}, "positive"),
    ({"period": np.nan}, "period: is nan, expected a finite"),
    ({"period": 10**5000}, "period: is .*finite number of at most"),
    ({"period": 0.04, "start": "now"}, "start: is 'now'"),
    ({"period": 0.04, "periods": 1.5}, "periods: is 1.5"),
    ({"period": 0.0242, "periods": 4}, "not a whole number"),
    ({"period": 0.04, "periods": 4}, "4 periods of 4 samples do not fit"),
    ({"period": 0.04, "periods": 0}, "periods: is 0"),
    ({"periods": 3}, "without a period"),
    ({"period": 0.04, "start": 4.9}, "start: 4.9 s is outside the record"),
    ({"period": 0.04, "start": 6.0}, "start: 6 s is outside the record"),
    ({"reference": np.zeros((N, 1))}, r"reference: has shape \(12, 1\), expected \(12, 2\)"),
]


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


LOST = [3, 7, 100, 500, 501, 505, 996]


@pytest.mark.parametrize(
    ("jitter", "lost", "off"), [(3e-3, [], 6e-4), (0.0, LOST, 1e-12), (2e-3, [100, 500, 501], 4e-4)]
)
def test_nominal_step_withstands_jitter_and_lost_samples(
    jitter: float, lost: list[int], off: float
):
    late = np.random.default_rng(0).uniform(-jitter, jitter, 1000)
    time = np.delete(0.01 * np.arange(1000) + late, lost)
    step = without_motion(time).step
    assert step == pytest.approx(0.01, rel=off)
    assert step == pytest.approx((time[-1] - time[0]) / 999, rel=1e-12)


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
        reference=draw() if data.draw(st.booleans()) else None,
        joint_names=data.draw(
            st.none() | st.lists(names, min_size=n, max_size=n, unique=True).map(tuple)
        ),
        period=1.0 if periodic else None,
        periods=1 if periodic else None,
    )
    file = tmp_path / "log.parquet"
    recording.to_parquet(file)
    again = read_recording(file)
    before, after = recording.columns(), again.columns()
    assert {k: v.tobytes() for k, v in before.items()} == {k: v.tobytes() for k, v in after.items()}
    for name in ("joint_names", "period", "start", "periods"):
        assert getattr(recording, name) == getattr(again, name)
    assert [entry.name for entry in tmp_path.iterdir()] == ["log.parquet"]
    assert json.loads(pq.read_schema(file).metadata[b"sdpid"])["period"] == recording.period


def motion(*ranges: tuple[float, float]) -> Recording:
    position = np.linspace(*np.array(ranges).T, 50)
    names = tuple("abcdef"[: len(ranges)])
    return Recording(
        time=np.arange(50.0), position=position, effort=np.zeros_like(position), joint_names=names
    )


ARM = (-2.8, 2.8)
FREE = (-np.inf, np.inf)
UNITS: list[tuple[list[Any], Any, str]] = [
    ([(-2.5, 2.5), (-1, 1)], [ARM, ARM], ""),
    ([(-140, 140), (-60, 10)], [ARM, ARM], "ab"),
    # Only what is clear.
    ([(-140, 140), (-2, 2)], [ARM, ARM], "a"),
    # A small motion far from zero, and a small range.
    ([(89, 91)], [ARM], "a"),
    ([(-6, 6)], [ARM], "a"),
    # A little beyond the limits, wrapped by a turn, and nonsense.
    ([(-1.0, 1.0)], [(-1.57, -0.7)], ""),
    ([(-3.0, 3.0)], [ARM], ""),
    ([(5.0, 8.0)], [ARM], ""),
    ([(-6.2, 6.2)], [(-2 * np.pi, 2 * np.pi)], ""),
    ([(-1e4, 1e4)], [ARM], ""),
    # Joints without limits may turn, but beside a clear one or in a range of arms.
    ([(0, 500), (-1, 1)], [FREE, ARM], ""),
    ([(0, 500), (-90, 90)], [FREE, ARM], "ab"),
    ([(-120, 170), (0, 300)], [FREE, FREE], "ab"),
    ([(0, 5000), (0, 3000)], [FREE, FREE], ""),
    # Limits unknown: more than half of at least two.
    ([(-140, 140), (-60, 10), (-2, 2)], None, "ab"),
    ([(-140, 140), (-1, 1), (-2, 2)], None, ""),
    ([(-140, 140)], None, ""),
]


@pytest.mark.parametrize(("ranges", "limits", "expected"), UNITS)
def test_degrees_are_suspected(ranges: list[Any], limits: Any, expected: str):
    recording = motion(*ranges)
    assert suspect_units(recording, limits) == tuple(expected)
    if not expected:
        require_plausible_units(recording, limits)
        return
    words = "looks like degrees.*" + ".*".join(f"{name} from" for name in expected) + ".*units="
    refuses(DataError, words, require_plausible_units, recording, limits)
    refuses(DataError, "position_limits", suspect_units, recording, [1.0, 2.0])


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
        reference=columns,
        joint_names=names,
    )


def columns_of(robot: sdpid.RobotModel, log: sdpid.Recording) -> list[int]:
    matched = match_joints(robot, log)
    assert matched.joint_names == robot.joint_names
    for other in (matched.effort, matched.velocity, matched.reference):
        np.testing.assert_array_equal(matched.position, other)
    return matched.position[0].astype(int).tolist()


@pytest.fixture(scope="module")
def ur5() -> sdpid.RobotModel:
    return sdpid.load_robot("ur_description/ur5_robot")


# The order of the Universal Robots driver's /joint_states: alphabetical, the elbow first.
WRISTS = tuple(f"wrist_{k}_joint" for k in (1, 2, 3))
DRIVER = ("elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint", *WRISTS)


def of(side: str, names: tuple[str, ...] = DRIVER) -> tuple[str, ...]:
    return tuple(f"{side}_{name}" for name in names)


@pytest.mark.parametrize(
    ("names", "columns"),
    [
        (("finger_joint", *DRIVER), [3, 2, 1, 4, 5, 6]),
        (of("ur", ("finger_joint", *DRIVER)), [3, 2, 1, 4, 5, 6]),
        ((*of("left"), *of("right"), *DRIVER), [14, 13, 12, 15, 16, 17]),
        (None, [0, 1, 2, 3, 4, 5]),
    ],
)
def test_columns_are_found_by_name(
    ur5: sdpid.RobotModel, names: tuple[str, ...] | None, columns: list[int]
) -> None:
    assert columns_of(ur5, log_of(names, len(names or columns))) == columns


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


OTHER = "not even with another prefix or suffix"


@pytest.mark.parametrize(
    ("names", "joints", "message"),
    [
        # Each ends in t, as the robot's do.
        ([f"{letter}_joint" for letter in "abcdef"], 6, OTHER),
        ((*DRIVER[:5], "wrist_joint"), 6, OTHER),
        (("left_elbow_joint", *DRIVER[1:]), 6, OTHER),
        ((*of("left"), *of("right")), 12, "in 2 ways: left_shoulder_pan_joint, .*; right_"),
        (None, 7, "has 7 joints, the robot 'ur5"),
        (DRIVER[:5], 5, "has 5 joints, the robot 'ur5"),
    ],
)
def test_other_names_are_refused(
    ur5: sdpid.RobotModel, names: Any, joints: int, message: str
) -> None:
    refuses(DataError, message, match_joints, ur5, log_of(names, joints))


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


def test_rows_of_a_recording_keep_base_and_contacts() -> None:
    # One kind and one offset are those of all contacts.
    assert contacts().kind == ("point", "point")
    assert contacts().offset.tolist() == [[0.0, 0.0, -0.02]] * 2
    assert "1 point, 1 plane, flags, forces)" in repr(contacts(kind=("point", "plane")))
    assert repr(log()).endswith("floating base with IMU, 2 contacts)")
    whole = log(reference=log().position)
    assert "with reference" in repr(whole)
    assert "with reference" in whole._repr_html_()
    part = whole.rows(slice(10, 30)).columns()
    for name, column in whole.columns().items():
        np.testing.assert_array_equal(part[name], column[10:30])
    assert {"base_angular_velocity_world_x", "base_orientation_w", "contact_left"} < set(part)
    assert {"accelerometer_z", "contact_force_right_z", "time", "reference_2"} < set(part)
    late = whole.time + np.where(np.arange(ROWS) < 20, 0.0, 1.0)
    pieces, _ = continuous(replace(whole, time=late))
    assert [piece.base.n_samples for piece in pieces] == [20, 20]
    np.testing.assert_array_equal(pieces[1].reference, whole.reference[20:])
    assert pieces[1].base.imu.translation.tolist() == [0.1, 0.0, 0.0]


def test_the_digest_counts_base_and_contacts() -> None:
    changes: list[dict[str, Any]] = [{}, {"contacts": None}, {"contacts": contacts(kind="plane")}]
    changes += [{"base": base(position=None)}, {"base": base(imu=None)}]
    digests = {recording_digest(log(**change)) for change in changes}
    assert len(digests) == 5
    assert recording_digest(log()) in digests


def commanded() -> Recording:
    return log(reference=np.zeros((ROWS, 2)), joint_names=("a", "b"))


TWO_JOINTS = sdpid.load_robot(ARM_URDF)


FLOATS = ".*this recording has a floating base"
# What cannot be, and what knows fixed robots only, by what is said of it.
FLOATING: dict[str, Any] = {
    "sample 1 has the norm 2.*by 1, limit": lambda: base(orientation=np.ones((ROWS, 4))),
    r"\(40, 3\), expected \(40, 4\)": lambda: base(orientation=np.ones((ROWS, 3))),
    r"\(39, 4\).*as many rows as position": lambda: base(position=np.zeros((ROWS - 1, 3))),
    "'world' or 'base': the axes of angular_velocity": lambda: base(velocity_frame=None),
    "without a velocity": lambda: base(angular_velocity=None),
    "base.imu: has 3 samples": lambda: base(imu=sdpid.Imu(gyroscope=np.zeros((3, 3)))),
    "neither gyroscope nor accelerometer": sdpid.Imu,
    "determinant is -1": lambda: sdpid.Imu(gyroscope=np.zeros((3, 3)), rotation=-np.eye(3)),
    "a is there more than once": lambda: contacts(frames=("a", "a")),
    "blob is not known; known are point, line, plane": lambda: contacts(kind="blob"),
    "holds 0.5, expected True or False": lambda: contacts(down=np.full((ROWS, 2), 0.5)),
    r"expected \(40, 2, 3\)": lambda: contacts(forces=np.zeros((ROWS, 2, 6))),
    "not both": lambda: contacts(wrenches=np.zeros((ROWS, 2, 6))),
    "nothing is known of contacts": lambda: contacts(down=None, forces=None),
    r"expected \(2, 3\)": lambda: contacts(offset=np.zeros((3, 3))),
    "contacts: are given without a base": lambda: log(base=None),
    "contacts: has 5 samples": lambda: log(contacts=contacts().rows(slice(5))),
    "base: is int, expected sdpid.BaseMotion": lambda: log(base=5),
    f"fit_controller{FLOATS}": lambda: sdpid.controllers.fit_controller(commanded(), "pd"),
    f"payload{FLOATS}": lambda: sdpid.identify_payload(TWO_JOINTS, commanded()),
    f"gains{FLOATS}": lambda: sdpid.identify_drive_gains(TWO_JOINTS, log(currents=True)),
    f"simulated motion{FLOATS}": lambda: Twin.of(TWO_JOINTS, commanded()),
    f"rollout{FLOATS}": lambda: _prepared(TWO_JOINTS, commanded(), None),
}


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
    right, late = ((omega * np.cos(angle - by * omega)).sum(axis=1) for by in (0.0, lag))
    wrong = scale * late + noise * rng.standard_normal(time.size)
    both = np.repeat(np.sin(angle).sum(axis=1)[:, None], 2, axis=1)
    return sdpid.Recording(
        time=time, position=both, velocity=np.column_stack([right, wrong]), effort=both
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
    found, late, correlation = velocity_fit(moving(rate, scale=sign * scale, lag=lag, seed=seed), 1)
    # At 25 Hz the trapezia of the mean lose (w h)²/12 = 1e-3, and a lag is only taken up to its
    # first order: (w lag)²/2 = 2e-3 of the scale.
    assert found == pytest.approx(sign * scale, rel=5e-3)
    assert late == pytest.approx(lag, abs=5e-4)
    assert correlation > 0.99


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"scale": 1.05}, "agrees with positions"),
        ({"scale": 0.93}, "agrees with positions"),
        ({"scale": 1.15}, "joint 2 is 1.15 times d/dt of its position, limit 0.9 to 1.1"),
        ({"scale": 0.85}, "joint 2 is 0.85 times"),
        ({"scale": -1.0}, "joint 2 is -1 times"),
        ({"scale": 57.3}, "joint 2 is 57.3 times"),
        ({"lag": 0.02}, "agrees with positions"),
        ({"lag": 0.1}, r"joint 2 is late by 0.1\d* s"),
        ({"lag": -0.1}, r"joint 2 is early by 0.1\d* s"),
        ({"noise": 0.1}, "agrees with positions"),
        ({"scale": 0.0, "noise": 1.0}, r"joint 2 does not follow d/dt of its position"),
    ],
)
def test_what_is_wrong_is_not_used(changes: dict[str, float], said: str) -> None:
    chosen = default_processing(moving(**changes))
    (velocity,) = [text for text in chosen.why if text.startswith("velocity")]
    assert chosen.velocity == ("measured" if "agrees" in said else "differentiated")
    assert re.search(said, velocity)


def test_rest_and_few_samples_say_nothing() -> None:
    log = moving()
    position, velocity = np.array(log.position), np.array(log.velocity)
    position[:, 1] = 0.3 + 1e-6 * np.sin(log.time)
    velocity[:, 1] = 1e-3 * np.random.default_rng(0).standard_normal(log.n_samples)
    resting = replace(log, position=position, velocity=velocity)
    assert velocity_fit(resting, 1) is None
    assert disagreement(resting, 1.0) is None
    assert default_processing(resting).velocity == "measured"
    assert velocity_fit(moving(seconds=0.1), 0) is None


def test_noise_of_positions_is_no_scale() -> None:
    log = moving()
    rate = np.sqrt(np.mean(log.velocity[:, 1] ** 2))
    # As much noise as makes the slope of the velocity over the rate 1 / (1 + 0.4²) = 0.86.
    noise = 0.4 * rate / (np.sqrt(2.0) * log.rate_hz)
    noisy = log.position + noise * np.random.default_rng(0).standard_normal(log.position.shape)
    log = replace(log, position=noisy)
    assert velocity_fit(log, 1)[0] == pytest.approx(np.sqrt(1.0 / 1.16), abs=0.02)
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


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 6))
def test_the_common_factor_is_the_largest(seed: int, n: int) -> None:
    gains = some(seed, n)
    C, c = gains.relative_covariance, gains.common_factor
    scale = np.linalg.eigvalsh(C)[-1]
    least = [np.linalg.eigvalsh(C - (c * s) ** 2)[0] for s in (0.99, 1.01)]
    assert least[0] > -1e-9 * scale
    assert least[1] < 0.0


def test_intervals_and_factors() -> None:
    gains = some()
    lower, upper = gains.intervals(0.9).T
    np.testing.assert_allclose(lower * upper, gains.gains**2)
    half = t.ppf(0.95, gains.freedom) * gains.standard_errors / gains.gains
    np.testing.assert_allclose(np.log(upper / lower), 2.0 * half)
    # A factor alone is all common, and known gains have none.
    gains = np.array([10.0, 5.0, 1.0])
    errors = 0.01**2 * np.outer(gains, gains)
    one = sdpid.DriveGains(joint_names=("a", "b", "c"), gains=gains, covariance=errors)
    assert one.common_factor == pytest.approx(0.01)
    known = sdpid.DriveGains(joint_names=["a"], gains=[2])
    np.testing.assert_array_equal(known.intervals(), [[2.0, 2.0]])
    assert known.common_factor == 0.0


def test_joints_are_taken_by_name() -> None:
    gains = some()
    last, first = gains.joint_names[2], gains.joint_names[0]
    two = gains.of_joints([last, first])
    np.testing.assert_array_equal(two.gains, gains.gains[[2, 0]])
    assert two.covariance[0, 1] == gains.covariance[2, 0]
    np.testing.assert_allclose(two.torque(np.ones((4, 2))), np.tile(two.gains, (4, 1)))
    refuses(DataError, "none for elbow", gains.of_joints, ["elbow"])
    refuses(DataError, "has 2 columns; there are gains for 3", gains.torque, np.ones((4, 2)))
    refuses(DataError, "no gains of to_dict", sdpid.DriveGains.from_dict, {})


NO_GAINS: list[tuple[dict[str, Any], str]] = [
    ({"gains": [1.0, -2.0]}, "that of b is -2 N·m/A"),
    ({"gains": [1.0]}, "shape"),
    ({"joint_names": ("a", "a")}, "each joint a name"),
    ({"joint_names": "ab"}, "expected a list of texts"),
    ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "covariance is none"),
    ({"freedom": [1.0, 0.0]}, "positive"),
    ({"gains": [1.0, np.nan]}, "not finite"),
    ({"gains": [1e308, 1e-308], "covariance": np.full((2, 2), 1e308)}, "too large beside"),
    ({"basis": 5}, "expected a text"),
    ({"sources": ["a.csv"]}, "names and digests"),
]
GIVEN: dict[str, Any] = {"joint_names": ("a", "b"), "gains": [1.0, 2.0]}
REFUSED = [
    *((words, partial(Recording, **fields(**changes))) for changes, words in BAD),
    *((words, partial(sdpid.DriveGains, **GIVEN | changes)) for changes, words in NO_GAINS),
    *FLOATING.items(),
]


@pytest.mark.parametrize(("words", "make"), REFUSED, ids=[words for words, _ in REFUSED])
def test_what_cannot_be_is_refused(words: str, make: Any) -> None:
    refuses(DataError, words, make)


def test_what_files_hold_no_gains_is_told(tmp_path: Path) -> None:
    path, one = tmp_path / "g.toml", 'joint_names = ["a"]\ngains = '
    for text, said in (
        ("gains = [1.0]", "no joint_names"),
        (f"{one}[1.0]\ngain = 2", "gain is not known"),
        (f'{one}[1.0]\nunit = "A"', "expected 'N.m/A'"),
        (f"{one}[true, 2.0]", "shape"),
    ):
        path.write_text(text)
        refuses(DataError, said, sdpid.DriveGains.from_toml, path)


def test_what_a_file_says_drives_no_terminal() -> None:
    gains = sdpid.DriveGains(
        joint_names=("a\x1b[2J",), gains=[1.0], basis="b\x1b[2J", notes=["c\x1b[2J"]
    )
    assert not {"\x1b"} & {*gains.describe(), *gains.in_words, *repr(gains)}
