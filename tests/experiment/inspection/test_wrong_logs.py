"""Logs that are wrong in one way each, of an arm whose bodies are not quite as described."""

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError
from sdpid.experiment.inspection.accept import REFUSED, kinds_accepted, require_accepted
from sdpid.experiment.inspection.channels.rules import RULES
from sdpid.experiment.inspection.dynamics_checks import OF_FLAGS
from sdpid.experiment.inspection.finding import Finding
from sdpid.experiment.inspection.inspect import inspect_recording, inspect_recordings
from sdpid.experiment.inspection.time_checks import _read_as_seconds
from sdpid.experiment.preparation.several import prepare_recordings
from sdpid.experiment.recording.recording import Recording
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


@pytest.fixture(scope="module")
def log(robot: sdpid.RobotModel) -> Recording:
    return simulated(robot, 0)


def flipped(*quantities: str, joints: tuple[int, ...] = (JOINT,)) -> Change:
    sign = np.ones(6)
    sign[list(joints)] = -1.0
    return lambda log: replace(log, **{name: sign * getattr(log, name) for name in quantities})


def ordered(order: list[int], *quantities: str) -> Change:
    return lambda log: replace(log, **{name: getattr(log, name)[:, order] for name in quantities})


def scaled(quantity: str, factor: float | np.ndarray) -> Change:
    return lambda log: replace(log, **{quantity: factor * getattr(log, quantity)})


def zeroed(log: Recording) -> Recording:
    return replace(log, position=log.position + np.pi / 2.0 * (np.arange(6) == JOINT))


def late(quantity: str, seconds: float) -> Change:
    def change(log: Recording) -> Recording:
        moved = [np.interp(T - seconds, T, column) for column in getattr(log, quantity).T]
        return replace(log, **{quantity: np.column_stack(moved)})

    return change


def clipped(quantity: str) -> Change:
    def change(log: Recording) -> Recording:
        values = getattr(log, quantity).copy()
        column = values[:, JOINT]
        values[:, JOINT] = np.clip(column, *np.percentile(column, (5.0, 95.0)))
        return replace(log, **{quantity: values})

    return change


def one_way(log: Recording) -> Recording:
    position = log.position.copy()
    position[:, JOINT] = np.linspace(-2.0, 0.0, len(T)) + 0.05 * np.sin(T)
    return replace(log, position=position, velocity=None)


def rested(log: Recording) -> Recording:
    rows = np.minimum(np.arange(3000), 1500)
    noise = 1e-6 * np.random.default_rng(0).standard_normal((3000, 6))
    return replace(log, position=log.position[rows] + noise, effort=log.effort[rows], velocity=None)


def losing(log: Recording) -> Recording:
    kept = np.random.default_rng(0).uniform(size=len(T)) > 0.1
    return replace(log, **{name: getattr(log, name)[kept] for name in ("time", *ALL)})


def jittering(log: Recording) -> Recording:
    return replace(log, time=T + np.random.default_rng(0).uniform(-0.3, 0.3, len(T)) / RATE)


def changed_rows(quantity: str, rows: slice, value: Callable[[np.ndarray], object]) -> Change:
    """Change one joint's values in some rows."""

    def change(log: Recording) -> Recording:
        values = getattr(log, quantity).copy()
        values[rows, JOINT] = value(values[rows, JOINT])
        return replace(log, **{quantity: values})

    return change


def stays(quantity: str, seconds: float = 1.0) -> Change:
    return changed_rows(quantity, slice(500, 500 + int(seconds * RATE)), lambda values: values[0])


