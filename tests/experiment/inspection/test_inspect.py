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
from sdpid import RobotModel
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
from sdpid.experiment.recording.recording import Recording
from tests.helpers.motions import sines
from tests.helpers.refusals import refuses

RATE = 100.0
T = np.arange(3000) / RATE
JOINT = 1
ALL = ("position", "velocity", "effort")
Change = Callable[[Recording], Recording]


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return sdpid.load_robot("ur_description/ur5_robot")


def simulated(robot: RobotModel, seed: int, load: float = 0.0) -> Recording:
    """Bodies 15 % heavier or lighter than described, friction, offsets and noise."""
    rng = np.random.default_rng(seed)
    rate = 2.0 * np.pi * rng.uniform(0.05, 0.4, (4, robot.n))
    phase = rng.uniform(0.0, 2.0 * np.pi, rate.shape)
    size = np.array([1.0, 0.5, 0.8, 1.0, 1.0, 1.0]) / 2.0
    position, velocity, acceleration = sines(T, rate, phase, size)
    position -= np.array([0.0, 1.2, 0.0, 0.0, 0.0, 0.0])
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


def only(log: Recording, robot: RobotModel | None = None, kind: str = "") -> Finding:
    """Return the one finding, or the one of a kind."""
    (found,) = (f for f in inspect_recording(log, robot).findings if kind in ("", f.kind))
    return found


def kinds(log: Recording, robot: RobotModel | None = None) -> list[tuple[str, str | None]]:
    return [(each.kind, each.joint) for each in inspect_recording(log, robot).findings]


@pytest.fixture(scope="module")
def log(robot: RobotModel) -> Recording:
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


def added(value: float, quantity: str, rows: Any = slice(None)) -> Change:
    return one(partial(np.add, value), quantity, rows=rows)


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


def rested(log: Recording) -> Recording:
    rows = np.minimum(np.arange(3000), 1500)
    noise = 1e-6 * np.random.default_rng(0).standard_normal((3000, 6))
    return replace(log, position=log.position[rows] + noise, effort=log.effort[rows], velocity=None)


def losing(log: Recording) -> Recording:
    return log.rows(np.random.default_rng(0).uniform(size=len(T)) > 0.1)


def jittering(log: Recording) -> Recording:
    return replace(log, time=T + np.random.default_rng(0).uniform(-0.3, 0.3, len(T)) / RATE)


def still(joint: int) -> Change:
    return one(lambda values: 0.3 + 0.0 * values, "position", joint=joint)


def without_velocity(change: Change) -> Change:
    return lambda log: replace(change(log), velocity=None)


def at(rows: np.ndarray, times: float = 1.0) -> Change:
    """Return positions and efforts of other rows at the times of the first ones."""
    return lambda log: Recording(
        time=times * T[: len(rows)], position=log.position[rows], effort=log.effort[rows]
    )


