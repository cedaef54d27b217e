"""Plans for controllers: the motion as independent readers find it, and their page."""

import csv
import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid._common.files import hashed, load_toml
from sdpid.errors import ExportError
from sdpid.excitation.geometry.obstacles import obstacles_from_toml
from sdpid.excitation.limits.limits import Limits
from sdpid.excitation.search.ipopt import INTERRUPTED
from sdpid.experiment.trajectory.reading import read_trajectory
from sdpid.experiment.trajectory.trajectory import Trajectory, played
from sdpid.output.charts.page import number
from sdpid.output.plans import write
from sdpid.output.plans.page import plan_html
from sdpid.output.plans.write import write_plan
from tests.helpers.browser import Tab, look
from tests.helpers.motions import fourier_motion, spline_motion
from tests.helpers.plans import AROUND, LIMITS, small_plan
from tests.helpers.refusals import refuses
from tests.helpers.scenes import unpacked
from tests.output.test_report import elements, self_contained, tree, words

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
    starts = []
    for start, curve in motion.curves():
        count = motion.periods if curve is motion.series else 1
        starts += [(start + k * motion.period, curve) for k in range(count)]
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
    write.write_motion_csv(motion, path)
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


def test_the_message_holds_the_motion(motion: Trajectory, tmp_path: Path) -> None:
    yaml = pytest.importorskip("yaml")
    path = tmp_path / "joint_trajectory.yaml"
    write.write_joint_trajectory(motion, path)
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
    text = "\n".join(lines)
    play = rf"^  sdpid_play\(({number}), ({number}), ({listed}(?:, {listed}){{5}})\)$"
    played = [
        (float(end), float(width), np.array([*map(json.loads, re.findall(listed, lists))]))
        for end, width, lists in re.findall(play, text, re.M)
    ]
    ((start, _, speed),) = re.findall(
        rf"^  movej\(({listed}), a=({number}), v=({number})\)$", text, re.M
    )
    order = [line.split("(")[0].strip() for line in lines]
    assert order.index("movej") < order.index("sleep") < order.index("sdpid_play")
    assert order[-2:] == ["stopj", "end"]
    (servo,) = [line.strip() for line in lines if "servoj(" in line]
    start = np.array(json.loads(start))
    return {"start": start, "speed": float(speed), "played": played, "servoj": servo}


def test_the_program_plays_the_motion(motion: Trajectory, tmp_path: Path) -> None:
    """Its loop, run here at two rates of the controller, gives the motion at every step."""
    path = tmp_path / "excitation.script"
    write.write_urscript(motion, path)
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
    seven, path = spline_motion((*SIX, "joint_7")), tmp_path / "a.script"
    refuses(ExportError, r"7 joints.*have 6", write.write_urscript, seven, path)
    assert not path.exists()


def test_pieces_follow_and_join(motion: Trajectory) -> None:
    made = write.pieces(motion)
    for one, other in pairwise(made):
        assert one.end == pytest.approx(other.begin, abs=1e-12)
        assert np.allclose(one.coefficients.sum(axis=0), other.coefficients[0], atol=1e-9)
    s = np.linspace(0.0, 1.0, 17)
    for piece in made:
        q = np.vander(s, 6, increasing=True) @ piece.coefficients
        expected = at(motion, piece.begin + s * (piece.end - piece.begin))
        assert np.abs(q - expected).max() < 1.5 * write.TOLERANCE


# The page of a plan: valid, alone, told in words, and the arm moves.


EVIL = "</script><script>alert(1)</script>"


@pytest.fixture(scope="module")
def page() -> str:
    pytest.importorskip("jinja2")
    pytest.importorskip("matplotlib")
    plan = small_plan()
    return plan_html(replace(plan, notes=(*plan.notes, EVIL)), command=f"sdpid excite {EVIL}")


def scene(page: str) -> dict[str, Any]:
    found, _ = [each for each in elements(page, "script") if each.get("type")]
    content: dict[str, Any] = json.loads(found.text)
    return content


def test_it_is_valid_and_alone(page: str) -> None:
    """Scripts run by their digests; nothing is fetched."""
    assert page.startswith("<!DOCTYPE html>")
    self_contained(page)
    *data, player, _, _ = elements(page, "script")
    assert [each.get("type") for each in data] == ["application/json"] * 2
    ids = [e.get("id") for e in tree(page).iter("{*}*") if e.get("id")]
    assert all(link.get("href")[1:] in ids for link in elements(page, "a"))
    assert "http" not in player.text