REVERSED = list(range(5, -1, -1))
CURRENTS = 1.0 / np.linspace(14.0, 9.0, 6)
WRONG: dict[str, tuple[Change, str, str, str]] = {
    "currents": (scaled("effort", CURRENTS), "effort_scale", "refuse", "currents (A)"),
    "N·mm": (scaled("effort", 1e3), "effort_scale", "refuse", "N·mm or mN·m instead of N·m"),
    "effort": (flipped("effort"), "effort_sign", "refuse", "effort of shoulder_lift_joint has"),
    "efforts": (scaled("effort", -1.0), "effort_sign", "refuse", "effort of all joints has"),
    "position": (
        flipped("position", "velocity"),
        "position_sign",
        "refuse",
        "position of shoulder_lift_joint has the wrong sign",
    ),
    "axis": (flipped(*ALL), "axis_sign", "refuse", "count the other way round"),
    "zero": (zeroed, "position_zero", "refuse", "another zero"),
    "exchanged": (
        ordered([2, 1, 0, 3, 4, 5], *ALL),
        "joint_order",
        "refuse",
        "order elbow_joint, shoulder_lift_joint, shoulder_pan_joint, wrist_1_joint",
    ),
    "reversed": (
        ordered(REVERSED, *ALL),
        "joint_order",
        "refuse",
        "order wrist_3_joint, wrist_2_joint, wrist_1_joint, elbow_joint, shoulder_lift_joint",
    ),
    "efforts' order": (
        ordered([5, 0, 1, 2, 3, 4], "effort"),
        "effort_order",
        "refuse",
        "efforts are in the order wrist_3_joint, shoulder_pan_joint, shoulder_lift_joint",
    ),
    "degrees": (scaled("position", 180.0 / np.pi), "position_in_degrees", "refuse", "degrees"),
    "ms as s": (
        lambda log: replace(log, time=1e3 * T),
        "time_unit",
        "refuse",
        "must be in ms (100 Hz)",
    ),
    "s as ms": (lambda log: replace(log, time=1e-3 * T), "time_unit", "refuse", "were read as ms"),
    "late efforts": (late("effort", 0.06), "effort_late", "warning", "late by"),
    "early efforts": (late("effort", -0.06), "effort_late", "warning", "early by"),
    "late velocity": (late("velocity", 0.06), "velocity_late", "note", "late by up to 5"),
    "clipped effort": (clipped("effort"), "effort_clipped", "warning", "effort of shoulder_lift"),
    "clipped velocity": (clipped("velocity"), "velocity_clipped", "note", "it is clipped"),
    "one way": (one_way, "one_direction", "warning", "shoulder_lift_joint moves in one direction"),
    "rest": (rested, "long_rest", "warning", "stands still in 49 %"),
    **{
        f"{quantity} for {seconds:g} s": (
            stays(quantity, seconds),
            f"{quantity}_frozen",
            severity,
            f"{quantity} of shoulder_lift_joint stays at",
        )
        for quantity, severity in (
            ("effort", "warning"),
            ("velocity", "note"),
            ("position", "refuse"),
        )
        for seconds in (0.5, 1.0, 6.0)
    },
    **{
        f"effort {size:g} N·m off": (
            changed_rows("effort", slice(700, 701), lambda values, size=size: values + size),
            "effort_spike",
            "warning",
            "at row 701",
        )
        for size in (400.0, 1e5)
    },
    **{
        f"position {angle:g} rad off": (
            changed_rows("position", slice(700, 701), lambda values, angle=angle: values + angle),
            "position_lone",
            "refuse",
            f"shoulder_lift_joint is {angle:.3g} rad off those before and after it at row 701",
        )
        for angle in (0.05, 0.3, 30.0)
    },
    **{
        f"rounded to {step:g} rad": (
            changed_rows(
                "position", slice(None), lambda values, step=step: step * np.rint(values / step)
            ),
            "position_coarse",
            "warning",
            "shoulder_lift_joint has",
        )
        for step in (0.03, 0.1)
    },
    **{
        f"effort {seconds:g} s late": (
            changed_rows(
                "effort", slice(None), lambda values, late=seconds: np.interp(T - late, T, values)
            ),
            "effort_late",
            "warning",
            "effort of shoulder_lift_joint alone is late by",
        )
        for seconds in (0.04, 0.1)
    },
    **{
        f"{factor:g} times the time": (
            lambda log, factor=factor: replace(log, time=factor * log.time),
            "time_scale",
            "refuse",
            f"the time stamps count {factor:g} s for every second",
        )
        for factor in (0.5, 1.25, 2.0)
    },
    "lost": (losing, "lost_samples", "warning", "are missing"),
    "jitter": (jittering, "jitter", "note", "time stamps jitter by"),
}


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
    (finding,) = inspect_recording(change(log), robot).findings
    assert (finding.kind, finding.joint) in ((kind, robot.joint_names[JOINT]), ("time_scale", None))


def test_what_else_is_wrong_beside_a_wrong_channel_is_told(log: Recording, robot: sdpid.RobotModel):
    wrong = flipped("effort")(stays("effort", 6.0)(log))
    assert {f.kind for f in inspect_recording(wrong, robot).findings} == {
        "effort_frozen",
        "effort_sign",
    }


@pytest.mark.parametrize("seed", range(4))
def test_a_good_log_is_left_alone(robot: sdpid.RobotModel, seed: int):
    assert inspect_recording(simulated(robot, seed), robot).findings == ()


def test_a_channel_clipped_at_both_ends_is_one_finding(log: Recording, robot: sdpid.RobotModel):
    (found,) = inspect_recording(clipped("effort")(log), robot).findings
    high, low = np.percentile(log.effort[:, JOINT], (95.0, 5.0))
    assert f"stays at {high:.5g} and at {low:.5g} in " in found.message
    assert 280 < found.numbers["rows"] <= 300  # single rows are no plateaus


