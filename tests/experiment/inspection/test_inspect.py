"""Recordings of arms that are wrong in one way each, and right ones."""

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import sdpid
from sdpid.errors import DataError, SdpidError
from sdpid.experiment.inspection.inspect import (
    REFUSED,
    inspect_recording,
    inspect_recordings,
    kinds_accepted,
    require_accepted,
)
from sdpid.experiment.inspection.kinds import KINDS, Finding
from sdpid.experiment.inspection.motion_checks import _read_as_seconds
from sdpid.experiment.preparation.overview import overview
from sdpid.experiment.preparation.prepare import prepare
from sdpid.experiment.recording.recording import Recording, rows_of
from tests.helpers.refusals import refuses

RATE = 100.0
T = np.arange(3000) / RATE
JOINT = 1
ALL = ("position", "velocity", "effort")
Change = Callable[[Recording], Recording]


@pytest.fixture(scope="module")
def robot() -> sdpid.RobotModel:
    return sdpid.load_robot("ur_description/ur5_robot")


def simulated(robot: sdpid.RobotModel, seed: int, load: float = 0.0) -> Recording:
    """Bodies 15 % heavier or lighter than described, friction, offsets and noise."""
    rng = np.random.default_rng(seed)
    rate = 2.0 * np.pi * rng.uniform(0.05, 0.4, (4, robot.n))
    phase = rng.uniform(0.0, 2.0 * np.pi, rate.shape)
    size = np.array([1.0, 0.5, 0.8, 1.0, 1.0, 1.0]) / 2.0
    angle = T[:, None, None] * rate + phase
    position = (size * np.sin(angle)).sum(axis=1) - np.array([0.0, 1.2, 0.0, 0.0, 0.0, 0.0])
    velocity = (size * rate * np.cos(angle)).sum(axis=1)
    acceleration = -(size * rate**2 * np.sin(angle)).sum(axis=1)
    bodies = robot.prior * np.exp(0.15 * np.random.default_rng(7).standard_normal((6, 1)))
    bodies[-1, :4] += load * np.array([1.0, 0.05, 0.05, 0.1])
    effort = robot.inverse_dynamics(bodies, position, velocity, acceleration)
    usual = np.sqrt(effort.std(axis=0) * effort.std(axis=0).max())
    effort += 0.15 * usual * np.tanh(velocity / 0.01) + 0.1 * usual * velocity + 0.02 * usual
    effort += 0.01 * usual * rng.standard_normal(effort.shape)
    return Recording(
        time=T,
        position=position + 1e-5 * rng.standard_normal(position.shape),
        velocity=velocity,
        effort=effort,
        joint_names=robot.joint_names,
    )


def only(log: Recording, robot: sdpid.RobotModel | None = None, kind: str = "") -> Finding:
    """Return the one finding, or the one of a kind."""
    (found,) = (f for f in inspect_recording(log, robot).findings if kind in ("", f.kind))
    return found


def kinds(log: Recording, robot: sdpid.RobotModel | None = None) -> list[tuple[str, str | None]]:
    return [(each.kind, each.joint) for each in inspect_recording(log, robot).findings]


@pytest.fixture(scope="module")
def log(robot: sdpid.RobotModel) -> Recording:
    return simulated(robot, 0)


def every(change: Callable[[np.ndarray], Any], *quantities: str) -> Change:
    return lambda log: replace(log, **{name: change(getattr(log, name)) for name in quantities})


def one(
    change: Callable[[np.ndarray], Any],
    *quantities: str,
    rows: Any = slice(None),
    joint: int = JOINT,
) -> Change:
    """Change one joint's values, in some rows."""

    def changed(table: np.ndarray) -> np.ndarray:
        values = table.copy()
        values[rows, joint] = change(values[rows, joint])
        return values

    return every(changed, *quantities)


def flipped(*quantities: str) -> Change:
    return one(np.negative, *quantities)


def ordered(order: list[int], *quantities: str) -> Change:
    return every(lambda table: table[:, order], *quantities)


def scaled(quantity: str, factor: float | np.ndarray) -> Change:
    return every(partial(np.multiply, factor), quantity)


def later(seconds: float, values: np.ndarray) -> np.ndarray:
    return np.interp(T - seconds, T, values)


