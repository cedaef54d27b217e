"""Checks of whole motions: against dense evaluation, and what each broken limit is called."""

import math
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
from sdpid.excitation.limits.tool import tool_frames
from sdpid.excitation.limits.torque import TorqueModel
from sdpid.experiment.plant.default_motion import default_motion
from sdpid.experiment.trajectory.fourier import FourierSeries
from sdpid.experiment.trajectory.sampled import SampledCurve
from sdpid.experiment.trajectory.spline import Spline
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


@given(seed=SEEDS, factor=st.floats(0.5, 3.0))
def test_slower_motions_scale(seed: int, factor: float) -> None:
    robot = sdpid.load_robot(TREE)
    curve = spline(robot.n, seed)
    slow = Spline(duration=factor * curve.duration, control_points=curve.control_points)
    # Bounds are refined to a share of the limit, so that small ones are met closely.
    limits = sdpid.Limits(velocity=1e-3, acceleration=1e-3, jerk=1e-3)
    fast, stretched = (
        check_trajectory(robot, each, limits, collision=False) for each in (curve, slow)
    )
    for order, kind in enumerate(("position", "velocity", "acceleration", "jerk")):
        for a, b in zip(by_kind(fast, kind), by_kind(stretched, kind), strict=True):
            np.testing.assert_allclose(b.worst * factor**order, a.worst, rtol=1e-3, atol=0.01)


@given(seed=SEEDS)
def test_mirrored_motions_mirror_their_rows(seed: int) -> None:
    robot = sdpid.load_robot(TREE)
    curve = spline(robot.n, seed)
    mirrored = Spline(duration=curve.duration, control_points=-curve.control_points)
    a, b = (
        check_trajectory(robot, each, unlimited(robot), collision=False)
        for each in (curve, mirrored)
    )
    upper = [row.reached for row in by_kind(a, "position") if row.side == "upper"]
    lower = [row.reached for row in by_kind(b, "position") if row.side == "lower"]
    np.testing.assert_allclose(upper, -np.array(lower))
    for kind in ("velocity", "acceleration", "jerk"):
        for one, other in zip(by_kind(a, kind), by_kind(b, kind), strict=True):
            np.testing.assert_allclose(one.worst, other.worst)


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
    assert {row.verdict for row in by_kind(check, "position")} == {"held"}


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


@pytest.mark.parametrize("source", ROBOTS)
def test_derivatives_of_torques(source: str) -> None:
    robot = sdpid.load_robot(source)
    model = TorqueModel.of(robot)
    rng = np.random.default_rng(1)
    state = list(rng.normal(size=(3, 4, robot.n)))
    torque, *slopes = model.torque_and_derivatives(*state)
    np.testing.assert_allclose(torque, efforts(robot, *state), rtol=1e-10, atol=1e-10)
    for which, slope in enumerate(slopes):
        for j in range(robot.n):
            ends = []
            for sign in (1.0, -1.0):
                moved = [each.copy() for each in state]
                moved[which][:, j] += sign * 1e-6
                ends.append(model.torque(*moved))
            np.testing.assert_allclose(
                slope[:, :, j], (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-5
            )


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
    with pytest.raises(DataError, match="velocity_joint_2 is missing"):
        check_trajectory(denso, columns, collision=False)
    with pytest.raises(DataError, match="time is missing"):
        check_trajectory(denso, {"position": np.zeros((3, denso.n))}, collision=False)
    with pytest.raises(DataError, match="give a Trajectory"):
        check_trajectory(denso, 3.0, collision=False)  # type: ignore[arg-type]


def test_wrong_joints_are_told(denso: sdpid.RobotModel) -> None:
    refuses(DataError, "3 joints", check_trajectory, denso, spline(3, 0), collision=False)
    motion = default_motion(denso, 1, period=8.0)
    other = replace(motion, joint_names=tuple("abcdef"))
    refuses(DataError, "its joints are a, b, c", check_trajectory, denso, other, collision=False)
    names = tuple(reversed(denso.joint_names))
    turned = check_trajectory(denso, replace(motion, joint_names=names), collision=False)
    straight = check_trajectory(denso, motion, collision=False)
    assert by_kind(turned, "velocity")[0].reached == by_kind(straight, "velocity")[5].reached
    with pytest.raises(DataError, match="they are of the joints"):
        check_trajectory(denso, motion, sdpid.Limits().of(sdpid.load_robot(TREE)), collision=False)
    with pytest.raises(ModelError, match="no frame 'hand'"):
        check_trajectory(denso, motion, sdpid.Limits(tool_speed=1.0, tool="hand"), collision=False)
    refuses(DataError, "spread is -1", TorqueModel.of, denso, spread=-1.0)
    refuses(DataError, "reserve is 1", TorqueModel.of, denso, reserve=1.0)


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


def test_a_rail_without_limits_is_checked_as_far_as_the_motion_goes() -> None:
    robot = sdpid.load_robot(
        """<robot name="rail"><link name="base"/><link name="cart"><collision><geometry>
        <sphere radius="0.1"/></geometry></collision></link><joint name="slide" type="prismatic">
        <parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
        <limit lower="-1e10" upper="1e10" effort="9" velocity="99"/></joint></robot>"""
    )
    assert not np.isfinite(robot.position_limits).any()
    points = np.repeat([0.0, 12.0, 0.0], [3, 20, 3])[:, None]
    obstacles = [Box(size=(1.0, 1.0, 1.0), translation=(10.0, 0.0, 0.0))]
    check = check_trajectory(
        robot, Spline(duration=20.0, control_points=points), obstacles=obstacles
    )
    (row,) = [row for row in check.rows if row.kind == "distance"]
    assert row.verdict == "broken"
    near = Spline(duration=20.0, control_points=points / 2)
    assert check_trajectory(robot, near, obstacles=obstacles).ok


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


SLIDER = """<robot name="slider"><link name="base"/><link name="cart"><inertial><mass value="1"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry>
  <box size="0.2 0.2 0.2"/></geometry></collision></link>
  <joint name="rail" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
  {}</joint></robot>"""


@pytest.mark.parametrize(
    "limit", ["", '<limit lower="-1" upper="1" effort="9" velocity="99"/>'], ids=["none", "beyond"]
)
def test_obstacles_outside_of_the_limits_are_met(limit: str) -> None:
    robot = sdpid.load_robot(SLIDER.format(limit or '<limit effort="9" velocity="99"/>'))
    points = np.zeros((12, 1))
    points[3:9] = 12.0
    curve = Spline(duration=20.0, control_points=points)
    box = Box(size=(0.5, 0.5, 0.5), translation=(10.0, 0.0, 0.0))
    check = check_trajectory(robot, curve, obstacles=[box])
    rows = by_kind(check, "distance")
    assert any(row.verdict == "broken" for row in rows)
