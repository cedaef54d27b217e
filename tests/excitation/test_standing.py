"""Plans for robots that stand: limits are held, feet stay down in MuJoCo, bad input is told."""

import gc
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.estimation.compression.contact_rows import ContactRows
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.limits.check import LimitCheck
from sdpid.excitation.search.space import SplineSpace
from sdpid.excitation.standing.design import _joints
from sdpid.excitation.standing.held import Held
from sdpid.excitation.standing.plan import write_standing
from sdpid.excitation.standing.stance import Stance, StanceStates, StandingRows
from sdpid.experiment.processing.contact_samples import ContactSamples
from sdpid.experiment.trajectory.whole_body import WholeBodyMotion
from sdpid.robot.legs import find_legs
from tests.helpers.plans import standing_plan
from tests.helpers.refusals import refuses


def test_a_plan_holds_its_limits_and_tells_what_it_buys() -> None:
    plan = standing_plan()
    assert plan.limits.ok
    kinds = {row.kind for row in plan.limits.rows}
    assert {"torque", "normal force", "friction", "determinant", "miss"} <= kinds
    assert np.all(plan.standard_errors <= plan.before * (1.0 + 1e-9))
    assert np.min(plan.standard_errors / plan.before) < 0.2
    told = [note for note in plan.notes if "limit nothing" in note]
    assert len(told) == 3
    assert told[1].startswith("all joints have velocity limits in the description")
    motion = plan.motion
    # From rest to rest, and somewhere between.
    np.testing.assert_allclose(motion.velocity[[0, -1]], 0.0, atol=1e-9)
    assert np.ptp(motion.base_position, axis=0).max() > 0.01
    assert motion.forces[:, :, 2].min() >= plan.held.load
    np.testing.assert_allclose(
        np.gradient(motion.position, motion.time, axis=0), motion.velocity, atol=0.02
    )


def test_feet_stay_down_in_mujoco() -> None:
    """With links that differ from the plan's, rotors and friction, no foot slips or lifts."""
    motion = standing_plan().motion
    run = sdpid.simulate_legged("solo12", motion)
    assert run.motion.down.all()
    force = run.motion.wrenches[:, :, :3]
    # The ground of the plant holds one; the plan uses half of that.
    used = np.linalg.norm(force[:, :, :2], axis=2) / force[:, :, 2]
    assert used.max() < 0.9
    rows = np.searchsorted(motion.time, run.recording.time)
    off = run.motion.position[:, :3] - motion.base_position[np.minimum(rows, len(motion.time) - 1)]
    assert np.abs(off).max() < 0.02


def test_the_same_design_is_found_again_beside_an_earlier_one() -> None:
    """Earlier plans count: what they tell is known before."""
    plan = standing_plan()
    again = sdpid.design_standing(
        "solo12", duration=3.0, steps=2, previous=plan, time_limit=600.0, progress=False
    )
    np.testing.assert_allclose(again.before, plan.standard_errors, rtol=1e-6)


def test_plans_do_not_keep_what_their_searches_looked_at() -> None:
    """States beside those of a search take 15 MB of a quadruped, 0.2 GB of a humanoid."""
    before = _states()
    plan = sdpid.design_standing("solo12", duration=1.5, steps=1, progress=False)
    assert plan.held.stance is plan.stance
    assert _states() == before


def _states() -> int:
    """Return how many states are kept somewhere."""
    gc.collect()
    return sum(isinstance(each, StanceStates) for each in gc.get_objects())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"duration": 0.5}, "duration: is 0.5 s; give more than 1"),
        ({"sway": 2.0}, "sway: is 2 m; give more than 0 and less than the base's height"),
        ({"grip": 0.0}, "grip: is 0; give more than 0"),
        ({"load": 0.99}, "load: is 0.99; give more than 0 and at most 0.9"),
        ({"starts": 0}, "starts: is 0"),
        ({"steps": 0}, "steps: is 0; give at least 1"),
        ({"previous": "x"}, "previous: is or holds 'x'; give what design_standing returned"),
        ({"standing": [np.nan] * 12}, "standing: the angle of 'FL_HAA' is nan; give finite ones"),
        ({"standing": [0.0] * 12}, "the leg of 'FL_FOOT' is straight: .* bend its knee"),
        (
            {"limits": sdpid.Limits(torque=0.1)},
            "standing still, torque of .* is .* N.m, the limit is",
        ),
    ],
)
def test_bad_input_is_told_before_the_search(arguments: dict[str, Any], message: str) -> None:
    refuses(DataError, message, sdpid.design_standing, "solo12", **arguments)


def test_limits_are_held_where_the_criterion_looks() -> None:
    """A leg that is stretched there, and nowhere else, would make rows without bound."""
    plan = standing_plan()
    space = SplineSpace.of(plan.stance.n, 3.0)
    for each in (space, space.refined(np.zeros(space.size))[0]):
        ((_, instants),) = plan.held.rows(each).parts
        np.testing.assert_array_equal(instants, each.grid())