def late(quantity: str, seconds: float) -> Change:
    return every(lambda table: np.apply_along_axis(partial(later, seconds), 0, table), quantity)


def clipped(quantity: str) -> Change:
    return one(lambda x: np.clip(x, *np.percentile(x, (5, 95))), quantity)


def stays(quantity: str, seconds: float = 1.0) -> Change:
    return one(lambda x: x[0], quantity, rows=slice(500, 500 + int(seconds * RATE)))


def rounded(step: float) -> Change:
    return one(lambda x: step * np.rint(x / step), "position")


def one_way(log: Recording) -> Recording:
    moved = one(lambda _: np.linspace(-2.0, 0.0, len(T)) + 0.05 * np.sin(T), "position")(log)
    return replace(moved, velocity=None)


def rested(log: Recording) -> Recording:
    rows = np.minimum(np.arange(3000), 1500)
    noise = 1e-6 * np.random.default_rng(0).standard_normal((3000, 6))
    return replace(log, position=log.position[rows] + noise, effort=log.effort[rows], velocity=None)


def losing(log: Recording) -> Recording:
    return rows_of(log, np.random.default_rng(0).uniform(size=len(T)) > 0.1)


def jittering(log: Recording) -> Recording:
    return replace(log, time=T + np.random.default_rng(0).uniform(-0.3, 0.3, len(T)) / RATE)


REVERSED = list(range(5, -1, -1))
CURRENTS = 1.0 / np.linspace(14.0, 9.0, 6)
EXCHANGED, TURNED = [2, 1, 0, 3, 4, 5], [5, 0, 1, 2, 3, 4]
WRONG: dict[str, tuple[Change, str, str, str]] = {
    "currents": (scaled("effort", CURRENTS), "effort_scale", "refuse", "currents (A)"),
    "N·mm": (scaled("effort", 1e3), "effort_scale", "refuse", "N·mm or mN·m instead of N·m"),
    "effort": (flipped("effort"), "effort_sign", "refuse", "leave 100 % of its variance unexpl"),
    "efforts": (scaled("effort", -1.0), "effort_sign", "refuse", "effort of all joints has"),
    "position": (flipped(*ALL[:2]), "position_sign", "refuse", "shoulder_lift_joint has the wrong"),
    "axis": (flipped(*ALL), "axis_sign", "refuse", "count the other way round"),
    "zero": (
        one(partial(np.add, np.pi / 2.0), "position"),
        "position_zero",
        "refuse",
        "other zero",
    ),
    "exchanged": (
        ordered(EXCHANGED, *ALL),
        "joint_order",
        "refuse",
        "elbow_joint, shoulder_lift_j",
    ),
    "reversed": (ordered(REVERSED, *ALL), "joint_order", "refuse", "wrist_3_joint, wrist_2_joint"),
    "efforts' order": (ordered(TURNED, "effort"), "effort_order", "refuse", "wrist_3_joint, shoul"),
    "degrees": (scaled("position", 180.0 / np.pi), "position_in_degrees", "refuse", "degrees"),
    "ms as s": (scaled("time", 1e3), "time_unit", "refuse", "must be in ms (100 Hz)"),
    "s as ms": (scaled("time", 1e-3), "time_unit", "refuse", "were read as ms"),
    "late efforts": (late("effort", 0.06), "effort_late", "warning", " ms or more against the mot"),
    "early efforts": (late("effort", -0.06), "effort_late", "warning", "early by"),
    "late velocity": (late("velocity", 0.06), "velocity_late", "note", "late by up to 5"),
    "clipped effort": (clipped("effort"), "effort_clipped", "warning", "effort of shoulder_lift"),
    "clipped velocity": (clipped("velocity"), "velocity_clipped", "note", "it is clipped"),
    "one way": (one_way, "one_direction", "warning", "shoulder_lift_joint moves in one direction"),
    "rest": (rested, "long_rest", "warning", "stands still in 49 %"),
    "lost": (losing, "lost_samples", "warning", "are missing"),
    "jitter": (jittering, "jitter", "note", "time stamps jitter by"),
}
ROW = slice(700, 701)
STAYS = (("effort", "warning"), ("velocity", "note"), ("position", "refuse"))
for (name, severity), x in product(STAYS, (0.5, 1.0, 6.0)):
    words = f"{name} of shoulder_lift_joint stays at"
    WRONG[f"{name} for {x:g} s"] = stays(name, x), f"{name}_frozen", severity, words