def referred(reference: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Change:
    return lambda log: replace(log, reference=reference(log.position, log.velocity))


def named(*names: str, columns: Any = slice(None)) -> Change:
    def renamed(log: Recording) -> Recording:
        tables = {name: getattr(log, name)[:, columns] for name in ALL}
        return replace(log, joint_names=names, **tables)

    return renamed


def creeping(log: Recording) -> Recording:
    return Recording(time=10.0 * T, position=0.01 * log.position, effort=log.effort)


def dead_band(effort: np.ndarray) -> np.ndarray:
    """Return efforts of which small ones, most of them, are zero."""
    return np.where(np.abs(effort) < np.quantile(np.abs(effort), 0.85), 0.0, effort)


def current(effort: np.ndarray) -> np.ndarray:
    """Return currents of an unknown unit that say little but that the motor holds something."""
    slow = np.cumsum(np.random.default_rng(0).standard_normal(len(effort)))
    return 1.0 + 0.1 * slow / slow.std()


SECOND = "shoulder_lift_joint"
NAMES = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
JOINTS = tuple(f"{name}_joint" for name in NAMES)
REVERSED = list(range(5, -1, -1))
CURRENTS = 1.0 / np.linspace(14.0, 9.0, 6)
EXCHANGED, TURNED, MIXED = [2, 1, 0, 3, 4, 5], [5, 0, 1, 2, 3, 4], [3, 2, 5, 4, 0, 1]
MIXED_NAMES = ", ".join(JOINTS[j] for j in MIXED)
ROW = slice(700, 701)
ONE_WAY = one(lambda _: np.linspace(-2.0, 0.0, len(T)) + 0.05 * np.sin(T), "position")
Rows = dict[str, tuple[Change, str, str]]
SPOILED: Rows = {
    "currents": (scaled("effort", CURRENTS), "effort_scale", "currents (A)"),
    "N·mm": (scaled("effort", 1e3), "effort_scale", "N·mm or mN·m instead of N·m"),
    "effort": (flipped("effort"), "effort_sign", "leave 100 % of its variance unexplained"),
    "efforts": (scaled("effort", -1.0), "effort_sign", "effort of all joints has"),
    "position": (flipped(*ALL[:2]), "position_sign", f"{SECOND} has the wrong"),
    "axis": (flipped(*ALL), "axis_sign", "count the other way round"),
    "zero": (added(np.pi / 2.0, "position"), "position_zero", "other zero"),
    "exchanged": (ordered(EXCHANGED, *ALL), "joint_order", "elbow_joint, shoulder_lift_j"),
    "reversed": (ordered(REVERSED, *ALL), "joint_order", "wrist_3_joint, wrist_2_joint"),
    "efforts' order": (ordered(TURNED, "effort"), "effort_order", "wrist_3_joint, shoulder_pan"),
    "efforts, any order": (ordered(MIXED, "effort"), "effort_order", MIXED_NAMES),
    "degrees": (scaled("position", 180.0 / np.pi), "position_in_degrees", "degrees"),
    "ms as s": (scaled("time", 1e3), "time_unit", "must be in ms (100 Hz)"),
    "s as ms": (scaled("time", 1e-3), "time_unit", "were read as ms"),
    "late efforts": (late("effort", 0.06), "effort_late", " ms or more against the motion"),
    "early efforts": (late("effort", -0.06), "effort_late", "early by"),
    "late velocity": (late("velocity", 0.06), "velocity_late", "late by up to 5"),
    # At both ends; single rows are no plateaus.
    "clipped effort": (clipped("effort"), "effort_clipped", "12.67 and at -52.344 in 299 of 3000"),
    "clipped velocity": (clipped("velocity"), "velocity_clipped", "it is clipped"),
    "one way": (without_velocity(ONE_WAY), "one_direction", f"{SECOND} moves in one direction"),
    "rest": (rested, "long_rest", "stands still in 49 %"),
    "lost": (losing, "lost_samples", "are missing"),
    "jitter": (jittering, "jitter", "time stamps jitter by"),
}
for name, x in product(("effort", "velocity", "position"), (0.5, 1.0, 6.0)):
    words = f"{name} of {SECOND} stays at"
    SPOILED[f"{name} for {x:g} s"] = stays(name, x), f"{name}_frozen", words
for x in (400.0, 1e5):
    SPOILED[f"effort {x:g} N·m off"] = added(x, "effort", ROW), "effort_spike", "at row 701"
for x in (0.05, 0.3, 30.0):
    words = f"{SECOND} is {x:.3g} rad off those before and after it at row 701"
    SPOILED[f"position {x:g} rad off"] = added(x, "position", ROW), "position_lone", words
for x in (0.03, 0.1):
    SPOILED[f"rounded to {x:g} rad"] = rounded(x), "position_coarse", f"{SECOND} has"
for x in (0.04, 0.1):
    words = f"effort of {SECOND} alone is late by"
    SPOILED[f"effort {x:g} s late"] = one(partial(later, x), "effort"), "effort_late", words
for x in (0.5, 1.25, 2.0):
    words = f"the time stamps count {x:g} s for every second"
    SPOILED[f"{x:g} times the time"] = scaled("time", x), "time_scale", words


def severity(kind: str) -> str:
    """Return that of a kind: at 100 Hz the default processing does not use the velocity."""
    return "note" if kind.startswith("velocity") else KINDS[kind].severity


# What `identify` is tried on as well, in the tests of the verdict.
WRONG = {
    name: (change, kind, severity(kind), words) for name, (change, kind, words) in SPOILED.items()
}
# Of one joint a channel that is so many times too large.
TIMES = (
    ("velocity", 180.0 / np.pi, "velocity_scale", "the rate of its position (deg instead of rad)"),
    ("velocity", 30.0 / np.pi, "velocity_scale", "the rate of its position (rpm instead of rad/s)"),
    ("velocity", -1.0, "velocity_scale", f"velocity of {SECOND} has the sign opposite"),
    ("velocity", 1e3, "velocity_scale", "(a factor of 1000: time or velocity in thousandths)"),
    ("effort", 1e-2, "effort_scale", f"effort of {SECOND} is "),
    ("effort", 1e3, "effort_scale", "as at the other joints, limit 0.2 to 5: N·mm or mN·m"),
    ("effort", 0.0, "effort_silent", f"effort of {SECOND} is exactly 0 in 100 % of the rows"),
    ("position", 0.0, "joint_at_rest", f"{SECOND} never moves"),
    ("position", 1e-5, "joint_at_rest", f"{SECOND} moves by 1."),
)
REFERENCES = (
    (lambda q, v: np.degrees(q), "is 57.3 times the position (deg instead of rad), limit"),
    (lambda q, v: np.roll(q, 1, axis=1), "is followed by shoulder_pan_joint (correlation 1)"),
    (lambda q, v: q + 0.2, "is 0.2 rad off the position on average, limit 0.1"),
    (lambda q, v: q - 0.05 * v, "comes 0.05 s after the motion, limit 0.02: it is no command"),
    (lambda q, v: 0.0 * q, "is not followed (correlation 0.00, limit 0.9)"),
)
JUMP = without_velocity(added(4.8, "position", slice(700, None)))
REMARK = "simulated without a controller"
PREFIXED, GRIPPING = (f"left_{name}" for name in JOINTS), (*JOINTS, "gripper")
BACKWARDS = named(*JOINTS[::-1], columns=REVERSED)
ROWS: Rows = {
    **SPOILED,
    **{f"{name} × {x:g}": (one(partial(np.multiply, x), name), *row) for name, x, *row in TIMES},
    **{
        f"reference {words}": (referred(change), "reference_unlike", f"{SECOND} {words}")
        for change, words in REFERENCES
    },
    "dead band": (one(dead_band, "effort"), "effort_silent", "% of the rows in which it moves (li"),
    "current": (one(current, "effort"), "effort_small", "times as much (limit 5): another unit, a"),
    "repeated": (at(np.arange(2000) // 4 * 4), "repeated_rows", "1500 of 2000 rows (75 %)"),
    "jump": (JUMP, "position_jumps", "rad in one step at row 701, that is 47"),
    "creeping": (creeping, "time_unit", "time: at 10 Hz no joint is faster than"),
    "gap": (lambda log: log.rows(np.r_[0:600, 900:3000]), "continued", "split at 1 gap"),
    "remark": (lambda log: replace(log, notes=(REMARK,)), "recording", REMARK),
    "names": (named(*"abcdef"), "joints_unknown", "are not those of the robot 'ur5'"),
    "prefix": (named(*PREFIXED), "joints", "left_elbow_joint is elbow_joint"),
    "order": (BACKWARDS, "joints", "robot's order, the columns are of wrist_3_joint"),
    "gripper": (named(*GRIPPING, columns=[*range(6), 0]), "joints", "are left out: gripper"),
}


WITHOUT_REMEDY = ("joints_unknown", "joints", "continued", "recording")
OF_ONE = ("_frozen", "_spike", "_lone", "_coarse", "_silent", "_small", "effort_clipped")


@pytest.mark.parametrize("name", ROWS)
def test_what_is_wrong_is_found_and_named(log: Recording, robot: RobotModel, name: str):
    change, kind, words = ROWS[name]
    inspection = inspect_recording(change(log), robot)
    found = {each.kind: each for each in inspection.findings}
    assert kind in found, found
    assert found[kind].severity == severity(kind)
    assert words in found[kind].message
    assert bool(found[kind].remedy) or kind in WITHOUT_REMEDY
    assert inspection.ok == (found[kind].severity == "note")
    if found[kind].severity == "refuse":
        assert (kind in REFUSED) != KINDS[kind].final
        assert next(iter(found.values())) is found[kind]
    # Some hide the alarms that they raise.
    if kind in ("position_in_degrees", "joints_unknown", "repeated_rows", "continued"):
        assert [*found] == [kind]
    # No other joint and no unit is accused.
    if kind.endswith(OF_ONE) or "alone" in words:
        assert [(each.kind, each.joint) for each in inspection.findings] == [(kind, SECOND)]


def one_speed(_: Recording) -> Recording:
    """Return a joint that runs to and fro at one speed: it is not clipped."""
    phase = np.mod(0.4 * T, 2.0) - 1.0
    position = np.column_stack([0.5 * np.abs(phase), 0.3 * np.sin(3.0 * T)])
    velocity = np.column_stack([0.2 * np.sign(phase), 0.9 * np.cos(3.0 * T)])
    effort = np.random.default_rng(0).normal(size=position.shape)
    return Recording(time=T, position=position, velocity=velocity, effort=effort)


def read_late(_: Recording) -> Recording:
    """Return an encoder, as a dVRK's, that repeats its position, and then changes by as much."""
    time = np.arange(2000) / 200.0
    position = 0.5 * np.sin(24.0 * time)[:, None] * np.ones(2)
    for row in range(300, 2000, 300):
        position[row : row + 5, 1] = position[row - 1, 1]
    assert np.abs(np.diff(position, axis=0)).max() * 200.0 > 60.0
    return Recording(time=time, position=position, effort=position)


def alone(position: np.ndarray, time: np.ndarray = T) -> Change:
    """Return one joint, whose efforts are 0.1 times its position."""
    return lambda _: Recording(
        time=time, position=position[:, None], effort=0.1 * position[:, None]
    )


SIGNS = scaled("effort", np.array([1.0, -1.0, -1.0, 1.0, 1.0, 1.0]))
TWICE = {("effort_sign", name) for name in JOINTS[1:3]}
SLOW = np.round(0.5 * np.sin(2.0 * np.pi * np.arange(8000) / 4000.0), 1)
EXACTLY: dict[str, tuple[Change, set[tuple[str, str | None]]]] = {
    **{f"{x:g} times the time": (scaled("time", x), {("time_scale", None)}) for x in (0.5, 2.0)},
    "stays, wrong sign": (
        lambda log: flipped("effort")(stays("effort", 6.0)(log)),
        {("effort_frozen", SECOND), ("effort_sign", SECOND)},
    ),
    "two signs": (SIGNS, TWICE),
    "a reference that is followed": (referred(lambda q, v: q + 0.1 * v), set()),
    # A long rest without noise is no fault of the logger.
    "rest": (at(np.r_[0:500, np.full(500, 500), 500:1500]), set()),
    "one speed": (one_speed, set()),
    "read late": (read_late, set()),
    "rounded": (alone(SLOW, np.arange(8000) / 4000.0), {("position_coarse", "1")}),
    "wraps": (
        alone(np.angle(np.exp(0.8j * np.pi * T))),
        {("continued", None), ("one_direction", "1")},
    ),
}


@pytest.mark.parametrize("name", EXACTLY)
def test_this_and_nothing_else_is_told(log: Recording, robot: RobotModel, name: str):
    change, told = EXACTLY[name]
    changed = change(log)
    assert {*kinds(changed, robot if changed.n == robot.n else None)} == told


@pytest.mark.parametrize("seed", range(4))
def test_what_is_right_raises_no_alarm(robot: RobotModel, seed: int):
    log = simulated(robot, seed)
    inspection = inspect_recording(log, robot)
    assert inspection.ok
    assert inspection.findings == ()
    assert str(inspection) == "nothing wrong was found"
    assert overview(log, robot)["findings"] == []


@pytest.mark.parametrize("change", [late("velocity", 0.06), clipped("velocity")])
def test_a_wrong_velocity_matters_where_it_is_used(log: Recording, change: Change):
    """At 50 Hz the default processing takes the recorded velocity, at 100 Hz it does not."""
    finding = only(change(log).rows(slice(None, None, 2)))
    assert (finding.kind[:8], finding.severity) == ("velocity", "warning")


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
    cause, remedy = _read_as_seconds(1.0 / step)
    assert unit in cause
    if "must" in unit:
        name = unit.split()[3]
        assert remedy == f"give the unit: units={{'time': '{name}'}} (--unit time={name})"
    if step < 1e6:
        found = only(scaled("time", step * RATE)(log), kind="time_unit")
        assert (found.severity, found.remedy) == ("refuse", remedy)
        assert found.message.endswith(cause)


def test_an_inferred_unit_of_time_is_said(log: Recording):
    rows, jitter = np.arange(len(T)), 0.1 * np.sin(T)
    found = []
    # Where they are no whole numbers nothing is inferred, and the rate is warned of.
    for stamps in (10.0 * rows, 1.0 * rows, 10.0 * rows + jitter):
        columns = {"t": stamps, "q1": log.position[:, 1], "tau1": log.effort[:, 1]}
        found.append(only(sdpid.read_recording(pd.DataFrame(columns)), kind="time_unit"))
    assert [each.severity for each in found] == ["note", "note", "refuse"]
    for each in found[:2]:
        assert "taken for ms" in each.message
        assert "units={'time': 's'} (--unit time=s)" in each.remedy
    assert "0.1 Hz, limit 2 to 25000 Hz" in found[2].message
    known = sdpid.read_recording(pd.DataFrame({**columns, "t": T}), units={"time": "s"})
    assert "time_unit" not in dict(kinds(known))


def test_a_delay_is_told_without_false_precision(log: Recording, robot: RobotModel):
    """Inertia and friction take a part of it: less is told than there is."""
    found = only(late("effort", 0.06)(log), robot, "effort_late")
    assert 0.02 < found.numbers["delay"] < 0.06


def test_a_robot_that_hangs_is_told(log: Recording, robot: RobotModel):
    hanging = RobotModel.from_pinocchio(robot.pin_model, gravity=(0.0, 0.0, 9.81))
    assert "(0, 0, -9.81)" in only(log, hanging, "gravity_direction").message


def test_descriptions_without_masses_or_made_up_do_not_refuse(log: Recording, robot: RobotModel):
    wrong = scaled("effort", 1e3)(log)
    note = only(wrong, replace(robot, prior=np.zeros_like(robot.prior)))
    assert (note.severity, note.kind) == ("note", "effort_not_compared")
    assert "the robot's description has no masses" in note.message
    alike = np.tile([1.0, 0.0, 0.0, 0.1, 0.02, 0.0, 0.02, 0.0, 0.0, 0.01], (6, 1))
    findings = inspect_recording(wrong, replace(robot, prior=alike)).findings
    assert {f.severity for f in findings if f.kind == "effort_scale"} == {"warning"}


@pytest.mark.parametrize("name", ["dead band", "current"])
def test_an_effort_that_says_nothing_is_left_out(log: Recording, robot: RobotModel, name: str):
    change, kind, _ = ROWS[name]
    wrong = change(log)
    for given, left_out in (
        ({"accept": ()}, (SECOND,)),
        ({}, ()),
        ({"accept": (kind,)}, ()),
        ({"without_effort": iter([SECOND])}, (SECOND,)),
    ):
        assert prepare(robot, wrong, **given).without_effort == left_out
    assert f"--accept {kind}" in only(wrong, robot).remedy
    assert not inspect_recordings([wrong], robot, without_effort=[SECOND])


def test_recordings_with_another_load_are_named(robot: RobotModel):
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
    asked = r"a; b.*c.*accept=\['effort_sign', 'effort_scale'\]"
    refuses(DataError, asked, require_accepted, findings)
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
    abouts = [each.about for each in KINDS.values()]
    for kind, row in KINDS.items():
        assert set(row.hides) <= {*KINDS, *abouts, "everything"}, kind
    refused = sorted(name for name, row in KINDS.items() if row.severity == "refuse")
    final = {*refused} - {*REFUSED}
    assert final == {"joints_unknown", "time_stamps", "processing"}
    findings = [Finding(severity="refuse", kind=kind, message=kind) for kind in refused]
    error = refuses(DataError, "the log is refused", require_accepted, findings)
    asked = re.findall(r"--accept (\w+)", str(error))
    assert kinds_accepted(asked) == tuple(kind for kind in refused if kind not in final)


def test_every_use_of_a_log_refuses_it(log: Recording, robot: RobotModel):
    wrong = scaled("effort", CURRENTS)(log)
    asked = r"currents \(A\).*accept=\['effort_scale'\]"
    for use in (sdpid.identify, sdpid.identify_payload):
        refuses(DataError, asked, use, robot, wrong)
    refuses(DataError, asked, sdpid.identify, robot, log, validation=wrong)
    refuses(DataError, asked, sdpid.identify_payload, robot, log, wrong)
    payload = sdpid.identify_payload(robot, wrong, accept="effort_scale")
    assert [each.kind for each in payload.findings] == ["effort_scale"]
    assert payload.to_dict()["findings"][0]["severity"] == "refuse"


@pytest.mark.parametrize("joints", [JOINTS, [SECOND]])
def test_one_finding_names_every_reference_that_is_wrong(
    log: Recording, robot: RobotModel, joints: list[str]
):
    wrong = referred(lambda q, v: q + 0.2 * np.isin(JOINTS, joints))(log)
    finding = only(wrong, robot)
    assert [name for name in JOINTS if f"of {name} " in finding.message] == [*joints]
    assert finding.joint == (SECOND if len(joints) == 1 else None)
    assert ("scale" if finding.joint else f"{SECOND}: scale") in finding.numbers


def test_files_and_names_are_read(log: Recording, robot: RobotModel, tmp_path: Path):
    wrong = flipped("effort")(log)
    path = tmp_path / "run.npz"
    arrays = {"t": wrong.time, "q": wrong.position, "dq": wrong.velocity, "tau": wrong.effort}
    np.savez(path, **arrays, joint_names=np.array(log.names))
    told = inspect_recording(path, "ur_description/ur5_robot").findings
    assert told == inspect_recording(wrong, robot).findings
    refuses(DataError, r"log: is int 3; give a Recording, the path of a log", inspect_recording, 3)
    refuses(SdpidError, r"no_arm\.urdf", inspect_recording, log, tmp_path / "no_arm.urdf")


def test_findings_are_data(log: Recording, robot: RobotModel):
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


def test_a_joint_that_another_recording_moves_is_not_unknown(log: Recording, robot: RobotModel):
    rests = without_velocity(still(5))(log)
    for logs, remedies in (
        ((log, rests), ["nothing to do where it moves enough in another one"]),
        ((rests, rests), 2 * ["its inertia and friction are unknown; excite it"]),
    ):
        found = inspect_recordings(logs, robot)
        assert [f.remedy for f in found if f.kind == "joint_at_rest"] == remedies
    # What is only predicted says nothing of what the fit knows.
    others = prepare(robot, log).others(rests, accept=())
    (rest,) = (f for f in others.findings if f.kind == "joint_at_rest")
    assert rest.remedy == "how well it is predicted in motion is not shown; record it moving"


def test_identify_says_what_info_finds(log: Recording, robot: RobotModel):
    wrong = without_velocity(still(5))(scaled("effort", -1.0)(log))
    given = {"friction": (), "intervals": False}
    asked = r"effort_sign: effort of .* accept=\['effort_sign'\]"
    refuses(DataError, asked, sdpid.identify, robot, wrong, **given)
    result = sdpid.identify(robot, wrong, validation=wrong, accept="effort_sign", **given)
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


def master(rows: int = 4000) -> Recording:
    """Return a log read at times of its own, with a speed that is off and a drive that swings."""
    rng, step = np.random.default_rng(4), 0.005
    stamps = step * np.arange(rows)
    read = np.maximum.accumulate(stamps + 0.5 * step * rng.normal(size=rows))
    read = read[np.maximum.accumulate(np.where(rng.random(rows) < 0.1, 0, np.arange(rows)))]
    rates = np.array([1.3, 2.1, 3.4, 2.7])
    position, velocity = np.sin(rates * read[:, None]), rates * np.cos(rates * read[:, None])
    velocity[:, 2] *= 1.12
    effort = np.array([1.0, 2.0, 3.0, 0.1]) * np.cos(read)[:, None]
    effort[:, 3] += 0.3 * np.sin(2.0 * np.pi * 24.0 * stamps)
    return Recording(time=stamps, position=position, velocity=velocity, effort=effort)


def test_a_clock_speeds_and_noise_are_named():
    told = {each.kind: each for each in inspect_recording(master()).findings}
    clock, speed, noise = (
        told[f"{kind}"] for kind in ("clock_jitter", "velocity_unlike", "effort_noisy")
    )
    assert {clock.severity, speed.severity, noise.severity} == {"note"}
    assert clock.numbers["jitter"] == pytest.approx(0.0025, rel=0.4)
    assert clock.numbers["left"] < 0.3 * clock.numbers["missed"]
    assert (speed.joint, noise.joint) == ("3", "4")
    assert speed.numbers["scale"] == pytest.approx(1.12, abs=0.01)
    assert noise.numbers["frequency"] == pytest.approx(24.0, abs=0.5)
    assert not any("times taken" in each.message for each in told.values())
    again = [each.kind for each in inspect_recording(replace(master(), velocity=None)).findings]
    assert "clock_jitter" not in again
