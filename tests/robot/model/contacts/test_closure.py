"""Positions that close loops, beside the cosine rule."""

import numpy as np
import pytest

from sdpid import load_robot
from sdpid.errors import DataError
from sdpid.robot.model.contacts.closure import close_loops
from tests.helpers.linkages import urdf


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