for x in (400.0, 1e5):
    off = one(partial(np.add, x), "effort", rows=ROW)
    WRONG[f"effort {x:g} N·m off"] = off, "effort_spike", "warning", "at row 701"
for x in (0.05, 0.3, 30.0):
    off = one(partial(np.add, x), "position", rows=ROW)
    words = f"shoulder_lift_joint is {x:.3g} rad off those before and after it at row 701"
    WRONG[f"position {x:g} rad off"] = off, "position_lone", "refuse", words
for x in (0.03, 0.1):
    words = "shoulder_lift_joint has"
    WRONG[f"rounded to {x:g} rad"] = rounded(x), "position_coarse", "warning", words
for x in (0.04, 0.1):
    words = "effort of shoulder_lift_joint alone is late by"
    change = one(partial(later, x), "effort")
    WRONG[f"effort {x:g} s late"] = change, "effort_late", "warning", words
for x in (0.5, 1.25, 2.0):
    words = f"the time stamps count {x:g} s for every second"
    WRONG[f"{x:g} times the time"] = scaled("time", x), "time_scale", "refuse", words


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_found_and_named(log: Recording, robot: sdpid.RobotModel, name: str):
    change, kind, severity, words = WRONG[name]
    found = {each.kind: each for each in inspect_recording(change(log), robot).findings}
    assert kind in found, found
    assert found[kind].severity == severity
    assert words in found[kind].message
    assert found[kind].remedy
    if severity == "refuse":
        assert kind in REFUSED
        assert next(iter(found.values())) is found[kind]


OF_ONE_CHANNEL = ("_frozen", "_spike", "_lone", "_coarse", "time_scale")
CHANNELS = [n for n, row in WRONG.items() if row[1].endswith(OF_ONE_CHANNEL) or "alone" in row[3]]


@pytest.mark.parametrize("name", CHANNELS)
def test_a_wrong_channel_accuses_no_other_joint_and_no_unit(
    log: Recording, robot: sdpid.RobotModel, name: str
):
    change, kind, _, _ = WRONG[name]
    (found,) = kinds(change(log), robot)
    assert found in ((kind, robot.joint_names[JOINT]), ("time_scale", None))


def test_what_else_is_wrong_beside_a_wrong_channel_is_told(log: Recording, robot: sdpid.RobotModel):
    wrong = flipped("effort")(stays("effort", 6.0)(log))
    assert {*dict(kinds(wrong, robot))} == {"effort_frozen", "effort_sign"}


@pytest.mark.parametrize("seed", range(4))
def test_a_good_log_is_left_alone(robot: sdpid.RobotModel, seed: int):
    assert inspect_recording(simulated(robot, seed), robot).findings == ()


def test_a_channel_clipped_at_both_ends_is_one_finding(log: Recording, robot: sdpid.RobotModel):
    found = only(clipped("effort")(log), robot)
    high, low = np.percentile(log.effort[:, JOINT], (95.0, 5.0))
    assert f"stays at {high:.5g} and at {low:.5g} in " in found.message
    assert 280 < found.numbers["rows"] <= 300  # single rows are no plateaus


def test_a_joint_that_runs_at_one_speed_is_not_clipped():
    phase = np.mod(0.4 * T, 2.0) - 1.0
    position = np.column_stack([0.5 * np.abs(phase), 0.3 * np.sin(3.0 * T)])
    velocity = np.column_stack([0.2 * np.sign(phase), 0.9 * np.cos(3.0 * T)])
    effort = np.random.default_rng(0).normal(size=position.shape)
    assert not kinds(Recording(time=T, position=position, velocity=velocity, effort=effort))


@pytest.mark.parametrize("change", [late("velocity", 0.06), clipped("velocity")])
def test_a_wrong_velocity_matters_where_it_is_used(log: Recording, change: Change):
    """At 50 Hz the default processing takes the recorded velocity, at 100 Hz it does not."""
    wrong = change(log)
    slow = rows_of(wrong, slice(None, None, 2))
    for each, severity in ((wrong, "note"), (slow, "warning")):
        assert (only(each).kind[:8], only(each).severity) == ("velocity", severity)


