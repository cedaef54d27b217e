"""Checks of whole motions: against dense evaluation, and what each broken limit is called."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.estimation.prior.prior import Prior, link_rows
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.geometry.obstacles import Box, table
from sdpid.excitation.limits.check import LimitCheck, LimitRow, check_trajectory
from sdpid.excitation.limits.joint_limits import KINDS, _within_mimics, rest_to_rest
from sdpid.excitation.limits.limits import Limits
from sdpid.excitation.limits.measures import (
    ToolSpeedWithin,
    TorqueWithin,
    effort_norms,
    link_norms,
    tool_frames,
)
from sdpid.excitation.limits.torque import TorqueModel, body_sizes
from sdpid.experiment.trajectory.curve import Curve, SampledCurve, Spline
from sdpid.experiment.trajectory.drawn import default_motion
from sdpid.experiment.trajectory.fourier import FourierSeries
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC
from tests.helpers.small_robots import URDFS
from tests.helpers.strategies import SEEDS

ROBOTS = [TREE, TREE_MIMIC, *URDFS]


def spline(n: int, seed: int, *, duration: float = 3.0, size: float = 0.5) -> Spline:
    """Return a random closed motion."""
    free = size * np.random.default_rng(seed).normal(size=(10, n))
    return Spline.from_free(free, duration, closed=True)


def unlimited(robot: sdpid.RobotModel, **limits: Any) -> sdpid.Limits:
    """Return limits that are so wide that every row exists and none is broken."""
    kinds = ("upper", "velocity", "acceleration", "jerk", "torque")
    wide: dict[str, Any] = dict.fromkeys(kinds, 1e4)
    sliding = {"upper": 12.0, "lower": -12.0, "velocity": 15.0}
    return sdpid.Limits(**{**wide, "tool_speed": 1e4, **sliding, **limits}, override=True)


def by_kind(check: LimitCheck, kind: str) -> list[LimitRow]:
    return [row for row in check.rows if row.kind == kind]


def verdicts(check: LimitCheck, kind: str) -> set[str]:
    return {row.verdict for row in by_kind(check, kind)}


def efforts(robot: sdpid.RobotModel, q: Array, v: Array, a: Array) -> Array:
    """Return Pinocchio's efforts, description's friction added."""
    model = robot.pin_model.copy()
    model.armature = np.zeros(model.nv)
    data, E = model.createData(), robot.expansion
    states = zip(robot.configuration(q), v @ E.T, a @ E.T, strict=True)
    links = np.array([pin.rnea(model, data, *state) for state in states]) @ E
    viscous, coulomb = robot.described_friction()
    return np.asarray(links + viscous * v + coulomb * np.sign(v))


def tool_speeds(robot: sdpid.RobotModel, frame: int, q: Array, v: Array) -> Array:
    """Return speeds of a frame by Pinocchio's Jacobian."""
    model, data = robot.pin_model, robot.pin_model.createData()
    where = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    out = []
    for configuration, velocity in zip(robot.configuration(q), v @ robot.expansion.T, strict=True):
        J = pin.computeFrameJacobian(model, data, configuration, frame, where)
        out.append(np.linalg.norm((J.reshape(6, -1) @ velocity)[:3]))
    return np.array(out)


@pytest.mark.parametrize("source", ROBOTS)
@given(seed=SEEDS, size=st.floats(0.05, 1.0))
def test_bounds_hold_on_a_dense_grid(source: str, seed: int, size: float) -> None:
    robot = sdpid.load_robot(source)
    curve = spline(robot.n, seed, size=size)
    check = check_trajectory(robot, curve, unlimited(robot), collision=False)
    time = np.linspace(0.0, curve.duration, 3001)
    states = [curve.evaluate(time, derivative=order) for order in range(4)]
    found = {
        "velocity": np.abs(states[1]),
        "acceleration": np.abs(states[2]),
        "jerk": np.abs(states[3]),
        "torque": np.abs(efforts(robot, *states[:3])),
        "tool speed": np.column_stack(
            [tool_speeds(robot, frame, *states[:2]) for frame in tool_frames(robot)]
        ),
    }
    for kind, values in found.items():
        rows = by_kind(check, kind)
        worst = np.array([row.worst for row in rows])
        assert len(rows) == values.shape[1]
        assert np.all(values.max(axis=0) <= worst * (1.0 + 1e-9))
        assert np.all([row.reached <= row.worst for row in rows])
        # The bound is close to what is reached, in shares of the limit.
        assert np.all([row.worst - row.reached <= 2.1e-3 * row.limit for row in rows])
    upper = [row for row in by_kind(check, "position") if row.side == "upper"]
    lower = [row for row in by_kind(check, "position") if row.side == "lower"]
    assert np.all(states[0].max(axis=0) <= [row.worst for row in upper])
    assert np.all(states[0].min(axis=0) >= [row.worst for row in lower])


@given(seed=SEEDS, share=st.floats(0.3, 1.2), kind=st.sampled_from(["velocity", "torque", "jerk"]))
def test_tighter_limits_never_gain(seed: int, share: float, kind: str) -> None:
    robot = sdpid.load_robot(TREE)
    curve = spline(robot.n, seed, size=0.3)
    loose = check_trajectory(robot, curve, unlimited(robot), collision=False)
    limits = {
        name: share * row.worst + 1e-6
        for name, row in zip(robot.joint_names, by_kind(loose, kind), strict=True)
    }
    tight = {name: 0.9 * limit for name, limit in limits.items()}
    first, second = (
        check_trajectory(robot, curve, unlimited(robot, **{kind: each}), collision=False)
        for each in (limits, tight)
    )
    for a, b in zip(by_kind(first, kind), by_kind(second, kind), strict=True):
        if b.verdict == "held":
            assert a.verdict == "held"
        if a.verdict == "broken":
            assert b.verdict == "broken"
        assert b.slack < a.slack + 0.1 * a.limit


