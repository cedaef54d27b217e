"""The enclosed regressor holds the equations of motion, and Pinocchio's regressor."""

from __future__ import annotations

from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings

from sdpid._common.arrays import Array
from sdpid.assurance.log_proof.enclosure import U
from sdpid.assurance.log_proof.joints import Joint
from sdpid.assurance.log_proof.regressor import motion, regressor
from sdpid.robot.description.dh_table import DhJoint, DhTable
from sdpid.robot.inertia import inertia_tensor
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.assurance.log_proof.equations import DIGITS, exact_regressor
from tests.helpers.robots import TREE, TREE_MIMIC, pendulum
from tests.helpers.small_robots import URDFS
from tests.helpers.strategies import SEEDS, dh_tables

# What is left open beside the largest entry, in units of rounding: some hundred operations one
# after the other on the way to the last link, with entries that are differences of larger numbers.
SHARP = 20_000 * U


def enclosed(robot: RobotModel, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Return midpoints (links, n, 10, K) and radii (links, n, 3)."""
    tree = robot.tree
    assert tree is not None
    joints = [Joint.of(tree, i) for i in range(robot.n_links)]
    mid = np.zeros((robot.n, 10 * robot.n_links, len(q)))
    rad = np.zeros((robot.n, robot.n_links, 3))
    regressor(joints, motion(tree, robot.offset, q, v, a), mid, rad)
    return mid.reshape(robot.n, robot.n_links, 10, -1).swapaxes(0, 1), rad.swapaxes(0, 1)


def off(error: Array) -> list[Array]:
    """Return how large errors (..., 10) of m, h and I are: the last is a nuclear norm.

    That is the largest effort of the errors for an I of spectral norm one.
    """
    tensor = inertia_tensor(error)
    tensor = tensor / (2.0 - np.eye(3))
    nuclear = np.abs(np.linalg.eigvalsh(tensor)).sum(axis=-1)
    return [np.abs(error[..., 0]), np.linalg.norm(error[..., 1:4], axis=-1), nuclear]


def check(robot: RobotModel, seed: int, count: int = 2) -> None:
    q, v, a = generic_states(robot, count, seed)
    mid, rad = enclosed(robot, q, v, a)
    scale = max(1.0, float(np.abs(mid).max()))
    assert rad.max() < SHARP * scale
    with mp.workdps(DIGITS):
        for k in range(count):
            exact = exact_regressor(robot, q[k], v[k], a[k])
            exact = exact.reshape(robot.n, robot.n_links, 10).swapaxes(0, 1)
            error = exact - np.vectorize(mp.mpf, otypes=[object])(mid[..., k])
            for group, size in enumerate(off(error.astype(float))):
                # The norms round, by far less than this.
                assert np.all(size <= rad[..., group] * (1.0 + 1e-9))


@settings(max_examples=8)
@given(dh_tables(most=4), SEEDS)
def test_serial_arms(table: Any, seed: int) -> None:
    check(RobotModel.from_mdh(table), seed)


@pytest.mark.parametrize("text", [TREE, TREE_MIMIC, *URDFS])
def test_trees_and_mimics(text: str) -> None:
    check(load_robot(text), 3)


def test_lengths_whose_squares_are_no_doubles() -> None:
    joints = (DhJoint(d=1e-236), DhJoint(), DhJoint(d=1e-170, r=0.3))
    check(RobotModel.from_mdh(DhTable(joints=joints, gravity=(0.0, 10.0, 0.0))), 0)


def test_a_pendulum() -> None:
    check(pendulum(), 1)


@pytest.mark.parametrize("text", [TREE, "ur5_robot", *URDFS])
def test_a_floating_base(text: str) -> None:
    check(load_robot(text, root="free_flyer"), 2, count=1)


@pytest.mark.parametrize("name", ["denso_vp6242", "panda", "solo12", "tiago", "talos_reduced"])
@pytest.mark.parametrize("root", [None, "free_flyer"])
def test_pinocchio_is_inside(name: str, root: Any) -> None:
    robot = load_robot(name, root=root)
    q, v, a = generic_states(robot, 50, 5)
    mid, rad = enclosed(robot, q, v, a)
    expected = robot._pinocchio_regressor(*robot._states(q, v, a)).transpose(1, 2, 0)
    error = expected.reshape(robot.n, robot.n_links, 10, -1).swapaxes(0, 1) - mid
    # Its own rounding, where the equations leave next to nothing open.
    own = 8.0 * U * np.abs(mid).max()
    for group, size in enumerate(off(error.swapaxes(-1, -2))):
        assert np.all(size.max(axis=-1) <= rad[..., group] + own)
