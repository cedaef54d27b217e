"""Positions that close loops, and Jacobians of contacts."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from sdpid import load_robot
from sdpid.errors import DataError
from sdpid.robot.model.contacts.closure import close_loops
from sdpid.robot.model.contacts.jacobians import contact_jacobians, frame_axes, relative_jacobians
from tests.helpers.closed_chains import mjcf
from tests.helpers.linkages import urdf
from tests.helpers.robots import TREE, TREE_MIMIC_NO_OFFSET
from tests.helpers.small_robots import SMALL


@pytest.mark.parametrize("kind", ["spherical", "revolute"])
def test_positions_are_those_of_the_cosine_rule(kind: str) -> None:
    robot = load_robot(urdf("four_bar", kind=kind))
    crank = np.linspace(1.0, 8.0, 300) + np.sin(np.linspace(0.0, 9.0, 300))
    position = np.zeros((300, 3))
    position[:, 0] = crank
    found = close_loops(robot, position, robot.passive)
    way = 0.1 * np.column_stack([np.cos(crank), np.sin(crank)]) - [0.28, 0.0]
    size = np.linalg.norm(way, axis=1)
    rocker = np.arctan2(way[:, 1], way[:, 0]) - np.arccos(
        (size**2 + 0.25**2 - 0.3**2) / (2.0 * size * 0.25)
    )
    np.testing.assert_allclose(np.cos(found[:, 2] - rocker), 1.0, atol=1e-12)
    np.testing.assert_array_equal(found[:, 0], crank)
    # Followed, and not jumped to: the rocker swings, the crank turns.
    assert np.ptp(found[:, 2]) < 1.0


def test_refuses_what_loops_do_not_tell() -> None:
    text = urdf("four_bar")
    robot = load_robot(text)
    with pytest.raises(DataError, match="do not determine the positions of crank_joint"):
        close_loops(robot, np.zeros((5, 3)), robot.joint_names)
    far = load_robot(text.replace('link="rocker" xyz="0.25 0 0"', 'link="rocker" xyz="2 0 0"'))
    with pytest.raises(DataError, match="cannot be closed: the least gap is"):
        close_loops(far, np.zeros((5, 3)), far.passive)
    # Two arms do not reach each other everywhere.
    five = load_robot(urdf("five_bar").replace("0.22 0 0", "0.15 0 0"))
    apart = np.zeros((50, 4))
    apart[:, 0], apart[:, 2] = np.linspace(2.0, 3.6, 50), np.linspace(1.14, -0.5, 50)
    with pytest.raises(DataError, match=r"cannot be closed by left_rod_joint, .* at sample"):
        close_loops(five, apart, five.passive)


# Jacobians of contact points against Pinocchio's, and against differences of places.


FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
CASES = [
    pytest.param("solo12", "free_flyer", FEET, id="solo12"),
    pytest.param(TREE, "free_flyer", ("thumb", "bracket", "left_slide"), id="floating tree"),
    pytest.param(TREE, None, ("thumb", "bracket", "left_slide"), id="tree"),
    pytest.param(TREE_MIMIC_NO_OFFSET, "free_flyer", ("thumb", "finger"), id="mimic"),
    *(
        pytest.param(SMALL[name].urdf, root, (link,), id=f"{name} {root}")
        for name, link in (("hinge", "turn_link"), ("slider", "lift_link"), ("wheel", "roll_link"))
        for root in (None, "free_flyer")
    ),
]


@pytest.mark.parametrize(("source", "root", "frames"), CASES)
def test_equals_pinocchio(source: str, root: Any, frames: tuple[str, ...]) -> None:
    robot = load_robot(source, root=root)
    rng = np.random.default_rng(1)
    offset = rng.normal(scale=0.1, size=(len(frames), 3))
    q = rng.uniform(-1.0, 1.0, (4, robot.n if root is None else robot.pin_model.nq))
    if root is not None:
        q = np.array([pin.randomConfiguration(robot.pin_model, *_box(robot)) for _ in range(4)])
    expected = contact_jacobians(robot, q, frames, offset, compiled=False)
    assert expected.shape == (4, len(frames), 6, robot.n)
    compiled = contact_jacobians(robot, q, frames, offset, compiled=True)
    np.testing.assert_allclose(compiled, expected, atol=1e-13)
    data = robot.pin_model.createData()
    axes, numbers = frame_axes(robot, q, frames), [robot.frame_numbers[name] for name in frames]
    for k, configuration in enumerate(robot.configuration(q)):
        pin.framesForwardKinematics(robot.pin_model, data, configuration)
        for i, number in enumerate(numbers):
            np.testing.assert_allclose(axes[k, i], data.oMf[number].rotation, atol=1e-13)


def _box(robot: Any) -> tuple[Any, Any]:
    size = robot.pin_model.nq
    return -np.ones(size), np.ones(size)


def test_points_move_as_the_jacobian_says() -> None:
    robot = load_robot("solo12", root="free_flyer")
    model = robot.pin_model
    q = pin.randomConfiguration(model, *_box(robot))
    offset = np.array([0.03, -0.02, -0.018])
    J = contact_jacobians(robot, q[None], FEET[1:2], offset)[0, 0, :3]
    data, step = model.createData(), 1e-6
    number = model.getFrameId(FEET[1])

    def placement(at: Any) -> Any:
        pin.framesForwardKinematics(model, data, at)
        return pin.SE3(data.oMf[number])

    # The point is fixed to the foot: its place in the foot's axes does not change.
    own = placement(q).rotation.T @ offset
    for j in range(robot.n):
        ends = [
            placement(pin.integrate(model, q, sign * step * np.eye(robot.n)[j])) for sign in (-1, 1)
        ]
        slope = (ends[1].act(own) - ends[0].act(own)) / (2.0 * step)
        np.testing.assert_allclose(J[:, j], slope, atol=1e-8)


def test_refuses_a_frame_that_is_not_there() -> None:
    robot = load_robot("solo12", root="free_flyer")
    q = pin.neutral(robot.pin_model)[None]
    with pytest.raises(DataError, match=r"'FL_FOTO' is no frame .* FL_FOOT"):
        contact_jacobians(robot, q, ["FL_FOTO"])
    with pytest.raises(DataError, match=r"offset: has shape \(2, 3\), expected \(3,\) or \(1, 3\)"):
        contact_jacobians(robot, q, FEET[:1], np.zeros((2, 3)))


def test_links_that_meet_move_against_each_other_alone() -> None:
    """What carries both moves neither against the other, though a filter left them apart."""
    robot = load_robot(mjcf("ankle", floating=True))
    q = np.zeros((3, robot.pin_model.nq))
    q[:, 6] = 1.0
    q[:, 7:] = 1e-3 * np.arange(24).reshape(3, 8)
    ends = [loop.frame for loop in robot.loops], [loop.against for loop in robot.loops]
    J = relative_jacobians(robot, q, *ends)
    apart = contact_jacobians(robot, q, ends[0]) - contact_jacobians(robot, q, ends[1])
    assert np.abs(apart[..., :6]).max() > 1e-4
    assert not J[..., :6].any()
    # Each rod, its crank and the foot.
    names = np.array(robot.joint_names)
    for i, side in enumerate(("left", "right")):
        moving = {"pitch", "roll", side, f"{side}_a", f"{side}_b"}
        assert set(names[np.any(J[:, i] != 0.0, axis=(0, 1))]) == moving
        np.testing.assert_array_equal(J[:, i][..., 6:], apart[:, i][..., 6:])
