"""Loops as descriptions tell them."""

import numpy as np
import pytest

from sdpid import load_robot
from sdpid.errors import ModelError
from sdpid.robot.description.loops import pointing
from sdpid.robot.model.contacts.jacobians import frame_axes, frame_gaps
from tests.helpers.linkages import mjcf, urdf
from tests.helpers.refusals import refuses

URDF = urdf("four_bar", kind="continuous")


def test_a_urdf_tells_loops_and_joints_without_motors() -> None:
    robot = load_robot(URDF)
    (pin,) = robot.loops
    assert (pin.name, pin.frame, pin.against, pin.kind) == (
        "pin", "pin/coupler", "pin/rocker", "line",
    )  # fmt: skip
    assert robot.passive == ("coupler_joint", "rocker_joint")
    assert repr(robot) == "RobotModel('four_bar', 3 coordinates, 3 links, 1 loop)"
    axes = frame_axes(robot, np.zeros((1, 3)), [pin.frame, pin.against])
    np.testing.assert_allclose(axes[0, :, :, 1], [[0.0, -1.0, 0.0]] * 2, atol=1e-15)


@pytest.mark.parametrize("kind", ["connect", "weld"])
def test_equalities_of_an_mjcf_close_loops(kind: str) -> None:
    pytest.importorskip("mujoco")
    bodies = mjcf("four_bar")
    sites = bodies[bodies.index("<connect") : bodies.index("</equality>")]
    of_sites = load_robot(bodies)
    assert [loop.kind for loop in of_sites.loops] == ["point"]
    assert of_sites.passive == ("coupler_joint", "rocker_joint")
    robot = load_robot(
        bodies.replace(sites, f'<{kind} body1="coupler" body2="rocker" anchor="0.3 0.1 0"/>')
    )
    (loop,) = robot.loops
    # MuJoCo joins what is at one place when joints are at zero.
    assert frame_gaps(robot, np.zeros((1, 3)), [loop.frame], [loop.against]) < 1e-15
    assert loop.kind == ("point" if kind == "connect" else "plane")


def test_an_axis_makes_a_frame() -> None:
    for axis in ([0.0, -2.0, 0.0], [1.0, 0.2, -3.0]):
        R = pointing(np.array(axis))
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
        np.testing.assert_allclose(R[:, 1], axis / np.linalg.norm(axis), atol=1e-15)
        assert np.linalg.det(R) > 0.0


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('type="continuous"><link1', 'type="planar"><link1', "of kind 'planar'; supported are"),
        ('link="coupler" xyz', 'link="nobody" xyz', "there is no link 'nobody'"),
        ('<link2 link="rocker"', '<link2 link="coupler"', "do not move against each other"),
        ("<link2 ", "<link_2 ", "has no <link2 link=...>"),
        ('xyz="0.3 0 0"/><link2', 'xyz="0.3 0"/><link2', "expected 3 finite numbers"),
        ('"0 -1 0"/></loop', '"0 0 0"/></loop', "the axis is zero"),
        ('position="1.9"', 'position="left"', "position='left'>: expected the name"),
        ('passive_joint name="coupler_joint"', 'passive_joint name="x"', "x is said to have no"),
        ("<passive", '<passive_joint name="crank_joint"/><passive', "no joint has a motor"),
    ],
)
def test_refuses_what_is_no_loop(old: str, new: str, says: str) -> None:
    refuses(ModelError, says, load_robot, URDF.replace(old, new, 1))