@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_mirrored_and_slower_motions_have_the_rows_of_their_twins(factor: float) -> None:
    robot = sdpid.load_robot(TREE)
    curve = spline(robot.n, 0)
    twin = Spline(duration=factor * curve.duration, control_points=-curve.control_points)
    # Bounds are refined to a share of the limit, so that small ones are met closely.
    sizes = {"velocity": 1e-3, "acceleration": 1e-3, "jerk": 1e-3}
    limits = sdpid.Limits(lower=-3.0, upper=3.0, override=True, **sizes)
    one, other = (
        {
            (row.kind, row.subject, row.limit): row.worst
            for row in check_trajectory(robot, each, limits, collision=False).rows
        }
        for each in (curve, twin)
    )
    for order, kind in enumerate(("position", *sizes)):
        sign = 1.0 if order else -1.0
        for name, limit in ((n, x) for k, n, x in one if k == kind):
            expected = sign * one[kind, name, limit] / factor**order
            found = other[kind, name, sign * limit]
            np.testing.assert_allclose(found, expected, rtol=1e-3, atol=0.01)


def test_a_limit_broken_between_points_of_a_grid_is_found() -> None:
    robot = sdpid.load_robot(TREE)
    # Zero speed at every multiple of 0.05 s, and 2π·10·0.01 = 0.628 rad/s between them.
    series = FourierSeries(
        period=1.0,
        center=np.zeros(robot.n),
        harmonics=np.full((robot.n, 1), 10),
        amplitudes=np.full((robot.n, 1), 0.01),
        phases=np.full((robot.n, 1), math.pi / 2),
    )
    grid = series.evaluate(np.arange(0.0, 1.0, 0.05), derivative=1)
    assert np.abs(grid).max() < 1e-9
    peak = 0.01 * 2.0 * math.pi * 10.0
    broken = check_trajectory(robot, series, sdpid.Limits(velocity=0.999 * peak), collision=False)
    rows = by_kind(broken, "velocity")
    assert {row.verdict for row in rows} == {"broken"}
    np.testing.assert_allclose([row.reached for row in rows], peak, rtol=1e-3)
    sentence = rows[0].sentence()
    assert "lift: velocity 0.62" in sentence
    assert sentence in broken.sentences()
    assert "above the limit of 0.62769" in sentence
    held = check_trajectory(robot, series, sdpid.Limits(velocity=1.001 * peak), collision=False)
    assert {row.verdict for row in by_kind(held, "velocity")} == {"held"}


def test_a_limit_that_is_touched_is_held() -> None:
    robot = sdpid.load_robot(TREE)
    # The spline's control points are its positions where three are equal.
    points = np.zeros((12, robot.n))
    points[3:9] = 0.5
    curve = Spline(duration=2.0, control_points=points)
    check = check_trajectory(robot, curve, sdpid.Limits(upper=0.5, lower=0.0), collision=False)
    assert verdicts(check, "position") == {"held"}


def test_jumps_at_samples_are_seen_from_both_sides() -> None:
    robot = sdpid.load_robot(TREE)
    time = np.array([0.0, 1.0, 2.0])
    still = np.zeros((3, robot.n))
    # Accelerations jump at one second from −2·3·0.3/… to their mirror image.
    position = still.copy()
    position[1] = 0.3
    curve = SampledCurve(time=time, position=position, velocity=still)
    check = check_trajectory(robot, curve, sdpid.Limits(acceleration=1.0), collision=False)
    rows = by_kind(check, "acceleration")
    np.testing.assert_allclose([row.reached for row in rows], 1.8)
    np.testing.assert_allclose([row.excess for row in rows], 0.8)


@pytest.mark.parametrize("spread", [0.0, 2.0])
def test_torques_of_an_estimate_and_their_spread(denso: sdpid.RobotModel, spread: float) -> None:
    curve = spline(denso.n, 3)
    rng = np.random.default_rng(0)
    q, v, a = rng.normal(size=(3, 400, denso.n))
    theta = np.tile([2.0, 0.1, 0.0, 0.1, 0.1, 0.0, 0.1, 0.0, 0.0, 0.1], denso.n_links)
    effort = denso.inverse_dynamics(theta, q, v, a) + 0.5 * np.sign(v) + 0.2 * v
    effort += 0.05 * rng.normal(size=effort.shape)
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
    estimate = sdpid.solve_sdp(sdpid.build_problem(denso, samples))
    limits = sdpid.Limits(torque=500.0)
    check = check_trajectory(
        denso, curve, limits, collision=False, estimate=estimate, spread=spread
    )
    model = TorqueModel.of(denso, estimate, spread=spread)
    time = np.linspace(0.0, curve.duration, 2001)
    states = [curve.evaluate(time, derivative=order) for order in range(3)]
    nominal = np.abs(estimate.model().inverse_dynamics(*states))
    np.testing.assert_allclose(np.abs(model.torque(*states)), nominal, rtol=1e-9, atol=1e-9)
    whole = nominal + model.spread(*states)
    assert np.all(whole >= nominal)
    assert (model.spread(*states) > 0.0).any() == (spread > 0.0)
    worst = np.array([row.worst for row in by_kind(check, "torque")])
    assert np.all(whole.max(axis=0) <= worst * (1.0 + 1e-9))
    assert by_kind(check, "torque")[0].limit == pytest.approx(475.0)


def test_whole_trajectories_and_their_own_time(denso: sdpid.RobotModel) -> None:
    motion = default_motion(denso, 1, period=8.0)
    check = check_trajectory(denso, motion, collision=False)
    assert check.ok
    fast = replace(motion, connection=0.1)
    broken = check_trajectory(denso, fast, collision=False)
    row = broken.broken[0]
    assert row.verdict == "broken"
    # The short connection breaks the limit, before the periods or after them.
    assert motion.rest <= row.time <= motion.rest + 0.1 or row.time >= fast.duration - 1.1
    assert broken.to_dict()["ok"] is False
    assert "broken" in broken.table().text()
    assert any("no acceleration limits; they are not checked" in note for note in check.notes)