@pytest.mark.parametrize(("slack", "narrower"), [(-1e-6, 1.0013), (-0.05, 1.13), (-np.inf, 2.3)])
def test_limits_are_narrowed_by_what_was_missing(slack: float, narrower: float) -> None:
    """Also where a foot is pulled, and no friction holds it."""
    stance = Stance(find_legs(sdpid.load_robot("solo12", root="free_flyer")))
    held, space = limits_of(stance), SplineSpace.of(stance.n, 1.5)
    first = held.check(space.curve(np.zeros(space.size))).rows[0]
    row = replace(first, limit=0.5, slack=slack, verdict="broken")
    held.learn(LimitCheck(rows=(row,), notes=()))
    assert held.searched == pytest.approx(0.97 / narrower)


def test_robots_without_legs_are_refused() -> None:
    # Fingers of a Panda mimic each other, which is not what is wrong.
    for name in ("ur10_robot", "panda"):
        words = "has no link with 'foot' or 'sole'.*no robot on legs"
        refuses(ModelError, words, sdpid.design_standing, name)


def test_motions_of_other_robots_are_refused() -> None:
    motion = standing_plan().motion
    refuses(DataError, "'go1' has 12 joints and feet FL_foot", sdpid.simulate_legged, "go1", motion)
    words = "duration: 9 s, the motion ends after 3 s"
    refuses(DataError, words, sdpid.simulate_legged, "solo12", motion, duration=9.0)


# Kinematics, rows and loads of a stance, beside Pinocchio, differences, and an estimate's rows.


K = 12


@pytest.fixture(scope="module", params=["go1", "talos_reduced"])
def stance(request: pytest.FixtureRequest) -> Stance:
    return Stance(find_legs(sdpid.load_robot(request.param, root="free_flyer")))


def coordinates(stance: Stance, order: int, time: Array) -> Array:
    """Return coordinates of a smooth motion, or a derivative."""
    rng = np.random.default_rng(3)
    size = np.full(stance.n, 0.1)
    size[:3] = 0.03 * stance.legs.height
    size[:6] *= 0.2 if stance.legs.flat else 1.0
    rate = 2.0 * np.pi * rng.uniform(0.5, 1.5, stance.n)
    angle = np.outer(time, rate) + rng.uniform(0.0, 2.0 * np.pi, stance.n) + 0.5 * np.pi * order
    return np.asarray(size * rate**order * np.sin(angle))


def states(stance: Stance) -> tuple[StanceStates, list[Array]]:
    x = [coordinates(stance, order, np.linspace(0.0, 1.0, K)) for order in range(3)]
    return stance.states(stance.poses(x[0]), x[1], x[2]), x


def test_feet_neither_slip_nor_lift(stance: Stance) -> None:
    """Pinocchio, with the base's linear velocity, gives contacts no velocity and acceleration."""
    import pinocchio as pin

    found, x = states(stance)
    poses, model = found.poses, stance.robot.pin_model
    data = model.createData()
    assert poses.miss.max() < 1e-9
    for k in range(K):
        v, a = found.velocity[k].copy(), found.acceleration[k].copy()
        v[:3] = poses.turned[k].T @ x[1][k, :3]
        a[:3] -= np.cross(v[3:6], v[:3])
        pin.forwardKinematics(model, data, poses.configuration[k], v, a)
        for frame in stance.legs.frame_ids:
            pin.updateFramePlacement(model, data, frame)
            axes = pin.LOCAL_WORLD_ALIGNED
            speed = pin.getFrameVelocity(model, data, frame, axes)
            rise = pin.getFrameClassicalAcceleration(model, data, frame, axes)
            for each in (speed, rise):
                rolled = each.linear - stance.legs.radius * np.cross(each.angular, [0.0, 0.0, 1.0])
                np.testing.assert_allclose(rolled, 0.0, atol=1e-11)
                if stance.legs.flat:
                    np.testing.assert_allclose(each.angular, 0.0, atol=1e-11)


def test_balls_roll_along_the_way() -> None:
    """Joints of a motion have the rates that rolling without slip asks for."""
    stance = Stance(find_legs(sdpid.load_robot("go1", root="free_flyer")))
    time = np.linspace(0.0, 1.0, 501)
    x = [coordinates(stance, order, time) for order in range(3)]
    found = stance.states(stance.along(x[0]), x[1], x[2])
    joints = found.poses.configuration[:, 7:]
    slope = np.gradient(joints, time, axis=0, edge_order=2)
    np.testing.assert_allclose(found.velocity[:, 6:], slope, atol=5e-4)
    # On the shortest way the ball's turning about two axes is missed.
    straight = np.gradient(stance.poses(x[0]).configuration[:, 7:], time, axis=0, edge_order=2)
    missed, left = (np.abs(found.velocity[:, 6:] - each).max() for each in (straight, slope))
    assert missed > 3.0 * left