@pytest.mark.parametrize(
    ("step", "unit"),
    [
        (33.0, "must be in ms (30.3 Hz)"),
        (1e4, "must be in us (100 Hz)"),
        (1e7, "must be in ns (100 Hz)"),
        (1e2, "may be in ms (10 Hz) or us (1e+04 Hz)"),
        (1e14, "in no unit do the stamps make a rate of a robot"),
    ],
)
def test_the_unit_of_time_is_concluded(log: Recording, step: float, unit: str):
    slow = replace(log, time=step * np.arange(len(T))) if step < 1e6 else None
    cause, remedy = _read_as_seconds(1.0 / step)
    assert unit in cause
    if "must" in unit:
        name = unit.split()[3]
        assert remedy == f"give the unit: units={{'time': '{name}'}} (--unit time={name})"
    if slow is not None:
        found = only(slow, kind="time_unit")
        assert (found.severity, found.remedy) == ("refuse", remedy)
        assert found.message.endswith(cause)


def test_a_delay_is_told_without_false_precision(log: Recording, robot: sdpid.RobotModel):
    """Inertia and friction take a part of it: less is told than there is."""
    found = only(late("effort", 0.06)(log), robot, "effort_late")
    assert 0.02 < found.numbers["delay"] < 0.06


def test_several_errors_are_found_one_after_another(log: Recording, robot: sdpid.RobotModel):
    found = kinds(every(partial(np.multiply, [1, -1, -1, 1, 1, 1]), "effort")(log), robot)
    assert {*found} == {("effort_sign", name) for name in robot.joint_names[1:3]}


def test_a_robot_that_hangs_is_told(log: Recording, robot: sdpid.RobotModel):
    hanging = sdpid.RobotModel.from_pinocchio(robot.pin_model, gravity=(0.0, 0.0, 9.81))
    assert "(0, 0, -9.81)" in only(log, hanging, "gravity_direction").message


def test_descriptions_without_masses_or_made_up_do_not_refuse(
    log: Recording, robot: sdpid.RobotModel
):
    wrong = scaled("effort", 1e3)(log)
    massless = replace(robot, prior=np.zeros_like(robot.prior))
    note = only(wrong, massless)
    assert (note.severity, note.kind) == ("note", "effort_not_compared")
    assert "the robot's description has no masses" in note.message
    alike = np.tile([1.0, 0.0, 0.0, 0.1, 0.02, 0.0, 0.02, 0.0, 0.0, 0.01], (6, 1))
    findings = inspect_recording(wrong, replace(robot, prior=alike)).findings
    assert "effort_scale" in {f.kind for f in findings}
    assert all(f.severity != "refuse" for f in findings if f.kind == "effort_scale")


def dead_band(effort: np.ndarray) -> np.ndarray:
    """Return efforts of which small ones, most of them, are zero."""
    return np.where(np.abs(effort) < np.quantile(np.abs(effort), 0.85), 0.0, effort)


def current(effort: np.ndarray) -> np.ndarray:
    """Return currents of an unknown unit that say little but that the motor holds something."""
    slow = np.cumsum(np.random.default_rng(0).standard_normal(len(effort)))
    return 1.0 + 0.1 * slow / slow.std()


@pytest.mark.parametrize(
    ("joint", "change", "kind", "words"),
    [
        (4, dead_band, "effort_silent", "% of the rows in which it moves (limit 50 %)"),
        (1, current, "effort_small", "times as much (limit 5): another unit, a counterweight"),
    ],
)
def test_an_effort_that_says_nothing_is_left_out_and_accuses_no_other(
    log: Recording, robot: sdpid.RobotModel, joint: int, change: Callable, kind: str, words: str
):
    wrong, name = one(change, "effort", joint=joint)(log), robot.joint_names[joint]
    finding = only(wrong, robot)
    assert (finding.severity, finding.kind, finding.joint) == ("warning", kind, name)
    assert words in finding.message
    assert prepare(robot, wrong, accept=()).without_effort == (name,)
    assert prepare(robot, wrong).without_effort == ()
    assert prepare(robot, wrong, accept=(kind,)).without_effort == ()
    assert prepare(robot, wrong, without_effort=iter([name])).without_effort == (name,)
    assert f"--accept {kind}" in finding.remedy
    assert not inspect_recordings([wrong], robot, without_effort=[name])


