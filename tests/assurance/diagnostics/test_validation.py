"""Errors of a prediction stay numbers for efforts that are all but zero."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid.assurance.diagnostics.described import described_dynamics
from sdpid.assurance.diagnostics.validation import validate_dynamics, validate_robot
from sdpid.cli.printing import errors_table
from sdpid.errors import DataError
from sdpid.experiment.preparation.for_robot import prepare
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples
from sdpid.experiment.processing.contacts.held import base_held
from tests.helpers import legged
from tests.helpers.identified import arm_theta, identified, moved
from tests.helpers.runs import arm, recorded


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-153, 1e-100])
def test_an_effort_that_is_all_but_zero(size: float) -> None:
    samples = moved(arm_theta(), 1)
    estimate = identified(samples).estimate
    effort = np.array(samples.effort)
    effort[:, 0] *= size
    fit = sdpid.validate(estimate, replace(samples, effort=effort))
    assert fit.rmse[0] > 0.0
    assert fit.nrmse[0] > 1e90
    assert fit.r2[0] == -np.inf or fit.r2[0] < -1e90
    assert np.isfinite([fit.nrmse[1], fit.r2[1], fit.relative]).all()


def test_beside_no_effort_no_share_is_told() -> None:
    samples = moved(arm_theta(), 1)
    estimate = identified(samples).estimate
    effort = np.array(samples.effort)
    effort[:, 0] = 0.0
    fit = sdpid.validate(estimate, replace(samples, effort=effort))
    assert fit.nrmse[0] == np.inf
    told = fit.to_dict()["joints"]
    assert isinstance(told, dict)
    assert told["joint_1"]["nrmse"] is None
    assert told["joint_1"]["r2"] is None
    assert told["joint_1"]["rmse"] > 0.0
    printed = errors_table({"training": fit}).splitlines()
    assert printed[-1] == "no effort of which errors are a share: joint_1"
    assert next(line for line in printed if line.startswith("joint_1")).split()[-1] == "-"
    # Where nothing is predicted either, nothing is missed.
    still = replace(fit, nrmse=np.zeros(len(fit.nrmse)))
    assert "no effort" not in errors_table({"training": still})


def test_recordings_and_files_are_read_as_by_identify(tmp_path: Path) -> None:
    log, other = recorded(0), recorded(1)
    file = tmp_path / "other.npz"
    names = np.array(other.joint_names)
    np.savez(file, t=other.time, q=other.position, tau=other.effort, joint_names=names)
    found = sdpid.identify(arm(), log, validation=other, intervals=False, effects="none")
    processing = {"cutoff_hz": 5.0}
    for given in (other, file, [str(file)]):
        fit = sdpid.validate(found.estimate, given)
        np.testing.assert_allclose(fit.relative, found.validation.relative, rtol=0.05)
        slow = sdpid.validate(found.estimate, given, processing=processing, without_effort=["a"])
        assert slow.rows[0] == 0 < slow.rows[1]
    turned = replace(other, effort=-other.effort)
    with pytest.raises(DataError, match=r"validation.*effort_sign"):
        sdpid.validate(found.estimate, turned)
    assert sdpid.validate(found.estimate, turned, accept="effort_sign").relative > 1.0
    with pytest.raises(DataError, match="validation: is or holds int"):
        sdpid.validate(found.estimate, 3)


def test_a_description_on_legs_is_judged_beside_the_forces_that_suit_it() -> None:
    made = legged.gait(160)
    right = validate_robot(made.robot, made.samples)
    assert right.relative < 1e-9
    assert right.floating is not None
    assert right.floating.force < 1e-9 > right.floating.torque
    # Every body a tenth heavier, and noise: neither is hidden among the forces.
    samples = made.noisy(noise=0.1 * legged.NOISE)
    heavy = described_dynamics(made.robot, samples, bodies=1.1 * made.robot.prior)
    wrong = validate_dynamics(heavy, samples)
    assert wrong.relative > 3.0 * validate_robot(made.robot, samples).relative


def test_coordinates_of_a_base_are_no_joints_in_tables() -> None:
    made = legged.gait(40)
    flight = replace(made.samples, contacts=None)
    for samples in (made.samples, flight):
        fit = validate_robot(made.robot, samples)
        assert repr(fit).startswith("Validation(relative=")
        assert "root_joint" not in fit.table() + str(fit.to_dict()) + fit.moving.table()
        assert fit.table().count("\n") == 14
        assert "base, force in N" in fit.table()
        assert not fit.rows[:6].any()
    assert fit.floating is not None
    # Without the forces of the feet the base misses its weight.
    assert fit.floating.force > 10.0


def test_a_held_base_leaves_an_arm_of_legs() -> None:
    """An arm's recording predicts the same with its base said to be held as with a fixed one."""
    arm = sdpid.load_robot("solo12")
    t = 0.002 * np.arange(1000)
    rates = np.linspace(0.6, 1.7, arm.n)
    q, v = np.sin(np.outer(t, 2 * np.pi * rates)), np.cos(np.outer(t, 2 * np.pi * rates))
    q, a = 0.4 * q, -0.4 * (2 * np.pi * rates) ** 2 * q
    v = 0.4 * 2 * np.pi * rates * v
    effort = 1.1 * arm.inverse_dynamics(arm.prior, q, v, a)
    log = sdpid.Recording(time=t, position=q, effort=effort, joint_names=arm.joint_names)
    held = log.with_held_base("base_link")
    with pytest.raises(DataError, match="has the motion of a base already"):
        held.with_held_base("base_link")
    processing = sdpid.Processing(cutoff_hz=20.0, filter="finite", filter_friction=False)
    both = [
        validate_robot(robot, prepare(robot, recording, processing))
        for robot, recording in ((arm, log), (legged.quadruped(), held))
    ]
    np.testing.assert_allclose(both[0].rmse, both[1].rmse[6:], rtol=1e-6)
    assert both[1].relative == pytest.approx(0.1 / 1.1, rel=0.02)
    # What holds the base takes any force.
    assert both[1].floating is None
    assert "base" not in both[1].table()


@pytest.mark.parametrize("measured", [False, True])
def test_the_base_is_judged_where_it_is_not_held(measured: bool) -> None:
    made = legged.gait(80)
    first = np.arange(80) < 50
    down = np.column_stack([made.samples.contacts.down & ~first[:, None], first])
    contacts = ContactSamples(
        frames=(*legged.FEET, "base_link"),
        kind=(*["point"] * 4, "plane"),
        down=down,
        forces=np.zeros((80, 5, 6)) if measured else None,
        force_covariance=np.eye(6) if measured else None,
    )
    samples = replace(made.samples, contacts=contacts)
    assert base_held(made.robot, samples).tolist() == first.tolist()
    errors = validate_robot(made.robot, samples).floating
    assert errors is not None
    assert errors.samples == 30
    always = replace(contacts, down=np.tile(down[:1], (80, 1)))
    alone = validate_robot(made.robot, replace(samples, contacts=always))
    assert alone.floating is None
    if not measured:
        printed = errors_table(
            {"training": alone, "validation": validate_robot(made.robot, samples)}
        )
        told = next(line for line in printed.splitlines() if line.startswith("base, force"))
        assert told.split()[-4:-2] == ["-", "-"]
