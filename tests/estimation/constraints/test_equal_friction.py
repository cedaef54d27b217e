"""Friction of left and right joints: which terms, which way, and how much they may differ."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import sdpid
from sdpid.constraints import EqualFriction, Layout, equal_friction
from sdpid.errors import DataError, ModelError
from sdpid.robot.friction.model import FrictionModel
from tests.helpers.robots import small_arm

ALL = ("asymmetric_coulomb", "viscous", "offset", "rotor_inertia", "stribeck", "load", "tilt")


def layout_of(robot: sdpid.RobotModel, *terms: object) -> Layout:
    """Return where parameters are."""
    return Layout(robot, FrictionModel.from_terms(terms, robot.joint_names, first=robot.n_base))


@pytest.mark.parametrize("name", ["solo12", "talos_reduced"])
def test_mirrored_motions_meet_the_same_friction(name: str) -> None:
    """The image of a rotation is the other joint's, by Pinocchio's Jacobians, or its reverse."""
    robot = sdpid.load_robot(name, root="free_flyer")
    model, mirror = robot.pin_model, np.diag([1.0, -1.0, 1.0])
    data = model.createData()
    J = pin.computeJointJacobians(model, data, pin.neutral(model))
    turns = dict(zip(robot.joint_names[robot.n_base :], J[3:, robot.n_base :].T, strict=True))
    for pair in equal_friction(robot):
        image, other = -mirror @ turns[pair.first], turns[pair.second]
        assert np.allclose(image, -other if pair.opposite else other, atol=1e-6)


def test_terms_of_a_pair() -> None:
    robot = small_arm(3)
    layout = layout_of(robot, *ALL, sdpid.friction.Coupling("joint_2", "joint_3"))
    for opposite in (False, True):
        rows = list(EqualFriction("joint_1", "joint_3", opposite=opposite).compile(layout))
        found = {
            frozenset(np.array(layout.names)[np.flatnonzero(row.coefficients)]) for row in rows
        }
        sides = [("Fsp", "Fsn"), ("Fsn", "Fsp")] if opposite else [("Fsp",) * 2, ("Fsn",) * 2]
        pairs = [*sides, ("Fv", "Fv"), ("Ia", "Ia"), ("Fst", "Fst"), ("Fl", "Fl")]
        names = {frozenset((f"{a}1", f"{b}3")) for a, b in pairs}
        assert found <= names
        assert {pair for pair in names if pair <= set(layout.names)} == found
        assert all(row.lower == row.upper == 0.0 for row in rows)
        assert all(row.coefficients.sum() == 0.0 for row in rows)


@pytest.mark.parametrize(("left", "right", "holds"), [(1.0, 1.2, True), (1.0, 1.25, False)])
def test_a_share_is_of_the_mean(left: float, right: float, holds: bool) -> None:
    layout = layout_of(small_arm(2), "viscous")
    theta = np.zeros(layout.count)
    for values in ((left, right), (right, left)):
        theta[-2:] = values
        rows = EqualFriction("joint_1", "joint_2", within=0.2).compile(layout)
        assert all(row.coefficients @ theta >= row.lower for row in rows) is holds


def test_refused() -> None:
    robot = sdpid.load_robot("a1", root="free_flyer")
    with pytest.raises(ModelError, match=r"'FL_hip' is .* m away from that of 'RR_hip'"):
        equal_friction(robot, [("FL_hip_joint", "RR_hip_joint")])
    with pytest.raises(ModelError, match=r"equal_friction: 'a1.*' has no joint knee"):
        equal_friction(robot, [("knee", "RR_hip_joint")])
    with pytest.raises(DataError, match="no two joints of"):
        equal_friction(sdpid.load_robot("ur5_robot"))
    with pytest.raises(DataError, match="within is 2; give a share"):
        EqualFriction("a", "b", within=2)
    with pytest.raises(DataError, match="within is True; give a share"):
        EqualFriction("a", "b", within=True)
    with pytest.raises(DataError, match="within is nan; give a share"):
        EqualFriction("a", "b", within=np.nan)
    with pytest.raises(DataError, match="name two joints"):
        EqualFriction("a", "a")
    with pytest.raises(ModelError, match="has no joint 'a'"):
        list(EqualFriction("a", "joint_1").compile(layout_of(small_arm(2), "viscous")))