def test_the_variance_is_the_joints_own(log: Recording, robot: sdpid.RobotModel):
    (found,) = inspect_recording(flipped("effort")(log), robot).findings
    assert "leave 100 % of its variance unexplained, and " in found.message
    assert " % once that is mended" in found.message


@pytest.mark.parametrize("change", [late("velocity", 0.06), clipped("velocity")])
def test_a_wrong_velocity_matters_where_it_is_used(log: Recording, change: Change):
    """At 50 Hz the default processing takes the recorded velocity, at 100 Hz it does not."""
    wrong = change(log)
    slow = replace(wrong, **{name: getattr(wrong, name)[::2] for name in ("time", *ALL)})
    for each, severity in ((wrong, "note"), (slow, "warning")):
        (found,) = inspect_recording(each).findings
        assert (found.kind[:8], found.severity) == ("velocity", severity)


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
        (found,) = [f for f in inspect_recording(slow).findings if f.kind == "time_unit"]
        assert found.severity == "refuse"
        assert found.message.endswith(cause)
        assert found.remedy == remedy


def test_a_delay_is_told_without_false_precision(log: Recording, robot: sdpid.RobotModel):
    """Inertia and friction take a part of it: less is told than there is."""
    found = {
        each.kind: each for each in inspect_recording(late("effort", 0.06)(log), robot).findings
    }
    delay = found["effort_late"]
    assert 0.02 < delay.numbers["delay"] < 0.06
    assert " ms or more against the motion" in delay.message


def test_several_errors_are_found_one_after_another(log: Recording, robot: sdpid.RobotModel):
    wrong = flipped("effort", joints=(1, 2))(log)
    findings = inspect_recording(wrong, robot).findings
    assert {(f.kind, f.joint) for f in findings} == {
        ("effort_sign", robot.joint_names[1]),
        ("effort_sign", robot.joint_names[2]),
    }


def test_a_robot_that_hangs_is_told(log: Recording, robot: sdpid.RobotModel):
    hanging = sdpid.RobotModel.from_pinocchio(robot.pin_model, gravity=(0.0, 0.0, 9.81))
    (finding,) = inspect_recording(log, hanging).findings
    assert finding.kind == "gravity_direction"
    assert "(0, 0, -9.81)" in finding.message


def test_descriptions_without_masses_or_made_up_do_not_refuse(
    log: Recording, robot: sdpid.RobotModel
):
    wrong = scaled("effort", 1e3)(log)
    massless = replace(robot, prior=np.zeros_like(robot.prior))
    (note,) = inspect_recording(wrong, massless).findings
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
    effort, name = log.effort.copy(), robot.joint_names[joint]
    effort[:, joint] = change(effort[:, joint])
    wrong = replace(log, effort=effort)
    (finding,) = inspect_recording(wrong, robot).findings
    assert (finding.severity, finding.kind, finding.joint) == ("warning", kind, name)
    assert words in finding.message
    assert prepare_recordings(robot, wrong, accept=()).without_effort == (name,)
    assert prepare_recordings(robot, wrong).without_effort == ()
    assert prepare_recordings(robot, wrong, accept=(kind,)).without_effort == ()
    assert f"--accept {kind}" in finding.remedy
    assert not inspect_recordings([wrong], robot, without_effort=[name])


def test_what_is_wrong_with_an_effort_that_is_not_used_does_not_matter(
    log: Recording, robot: sdpid.RobotModel
):
    wrong, name = flipped("effort")(log), robot.joint_names[JOINT]
    assert [f.joint for f in inspect_recordings([wrong], robot)] == [name]
    assert inspect_recordings([wrong], robot, without_effort=[name]) == ()


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


def kinds_refused() -> Iterator[str]:
    """Yield every kind of finding, and of a correction, that the code may give to refuse a log."""
    yield from (rule.kind for rule in RULES if rule.severity == "refuse")
    for path in Path(sdpid.__file__).parent.joinpath("experiment").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("Finding", "Correction"):
                given = {each.arg: ast.unparse(each.value).strip("'") for each in node.keywords}
                mild = ("warning", "note", "subject.about_velocity")
                usual = "warning" if ast.unparse(node.func) == "Finding" else "refuse"
                if given.get("severity", usual) not in mild and given["kind"].isidentifier():
                    yield given["kind"]


def test_every_kind_that_is_refused_is_accepted_by_name_or_is_final():
    final = {"joints_unknown", "time_stamps", "processing"}
    kinds = set(kinds_refused()) - {"kind", *OF_FLAGS}
    assert kinds - final <= set(REFUSED)
    assert len(kinds) > 12
    findings = [Finding(severity="refuse", kind=kind, message=kind) for kind in sorted(kinds)]
    with pytest.raises(DataError) as error:
        require_accepted(findings)
    asked = re.findall(r"--accept (\w+)", str(error.value))
    assert kinds_accepted(asked) == tuple(sorted(kinds - final))


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
