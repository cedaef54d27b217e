"""What controllers get is the motion, as independent readers find it."""

import csv
import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BSpline

from sdpid._common.arrays import Array
from sdpid.errors import ExportError
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.output.plans.joint_trajectory import write_joint_trajectory
from sdpid.output.plans.motion_files import (
    write_coefficients,
    write_motion_csv,
    write_motion_parquet,
)
from sdpid.output.plans.pieces import TOLERANCE, pieces
from sdpid.output.plans.urscript import write_urscript
from tests.helpers.motions import fourier_motion, spline_motion

SIX = tuple(f"joint_{k}" for k in range(1, 7))
MOTIONS = {
    "spline": spline_motion(SIX),
    "open": spline_motion(SIX, 1, closed=False),
    "repeated": spline_motion(SIX, 2, periods=3, rest=0.5),
    "fourier": fourier_motion(SIX),
}


@pytest.fixture(params=list(MOTIONS))
def motion(request: pytest.FixtureRequest) -> Trajectory:
    return MOTIONS[request.param]


def at(motion: Trajectory, time: Array, derivative: int = 0) -> Array:
    """Return a motion at any times, part by part."""
    parts = motion.curves()
    starts = [(start, curve) for start, curve in parts if curve is not motion.series]
    (begin,) = [start for start, curve in parts if curve is motion.series]
    starts += [(begin + k * motion.period, motion.series) for k in range(motion.periods)]
    out = np.zeros((len(time), motion.n))
    if derivative == 0:
        _, last = max(starts, key=lambda part: part[0])
        out[:] = motion.center
        out[time > motion.duration / 2] = last.evaluate(np.array([last.duration]))
    for start, curve in starts:
        inside = (time >= start) & (time <= start + curve.duration)
        out[inside] = curve.evaluate(time[inside] - start, derivative=derivative)
    return out