def test_distances(denso: sdpid.RobotModel) -> None:
    motion = default_motion(denso, 1, period=8.0)
    limits = sdpid.Limits(clearance=0.02)
    check = check_trajectory(denso, motion, limits, obstacles=[table()])
    rows = by_kind(check, "distance")
    assert rows
    collision = CollisionModel.of(denso, [table()], near=motion.center)
    time = np.linspace(0.0, motion.period, 801)
    q = motion.series.evaluate(time)
    seen = collision.distances(q).min(axis=0)
    for row, distance in zip(rows, seen, strict=True):
        assert row.worst <= distance + 1e-5
        assert row.reached <= distance + 2e-3
    same = check_trajectory(denso, motion, limits, collision=collision)
    assert [row.subject for row in by_kind(same, "distance")] == [row.subject for row in rows]


def test_files_and_columns(denso: sdpid.RobotModel, tmp_path: Path) -> None:
    time = np.linspace(0.0, 2.0, 201)
    curve = spline(denso.n, 2, duration=2.0, size=0.2)
    columns: dict[str, Array] = {"time": time}
    for order, quantity in enumerate(("position", "velocity", "acceleration")):
        values = curve.evaluate(time, derivative=order)
        for j, name in enumerate(denso.joint_names):
            columns[f"{quantity}_{name}"] = values[:, j]
    path = tmp_path / "motion.csv"
    data = np.column_stack(list(columns.values()))
    np.savetxt(path, data, delimiter=",", header=",".join(columns), comments="")
    first = check_trajectory(denso, columns, collision=False)
    second = check_trajectory(denso, path, collision=False)
    for a, b in zip(first.rows, second.rows, strict=True):
        assert (a.kind, a.subject, a.verdict) == (b.kind, b.subject, b.verdict)
        np.testing.assert_allclose(a.worst, b.worst, rtol=1e-6, atol=1e-9)
    del columns["velocity_joint_2"]
    refuses(DataError, "velocity has 5 columns .*joints", check_trajectory, denso, columns)


def test_joints_in_another_order_are_put_in_the_robots(denso: sdpid.RobotModel) -> None:
    motion = default_motion(denso, 1, period=8.0)
    names = tuple(reversed(denso.joint_names))
    turned = check_trajectory(denso, replace(motion, joint_names=names), collision=False)
    straight = check_trajectory(denso, motion, collision=False)
    assert by_kind(turned, "velocity")[0].reached == by_kind(straight, "velocity")[5].reached


def test_wrong_shares_of_torque_are_refused(denso: sdpid.RobotModel) -> None:
    refuses(DataError, "spread is -1", TorqueModel.of, denso, spread=-1.0)
    refuses(DataError, "reserve is 1", TorqueModel.of, denso, reserve=1.0)


@pytest.mark.parametrize(
    ("error", "words", "given"),
    [
        (DataError, "3 joints", {"trajectory": spline(3, 0)}),
        (DataError, "give a Trajectory", {"trajectory": 3.0}),
        (DataError, "time is missing", {"trajectory": {"position": np.zeros((3, 6))}}),
        (DataError, "its joints are a, b, c", {"joint_names": tuple("abcdef")}),
        (
            DataError,
            "they are of the joints",
            {"limits": sdpid.Limits().of(sdpid.load_robot(TREE))},
        ),
        (ModelError, "no frame 'hand'", {"limits": sdpid.Limits(tool_speed=1.0, tool="hand")}),
    ],
)
def test_motions_and_limits_of_others_are_refused(
    denso: sdpid.RobotModel, error: type[Exception], words: str, given: dict[str, Any]
) -> None:
    motion = default_motion(denso, 1, period=8.0)
    if "joint_names" in given:
        given = {"trajectory": replace(motion, **given)}
    refuses(
        error, words, check_trajectory, denso, **{"trajectory": motion, "collision": False, **given}
    )


def test_friction_that_no_motor_overcomes_is_not_counted() -> None:
    text = TREE.replace('velocity="3"/></joint>', 'velocity="3"/>{}</joint>', 1)
    for coulomb, counted in ((3.0, True), (20.0, False)):
        robot = sdpid.load_robot(text.format(f'<dynamics friction="{coulomb}" damping="0"/>'))
        model = TorqueModel.of(robot)
        still, moving = np.zeros((1, robot.n)), np.full((1, robot.n), 1e-9)
        friction = model.friction(moving, still)[0, robot.joint_names.index("right")]
        assert friction == pytest.approx(coulomb if counted else 0.0)
        assert any("right in the description would take" in note for note in model.notes) != counted


def test_a_description_without_masses_has_no_torques(denso: sdpid.RobotModel) -> None:
    curve = spline(denso.n, 0, size=0.1)
    check = check_trajectory(denso, curve, sdpid.Limits(torque=10.0), collision=False)
    assert not by_kind(check, "torque")
    assert "the description has no masses: torques are not checked." in check.notes


SLIDER = """<robot name="slider"><link name="base"/><link name="cart"><collision><geometry>
  <sphere radius="0.1"/></geometry></collision></link><joint name="rail" type="prismatic">
  <parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
  <limit {} effort="9" velocity="99"/></joint></robot>"""


BOUNDED = 'lower="-1" upper="1"'


@pytest.mark.parametrize("limit", ["", 'lower="-1e10" upper="1e10"', BOUNDED])
def test_rails_are_checked_as_far_as_the_motion_goes(limit: str) -> None:
    robot = sdpid.load_robot(SLIDER.format(limit))
    points = np.repeat([0.0, 12.0, 0.0], [3, 20, 3])[:, None]
    obstacles = [Box(size=(1.0, 1.0, 1.0), translation=(10.0, 0.0, 0.0))]
    for share in (1.0, 0.5):
        curve = Spline(duration=20.0, control_points=share * points)
        check = check_trajectory(robot, curve, obstacles=obstacles)
        assert ("broken" in verdicts(check, "distance")) == (share == 1.0)
        assert check.ok == (share < 1.0 and limit != BOUNDED)


