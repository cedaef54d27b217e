"""The paper's variables: how many, how they map to theta, and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.estimation.local.physical_variables import PhysicalVariables
from sdpid.estimation.local.starts import random_start
from sdpid.estimation.problem import Problem, build_problem
from sdpid.robot.inertia import Consistency, margin
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.helpers.data import make_samples, random_theta
from tests.helpers.robots import TREE, planar_arm, small_arm
from tests.helpers.strategies import SEEDS

BOTH: tuple[Consistency, ...] = ("pseudo_inertia", "spatial_inertia")


def problem_of(robot: RobotModel, consistency: Consistency = "pseudo_inertia") -> Problem:
    rng = np.random.default_rng(0)
    samples = make_samples(robot, random_theta(robot, rng), rng, count=12 * robot.n + 40)
    return build_problem(robot, samples, consistency=consistency)


PROBLEMS = {
    (name, kind): problem_of(robot, kind)
    for name, robot in {"arm3": small_arm(3), "planar": planar_arm()}.items()
    for kind in BOTH
}
problems = st.sampled_from(sorted(PROBLEMS)).map(PROBLEMS.__getitem__)


def test_the_denso_has_the_papers_66(denso: RobotModel) -> None:
    variables = PhysicalVariables.of(problem_of(denso))
    assert (variables.count, variables.axis) == (66, 2)
    # All but zz of the first inertia, and z of the first center of mass, are gone.
    gone = sorted(set(range(72)) - set(variables.free.tolist()))
    assert gone == [0, 1, 2, 3, 4, 8]


@pytest.mark.parametrize(
    ("robot", "left_out"),
    [
        (small_arm(3), 6),
        (planar_arm(), 6),
        (load_robot(TREE), 0),
        (load_robot("denso_vp6242", gravity=(3.0, 0.0, -9.0)), 6),
        (load_robot("ur5_robot"), 6),
    ],
    ids=["vertical", "horizontal", "prismatic", "tilted", "ur5"],
)
def test_how_many_are_left_out(robot: RobotModel, left_out: int) -> None:
    problem = problem_of(robot)
    assert PhysicalVariables.of(problem).count == problem.n_theta - left_out


@given(problems, SEEDS)
def test_round_trip(problem: Problem, seed: int) -> None:
    variables = PhysicalVariables.of(problem)
    rng = np.random.default_rng(seed)
    x = variables.from_theta(random_start(problem, rng))
    np.testing.assert_allclose(variables.from_theta(variables.theta(x)), x, rtol=0, atol=1e-9)


@given(problems, SEEDS)
def test_what_is_left_out_has_no_influence(problem: Problem, seed: int) -> None:
    """The way to the variables and back keeps the base parameters."""
    variables = PhysicalVariables.of(problem)
    theta = random_start(problem, np.random.default_rng(seed))
    back = variables.theta(variables.from_theta(theta))
    expected = problem.base_of(theta)
    np.testing.assert_allclose(
        problem.base_of(back), expected, rtol=0, atol=1e-10 * np.abs(expected).max()
    )


@given(problems, SEEDS)
def test_filling_in_costs_no_margin(problem: Problem, seed: int) -> None:
    """The completed first link is consistent whenever any completion is."""
    variables = PhysicalVariables.of(problem)
    theta = random_start(problem, np.random.default_rng(seed))
    back = variables.theta(variables.from_theta(theta))
    bodies, filled = (problem.feasible.bodies(x) for x in (theta, back))
    before, after = margin(bodies, problem.consistency), margin(filled, problem.consistency)
    assert np.all(after >= before - 1e-9 * np.abs(bodies).max())


@given(problems, SEEDS)
def test_jacobian(problem: Problem, seed: int) -> None:
    variables = PhysicalVariables.of(problem)
    x = variables.from_theta(random_start(problem, np.random.default_rng(seed)))
    J = variables.jacobian(x)
    step = 1e-5
    for k in range(variables.count):
        change = np.zeros(variables.count)
        change[k] = step
        slope = (variables.theta(x + change) - variables.theta(x - change)) / (2 * step)
        # theta is at most cubic in the variables: central differences are nearly exact.
        scale = max(1.0, float(np.abs(slope).max()))
        np.testing.assert_allclose(J[:, k], slope, rtol=0, atol=1e-7 * scale)


@given(problems, SEEDS)
def test_inertias_are_what_the_margin_is_taken_of(problem: Problem, seed: int) -> None:
    variables = PhysicalVariables.of(problem)
    x = variables.from_theta(random_start(problem, np.random.default_rng(seed)))
    matrices, basis = variables.inertias(x)
    smallest: Array = np.linalg.eigvalsh(matrices)[:, 0]
    expected = problem.feasible.margins(variables.theta(x))
    np.testing.assert_allclose(smallest, expected, rtol=0, atol=1e-9 * np.abs(matrices).max())
    assert basis.shape == (6, 3, 3)