def test_the_table_holds_the_motion(motion: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "trajectory.csv"
    write_motion_csv(motion, path)
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    quantities = ("position", "velocity", "acceleration")
    assert header == ["time", *(f"{q}_{name}" for q in quantities for name in SIX)]
    table = np.array(rows, dtype=np.float64)
    time = table[:, 0]
    assert time[0] == 0.0
    assert time[-1] == pytest.approx(motion.duration, abs=1e-12)
    assert np.allclose(np.diff(time), 1.0 / motion.rate_hz)
    for k in range(3):
        assert np.allclose(table[:, 1 + 6 * k : 7 + 6 * k], at(motion, time, k), atol=1e-9)
    # With all digits, and at rest at both ends.
    assert np.array_equal(table[:-1, 1:7], motion.sample()[0])
    assert np.abs(table[[0, -1], 7:]).max() < 1e-6


def test_parquet_is_the_table(motion: Trajectory, tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    write_motion_csv(motion, tmp_path / "a.csv")
    write_motion_parquet(motion, tmp_path / "a.parquet")
    one, other = pandas.read_csv(tmp_path / "a.csv"), pandas.read_parquet(tmp_path / "a.parquet")
    assert list(one) == list(other)
    assert np.allclose(one, other, rtol=1e-15, atol=0.0)


def test_the_coefficients_are_the_motion(motion: Trajectory, tmp_path: Path) -> None:
    write_coefficients(motion, tmp_path / "c.json")
    content = json.loads((tmp_path / "c.json").read_text())
    assert content["joint_names"] == list(SIX)
    assert content["periods"] == motion.periods
    t = np.linspace(0.0, motion.period, 101)
    if content["kind"] == "b-spline":
        points = np.array(content["control_points"]).T
        found = BSpline(np.array(content["knots"]), points, content["degree"])(t)
    else:
        found = np.array(content["center"]) + sum(
            np.array(content["amplitudes"])[:, h]
            * np.sin(
                2 * np.pi * np.array(content["harmonics"])[:, h] * t[:, None] / content["period"]
                + np.array(content["phases"])[:, h]
            )
            for h in range(3)
        )
    assert np.allclose(found, motion.series.evaluate(t), atol=1e-12)


def test_the_message_holds_the_motion(motion: Trajectory, tmp_path: Path) -> None:
    yaml = pytest.importorskip("yaml")
    path = tmp_path / "joint_trajectory.yaml"
    write_joint_trajectory(motion, path)
    message = yaml.safe_load(path.read_text())
    assert set(message) == {"header", "joint_names", "points"}
    assert message["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    assert message["joint_names"] == list(SIX)
    points = message["points"]
    times = [point["time_from_start"] for point in points]
    assert all(isinstance(t["sec"], int) and 0 <= t["nanosec"] < 10**9 for t in times)
    time = np.array([t["sec"] + 1e-9 * t["nanosec"] for t in times])
    assert time[0] == 0.0
    assert time[-1] == pytest.approx(motion.duration, abs=1e-9)
    assert np.all(np.diff(time) > 0.0)
    for k, name in enumerate(("positions", "velocities", "accelerations")):
        values = np.array([point[name] for point in points])
        assert values.dtype == np.float64
        assert np.allclose(values, at(motion, time, k), atol=1e-7)


def program(text: str) -> dict[str, Any]:
    """Read a URScript program: its moves, and the polynomials that it plays."""
    number = r"-?\d+\.\d+"
    listed = rf"\[{number}(?:, {number}){{5}}\]"
    lines = [line.split("#")[0].rstrip() for line in text.splitlines()]
    lines = [line for line in lines if line]
    assert lines[0] == "def sdpid_excitation():"
    depth = 0
    for line in lines:
        depth += bool(re.fullmatch(r"\s*(def|while|if|for) ?.*:", line))
        depth -= line.strip() == "end"
        assert depth > 0 or line is lines[-1]
    assert depth == 0
    played = []
    for line in lines:
        if match := re.fullmatch(
            rf"  sdpid_play\(({number}), ({number}), ({listed}(?:, {listed}){{5}})\)", line
        ):
            lists = [json.loads(each) for each in re.findall(listed, match[3])]
            played.append((float(match[1]), float(match[2]), np.array(lists)))
    (start,) = [
        m
        for line in lines
        if (m := re.fullmatch(rf"  movej\(({listed}), a=({number}), v=({number})\)", line))
    ]
    order = [line.split("(")[0].strip() for line in lines]
    assert order.index("movej") < order.index("sleep") < order.index("sdpid_play")
    assert order[-2:] == ["stopj", "end"]
    (servo,) = [line.strip() for line in lines if "servoj(" in line]
    return {
        "start": np.array(json.loads(start[1])),
        "acceleration": float(start[2]),
        "speed": float(start[3]),
        "played": played,
        "servoj": servo,
    }


def test_the_program_plays_the_motion(motion: Trajectory, tmp_path: Path) -> None:
    """Its loop, run here at two rates of the controller, gives the motion at every step."""
    path = tmp_path / "excitation.script"
    write_urscript(motion, path)
    text = path.read_text()
    assert text.isascii()
    found = program(text)
    assert found["servoj"] == "servoj(q, t=get_steptime(), lookahead_time=0.1, gain=300)"
    assert found["speed"] <= 0.25
    rest = motion.rest
    assert np.allclose(found["start"], at(motion, np.array([rest]))[0], atol=1e-9)
    for step in (0.002, 0.008):
        clock, worst = 0.0, 0.0
        for end, width, lists in found["played"]:
            while clock < end:
                s = 1.0 - (end - clock) / width
                assert -1e-6 <= s <= 1.0
                q = sum(c * s**k for k, c in enumerate(lists))
                worst = max(worst, np.abs(q - at(motion, np.array([clock + rest]))[0]).max())
                clock += step
        assert worst < 2e-7
        moving = motion.duration - 2.0 * rest
        assert moving <= clock < moving + 1.5 * step


def test_the_program_is_for_six_joints(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"7 joints.*have 6"):
        write_urscript(spline_motion((*SIX, "joint_7")), tmp_path / "a.script")
    assert not list(tmp_path.iterdir())


def test_pieces_follow_and_join(motion: Trajectory) -> None:
    made = pieces(motion)
    for one, other in pairwise(made):
        assert one.end == pytest.approx(other.begin, abs=1e-12)
        assert np.allclose(one.coefficients.sum(axis=0), other.coefficients[0], atol=1e-9)
    for piece in made:
        s = np.linspace(0.0, 1.0, 17)
        q = np.vander(s, 6, increasing=True) @ piece.coefficients
        assert (
            np.abs(q - at(motion, piece.begin + s * (piece.end - piece.begin))).max()
            < 1.5 * TOLERANCE
        )