def test_it_tells_the_plan(page: str) -> None:
    plan, shown = small_plan(), words(page)
    for text in (
        "Every limit holds at every instant",
        "mm kept everywhere, nearest ",
        ", 20 mm asked for; a stays ",
        number(plan.condition_number),
        EVIL,
        "<b>box",
        "rad/s²",
        *plan.names,
        *plan.limits.notes,
        *plan.expected.sentences(),
    ):
        assert re.sub(r"\s+", " ", text).rstrip(".").lower() in shown.lower()
    # Five charts a joint, distances, spectrum, and errors over the duration.
    places = [each for each in elements(page, "div") if each.get("data-chart")]
    assert len(places) == 5 * plan.robot.n + 3
    held = json.loads(elements(page, "script")[1].text)
    assert len(held["charts"]) == len(places)
    for place in places:
        chart = held["charts"][int(place.get("data-chart"))]
        assert {line[0] for line in json.loads(place.get("data-look"))["lines"]} <= chart.keys()


def test_a_broken_limit_is_bad(page: str) -> None:
    plan = small_plan()
    row = replace(plan.limits.rows[0], verdict="broken", reached=99.0)
    limits = replace(plan.limits, rows=(row, *plan.limits.rows[1:]))
    shown = words(plan_html(replace(plan, limits=limits)))
    assert "Not every limit is proven to hold" in shown
    assert "Every limit holds" not in shown


def test_the_scene_is_the_motion(page: str) -> None:
    plan, found = small_plan(), scene(page)
    motion, frames = played(plan.trajectory, 25.0), found["frames"]
    assert frames["count"] == len(motion.time)
    assert (frames["count"] - 1) / frames["rate"] == pytest.approx(plan.trajectory.period)
    assert np.allclose(unpacked(frames["q"]), motion.position, atol=1e-4)
    groups = {(each["group"], each["link"]) for each in found["surfaces"]}
    assert groups == {("links", -1), ("links", 0), ("links", 1), ("obstacles", -1), ("planes", -1)}
    assert len(found["distances"]["frames"]) == frames["count"]


def test_the_arm_moves_in_a_browser(page: str, tmp_path: Path) -> None:
    """From a file: without a network, without errors, and it obeys its controls."""
    (tmp_path / "report.html").write_text(page, encoding="utf-8")
    told = "document.getElementById('scene-told').textContent"
    picture = "document.getElementById('scene-view').toDataURL()"

    async def visit(tab: Tab) -> None:
        # Out of sight it stands still.
        await tab.value("document.getElementById('scene').scrollIntoView()")
        await tab.until("document.getElementById('scene-told').textContent !== ''")
        await tab.value(f"[window.seen, window.read] = [{picture}, {told}]")
        await tab.until(f"{picture} !== seen && {told} !== read")
        assert "nearest:" in await tab.value(told)
        await tab.value("document.getElementById('scene-view').focus()")
        await tab.key(" ")
        await tab.until("document.getElementById('scene-play').textContent === 'Play'")
        await tab.value(f"window.seen = {picture}")
        await tab.key("ArrowLeft")
        await tab.until(f"{picture} !== seen")
        slide = "s = document.getElementById('scene-time'); s.value = 2; s.dispatchEvent(new Event("
        await tab.value(f"{slide}'input'))")
        await tab.until(f"{told}.startsWith('2.00 s of')")
        await tab.value("document.querySelector('#bought .chart').scrollIntoView()")
        await tab.until("document.querySelector('#bought .chart canvas') !== null")
        for width in (1280, 390):
            await tab.fits(width)
        tab.heard_nothing()

    look(tmp_path / "report.html", tmp_path / "profile", visit)


# The folder of a plan: every file, or none, and no one else's.