def test_a_motion_that_begins_below_the_table_is_broken() -> None:
    robot = sdpid.load_robot("ur10_robot")
    below = np.zeros((10, robot.n))
    below[:, 1] = 1.2
    curve = Spline.from_free(below, 2.0, closed=True)
    check = check_trajectory(robot, curve, obstacles=[table()])
    rows = [row for row in by_kind(check, "distance") if row.verdict == "broken"]
    assert any("table" in row.subject and row.excess > 0.3 for row in rows)


@given(seed=SEEDS)
def test_deviations_of_the_prior_are_bounded(seed: int) -> None:
    robot = sdpid.load_robot(TREE)
    curve = spline(robot.n, seed, size=0.3)
    model = TorqueModel.of(robot, spread=0.5, reserve=0.0)
    time = np.linspace(0.0, curve.duration, 1001)
    states = [curve.evaluate(time, derivative=order) for order in range(3)]
    dense = (np.abs(model.torque(*states)) + model.spread(*states)).max(axis=0)
    # A limit near what is reached makes the bound decide.
    limits = unlimited(robot, torque=(dense * 1.05).tolist())
    check = check_trajectory(robot, curve, limits, collision=False, torque=model)
    rows = by_kind(check, "torque")
    worst = np.array([row.worst for row in rows])
    assert np.all(dense <= worst * (1.0 + 1e-9))
    assert np.all(worst <= dense * 1.05)


def test_deviations_are_those_of_the_prior() -> None:
    robot = sdpid.load_robot(TREE)
    model = TorqueModel.of(robot, spread=0.1)
    q, v, a = np.random.default_rng(0).normal(size=(3, 3, robot.n))
    rows = link_rows(Prior(), robot)
    covariance = np.zeros((10 * robot.n_links,) * 2)
    for k, R in enumerate(rows):
        own = slice(10 * k, 10 * k + 10)
        covariance[own, own] = np.linalg.inv(R.T @ R)
    Y = robot.regressor(q, v, a)
    expected = 0.1 * np.sqrt(np.einsum("knp,pq,knq->kn", Y, covariance, Y))
    np.testing.assert_allclose(model.spread(q, v, a), expected, rtol=1e-8)


def test_jumps_of_acceleration_break_limits_of_jerk() -> None:
    robot = sdpid.load_robot(TREE)
    time = np.linspace(0.0, 2.0, 201)
    # Full acceleration, then full braking: a jump of 1 rad/s² at one second.
    position = np.where(time < 1.0, 0.25 * time**2, 0.5 - 0.25 * (2.0 - time) ** 2)
    velocity = np.where(time < 1.0, 0.5 * time, 0.5 * (2.0 - time))
    columns = {"time": time, "position": position, "velocity": velocity}
    motion = {
        key: value if key == "time" else np.tile(value[:, None], robot.n)
        for key, value in columns.items()
    }
    check = check_trajectory(robot, motion, sdpid.Limits(jerk=400.0), collision=False)
    rows = by_kind(check, "jerk")
    assert {row.verdict for row in rows} == {"broken"}
    np.testing.assert_allclose([row.time for row in rows], 1.0)
    np.testing.assert_allclose([row.reached for row in rows], 1000.0, rtol=1e-6)
    assert any("starts with a jolt from rest" in note for note in check.notes)
    wide = check_trajectory(robot, motion, sdpid.Limits(jerk=1001.0), collision=False)
    assert {row.verdict for row in by_kind(wide, "jerk")} == {"held"}


def test_motions_that_begin_in_motion_are_told(denso: sdpid.RobotModel) -> None:
    motion = default_motion(denso, 1, period=8.0)
    assert not any(
        "the motion" in n for n in check_trajectory(denso, motion, collision=False).notes
    )
    check = check_trajectory(denso, motion.series, collision=False)
    assert sum("in motion" in note for note in check.notes) == 2


# Limits as functions for a search: zero at the limit, and their derivatives.


@pytest.mark.parametrize("source", ROBOTS)
@pytest.mark.parametrize("kind", ["model", "torque", "tool"])
def test_derivatives(source: str, kind: str) -> None:
    robot = sdpid.load_robot(source)
    limits = sdpid.Limits(tool_speed=0.7).of(robot, assume=False)
    model = TorqueModel.of(robot)
    state = np.random.default_rng(0).normal(size=(3, 5, robot.n))
    inequality: Any = TorqueWithin(model=model, limits=limits)
    if kind == "tool":
        inequality = ToolSpeedWithin.of(robot, limits)
    function, slopes = inequality.evaluate, inequality.derivatives(*state)
    if kind == "model":
        function, (torque, *slopes) = model.torque, model.torque_and_derivatives(*state)
        np.testing.assert_allclose(torque, efforts(robot, *state), rtol=1e-10, atol=1e-10)
    values = function(*state)
    for which, slope in enumerate(slopes):
        for j in range(robot.n):
            step = np.zeros_like(state)
            step[which, :, j] = 1e-6
            expected = (function(*(state + step)) - function(*(state - step))) / 2e-6
            found = np.zeros((*values.shape, robot.n)) if slope is None else slope
            np.testing.assert_allclose(found[:, :, j], expected, rtol=1e-4, atol=1e-5)


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
    # Deviations are added.
    robust = TorqueWithin(model=TorqueModel.of(robot, reserve=0.0, spread=2.0), limits=limits)
    assert np.all(robust.evaluate(*state) < torque.evaluate(*state))


# Limits: the tighter of what is given and described, and what is told before any search.


