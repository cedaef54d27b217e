"""Errors of a prediction stay numbers for efforts that are all but zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.assurance.diagnostics.described import described_dynamics
from sdpid.assurance.diagnostics.validation import validate_dynamics, validate_robot
from tests.helpers import legged
from tests.helpers.identified import arm_theta, identified, moved


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
        assert repr(fit).startswith("Validation(12 joints")
        assert "root_joint" not in fit.table() + str(fit.to_dict()) + fit.moving.table()
        assert fit.table().count("\n") == 14
        assert "base, force in N" in fit.table()
        assert not fit.rows[:6].any()
    assert fit.floating is not None
    # Without the forces of the feet the base misses its weight.
    assert fit.floating.force > 10.0
