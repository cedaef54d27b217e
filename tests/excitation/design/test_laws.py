"""Laws of designs: tighter limits never gain, and scaled or mirrored tasks are the same task."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.excitation.criterion.criterion import Criterion
from sdpid.excitation.criterion.objectives import Objective, ObjectiveKind
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.limits.check import LimitCheck, check_trajectory
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.plan.plan import Plan
from sdpid.excitation.search.search import Candidate, Search
from sdpid.excitation.search.space import SplineSpace
from sdpid.excitation.search.starts import random_start
from sdpid.experiment.trajectory.spline import Spline
from sdpid.robot.model.model import RobotModel
from tests.helpers.dense_check import dense_check
from tests.helpers.plans import small_plan
from tests.helpers.robots import planar_arm, small_arm

pytest.importorskip("casadi", reason="needs the extra excite")

# Powers of 1/s in the units of each kind.
ORDERS = {"position": 0, "velocity": 1, "acceleration": 2, "jerk": 3}
KINDS = tuple(ORDERS)[1:]


@pytest.fixture(scope="module")
def plan() -> Plan:
    return small_plan()


def kinematic(plan: Plan, curve: Any, limits: JointLimits) -> LimitCheck:
    """Return the check of a curve against limits of its derivatives alone."""
    none = np.full(curve.n, np.inf)
    bare = replace(limits, torque=none, tool_speed=None, clearance=None)
    return check_trajectory(plan.robot, curve, bare, collision=False)


def slacks(check: LimitCheck) -> dict[tuple[str, str, str], float]:
    return {(row.kind, row.subject, row.side): row.slack for row in check.rows}


def scaled(limits: JointLimits, time: float) -> JointLimits:
    """Return the limits of a motion that takes `time` as long."""
    return replace(limits, **{kind: getattr(limits, kind) / time ** ORDERS[kind] for kind in KINDS})


def spline_of(plan: Plan) -> Spline:
    series = plan.trajectory.series
    assert isinstance(series, Spline)
    return series


@settings(max_examples=10, deadline=None)
@given(st.sampled_from(KINDS), st.floats(1.0, 10.0))
def test_wider_limits_hold_too(kind: str, factor: float) -> None:
    plan = small_plan()
    wider = replace(plan.joint_limits, **{kind: factor * getattr(plan.joint_limits, kind)})
    assert kinematic(plan, spline_of(plan), wider).ok


@settings(max_examples=10, deadline=None)
@given(st.sampled_from(KINDS), st.floats(0.1, 0.999))
def test_limits_below_what_is_reached_are_broken(kind: str, factor: float) -> None:
    plan = small_plan()
    curve = spline_of(plan)
    time = np.linspace(0.0, curve.duration, 2001)
    reached = np.abs(curve.evaluate(time, derivative=ORDERS[kind])).max(axis=0)
    tighter = replace(plan.joint_limits, **{kind: factor * reached})
    check = kinematic(plan, curve, tighter)
    assert {row.kind for row in check.broken} == {kind}


@settings(max_examples=10, deadline=None)
@given(st.floats(0.2, 5.0))
def test_slow_motions_have_the_same_slack_of_slow_limits(time: float) -> None:
    plan = small_plan()
    curve = spline_of(plan)
    slow = Spline(duration=time * curve.duration, control_points=curve.control_points)
    usual = kinematic(plan, curve, plan.joint_limits)
    found = slacks(kinematic(plan, slow, scaled(plan.joint_limits, time)))
    assert found.keys() == slacks(usual).keys()
    for row in usual.rows:
        slack = found[row.kind, row.subject, row.side]
        # Bounds are refined to 0.2 % of a limit, or of a range.
        near = pytest.approx(row.slack, rel=1e-2, abs=3e-3 * max(abs(row.limit), 1.0))
        assert slack * time ** ORDERS[row.kind] == near
        assert slack >= 0.0


def test_mirrored_motions_have_the_slack_of_mirrored_limits(plan: Plan) -> None:
    curve = spline_of(plan)
    mirrored = Spline(duration=curve.duration, control_points=-curve.control_points)
    limits = plan.joint_limits
    swapped = replace(limits, lower=-limits.upper, upper=-limits.lower, rest=-limits.rest)
    usual = sorted(slacks(kinematic(plan, curve, limits)).values())
    found = sorted(slacks(kinematic(plan, mirrored, swapped)).values())
    np.testing.assert_allclose(found, usual, rtol=1e-9, atol=1e-9)


def test_no_grid_finds_less_slack_than_is_stated(plan: Plan) -> None:
    dense = dense_check()
    states, limits = dense.states_of(plan.trajectory), plan.joint_limits
    kinds = ("lower", "upper", *KINDS)
    found = list(
        dense.joints_reached(
            plan.robot.joint_names, states, **{kind: getattr(limits, kind) for kind in kinds}
        )
    )
    effort = dense.efforts(plan.robot, states)
    found += dense.efforts_reached(plan.robot.joint_names, states.time, effort, limits.torque)
    stated: dict[tuple[str, str], float] = {}
    for row in plan.limits.rows:
        key = row.kind, row.subject
        stated[key] = min(row.slack, stated.get(key, np.inf))
    assert found
    assert all(reached.held for reached in found)
    for reached in found:
        assert reached.slack >= stated[reached.kind, reached.subject] - 1e-9


def criterion_of(robot: RobotModel, kind: ObjectiveKind, friction: tuple[str, ...]) -> Criterion:
    rows = BaseRows.of(robot, friction)
    known = np.zeros((rows.count, rows.count))
    return Criterion(rows=rows, objective=Objective(kind=kind), rates=np.ones(robot.n), known=known)


def states_of(curve: Spline, time: float = 1.0) -> tuple[Array, Array, Array]:
    """Return the states of a curve that takes `time` as long."""
    grid = (np.arange(80) + 0.5) / 80.0 * curve.duration
    q, v, a = (curve.evaluate(grid, derivative=order) / time**order for order in range(3))
    return q, v, a


def drawn(n: int, seed: int) -> Spline:
    points = np.random.default_rng(seed).uniform(-1.5, 1.5, (20, n))
    return Spline(duration=8.0, control_points=points)


@given(st.integers(0, 1000), st.floats(0.2, 5.0))
def test_without_gravity_time_changes_no_condition_number(seed: int, time: float) -> None:
    robot = small_arm(3).with_gravity((0.0, 0.0, 0.0))
    criterion = criterion_of(robot, "condition", ())
    curve = drawn(3, seed)
    usual, slow = (criterion.value(*states_of(curve, t), 8.0) for t in (1.0, time))
    assert slow == pytest.approx(usual, abs=1e-6)


@pytest.mark.parametrize("kind", ["condition", "D", "mixed"])
@given(seed=st.integers(0, 1000))
def test_mirrored_motions_of_a_planar_arm_show_as_much(kind: ObjectiveKind, seed: int) -> None:
    criterion = criterion_of(planar_arm(), kind, ("coulomb", "viscous"))
    q, v, a = states_of(drawn(2, seed))
    # Joint angle zero is horizontal: the mirror turns the first joint by half a turn.
    mirror = np.array([np.pi, 0.0])
    usual, mirrored = criterion.value(q, v, a, 8.0), criterion.value(mirror - q, -v, -a, 8.0)
    assert mirrored == pytest.approx(usual, abs=1e-6)


@given(st.integers(0, 1000), st.floats(-3.0, 3.0))
def test_turning_a_vertical_first_joint_shows_as_much(seed: int, angle: float) -> None:
    criterion = criterion_of(small_arm(3), "mixed", ("viscous", "offset"))
    q, v, a = states_of(drawn(3, seed))
    usual = criterion.value(q, v, a, 8.0)
    turned = criterion.value(q + np.array([angle, 0.0, 0.0]), v, a, 8.0)
    assert turned == pytest.approx(usual, abs=1e-6)


LIMITS = sdpid.Limits(lower=-1.5, upper=1.0, velocity=2.0, acceleration=4.0, jerk=40.0, share=1.0)


def search_of(limits: sdpid.Limits) -> Search:
    robot = planar_arm()
    criterion = criterion_of(robot, "mixed", ("viscous",))
    space = SplineSpace.of(robot.n, 4.0, intervals=8)
    return Search(space=space, criterion=criterion, limits=limits.of(robot))


def found_from(search: Search, start: Array) -> Candidate:
    candidate, _ = search.improve(start, None, most_steps=40)
    return candidate


@settings(max_examples=6, deadline=None)
@given(st.sampled_from(KINDS), st.floats(0.3, 0.9), st.integers(0, 100))
def test_a_tighter_limit_never_gains(kind: str, factor: float, seed: int) -> None:
    # What is best within the tighter limits is within the wider ones, and may get better there.
    wide = search_of(LIMITS)
    tight = search_of(replace(LIMITS, **{kind: factor * getattr(LIMITS, kind)}))
    rng = np.random.default_rng(seed)
    start = random_start(tight.space, tight.linear, rng.uniform(-1, 0.5, 2), rng, lambda x: True)
    within = found_from(tight, start)
    matrix, lower, upper = wide.linear
    assert np.all((matrix @ within.x >= lower) & (matrix @ within.x <= upper))
    assert found_from(wide, within.x).value <= within.value