ARM = """<robot name="arm"><link name="base"/>{links}{joints}</robot>"""
LINK = """<link name="l{0}"><inertial><origin xyz="0.3 0 0"/><mass value="4"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{before}"/><child link="l{i}"/>
  <origin xyz="0.1 0 0"/><axis xyz="0 1 0"/>{limit}</joint>"""
LIMIT = '<limit lower="-2" upper="1" velocity="3" effort="100"/>'
NO_LIMIT = '<limit velocity="0" effort="0"/>'
WIDE = '<limit lower="-10" upper="10" velocity="1000" effort="1e5"/>'
# Stretched out, the first joint carries 4 kg at 0.3 m and 4 kg at 0.4 m: 27 N·m.
WEAK = '<limit lower="-2.5" upper="2.5" velocity="3" effort="30"/>'


def arm(*kinds: str, limit: str = LIMIT) -> sdpid.RobotModel:
    """Return an arm of joints a, b, … with the same limits."""
    names = "abcdef"[: len(kinds)]
    links = "".join(LINK.format(i) for i in range(len(kinds)))
    joints = "".join(
        JOINT.format(name=name, kind=kind, before=f"l{i - 1}" if i else "base", i=i, limit=limit)
        for i, (name, kind) in enumerate(zip(names, kinds, strict=True))
    )
    return sdpid.load_robot(ARM.format(links=links, joints=joints))


TWO = ("revolute", "revolute")


def test_description_holds_where_nothing_is_given() -> None:
    found = Limits().of(arm(*TWO))
    expected = dict(zip(KINDS, (-2.0, 1.0, 3.0, 5.0, 50.0, 100.0), strict=True))
    assert {kind: getattr(found, kind).tolist() for kind in KINDS} == {
        kind: [value, value] for kind, value in expected.items()
    }
    assert found.sources["velocity"] == ("description", "description")
    assert found.sources["jerk"] == ("assumed", "assumed")
    assert len(found.assumed) == 2
    assert all("all joints have no" in sentence for sentence in found.assumed)
    assert Limits(**BEYOND).of(arm(*TWO)).sources["upper"] == ("description", "description")
    assert Limits(jerk=math.inf).of(arm(*TWO)).sources["jerk"] == ("given", "given")
    assert not found.lower.flags.writeable
    assert found.table().header[0] == "joint"


INF = math.inf
BEYOND: dict[str, Any] = {"upper": {"a": 2.0}, "velocity": 4.0}


@pytest.mark.parametrize(
    ("given", "limit", "more", "expected", "words"),
    [
        ({}, LIMIT, {}, {"rest": [0.0, 0.0]}, "no jerk limits"),
        ({}, LIMIT.replace("-2", "-0.05"), {}, {"rest": [0.475] * 2}, "no jerk limits"),
        ({}, LIMIT, {"share": 0.9}, {"lower": [-1.85] * 2, "torque": [90.0] * 2}, "90 % are used"),
        ({"share": 0.5}, LIMIT, {"share": 0.9}, {"velocity": [1.5] * 2}, "50 % are used"),
        # What is given is taken at its word.
        ({"velocity": 2.9}, LIMIT, {"share": 0.9}, {"velocity": [2.9] * 2}, "90 %"),
        (BEYOND, LIMIT, {}, {"upper": [1.0] * 2, "velocity": [3.0] * 2}, "a has upper limits bey"),
        (
            {**BEYOND, "override": True},
            LIMIT,
            {},
            {"upper": [2.0, 1.0], "velocity": [4.0] * 2},
            "which they override",
        ),
        (
            {"jerk": INF, "acceleration": {"a": INF, "*": 2.0}},
            LIMIT,
            {"assume": False},
            {"acceleration": [INF, 2.0], "jerk": [INF] * 2},
            "",
        ),
        (
            {},
            NO_LIMIT,
            {"rest": [0.5, 0.2]},
            {"lower": [0.5 - np.pi, 0.1], "upper": [0.5 + np.pi, 0.3], "velocity": [2.0, 0.25]},
            "a has no position limits; half a turn .* b has no position limits; 0.1 m .* b has no "
            "velocity .* all joints have no torque limits; they are not",
        ),
        # A position that is asked for is kept.
        ({}, WEAK, {"rest": [0.0, 0.0]}, {"rest": [0.0, 0.0]}, ""),
        (
            {},
            WIDE,
            {},
            {},
            r"all joints have ranges of positions in .* all joints have velocity limits in .*"
            r"\(more than 62.8 rad/s\); give the real ones\. all joints have torque limits in",
        ),
    ],
)
def test_limits_that_are_given_narrow_those_described(
    given: dict[str, Any], limit: str, more: dict[str, Any], expected: dict[str, Any], words: str
) -> None:
    kinds = ("continuous", "prismatic") if limit == NO_LIMIT else TWO
    found = Limits(**given).of(arm(*kinds, limit=limit), **more)
    for name, values in expected.items():
        np.testing.assert_allclose(getattr(found, name), values)
    assert re.search(words, " ".join(found.assumed))


def test_real_limits_in_place_of_empty_ones_are_not_told() -> None:
    real = Limits(lower=-1.0, upper=1.0, velocity={"a": 2.0}, torque=50.0)
    told = [text for text in real.of(arm(*TWO, limit=WIDE)).assumed if "limit nothing" in text]
    assert [text[:22] for text in told] == ["b has velocity limits "]


SIZES = st.one_of(st.none(), st.floats(0.1, 300.0))


