"""Joints of a recording matched with those of a robot."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid.experiment.recording.joints import match_joints


def log_of(names: tuple[str, ...] | None, joints: int | None = None) -> sdpid.Recording:
    """A recording whose column j holds j everywhere, but for its motion in time."""
    n = joints or len(names or ())
    time = np.arange(20) / 10.0
    columns = np.arange(n) + 0.01 * time[:, None]
    return sdpid.Recording(
        time=time,
        position=columns,
        effort=columns,
        velocity=columns,
        joint_names=names,
    )


def columns_of(robot: sdpid.RobotModel, log: sdpid.Recording) -> list[int]:
    matched = match_joints(robot, log)
    assert matched.joint_names == robot.joint_names
    assert matched.velocity is not None
    np.testing.assert_array_equal(matched.position, matched.effort)
    np.testing.assert_array_equal(matched.position, matched.velocity)
    return matched.position[0].astype(int).tolist()


@pytest.fixture(scope="module")
def ur5() -> sdpid.RobotModel:
    return sdpid.load_robot("ur_description/ur5_robot")


# The order of the Universal Robots driver's /joint_states: alphabetical, the elbow first.
DRIVER = (
    "elbow_joint",
    "shoulder_lift_joint",
    "shoulder_pan_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)


def test_driver_order_with_a_prefix(ur5: sdpid.RobotModel) -> None:
    prefixed = tuple(f"left_{name}" for name in DRIVER)
    assert columns_of(ur5, log_of(prefixed)) == [2, 1, 0, 3, 4, 5]
    assert columns_of(ur5, log_of(DRIVER)) == [2, 1, 0, 3, 4, 5]


@given(
    order=st.permutations(range(6)),
    prefix=st.text("abc_/1", max_size=4),
    suffix=st.sampled_from(["", "_joint", "_position", "7"]),
)
def test_one_prefix_and_one_suffix_do_not_matter(
    ur5: sdpid.RobotModel, order: list[int], prefix: str, suffix: str
) -> None:
    cores = [name.removesuffix("_joint") for name in ur5.joint_names]
    names = tuple(f"{prefix}{cores[j]}{suffix}" for j in order)
    assert columns_of(ur5, log_of(names)) == [order.index(j) for j in range(6)]


def test_columns_of_other_joints_are_left_out(ur5: sdpid.RobotModel) -> None:
    assert columns_of(ur5, log_of(("finger_joint", *DRIVER))) == [3, 2, 1, 4, 5, 6]
    arm = tuple(f"ur_{name}" for name in DRIVER)
    assert columns_of(ur5, log_of(("ur_finger_joint", *arm))) == [3, 2, 1, 4, 5, 6]


def test_two_arms_are_refused_unless_one_has_the_names(ur5: sdpid.RobotModel) -> None:
    arms = tuple(f"{side}_{name}" for side in ("left", "right") for name in DRIVER)
    with pytest.raises(
        sdpid.errors.DataError, match=r"in 2 ways: left_shoulder_pan_joint, .*; right_"
    ):
        match_joints(ur5, log_of(arms))
    assert columns_of(ur5, log_of((*arms, *DRIVER))) == [14, 13, 12, 15, 16, 17]


@pytest.mark.parametrize(
    "names",
    [
        # Each ends in t, as the robot's do.
        ("a_joint", "b_joint", "c_joint", "d_joint", "e_joint", "f_joint"),
        (*DRIVER[:5], "wrist_joint"),
        ("left_elbow_joint", *DRIVER[1:]),
    ],
)
def test_other_names_are_refused(ur5: sdpid.RobotModel, names: tuple[str, ...]) -> None:
    with pytest.raises(sdpid.errors.DataError, match="not even with another prefix or suffix"):
        match_joints(ur5, log_of(names))


def test_without_names_the_columns_are_taken_in_order(ur5: sdpid.RobotModel) -> None:
    assert columns_of(ur5, log_of(None, 6)) == [0, 1, 2, 3, 4, 5]
    with pytest.raises(sdpid.errors.DataError, match="has 7 joints, the robot 'ur5"):
        match_joints(ur5, log_of(None, 7))


def test_too_few_columns_are_refused(ur5: sdpid.RobotModel) -> None:
    with pytest.raises(sdpid.errors.DataError, match="has 5 joints, the robot 'ur5"):
        match_joints(ur5, log_of(DRIVER[:5]))


def test_a_log_in_driver_order_is_identified_as_in_the_robot_s(ur5: sdpid.RobotModel) -> None:
    time = np.arange(2000) / 100.0
    rate = 2.0 * np.pi * np.linspace(0.2, 0.5, 6)
    position = 0.5 * np.sin(rate * time[:, None]) - 1.2
    velocity = 0.5 * rate * np.cos(rate * time[:, None])
    effort = ur5.inverse_dynamics(ur5.prior, position, velocity, -(rate**2) * (position + 1.2))
    log = sdpid.Recording(time=time, position=position, effort=effort, joint_names=ur5.joint_names)
    order = [ur5.joint_names.index(name) for name in DRIVER]
    driver = replace(
        log,
        position=log.position[:, order],
        effort=log.effort[:, order],
        joint_names=tuple(f"left_{name}" for name in DRIVER),
    )
    found = [sdpid.identify(ur5, each, friction=(), intervals=False) for each in (log, driver)]
    np.testing.assert_array_equal(found[0].estimate.base, found[1].estimate.base)
