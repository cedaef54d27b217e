"""Commanded positions: found where their names are clear, and kept by everything."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError
from sdpid.experiment.readers.read import read_described, read_recording
from sdpid.experiment.recording.gaps import continuous, unwrapped
from sdpid.experiment.recording.joints import match_joints
from tests.helpers.refusals import refuses

N = 300
T = 0.01 * np.arange(N)
Q = np.sin(np.outer(T, [1.0, 1.7]))
REF = np.sin(np.outer(T + 0.02, [1.0, 1.7]))
TAU = np.random.default_rng(5).standard_normal((N, 2))


def written(folder: Path, names: list[str], *tables: Any) -> Path:
    file = folder / "log.csv"
    rows = np.column_stack([T, Q, TAU, *tables])
    np.savetxt(file, rows, delimiter=",", header=",".join(["t", *names]), comments="", fmt="%.17g")
    return file


def pair(template: str) -> list[str]:
    return [template.format(j) for j in (1, 2)]


@pytest.mark.parametrize(
    "name",
    [
        *("q_d_{}", "q_d[{}]", "q_des_{}", "target_q_{}", "position_reference_{}", "reference_{}"),
        *("ref_pos_{}", "q_cmd{}", "joint_position_command_{}", "q_setpoint_{}"),
    ],
)
def test_numbered_references_are_found(tmp_path: Path, name: str):
    names = [*pair("q_{}"), *pair("tau_{}"), *pair("dq_d_{}"), *pair("tau_J_d_{}"), *pair(name)]
    log = read_recording(written(tmp_path, names, 0 * Q, 0 * Q, REF))
    np.testing.assert_array_equal(log.reference, REF)
    np.testing.assert_array_equal(log.position, Q)
    assert log.velocity is None


def test_references_by_joints_units_and_arrays(tmp_path: Path):
    labels = ("lift", "elbow")
    names = [f"{each}_{q}" for q in ("position", "effort") for each in labels]
    file = written(
        tmp_path, [*names, "elbow_target_position", "lift_target_position"], REF[:, ::-1]
    )
    np.testing.assert_array_equal(read_recording(file).reference, REF)
    assert read_recording(file, columns={"reference": None}).reference is None
    # A reference has the unit of the position, unless it says otherwise.
    names = [*pair("Joint {} [deg]"), *pair("Torque {} (Nm)"), *pair("Command {} [deg]")]
    file = written(tmp_path, names, REF)
    np.testing.assert_allclose(read_recording(file).reference, np.radians(REF))
    names = [*pair("q_{}"), *pair("tau_{}"), *pair("q_ref_{}")]
    file = written(tmp_path, names, REF)
    log = read_recording(file, units={"position": "deg"})
    np.testing.assert_allclose(log.reference, np.radians(REF))
    log = read_recording(file, units={"position": "deg", "reference": "rad"})
    np.testing.assert_array_equal(log.reference, REF)
    log = read_recording(file, motors={"gear_ratios": [10.0, -20.0], "offsets": [0.5, 0.0]})
    np.testing.assert_allclose(log.reference, REF / [10.0, -20.0] + [0.5, 0.0])
    motors = {"gear_ratios": [10.0, 20.0], "applies_to": ["position"]}
    np.testing.assert_array_equal(read_recording(file, motors=motors).reference, REF)
    np.savez(tmp_path / "log.npz", t=T, q=Q, tau=TAU, q_d=REF)
    np.testing.assert_array_equal(read_recording(tmp_path / "log.npz").reference, REF)


@pytest.mark.parametrize(
    ("names", "table", "why"),
    [
        # A derivative by its values, and by the second derivative beside it.
        (pair("q_d_{}"), np.cos(np.outer(T, [1.0, 1.7])), "may be a derivative"),
        ([*pair("q_d_{}"), *pair("q_dd_{}")], np.hstack([REF, REF]), None),
        (pair("command_{}"), REF, None),
        (pair("target_{}"), REF, None),
        (pair("target_qd_{}"), REF, None),
        (pair("qd_des_{}"), REF, None),
        (pair("tau_ref_{}"), REF, None),
        (pair("Command {} [A]"), REF, None),
        (pair("position_error_{}"), REF, None),
        ([*pair("q_ref_{}"), *pair("target_q_{}")], np.hstack([REF, REF]), "it could be "),
        (pair("q_ref_{}"), np.where(T[:, None] > 1.0, np.nan, REF), "lacks values"),
    ],
)
def test_what_may_be_something_else_is_left_out(
    tmp_path: Path, names: list[str], table: np.ndarray, why: str | None
):
    file = written(tmp_path, [*pair("q_{}"), *pair("tau_{}"), *names], table)
    reading = read_described(file)
    assert reading.recording.reference is None
    if why is None:
        assert "reference" not in reading.sources
    else:
        assert why in reading.sources["reference"]
    if np.isfinite(table).all():
        units = {"reference": "rad"}
        log = read_recording(file, columns={"reference": names[:2]}, units=units)
        np.testing.assert_array_equal(log.reference, table[:, :2])
    else:
        refuses(DataError, "reference", read_recording, file, columns={"reference": names[:2]})


def test_positions_of_a_joint_called_d_are_no_reference(tmp_path: Path):
    names = ["q_c", "q_d", "tau_c", "tau_d"]
    log = read_recording(written(tmp_path, names))
    assert log.joint_names == ("c", "d")
    assert log.reference is None


@pytest.mark.parametrize("stored", [False, True])
def test_a_recording_keeps_its_reference(tmp_path: Path, stored: bool):
    log = sdpid.Recording(
        time=T, position=Q, effort=TAU, reference=REF, joint_names=("lift", "elbow")
    )
    assert repr(log) == "Recording(300 samples, 2 joints, 100 Hz, with reference)"
    assert "commanded positions" in log._repr_html_()
    log.to_csv(tmp_path / "log.csv")
    log.to_parquet(tmp_path / "log.parquet")
    np.testing.assert_array_equal(read_recording(tmp_path / "log.csv").reference, REF)
    log = read_recording(tmp_path / "log.parquet", stored=stored)
    np.testing.assert_array_equal(log.reference, REF)
    picked = read_recording(tmp_path / "log.parquet", joint_names=["elbow"], stored=stored)
    np.testing.assert_array_equal(picked.reference, REF[:, 1:])
    with pytest.raises(DataError, match=r"reference: has shape \(300, 1\), expected \(300, 2\)"):
        replace(log, reference=REF[:, :1])
    # The robot's order, gaps and late stamps.
    robot = SimpleNamespace(n=2, n_base=0, name="arm", joint_names=("elbow", "lift"), passive=())
    np.testing.assert_array_equal(match_joints(cast(Any, robot), log).reference, REF[:, ::-1])
    gap = np.delete(np.arange(N), np.s_[100:150])
    kept = {"time": T[gap], "position": Q[gap], "effort": TAU[gap], "reference": REF[gap]}
    pieces, _ = continuous(sdpid.Recording(**kept))
    assert len(pieces) == 2
    np.testing.assert_array_equal(np.concatenate([each.reference for each in pieces]), REF[gap])


def test_wrapped_references_follow_positions():
    angle, ahead = 3.0 * np.outer(T, [1.0, 0.3]), 3.0 * np.outer(T + 0.03, [1.0, 0.3])

    def wrapped(values: np.ndarray) -> np.ndarray:
        return np.mod(values + np.pi, 2.0 * np.pi) - np.pi

    log = sdpid.Recording(time=T, position=wrapped(angle), effort=TAU, reference=wrapped(ahead))
    found, _ = unwrapped(log)
    np.testing.assert_allclose(found.reference, ahead, atol=1e-12)
    # Whole turns off, and only one of them wrapped.
    log = sdpid.Recording(time=T, position=angle, effort=TAU, reference=ahead + 4.0 * np.pi)
    np.testing.assert_allclose(unwrapped(log)[0].reference, ahead, atol=1e-12)
    # In degrees nothing is known of turns.
    log = sdpid.Recording(time=T, position=angle, effort=TAU, reference=np.degrees(ahead))
    assert unwrapped(log)[0] is log


def test_simulated_references_are_what_the_controller_followed():
    robot = sdpid.load_robot("denso_vp6242")
    from sdpid.experiment.plant.drives import load_drives

    log = sdpid.simulate(robot, seed=1, noise=False)
    drives = load_drives(robot.name)
    speed = (log.position[2:] - log.position[:-2]) / (2.0 * log.step)
    behind = log.reference[1:-1] - log.position[1:-1]
    torque = drives.velocity_gain * (drives.proportional_gain * behind - speed)
    off = np.sqrt(np.mean((torque - log.effort[1:-1]) ** 2, axis=0))
    assert np.all(off < 2e-3 * log.effort.std(axis=0))