FILES = {*write.NAMES} - {"excitation.script"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("pyarrow")
    pytest.importorskip("jinja2")
    out = tmp_path_factory.mktemp("plans") / "new" / "plan"
    told: list[str] = []
    files = write_plan(small_plan(), out, report=told.append)
    assert {file.name for file in files} == FILES
    assert told == [
        "no excitation.script: arms of Universal Robots have 6 turning joints, this robot has "
        "others"
    ]
    return out


def test_the_files_are_there_and_listed(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == FILES
    assert len(FILES) == 8
    listed = json.loads((folder / "plan.json").read_text())["files"]
    assert {name: each["sha256"] for name, each in listed.items()} == {
        name: hashed(folder / name)["sha256"] for name in FILES - {"plan.json"}
    }


def test_the_motion_is_that_of_the_plan(folder: Path) -> None:
    """Whatever form it is read from, at other times too."""
    own = small_plan().trajectory
    again = sdpid.Trajectory.from_toml(folder / "trajectory.toml")
    assert np.array_equal(again.series.control_points, own.series.control_points)  # type: ignore[attr-defined]
    time = np.linspace(0.0, own.period, 997)
    read = read_trajectory(folder / "trajectory.csv", own.joint_names)
    assert read.series.duration == pytest.approx(own.duration, abs=1e-12)
    for order, near in enumerate((1e-9, 1e-7, 1e-4)):
        found = read.series.evaluate(time, derivative=order)
        assert np.allclose(found, own.series.evaluate(time, derivative=order), atol=near)


def test_the_results_are_told(folder: Path) -> None:
    plan, told = small_plan(), json.loads((folder / "plan.json").read_text())
    expected = {
        "robot": "arm",
        "joint_names": ["a", "b"],
        "condition_number": plan.condition_number,
        "assumed": list(plan.limits.notes),
    }
    assert told.items() >= expected.items()
    assert told["limits"]["ok"] is True
    assert {row["kind"] for row in told["limits"]["rows"]} >= {"position", "velocity", "torque"}
    assert list(told["standard_errors"]) == list(plan.names)
    assert told["expected"]["sentences"] == list(plan.expected.sentences())
    assert told["settings"]["seed"] == 3


def test_limits_and_obstacles_are_those_given(folder: Path) -> None:
    config = load_toml(folder / "plan.toml")
    assert (config["limits"], config["obstacles"]) == ("limits.toml", "obstacles.toml")
    assert config["friction"] == ["coulomb", "viscous", "offset"]
    assert "robot" not in config  # it was given in memory
    robot = small_plan().robot
    one, other = (each.of(robot) for each in (LIMITS, Limits.from_toml(folder / "limits.toml")))
    assert np.array_equal(one.acceleration, other.acceleration)
    assert np.array_equal(one.jerk, other.jerk)
    assert one.clearance == other.clearance
    assert obstacles_from_toml(folder / "obstacles.toml") == AROUND


def test_a_search_that_ended_early_says_so(tmp_path: Path) -> None:
    """Options do not make the same plan again where time ended the search."""
    plan = small_plan()
    write_plan(plan, tmp_path)
    assert "another run" not in (tmp_path / "plan.toml").read_text()
    timed = replace(plan, settings={**plan.settings, "time_limit": 3.0})
    stopped = replace(plan, history=({**plan.history[0], "status": INTERRUPTED},))
    for each, word in ((timed, "time limit"), (stopped, "interrupted")):
        write_plan(each, tmp_path)
        assert word in (tmp_path / "plan.toml").read_text().splitlines()[0]
        load_toml(tmp_path / "plan.toml")


@pytest.mark.parametrize("name", ["report.html", "trajectory.csv", "plan.json", "limits.toml"])
def test_files_that_no_plan_wrote_are_not_replaced(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("mine")
    words = f"{name}, which no run like this wrote"
    refuses(ExportError, words, write_plan, small_plan(), tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "mine"


def test_a_plan_replaces_a_plan_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    first = write_plan(small_plan(), tmp_path)
    content = {path.name: path.read_bytes() for path in first}
    second = write_plan(small_plan(), tmp_path)
    assert {path.name: path.read_bytes() for path in second} == content
    assert (tmp_path / "mine.txt").read_text() == "mine"
    # With options of a command there are no limits.toml and obstacles.toml: those of before go.
    write_plan(small_plan(), tmp_path, config="seed = 1\n")
    assert not (tmp_path / "limits.toml").exists()
    (tmp_path / "plan.toml").write_text("# my own\n")
    refuses(ExportError, "which no run like this wrote", write_plan, small_plan(), tmp_path)
    assert (tmp_path / "plan.toml").read_text() == "# my own\n"


def test_what_is_not_installed_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(write.importlib.util, "find_spec", lambda name: None)
    told: list[str] = []
    names = {path.name for path in write_plan(small_plan(), tmp_path, report=told.append)}
    assert FILES - names == {"report.html"}
    assert any("[report]'" in each for each in told)


def test_a_plan_without_collisions(tmp_path: Path) -> None:
    write_plan(replace(small_plan(), collision=None), tmp_path)
    assert "no collisions were checked" in (tmp_path / "report.html").read_text()


def test_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = Mock(side_effect=OSError(28, "No space left on device"))
    monkeypatch.setattr(write, "write_joint_trajectory", full)
    refuses(ExportError, "No space left", write_plan, small_plan(), tmp_path / "plan")
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").write_text("")
    refuses(ExportError, "it is a file", write_plan, small_plan(), tmp_path / "file")


def test_it_can_be_rehearsed(folder: Path) -> None:
    """The simulated robot follows the motion of the file."""
    pytest.importorskip("mujoco")
    motion = sdpid.Trajectory.from_toml(folder / "trajectory.toml")
    log = sdpid.simulate(small_plan().robot, motion, seed=1)
    assert log.n_samples >= motion.n_samples