def test_rows_are_those_of_an_estimate(stance: Stance) -> None:
    found, x = states(stance)
    robot, legs = stance.robot, stance.legs
    rows = rows_of(stance, np.random.default_rng(1).uniform(0.5, 2.0, robot.n))
    W = rows.rows(*x)
    samples = sdpid.Samples(
        position=found.poses.configuration,
        velocity=found.velocity,
        acceleration=found.acceleration,
        effort=np.zeros_like(found.velocity),
        contacts=ContactSamples(
            frames=legs.frames,
            kind="plane" if legs.flat else "point",
            offset=(0.0, 0.0, -legs.radius),
            down=np.ones((K, len(legs.frames)), dtype=bool),
        ),
    )
    contacts = ContactRows.of(robot, samples, slice(0, K))
    root = np.diag(rows.spread**-0.5)[None]
    every = np.ones((K, robot.n), dtype=bool)
    T, _ = contacts.eliminated(root, np.zeros(K, dtype=np.intp), every)
    other = T @ rows.regressor.rows(samples.position, found.velocity, found.acceleration)
    mine, theirs = (np.einsum("kmb,kmc->kbc", each, each) for each in (W, other))
    np.testing.assert_allclose(mine, theirs, atol=1e-10 * np.abs(theirs).max())


def test_derivatives_are_those_of_differences(stance: Stance) -> None:
    _, x = states(stance)
    x = [each[:4] for each in x]
    rng = np.random.default_rng(2)
    rows = rows_of(stance, np.ones(stance.robot.n))
    smooth = replace(rows, regressor=rows.regressor.smooth())
    W = smooth.rows(*x)
    C = rng.normal(size=W.shape) / max(1.0, float(np.abs(W).max()))
    held = limits_of(stance)
    by_rows, by_held = smooth.gradient(C, *x), held.derivatives(*x)
    for order in range(3):
        way = rng.normal(size=x[order].shape)
        ends = []
        for sign in (1.0, -1.0):
            moved = [*x]
            moved[order] = x[order] + sign * 1e-5 * way
            ends.append((np.sum(C * smooth.rows(*moved)), held.evaluate(*moved)))
        slope = (ends[0][0] - ends[1][0]) / 2e-5
        assert np.sum(by_rows[order] * way) == pytest.approx(slope, rel=1e-4, abs=1e-5)
        by = by_held[order]
        assert by is not None
        along, found = np.einsum("krm,km->kr", by, way), (ends[0][1] - ends[1][1]) / 2e-5
        np.testing.assert_allclose(along, found, atol=1e-4 * max(1.0, float(np.abs(found).max())))


def rows_of(stance: Stance, spread: Array) -> StandingRows:
    regressor = BaseRows.of(stance.robot, ("coulomb", "viscous"))
    return StandingRows(stance=stance, regressor=regressor, spread=spread)


def limits_of(stance: Stance) -> Held:
    joints = _joints(stance.robot, None, stance.legs.standing)
    bodies = np.array(stance.robot.prior)
    return Held(stance=stance, joints=joints, bodies=bodies, grip=0.5, load=1.0)


def test_torques_and_forces_carry_the_motion(stance: Stance) -> None:
    """RNEA without forces is torques and forces together; still, feet share the weight."""
    found, _ = states(stance)
    robot, bodies = stance.robot, np.array(stance.robot.prior)
    held = limits_of(stance)
    torque, wrenches = held.loads(found)
    rows = wrenches.shape[2]
    J = stance.at_contacts(found.poses.jacobians)[:, :, :rows]
    needed = robot.efforts_of_bodies(
        bodies, found.poses.configuration, found.velocity, found.acceleration
    )
    made = np.einsum("kcrn,kcr->kn", J, wrenches)
    made[:, 6:] += torque
    np.testing.assert_allclose(made, needed, atol=1e-8 * np.abs(needed).max())
    still = np.zeros((1, stance.n))
    _, rest = held.loads(stance.states(stance.standing, still, still))
    weight = bodies[:, 0].sum() * 9.81
    assert rest[0, :, 2].sum() == pytest.approx(weight, rel=1e-6)
    assert np.abs(rest[0, :, :2]).max() < 1e-6 * weight


# The folder of a plan for a robot that stands.


def test_a_plan_is_written_and_read(tmp_path: Path) -> None:
    plan = standing_plan()
    files = write_standing(plan, tmp_path / "plan")
    assert {file.name for file in files} >= {"trajectory.csv", "plan.json"}
    read = WholeBodyMotion.from_csv(tmp_path / "plan" / "trajectory.csv")
    for name in ("time", "position", "effort", "base_orientation", "down", "forces"):
        np.testing.assert_array_equal(getattr(read, name), getattr(plan.motion, name))
    content = json.loads((tmp_path / "plan" / "plan.json").read_text(encoding="utf-8"))
    assert content["limits"]["ok"]
    assert len(content["base_parameters"]) == plan.base.count
    log = sdpid.read_recording(tmp_path / "plan" / "trajectory.csv")
    assert log.base is not None
    assert log.contacts is not None
    (tmp_path / "bad.csv").write_text("time,position_a\n0,1\n", encoding="utf-8")
    refuses(DataError, "has no column 'velocity_a'", WholeBodyMotion.from_csv, tmp_path / "bad.csv")