@given(st.lists(SIZES, min_size=3, max_size=3), st.floats(-3.0, -0.5), st.floats(0.1, 1.0))
def test_the_tighter_holds(sizes: list[float | None], lower: float, share: float) -> None:
    robot = arm("revolute", "prismatic", "revolute", limit=LIMIT.replace("100", "1000"))
    loose = Limits().of(robot, share=share)
    tight = Limits(velocity=[None if s is None else s / 100 for s in sizes], torque=sizes)
    found = tight.of(robot, share=share, assume=False)
    described = Limits().of(robot)
    assert np.all(found.velocity <= described.velocity)
    assert np.all(found.torque <= described.torque)
    for j, size in enumerate(sizes):
        if size is None:
            assert found.torque[j] == loose.torque[j]
        else:
            assert found.torque[j] == min(size, 1000.0)
    narrowed = Limits(lower=lower).of(robot, share=share, assume=False)
    np.testing.assert_array_equal(narrowed.lower, max(lower, -2.0))
    assert np.all(narrowed.lower <= narrowed.rest)
    assert np.all(narrowed.rest <= narrowed.upper)


HALF = {"upper": 0.5, "lower": -0.5}


@pytest.mark.parametrize(
    ("given", "limit", "rest", "words"),
    [
        ({"lower": 0.5, "upper": 0.2}, LIMIT, None, r"'a': lower 0\.5 .* upper 0\.2 .*exchange"),
        ({"lower": 1.5}, LIMIT, None, r"'a': lower 1\.5 \(given\).* upper 1 \(description\)"),
        ({"velocity": -1.0}, LIMIT, None, r"velocity .* -1\.0.* above 0"),
        ({"velocity": {"b": math.nan}}, LIMIT, None, "velocity of joint 'b' is nan"),
        ({"velocity": "fast"}, LIMIT, None, "velocity .*'fast'"),
        ({"velocity": {"c": 1.0}}, LIMIT, None, "no joint 'c'.* a, b"),
        ({"torque": [1.0, 2.0, 3.0]}, LIMIT, None, "torque has 3 values, .*2 joints"),
        ({"lower": -90.0}, LIMIT, None, r"degrees; give -1\.571 rad"),
        ({"velocity": 180.0}, LIMIT, None, "degrees; give 3.142 rad/s"),
        ({"torque": {"a": 1.0}, **HALF}, LIMIT, None, "'a': gravity alone .* 1 N·m"),
        ({"tool_speed": 0.0}, LIMIT, None, "tool_speed .* above 0"),
        ({"tool": 3}, LIMIT, None, "tool is 3; give the name"),
        ({"clearance": -0.1}, LIMIT, None, "clearance .* from 0"),
        ({"share": 1.1}, LIMIT, None, "share .* at most 1"),
        ({"override": "yes"}, LIMIT, None, "override is 'yes'"),
        ({}, LIMIT, [0.0, 1.5], r"'b': the rest position 1\.5 rad is above the limit of 1"),
        ({"torque": 20.0}, LIMIT, [0.0, 0.0], r"'a': gravity alone needs 27\.\d* N·m at the rest"),
        ({}, LIMIT, [0.0], r"rest position: has shape \(1,\), expected \(2,\): a, b"),
        ({}, LIMIT.replace('"-2"', '"3"'), None, "from 3 to 1"),
        (
            {},
            '<limit lower="-.5" upper="1" effort="1" velocity="3"/>',
            None,
            "best of .* limit with override",
        ),
    ],
)
def test_wrong_limits_are_told(
    given: dict[str, Any], limit: str, rest: list[float] | None, words: str
) -> None:
    refuses(DataError, words, lambda: Limits(**given).of(arm(*TWO, limit=limit), rest))


def test_wrong_robots_and_millimeters_are_told() -> None:
    base = sdpid.load_robot(arm(*TWO).urdf, root="free_flyer")
    refuses(ModelError, "floating base", Limits().of, base)
    wrong = Limits(upper={"slide": 300.0})
    refuses(DataError, r"looks like mm; give 0\.3 m", wrong.of, sdpid.load_robot(TREE))


FILE = """
[arm]
tool_speed = 0.25
clearance = 0.03
velocity = 1.5
jerk = inf

[a]
lower = -1.0
velocity = 1.0

[[joint]]
name = "b"
torque = 60

[[box]]
size = [1, 1, 1]
"""


