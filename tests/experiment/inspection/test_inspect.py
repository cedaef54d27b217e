"""Findings about recordings: each check by a recording that has the defect, and one without."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import sdpid
from sdpid.errors import DataError, SdpidError
from sdpid.experiment.inspection.inspect import inspect_recording, inspect_recordings
from sdpid.experiment.preparation.overview import overview
from sdpid.experiment.preparation.several import prepare_recordings
from sdpid.experiment.recording.recording import Recording
from tests.helpers.refusals import refuses

RATE = 200.0
T = np.arange(2000) / RATE


@pytest.fixture(scope="module")
def robot() -> sdpid.RobotModel:
    return sdpid.load_robot("ur_description/ur5_robot")


@pytest.fixture(scope="module")
def log(robot: sdpid.RobotModel) -> Recording:
    """A slow motion, efforts as the description says."""
    rate = 2.0 * np.pi * np.linspace(0.2, 0.5, robot.n)
    swing = 0.5 * np.sin(rate * T[:, None])
    # Half raised, where the torque of gravity follows the angle.
    position = swing - 1.2
    velocity = 0.5 * rate * np.cos(rate * T[:, None])
    effort = robot.inverse_dynamics(robot.prior, position, velocity, -(rate**2) * swing)
    return Recording(
        time=T,
        position=position,
        effort=effort,
        velocity=velocity,
        joint_names=robot.joint_names,
    )


def changed(log: Recording, quantity: str, j: int, factor: float) -> Recording:
    values = getattr(log, quantity).copy()
    values[:, j] *= factor
    return replace(log, **{quantity: values})


def rows_of(log: Recording, rows: np.ndarray, time: np.ndarray | None = None) -> Recording:
    return replace(
        log,
        time=log.time[rows] if time is None else time,
        position=log.position[rows],
        effort=log.effort[rows],
        velocity=None if log.velocity is None else log.velocity[rows],
    )


def kinds(log: Recording, robot: sdpid.RobotModel | None = None) -> list[tuple[str, str | None]]:
    return [(each.kind, each.joint) for each in inspect_recording(log, robot).findings]


def test_what_is_right_raises_no_alarm(log: Recording, robot: sdpid.RobotModel):
    inspection = inspect_recording(log, robot)
    assert inspection.ok
    assert inspection.findings == ()
    assert str(inspection) == "nothing wrong was found"
    facts = overview(log, robot)
    assert facts["findings"] == []
    assert facts["joints"][0]["motion_hz"] == pytest.approx(0.2, abs=0.06)


@pytest.mark.parametrize(
    ("quantity", "factor", "kind", "words"),
    [
        ("velocity", 180.0 / np.pi, "velocity_scale", "57.3 times the rate of its position (deg"),
        ("velocity", 30.0 / np.pi, "velocity_scale", "(rpm instead of rad/s)"),
        ("velocity", -1.0, "velocity_scale", "velocity of {} has the sign opposite"),
        ("velocity", 1e3, "velocity_scale", "(a factor of 1000: time or velocity in thousandths)"),
        ("effort", 1e-2, "effort_scale", "effort of {} is 0.0102 times what the description's"),
        ("effort", 1e3, "effort_scale", "as at the other joints, limit 0.2 to 5: N·mm or mN·m"),
        ("effort", -1.0, "effort_sign", "effort of {} has the wrong sign: gravity, inertia and"),
        ("effort", 0.0, "effort_silent", "effort of {} is exactly 0 in 100 % of the rows"),
        ("position", 0.0, "joint_at_rest", "{} never moves"),
        ("position", 1e-5, "joint_at_rest", "{} moves by 1e-05 rad only"),
    ],
)
def test_wrong_signals_are_named(
    log: Recording,
    robot: sdpid.RobotModel,
    quantity: str,
    factor: float,
    kind: str,
    words: str,
):
    wrong = changed(log, quantity, 1, factor)
    found = [each for each in inspect_recording(wrong, robot).findings if each.kind == kind]
    (finding,) = [each for each in found if each.joint == log.names[1]]
    assert words.format(log.names[1]) in finding.message
    assert finding.remedy
    # At 200 Hz the default processing does not use the recorded velocity.
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
    ],
)
def test_references_that_are_not_followed_are_named(
    log: Recording, robot: sdpid.RobotModel, change: Any, words: str | None
):
    logged = replace(log, reference=change(log.position, log.velocity))
    inspection = inspect_recording(logged, robot)
    assert inspection.ok
    assert {each.kind for each in inspection.findings} == ({"reference_unlike"} if words else set())
    if words:
        # One finding, which names every joint.
        (finding,) = inspection.findings
        assert all(f"of {name} " in finding.message for name in log.names)
        assert finding.joint is None
        assert f"{log.names[1]} {words}" in finding.message
        assert f"{log.names[1]}: scale" in finding.numbers


def test_a_reference_of_one_joint_that_is_not_followed_is_named(
    log: Recording, robot: sdpid.RobotModel
):
    reference = log.position.copy()
    reference[:, 1] += 0.2
    (finding,) = inspect_recording(replace(log, reference=reference), robot).findings
    assert finding.joint == log.names[1]
    assert finding.numbers["offset"] == pytest.approx(0.2, abs=1e-3)


def test_a_position_that_jumps_is_named_with_its_row(log: Recording):
    position = log.position.copy()
    position[700:, 1] += 4.8
    (finding,) = inspect_recording(replace(log, position=position, velocity=None)).findings
    assert (finding.kind, finding.severity) == ("position_jumps", "refuse")
    assert finding.numbers["row"] == 701
    assert "changes by 4.8" in finding.message
    assert "at row 701," in finding.message


def test_an_encoder_that_is_read_late_does_not_jump():
    """As a dVRK's: it repeats its position, and what it then changes by took as long."""
    position = 0.5 * np.sin(24.0 * T)[:, None] * np.ones(2)
    for row in range(300, 2000, 300):
        position[row : row + 5, 1] = position[row - 1, 1]
    late = Recording(time=T, position=position, effort=position)
    assert np.abs(np.diff(position, axis=0)).max() * RATE > 60.0
    assert "position_jumps" not in dict(kinds(late))
    t = np.arange(8000) / 4000.0
    swing = 0.5 * np.sin(2.0 * np.pi * t)[:, None]
    rounded = Recording(time=t, position=np.round(swing, 1), effort=swing)
    assert kinds(rounded) == [("position_coarse", "1")]


