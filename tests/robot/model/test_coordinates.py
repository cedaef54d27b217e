"""Which coordinates are lengths."""

from typing import Literal

import pytest

from sdpid.robot.model.coordinates import sliding
from sdpid.robot.model.load import load_robot
from tests.helpers.robots import TREE


@pytest.mark.parametrize("root", [None, "free_flyer"])
def test_lengths_are_those_of_sliding_joints_and_of_a_base(
    root: Literal["free_flyer"] | None,
) -> None:
    robot = load_robot(TREE, root=root)
    found = sliding(robot.pin_model, robot.joint_names)
    lengths = {name for name, slides in zip(robot.joint_names, found, strict=True) if slides}
    base = {name for name in robot.joint_names if name.endswith(("/vx", "/vy", "/vz"))}
    assert lengths == {"lift", "slide"} | base
    assert len(base) == (3 if root == "free_flyer" else 0)