def test_recordings_with_another_load_are_named(robot: sdpid.RobotModel):
    logs = [simulated(robot, 0), simulated(robot, 1), simulated(robot, 2, load=2.0)]
    (finding,) = inspect_recordings(logs, robot)
    assert (finding.kind, finding.severity) == ("payload_differs", "refuse")
    assert finding.message.startswith("recording 3: it carries another load than recording 1: +")
    assert finding.numbers["mass"] == pytest.approx(2.0, abs=0.3)
    assert inspect_recordings(logs[:2], robot) == ()


def test_findings_are_overruled_by_name():
    findings = [
        Finding(severity="refuse", kind="effort_sign", message="a", remedy="b"),
        Finding(severity="refuse", kind="effort_scale", message="c"),
        Finding(severity="warning", kind="long_rest", message="d"),
    ]
    with pytest.raises(DataError, match=r"a; b.*c.*accept=\['effort_sign', 'effort_scale'\]"):
        require_accepted(findings)
    asked = r"accept=\['effort_scale'\] \(--accept effort_scale\) overrules"
    refuses(DataError, asked, require_accepted, findings, "effort_sign")
    assert findings[0].line() == "accepted effort_sign: a; b"
    assert findings[0].line(used=False) == "refuse effort_sign: a; b"
    assert findings[2].line() == "warning long_rest: d"
    require_accepted(findings, ["effort_sign", "effort_scale"])
    refuses(DataError, "did you mean effort_sign", require_accepted, [], ["effort_sing"])
    for wrong in (None, True, 3):
        refuses(DataError, rf"accept: is {wrong}; give kinds of findings", kinds_accepted, wrong)


def kinds_told() -> Iterator[str]:
    """Yield every kind of finding, and of a correction, that the code names."""
    for path in Path(sdpid.__file__).parent.joinpath("experiment").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("found", "Correction"):
                named = (each.value for each in node.keywords if each.arg == "kind")
                (kind, *_) = (*node.args, *named)
                yield from [kind.value] if isinstance(kind, ast.Constant) else []


def test_every_kind_that_is_refused_is_accepted_by_name_or_is_final():
    assert set(kinds_told()) <= set(KINDS)
    assert len(set(kinds_told())) > 40
    for kind, row in KINDS.items():
        assert set(row.hides) <= {*KINDS, *(each.about for each in KINDS.values())}, kind
    refused = sorted(name for name, row in KINDS.items() if row.severity == "refuse")
    final = {*refused} - {*REFUSED}
    assert final == {"joints_unknown", "time_stamps", "processing"}
    findings = [Finding(severity="refuse", kind=kind, message=kind) for kind in refused]
    with pytest.raises(DataError) as error:
        require_accepted(findings)
    asked = re.findall(r"--accept (\w+)", str(error.value))
    assert kinds_accepted(asked) == tuple(kind for kind in refused if kind not in final)


def test_every_use_of_a_log_refuses_it(log: Recording, robot: sdpid.RobotModel):
    wrong = scaled("effort", CURRENTS)(log)
    for use in (
        lambda **given: sdpid.identify(robot, wrong, **given),
        lambda **given: sdpid.identify(robot, log, validation=wrong, **given),
        lambda **given: sdpid.identify_payload(robot, wrong, **given),
        lambda **given: sdpid.identify_payload(robot, log, wrong, **given),
    ):
        refuses(DataError, r"currents \(A\).*accept=\['effort_scale'\]", use)
    payload = sdpid.identify_payload(robot, wrong, accept="effort_scale")
    assert [each.kind for each in payload.findings] == ["effort_scale"]
    assert payload.to_dict()["findings"][0]["severity"] == "refuse"


# Findings about recordings: each check by a recording that has the defect, and one without.


def at(log: Recording, rows: Any) -> Recording:
    """Return positions and efforts of other rows at the times of the first ones."""
    return Recording(
        time=log.time[: len(rows)], position=log.position[rows], effort=log.effort[rows]
    )


def test_what_is_right_raises_no_alarm(log: Recording, robot: sdpid.RobotModel):
    inspection = inspect_recording(log, robot)
    assert inspection.ok
    assert inspection.findings == ()
    assert str(inspection) == "nothing wrong was found"
    assert overview(log, robot)["findings"] == []