def test_one_effort_far_beyond_all_others_is_named(log: Recording):
    effort = log.effort.copy()
    effort[444, 2] = 1e5
    (finding,) = inspect_recording(replace(log, effort=effort)).findings
    assert (finding.kind, finding.joint, finding.numbers["row"]) == (
        "effort_spike",
        log.names[2],
        445.0,
    )


def test_a_gap_is_no_outlier(log: Recording):
    """The motion during a gap is no jump: 1 rad is nothing in half a second."""
    gap = rows_of(log, np.r_[0:600, 900:2000])
    (finding,) = inspect_recording(gap).findings
    assert (finding.severity, finding.kind) == ("note", "continued")
    assert "split at 1 gap" in finding.message
    assert inspect_recording(gap).ok


def test_wrapped_angles_are_continued_not_alarmed_about(log: Recording):
    turning = np.angle(np.exp(1j * 4.0 * np.pi * 0.2 * T))[:, None]
    wrapped = Recording(time=T, position=turning, effort=log.effort[:, 1:2])
    finding, _ = sorted(inspect_recording(wrapped).findings, key=lambda each: each.kind)
    assert finding.severity == "note"
    assert "angles that wrap continued" in finding.message


def test_rows_that_repeat_the_row_before_are_counted(log: Recording):
    held = rows_of(log, np.arange(2000) // 4 * 4, T)
    (finding,) = inspect_recording(replace(held, velocity=None)).findings
    assert finding.kind == "repeated_rows"
    assert finding.numbers["rows"] == 1500
    # A long rest without noise is no fault of the logger.
    rests = rows_of(log, np.r_[0:500, np.full(500, 500), 500:1500], T)
    assert inspect_recording(replace(rests, velocity=None)).ok


def test_positions_in_degrees_hide_the_alarms_that_they_raise(
    log: Recording, robot: sdpid.RobotModel
):
    wrong = replace(log, position=np.degrees(log.position))
    assert kinds(wrong, robot) == [("position_in_degrees", None)]


def test_joints_that_do_not_match_are_a_finding(log: Recording, robot: sdpid.RobotModel):
    other = replace(log, joint_names=("a", "b", "c", "d", "e", "f"))
    assert kinds(other, robot) == [("joints_unknown", None)]
    prefixed = replace(log, joint_names=tuple(f"left_{name}" for name in log.names))
    (finding,) = inspect_recording(prefixed, robot).findings
    assert finding.severity == "note"
    assert "left_elbow_joint is elbow_joint" in finding.message


def test_files_and_names_are_read(log: Recording, robot: sdpid.RobotModel, tmp_path: Path):
    wrong = changed(log, "effort", 1, -1.0)
    path = tmp_path / "run.npz"
    arrays = {"t": wrong.time, "q": wrong.position, "dq": wrong.velocity, "tau": wrong.effort}
    np.savez(path, **arrays, joint_names=np.array(log.names))
    told = inspect_recording(path, "ur_description/ur5_robot").findings
    assert told == inspect_recording(wrong, robot).findings
    refuses(DataError, r"log: is int 3; give a Recording, the path of a log", inspect_recording, 3)
    refuses(SdpidError, r"no_arm\.urdf", inspect_recording, log, tmp_path / "no_arm.urdf")


def test_findings_are_data(log: Recording, robot: sdpid.RobotModel):
    wrong = changed(log, "effort", 1, -1.0)
    first, second = inspect_recordings((log, wrong), robot), inspect_recordings((wrong,), robot)
    assert [str(each) for each in first] == [f"recording 2: {each}" for each in second]
    entry = second[0].to_dict()
    assert entry["severity"] == "refuse"
    assert entry["numbers"]["unexplained_mended"] < 0.05
    assert entry["text"] == f"{entry['message']}; {entry['remedy']}"


def test_a_joint_that_another_recording_moves_is_not_unknown(
    log: Recording, robot: sdpid.RobotModel
):
    position = log.position.copy()
    position[:, 5] = 0.3
    still = replace(log, position=position, velocity=None)
    rests = [f for f in inspect_recordings((log, still), robot) if f.kind == "joint_at_rest"]
    assert [f.remedy for f in rests] == ["nothing to do where it moves enough in another one"]
    rests = [f for f in inspect_recordings((still, still), robot) if f.kind == "joint_at_rest"]
    assert [f.remedy for f in rests] == ["its inertia and friction are unknown; excite it"] * 2
    # What is only predicted says nothing of what the fit knows.
    others = prepare_recordings(robot, log).others(still, accept=())
    (rest,) = (f for f in others.findings if f.kind == "joint_at_rest")
    assert rest.remedy == "how well it is predicted in motion is not shown; record it moving"


def test_identify_says_what_info_finds(log: Recording, robot: sdpid.RobotModel):
    rng = np.random.default_rng(0)
    effort = -log.effort + rng.normal(0.0, 0.1, log.effort.shape)
    position = log.position.copy()
    position[:, 5] = 0.3
    wrong = replace(log, effort=effort, position=position, velocity=None)
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


ROBOTS = {
    "kinova_gen3_dynamapp": ("opti_traj_testing1", "gen3"),
    "kuka_lwr4plus": ("measurements_1", "kuka_lwr4"),
    "panda_unisa": ("panda_exciting", "panda"),
    "staubli_tx40": ("tx40_rows_0_24750", "tx40"),
    "ur10_unisa": ("ur10_exciting", "ur10"),
}


# Three joints of the Gen3 turn one way only.
TRUE_OF_THEM = {"kinova_gen3_dynamapp": {"one_direction"}}


def test_a_record_whose_rows_repeat_is_not_refused(data_folder):
    findings = inspect_recording(data_folder / "dvrk_mtm" / "one.npz").findings
    assert {(each.severity, each.kind) for each in findings} == {("warning", "repeated_rows")}


@pytest.mark.parametrize("name", ROBOTS)
def test_real_logs_raise_no_alarm(data_folder, name: str):
    log, urdf = ROBOTS[name]
    record = sdpid.read_recording(data_folder / name / f"{log}.npz")
    robot = sdpid.load_robot(data_folder / name / f"{urdf}.urdf")
    warned = [each for each in inspect_recording(record, robot).findings if each.severity != "note"]
    assert {each.kind for each in warned} == TRUE_OF_THEM.get(name, set()), warned


def test_an_inferred_unit_of_time_is_said(log: Recording):
    columns = {"q1": log.position[:, 1], "tau1": log.effort[:, 1]}
    for stamps in (np.arange(len(T)) * 10.0, np.arange(len(T)) * 1.0):
        read = sdpid.read_recording(pd.DataFrame({"t": stamps, **columns}))
        (finding,) = [f for f in inspect_recording(read).findings if f.kind == "time_unit"]
        assert finding.severity == "note"
        assert "taken for ms" in finding.message
        assert "units={'time': 's'} (--unit time=s)" in finding.remedy
    # No whole numbers: nothing is inferred, and the rate is warned of.
    jitter = np.random.default_rng(0).uniform(-0.1, 0.1, len(T))
    read = sdpid.read_recording(pd.DataFrame({"t": np.arange(len(T)) * 10.0 + jitter, **columns}))
    (finding,) = [f for f in inspect_recording(read).findings if f.kind == "time_unit"]
    assert finding.severity == "refuse"
    assert "0.1 Hz, limit 2 to 25000 Hz" in finding.message
    given = sdpid.read_recording(pd.DataFrame({"t": T, **columns}), units={"time": "s"})
    assert "time_unit" not in [f.kind for f in inspect_recording(given).findings]
    # What else a recording says of itself has no unit to mend.
    simulated = replace(log, notes=("simulated without a controller",))
    (said,) = [f for f in inspect_recording(simulated).findings if "simulated" in f.message]
    assert (said.severity, said.kind, said.remedy) == ("note", "recording", "")
