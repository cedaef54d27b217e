"""Limits as functions for a search: zero at the limit, and their derivatives."""

from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.excitation.limits.inequalities import ToolSpeedWithin, TorqueWithin
from sdpid.excitation.limits.torque import TorqueModel
from tests.helpers.robots import TREE, TREE_MIMIC
from tests.helpers.small_robots import URDFS


def differences(inequality: Any, state: list[Array], which: int) -> Array:
    """Return central differences (K, r, n) by one part of the state."""
    step, columns = 1e-6, []
    for j in range(state[0].shape[1]):
        ends = []
        for sign in (1.0, -1.0):
            moved = [each.copy() for each in state]
            moved[which][:, j] += sign * step
            ends.append(inequality.evaluate(*moved))
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    return np.stack(columns, axis=2)


@pytest.mark.parametrize("source", [TREE, TREE_MIMIC, *URDFS])
@pytest.mark.parametrize("kind", ["torque", "tool"])
def test_derivatives(source: str, kind: str) -> None:
    robot = sdpid.load_robot(source)
    limits = sdpid.Limits(tool_speed=0.7).of(robot, assume=False)
    inequality: Any = ToolSpeedWithin.of(robot, limits)
    if kind == "torque":
        inequality = TorqueWithin(model=TorqueModel.of(robot), limits=limits)
    state = list(np.random.default_rng(0).normal(size=(3, 5, robot.n)))
    values = inequality.evaluate(*state)
    for which, slope in enumerate(inequality.derivatives(*state)):
        expected = differences(inequality, state, which)
        found = np.zeros_like(expected) if slope is None else slope
        assert found.shape == (*values.shape, robot.n)
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


def test_limits_are_met_at_zero() -> None:
    robot = sdpid.load_robot(TREE)
    limits = sdpid.Limits(tool_speed=0.7).of(robot, assume=False)
    model = TorqueModel.of(robot, reserve=0.0)
    state = np.random.default_rng(1).normal(size=(3, 4, robot.n))
    torque = TorqueWithin(model=model, limits=limits)
    limited = np.isfinite(limits.torque)
    share = model.torque(*state)[:, limited] / limits.torque[limited]
    np.testing.assert_allclose(torque.evaluate(*state), 1.0 - share**2)
    speed = ToolSpeedWithin.of(robot, limits)
    at_rest = state * np.array([1.0, 0.0, 0.0])[:, None, None]
    np.testing.assert_array_equal(speed.evaluate(*at_rest), 1.0)
    assert ToolSpeedWithin.of(robot, sdpid.Limits().of(robot, assume=False)) is None


def test_deviations_are_added() -> None:
    robot = sdpid.load_robot(TREE)
    limits = sdpid.Limits().of(robot, assume=False)
    state = np.random.default_rng(1).normal(size=(3, 4, robot.n))
    nominal, robust = (
        TorqueWithin(model=TorqueModel.of(robot, spread=spread), limits=limits).evaluate(*state)
        for spread in (0.0, 2.0)
    )
    assert np.all(robust < nominal)