@pytest.mark.parametrize(
    ("quantity", "factor", "kind", "words"),
    [
        (
            "velocity",
            180.0 / np.pi,
            "velocity_scale",
            "times the rate of its position (deg instead",
        ),
        ("velocity", 30.0 / np.pi, "velocity_scale", "(rpm instead of rad/s)"),
        ("velocity", -1.0, "velocity_scale", "velocity of {} has the sign opposite"),
        ("velocity", 1e3, "velocity_scale", "(a factor of 1000: time or velocity in thousandths)"),
        ("effort", 1e-2, "effort_scale", " times what the description's"),
        ("effort", 1e3, "effort_scale", "as at the other joints, limit 0.2 to 5: N·mm or mN·m"),
        ("effort", 0.0, "effort_silent", "effort of {} is exactly 0 in 100 % of the rows"),
        ("position", 0.0, "joint_at_rest", "{} never moves"),
        ("position", 1e-5, "joint_at_rest", "{} moves by 1."),
    ],
)
def test_wrong_signals_are_named(
    log: Recording, robot: sdpid.RobotModel, quantity: str, factor: float, kind: str, words: str
):
    wrong = one(partial(np.multiply, factor), quantity)(log)
    finding = only(wrong, robot, kind)
    assert finding.joint == log.names[JOINT]
    assert words.format(finding.joint) in finding.message
    assert finding.remedy
    # At 100 Hz the default processing does not use the recorded velocity.
    assert (finding.severity == "note") == (quantity == "velocity")
    assert inspect_recording(wrong, robot).ok == (quantity == "velocity")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda q, v: q + 0.1 * v, None),
        (lambda q, v: np.degrees(q), "is 57.3 times the position (deg instead of rad), limit"),
        (lambda q, v: np.roll(q, 1, axis=1), "is followed by shoulder_pan_joint (correlation 1)"),
        (lambda q, v: q + 0.2, "is 0.2 rad off the position on average, limit 0.1"),
        (lambda q, v: q - 0.05 * v, "comes 0.05 s after the motion, limit 0.02: it is no command"),
        (lambda q, v: 0.0 * q, "is not followed (correlation 0.00, limit 0.9)"),
        (lambda q, v: q + 0.2 * (np.arange(6) == JOINT), "is 0.2 rad off the position on"),
    ],
)
def test_references_that_are_not_followed_are_named(
    log: Recording, robot: sdpid.RobotModel, change: Any, words: str | None
):
    findings = inspect_recording(
        replace(log, reference=change(log.position, log.velocity)), robot
    ).findings
    assert [each.kind for each in findings] == (["reference_unlike"] if words else [])
    for finding in findings:
        # One finding, which names every joint that is wrong.
        assert finding.severity == "note"
        assert f"{log.names[JOINT]} {words}" in finding.message
        told = [name for name in log.names if f"of {name} " in finding.message]
        assert told == ([finding.joint] if finding.joint else list(log.names))
        assert ("scale" if finding.joint else f"{log.names[JOINT]}: scale") in finding.numbers


def test_a_position_that_jumps_is_named_with_its_row(log: Recording):
    jumps = one(partial(np.add, 4.8), "position", rows=slice(700, None))(log)
    finding = only(replace(jumps, velocity=None))
    assert (finding.kind, finding.severity) == ("position_jumps", "refuse")
    assert "changes by 4.79" in finding.message
    assert f"at row {finding.numbers['row']:.0f}," in finding.message
    assert finding.numbers["row"] == 701


def test_an_encoder_that_is_read_late_does_not_jump():
    """As a dVRK's: it repeats its position, and what it then changes by took as long."""
    time = np.arange(2000) / 200.0
    position = 0.5 * np.sin(24.0 * time)[:, None] * np.ones(2)
    for row in range(300, 2000, 300):
        position[row : row + 5, 1] = position[row - 1, 1]
    assert np.abs(np.diff(position, axis=0)).max() * 200.0 > 60.0
    late = Recording(time=time, position=position, effort=position)
    assert "position_jumps" not in dict(kinds(late))
    swing = 0.5 * np.sin(2.0 * np.pi * np.arange(8000) / 4000.0)[:, None]
    rounded = Recording(time=np.arange(8000) / 4000.0, position=np.round(swing, 1), effort=swing)
    assert kinds(rounded) == [("position_coarse", "1")]


