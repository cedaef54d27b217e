"""Kinematics, rows and loads of a stance, beside Pinocchio, differences, and an estimate's rows."""

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.compression.contact_rows import ContactRows
from sdpid.excitation.standing.held import Held
from sdpid.excitation.standing.loads import loads
from sdpid.excitation.standing.rows import StandingRows
from sdpid.excitation.standing.stance import Stance, States
from sdpid.excitation.standing.task import _joints
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples
from sdpid.robot.legs.find import find_legs

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


def states(stance: Stance) -> tuple[States, list[Array]]:
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
    rows = StandingRows.of(stance, ("coulomb", "viscous"))
    rows = replace(rows, spread=np.random.default_rng(1).uniform(0.5, 2.0, robot.n))
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
    other = T @ rows.regressor(found)
    mine, theirs = (np.einsum("kmb,kmc->kbc", each, each) for each in (W, other))
    np.testing.assert_allclose(mine, theirs, atol=1e-10 * np.abs(theirs).max())


def test_derivatives_are_those_of_differences(stance: Stance) -> None:
    _, x = states(stance)
    x = [each[:4] for each in x]
    rng = np.random.default_rng(2)
    smooth = StandingRows.of(stance, ("coulomb", "viscous")).smooth()
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


def limits_of(stance: Stance) -> Held:
    joints = _joints(stance.robot, None, stance.legs.standing)
    bodies = np.array(stance.robot.prior)
    return Held(stance=stance, joints=joints, bodies=bodies, grip=0.5, load=1.0)


def test_torques_and_forces_carry_the_motion(stance: Stance) -> None:
    """RNEA without forces is torques and forces together; still, feet share the weight."""
    found, _ = states(stance)
    robot, bodies = stance.robot, np.array(stance.robot.prior)
    got = loads(stance, bodies, found, 0.5)
    rows = got.wrenches.shape[2]
    J = stance.at_contacts(found.poses.jacobians)[:, :, :rows]
    needed = robot.efforts_of_bodies(
        bodies, found.poses.configuration, found.velocity, found.acceleration
    )
    made = np.einsum("kcrn,kcr->kn", J, got.wrenches)
    made[:, 6:] += got.torque
    np.testing.assert_allclose(made, needed, atol=1e-8 * np.abs(needed).max())
    still = np.zeros((1, stance.n))
    rest = loads(stance, bodies, stance.states(stance.standing, still, still), 0.5)
    weight = bodies[:, 0].sum() * 9.81
    assert rest.wrenches[0, :, 2].sum() == pytest.approx(weight, rel=1e-6)
    assert np.abs(rest.wrenches[0, :, :2]).max() < 1e-6 * weight