def test_file(tmp_path: Path) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(FILE)
    found = Limits.from_toml(path).of(arm(*TWO))
    assert found.lower.tolist() == [-1.0, -2.0]
    assert found.velocity.tolist() == [1.0, 1.5]
    assert found.torque.tolist() == [100.0, 60.0]
    assert np.isinf(found.jerk).all()
    assert (found.tool_speed, found.clearance) == (0.25, 0.03)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[a]\nspeed = 1.0", "'speed'.* velocity"),
        ("[arm]\nspeed = 1.0", r"\[arm\] has 'speed'.* tool_speed"),
        ("velocity = 1.0", r"outside of a table.*\[arm\]"),
        ("[[joint]]\nlower = 0.0", "without a name"),
        ("[a]\nlower = 0.0\n[[joint]]\nname = 'a'\nlower = 1.0", "lower twice"),
        ("[a]\nlower = 'low'", "'low'; give a number"),
        ("[a", "not a TOML file"),
    ],
)
def test_wrong_files_are_told(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(text)
    assert "limits.toml" in str(refuses(DataError, words, Limits.from_toml, path))


@pytest.mark.parametrize(
    ("distance", "velocity", "acceleration", "jerk", "seconds"),
    [
        (2.0, 1.0, math.inf, math.inf, 2.0),
        (1.0, math.inf, 4.0, math.inf, 1.0),
        (3.0, 1.0, 2.0, math.inf, 3.5),
        # Four ramps of one second each: half of the way is jerk·1³.
        (2.0, math.inf, math.inf, 1.0, 4.0),
        # The speed is reached by two ramps, then a cruise of one second.
        (3.0, 1.0, math.inf, 1.0, 5.0),
        # All three: ramps of 1 s, 2 s of full acceleration, then a cruise of 2 s.
        (18.0, 3.0, 1.0, 1.0, 10.0),
    ],
)
def test_rest_to_rest(
    distance: float, velocity: float, acceleration: float, jerk: float, seconds: float
) -> None:
    found = rest_to_rest(distance, velocity, acceleration, jerk)
    np.testing.assert_allclose(found, seconds)


POSITIVE = st.floats(0.1, 10.0)


@given(POSITIVE, POSITIVE, POSITIVE, POSITIVE, st.floats(1.0, 3.0))
def test_wider_limits_take_no_longer(d: float, v: float, a: float, j: float, more: float) -> None:
    least = rest_to_rest(d, v, a, j)
    for wider in ((d, more * v, a, j), (d, v, more * a, j), (d, v, a, more * j)):
        assert rest_to_rest(*wider) <= least * (1.0 + 1e-12)
    # Slower by c: time stretches by c.
    slower = rest_to_rest(d, v / more, a / more**2, j / more**3)
    np.testing.assert_allclose(slower, more * least, rtol=1e-9)
    # Limits that do not bind are none.
    near = rest_to_rest(d, v, a, 1e12)
    np.testing.assert_allclose(near, rest_to_rest(d, v, a, math.inf), rtol=1e-3)


def test_shortest_duration() -> None:
    found = Limits(acceleration=1.0, jerk=INF).of(arm(*TWO))
    np.testing.assert_allclose(found.shortest_duration(), 4.0 * np.sqrt(0.3))


def test_infinity_survives_plain_values() -> None:
    given = Limits(jerk=math.inf, velocity=[1.0, None], torque={"a": 60.0, "*": math.inf})
    again = Limits(**json.loads(json.dumps(given.to_dict())))
    assert again.to_dict() == given.to_dict()
    assert np.isinf(again.of(arm(*TWO)).jerk).all()


def test_rest_is_where_the_motors_hold_the_arm() -> None:
    found = Limits().of(arm(*TWO, limit=WEAK))
    assert np.any(found.rest != 0.0)
    still = np.zeros((1, 2))
    assert np.all(np.abs(arm(*TWO).described_efforts(found.rest[None], still, still)) <= 21.0)
    assert any("motors hold easily" in sentence for sentence in found.assumed)


def test_limits_of_followers_hold_too() -> None:
    # The thumb is at -0.7·finger + 0.2 and within ±0.3: the finger within -0.14 and 0.71.
    text = TREE_MIMIC.replace(
        'lower="-1" upper="1" effort="5" velocity="3"/><mimic',
        'lower="-0.3" upper="0.3" effort="5" velocity="3"/><mimic',
    )
    found = Limits().of(sdpid.load_robot(text))
    j = found.joint_names.index("finger")
    np.testing.assert_allclose([found.lower[j], found.upper[j]], [-0.1 / 0.7, 0.5 / 0.7])


# Bounds on efforts and on the rates of efforts, against the derivatives themselves.


# Coefficients of central differences of the first and second derivative, sixth order.
FIRST = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0
SECOND = np.array([2.0, -27.0, 270.0, -490.0, 270.0, -27.0, 2.0]) / 180.0
STEP = 2e-3


def along(robot: sdpid.RobotModel, jet: Array) -> tuple[Array, Array]:
    """Return efforts (7, n) and positions of the links (7, links, 3) of a polynomial with a jet."""
    model, data = robot.pin_model, robot.pin_model.createData()
    times = STEP * np.arange(-3, 4)
    powers = times[:, None] ** np.arange(5) / [1.0, 1.0, 2.0, 6.0, 24.0]
    efforts, origins = [], []
    for row in powers:
        q, v, a = (row[: 5 - order] @ jet[order:] for order in range(3))
        configuration = robot.configuration(q[None])[0]
        efforts.append(pin.rnea(model, data, configuration, v, a).copy())
        pin.forwardKinematics(model, data, configuration)
        origins.append([place.translation.copy() for place in data.oMi][1:])
    return np.array(efforts), np.array(origins)


@given(seed=SEEDS, size=st.floats(0.1, 3.0))
def test_bounds_hold(seed: int, size: float) -> None:
    robot = sdpid.load_robot(TREE)
    rng = np.random.default_rng(seed)
    jet = size * rng.normal(size=(5, robot.n))
    jet[0] = rng.uniform(-1.0, 1.0, robot.n)
    efforts, origins = along(robot, jet)
    joints = np.abs(jet)[:, None, :]
    norms = link_norms(robot.tree, joints)
    gravity = float(np.linalg.norm(robot.gravity))
    bounds = sum(
        effort_norms(robot.tree, norms, k + 1, body, gravity)
        for k, body in enumerate(body_sizes(robot.prior))
    )
    bounds = np.asarray(bounds)[:, 0]
    values = [np.abs(efforts[3])]
    values += [np.abs(c @ efforts) / STEP**k for k, c in ((1, FIRST), (2, SECOND))]
    for value, bound in zip(values, bounds, strict=True):
        assert np.all(value <= bound * (1.0 + 1e-5) + 1e-5)
    speeds = np.linalg.norm(np.tensordot(FIRST, origins, axes=1) / STEP, axis=1)
    accelerations = np.linalg.norm(np.tensordot(SECOND, origins, axes=1) / STEP**2, axis=1)
    for i in range(robot.n_links):
        assert speeds[i] <= norms.origin[i + 1][1, 0] * (1.0 + 1e-6) + 1e-7
        assert accelerations[i] <= norms.origin[i + 1][2, 0] * (1.0 + 1e-6) + 1e-4


def test_bounds_are_met_by_a_pendulum() -> None:
    # One link about a horizontal axis through its frame: torque I·a + m·g·c·cos(q).
    text = """<robot name="p"><link name="b"/><link name="l"><inertial><origin xyz="0.5 0 0"/>
      <mass value="2"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
      <joint name="j" type="continuous"><parent link="b"/><child link="l"/><axis xyz="0 1 0"/>
      <limit effort="1" velocity="1"/></joint></robot>"""
    robot = sdpid.load_robot(text)
    joints = np.array([1.0, 0.0, 3.0, 0.0, 0.0])[:, None, None]
    norms = link_norms(robot.tree, joints)
    (found,) = effort_norms(robot.tree, norms, 1, body_sizes(robot.prior)[0], 9.81)[0]
    assert found == pytest.approx(2.0 * 0.25 * 3.0 + 2.0 * 0.5 * 9.81)


# The published excitations of a UR10e break their own limits: by as much as a dense grid says.


class Sum:
    """The sum of two curves of the same duration."""

    def __init__(self, first: Curve, second: Curve) -> None:
        self.parts, self.n, self.duration = (first, second), first.n, first.duration
        self.breaks = np.union1d(first.breaks, second.breaks)

    def evaluate(self, time: Any, *, derivative: int = 0) -> Array:
        return np.asarray(sum(part.evaluate(time, derivative=derivative) for part in self.parts))

    def enclose(self, edges: Any, *, derivative: int = 0) -> tuple[Array, Array]:
        bounds = [part.enclose(edges, derivative=derivative) for part in self.parts]
        return bounds[0][0] + bounds[1][0], bounds[0][1] + bounds[1][1]


def published(path: Path) -> tuple[Sum, sdpid.Limits]:
    """Return a motion of the data, a Fourier series and a polynomial, and its limits."""
    from scipy.io import loadmat

    data = loadmat(path, squeeze_me=True)
    given = {
        key: np.asarray(data["traj_par"][key].item(), dtype=np.float64)
        for key in ("T", "q_min", "q_max", "qd_max", "q2d_max")
    }
    a, b, T = data["a"], data["b"], float(given["T"])
    harmonics = np.tile(np.arange(1, a.shape[1] + 1), (6, 1))
    series = FourierSeries(
        period=T,
        center=np.zeros(6),
        harmonics=harmonics,
        amplitudes=np.hypot(a, b) / (2.0 * np.pi * harmonics / T),
        phases=np.arctan2(-b, a),
    )
    # A quintic is that which has its states at both ends.
    ends = np.array([0.0, T])
    powers = np.polynomial.polynomial
    states = [powers.polyval(ends, powers.polyder(data["c_pol"].T, k)).T for k in range(3)]
    quintic = SampledCurve(
        time=ends, position=states[0], velocity=states[1], acceleration=states[2]
    )
    limits = sdpid.Limits(
        lower=given["q_min"].tolist(),
        upper=given["q_max"].tolist(),
        velocity=given["qd_max"].tolist(),
        acceleration=given["q2d_max"].tolist(),
        override=True,
    )
    return Sum(series, quintic), limits


# Position, rad beyond the limit, and share of the limit of acceleration, as the data's README says.
@pytest.mark.parametrize(
    ("name", "beyond", "share"),
    [
        ("N5T20QR", 0.0007, 0.99),
        ("N7T25QR", 0.005, 1.004),
        ("N8T20QR", 0.027, 1.02),
        ("N10T20QR", 0.028, 1.14),
        ("N12T20QR", 0.019, 1.21),
        ("ga_N7T25", 0.025, 1.04),
    ],
)
def test_broken_limits_are_named(data_folder: Path, name: str, beyond: float, share: float) -> None:
    folder = data_folder / "ur10e_innopolis"
    (path,) = folder.glob(f"optimal_trajectories/*{name}*.mat")
    robot = sdpid.load_robot(folder / "ur10e.urdf")
    curve, limits = published(path)
    check = sdpid.check_trajectory(robot, curve, limits, collision=False)
    excess = max(row.excess for row in check.rows if row.kind == "position")
    assert excess == pytest.approx(beyond, rel=0.1, abs=6e-4)
    rows = [row for row in check.rows if row.kind == "acceleration"]
    assert max(row.reached / row.limit for row in rows) == pytest.approx(share, abs=6e-3)
    assert {row.verdict for row in check.rows} <= {"held", "broken"}
    time = np.linspace(0.0, curve.duration, 20_001)
    for order, kind in enumerate(("velocity", "acceleration"), 1):
        dense = np.abs(curve.evaluate(time, derivative=order)).max(axis=0)
        worst = [row.worst for row in check.rows if row.kind == kind]
        assert np.all(dense <= np.array(worst) * (1.0 + 1e-9))


def test_what_no_torque_holds_is_told() -> None:
    joints = ("wrist_2_joint", "wrist_3_joint")
    wrist = sdpid.Transmission([[1.0, 1.0], [1.0, -1.0]], joints=joints)
    robot = sdpid.load_robot("ur5_robot", transmission=wrist)
    springs = (sdpid.friction.Spring("elbow_joint", 3.0, 0.0),)
    told = TorqueModel.of(replace(robot, springs=springs)).notes
    assert any("not in them: Spring" in note for note in told)
    assert any("several motors move" in note for note in told)
    terms = FrictionModel.from_terms(springs, robot.joint_names)
    theta = np.append(robot.prior.ravel(), 3.0)
    estimate = RobotDynamics(robot=robot, terms=terms, theta=theta)
    assert any("not in them: Spring" in note for note in TorqueModel.of(robot, estimate).notes)


@given(seed=SEEDS)
def test_motors_that_move_joints_together_keep_the_limits_of_these(seed: int) -> None:
    rng, names = np.random.default_rng(seed), ("joint_4", "joint_5", "joint_6")
    matrix = rng.normal(size=(3, 3)) + 2.0 * np.eye(3)
    plain = sdpid.load_robot("denso_vp6242")
    wrist = sdpid.Transmission(matrix, 0.1 * rng.normal(size=3), joints=names)
    robot = sdpid.load_robot("denso_vp6242", transmission=wrist)
    free = np.full(robot.n, np.nan)
    low, high = _within_mimics(robot, free, free)
    motors = rng.uniform(low[3:], high[3:], (50, 3))
    joints = motors @ matrix.T + np.array(wrist.offset)
    limits = plain.position_limits[3:]
    assert np.all((joints >= limits[:, 0] - 1e-9) & (joints <= limits[:, 1] + 1e-9))