def test_a_gap_is_no_outlier(log: Recording):
    """The motion during a gap is no jump: 1 rad is nothing in half a second."""
    gap = rows_of(log, np.r_[0:600, 900:3000])
    finding = only(gap)
    assert (finding.severity, finding.kind) == ("note", "continued")
    assert "split at 1 gap" in finding.message
    assert inspect_recording(gap).ok


def test_wrapped_angles_are_continued_not_alarmed_about(log: Recording):
    turning = np.angle(np.exp(1j * 4.0 * np.pi * 0.2 * T))[:, None]
    wrapped = Recording(time=T, position=turning, effort=log.effort[:, 1:2])
    finding = only(wrapped, kind="continued")
    assert finding.severity == "note"
    assert "angles that wrap continued" in finding.message


def test_rows_that_repeat_the_row_before_are_counted(log: Recording):
    finding = only(at(log, np.arange(2000) // 4 * 4))
    assert (finding.kind, finding.numbers["rows"]) == ("repeated_rows", 1500)
    # A long rest without noise is no fault of the logger.
    assert inspect_recording(at(log, np.r_[0:500, np.full(500, 500), 500:1500])).ok


def test_positions_in_degrees_hide_the_alarms_that_they_raise(
    log: Recording, robot: sdpid.RobotModel
):
    wrong = replace(log, position=np.degrees(log.position))
    assert kinds(wrong, robot) == [("position_in_degrees", None)]


def test_names_of_joints_are_matched_and_what_is_done_is_told(
    log: Recording, robot: sdpid.RobotModel
):
    other = replace(log, joint_names=("a", "b", "c", "d", "e", "f"))
    assert kinds(other, robot) == [("joints_unknown", None)]
    wider = {name: getattr(log, name)[:, [*range(6), 0]] for name in ALL}
    backwards = replace(log, joint_names=log.names[::-1])
    for changed, words in (
        (replace(log, joint_names=[f"left_{x}" for x in log.names]), "left_elbow_joint is elbow_j"),
        (ordered(REVERSED, *ALL)(backwards), "robot's order, the columns are of wrist_3_joint"),
        (replace(log, joint_names=(*log.names, "gripper"), **wider), "are left out: gripper"),
    ):
        finding = only(changed, robot)
        assert (finding.severity, finding.kind) == ("note", "joints")
        assert words in finding.message


def test_a_log_that_is_too_slow_for_a_robot_is_in_another_unit(log: Recording):
    creeps = Recording(time=10.0 * T, position=0.01 * log.position, effort=log.effort)
    finding = only(creeps, kind="time_unit")
    assert finding.severity == "refuse"
    assert "time: at 10 Hz no joint is faster than" in finding.message
    assert finding.numbers["speed"] < finding.numbers["limit"] == 0.02


def test_files_and_names_are_read(log: Recording, robot: sdpid.RobotModel, tmp_path: Path):
    wrong = flipped("effort")(log)
    path = tmp_path / "run.npz"
    arrays = {"t": wrong.time, "q": wrong.position, "dq": wrong.velocity, "tau": wrong.effort}
    np.savez(path, **arrays, joint_names=np.array(log.names))
    told = inspect_recording(path, "ur_description/ur5_robot").findings
    assert told == inspect_recording(wrong, robot).findings
    refuses(DataError, r"log: is int 3; give a Recording, the path of a log", inspect_recording, 3)
    refuses(SdpidError, r"no_arm\.urdf", inspect_recording, log, tmp_path / "no_arm.urdf")


def test_findings_are_data(log: Recording, robot: sdpid.RobotModel):
    wrong = flipped("effort")(log)
    first, second = inspect_recordings((log, wrong), robot), inspect_recordings((wrong,), robot)
    assert [str(each) for each in first] == [f"recording 2: {each}" for each in second]
    inspection = inspect_recording(wrong, robot)
    assert repr(inspection) == "Inspection(ok=False, findings: 1 refuse)"
    assert inspection.to_dict() == {"ok": False, "findings": [second[0].to_dict()]}
    assert "<td>effort_sign</td>" in inspection._repr_html_()
    entry = second[0].to_dict()
    assert entry["severity"] == "refuse"
    assert entry["numbers"]["unexplained_mended"] < 0.05
    assert entry["text"] == f"{entry['message']}; {entry['remedy']}"


def resting(log: Recording) -> Recording:
    still = one(lambda values: 0.3 + 0.0 * values, "position", joint=5)
    return replace(still(log), velocity=None)


def test_a_joint_that_another_recording_moves_is_not_unknown(
    log: Recording, robot: sdpid.RobotModel
):
    still = resting(log)
    for logs, remedies in (
        ((log, still), ["nothing to do where it moves enough in another one"]),
        ((still, still), 2 * ["its inertia and friction are unknown; excite it"]),
    ):
        found = inspect_recordings(logs, robot)
        assert [f.remedy for f in found if f.kind == "joint_at_rest"] == remedies
    # What is only predicted says nothing of what the fit knows.
    others = prepare(robot, log).others(still, accept=())
    (rest,) = (f for f in others.findings if f.kind == "joint_at_rest")
    assert rest.remedy == "how well it is predicted in motion is not shown; record it moving"


def test_identify_says_what_info_finds(log: Recording, robot: sdpid.RobotModel):
    wrong = resting(scaled("effort", -1.0)(log))
    with pytest.raises(DataError, match=r"effort_sign: effort of .* accept=\['effort_sign'\]"):
        sdpid.identify(robot, wrong, friction=(), intervals=False)
    result = sdpid.identify(
        robot, wrong, validation=wrong, friction=(), intervals=False, accept="effort_sign"
    )
    found = inspect_recording(wrong, robot).findings
    assert {"effort_sign", "joint_at_rest"} <= {each.kind for each in found}
    assert result.findings[: len(found)] == found
    assert {str(each) for each in found} <= set(result.notes)
    assert any(note.startswith("validation recording 1: effort of") for note in result.notes)
    saved = result.to_dict()
    assert saved["findings"][0]["kind"] == "effort_sign"
    assert saved["verdict"][0].startswith("The recording is not what it says: effort of")


# Three joints of the Gen3 turn one way only, and rows of the dVRK's repeat.
REAL = {
    "kinova_gen3_dynamapp/opti_traj_testing1": ("gen3", {"one_direction"}),
    "kuka_lwr4plus/measurements_1": ("kuka_lwr4", set()),
    "panda_unisa/panda_exciting": ("panda", set()),
    "staubli_tx40/tx40_rows_0_24750": ("tx40", set()),
    "ur10_unisa/ur10_exciting": ("ur10", set()),
    "dvrk_mtm/one": (None, {"repeated_rows"}),
}


@pytest.mark.parametrize("name", REAL)
def test_real_logs_raise_no_alarm(data_folder, name: str):
    urdf, true = REAL[name]
    path = data_folder / f"{name}.npz"
    robot = None if urdf is None else sdpid.load_robot(path.with_name(f"{urdf}.urdf"))
    findings = inspect_recording(sdpid.read_recording(path), robot).findings
    assert all(each.severity != "refuse" for each in findings)
    assert {each.kind for each in findings if each.severity == "warning"} == true, findings


def test_an_inferred_unit_of_time_is_said(log: Recording):
    columns = {"q1": log.position[:, 1], "tau1": log.effort[:, 1]}

    def read(stamps: np.ndarray, **given: Any) -> Recording:
        return sdpid.read_recording(pd.DataFrame({"t": stamps, **columns}), **given)

    rows = np.arange(len(T))
    for stamps in (10.0 * rows, 1.0 * rows):
        finding = only(read(stamps), kind="time_unit")
        assert finding.severity == "note"
        assert "taken for ms" in finding.message
        assert "units={'time': 's'} (--unit time=s)" in finding.remedy
    # No whole numbers: nothing is inferred, and the rate is warned of.
    jitter = np.random.default_rng(0).uniform(-0.1, 0.1, len(T))
    finding = only(read(10.0 * rows + jitter), kind="time_unit")
    assert finding.severity == "refuse"
    assert "0.1 Hz, limit 2 to 25000 Hz" in finding.message
    assert "time_unit" not in dict(kinds(read(T, units={"time": "s"})))
    # What else a recording says of itself has no unit to mend.
    said = only(replace(log, notes=("simulated without a controller",)))
    assert (said.severity, said.kind, said.remedy) == ("note", "recording", "")
