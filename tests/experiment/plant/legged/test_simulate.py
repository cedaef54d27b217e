"""Quadrupeds obey the equation of motion that identification assumes, and sensors say so."""

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.experiment.plant.legged.friction import DryFriction
from sdpid.experiment.plant.legged.sensors import Sensors
from sdpid.experiment.plant.legged.simulate import LeggedRun, simulate_legged
from sdpid.experiment.plant.legged.truth import changed_parameters
from sdpid.robot.inertia import margin
from sdpid.robot.legs.find import find_legs
from tests.helpers.refusals import refuses

# What forces from the simulator may leave of the equation of motion, N and N·m.
EQUATION = 1e-6


@cache
def robot() -> sdpid.RobotModel:
    return sdpid.load_robot("go1", root="free_flyer")


@cache
def exact(motion: str) -> LeggedRun:
    # Three steps of the trot, and the first half of the walk's first.
    return simulate_legged(robot(), motion, duration=0.8, seed=1, sensors=Sensors.exact())


def contact_torques(run: LeggedRun, moved: sdpid.RobotModel) -> Array:
    """Return J^T·f of the true wrenches by Pinocchio, sample by sample, shape (N, nv)."""
    model, contacts = moved.pin_model, run.recording.contacts
    assert contacts is not None
    data, out = model.createData(), np.zeros((len(run.motion.position), model.nv))
    for k, q in enumerate(run.motion.position):
        pin.computeJointJacobians(model, data, q)
        for name, wrench in zip(contacts.frames, run.motion.wrenches[k], strict=True):
            frame = model.getFrameId(name)
            pin.updateFramePlacement(model, data, frame)
            out[k] += pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED).T @ wrench
    return out


@pytest.mark.parametrize("motion", ["stand", "trot", "walk", "hang"])
def test_the_equation_of_motion_holds_with_the_simulators_forces(motion: str) -> None:
    run = exact(motion)
    moved, n = run.motion, 12
    links, (coulomb, viscous, rotor) = run.theta[:130], run.theta[130:].reshape(3, n)
    needed = robot().inverse_dynamics(
        links.reshape(-1, 10), moved.position, moved.velocity, moved.acceleration
    )
    needed[:, 6:] += rotor * moved.acceleration[:, 6:] + moved.friction
    residual = needed - moved.effort - contact_torques(run, robot())
    assert np.abs(residual).max() < EQUATION
    speed = moved.velocity[:, 6:]
    law = coulomb * np.tanh(speed / 0.02) + viscous * speed
    np.testing.assert_allclose(moved.friction, law)


@pytest.mark.parametrize("motion", ["trot", "hang"])
def test_the_sensors_measure_the_motion(motion: str) -> None:
    run = exact(motion)
    log, moved = run.recording, run.motion
    assert log.base.imu is not None
    np.testing.assert_allclose(log.position, moved.position[:, 7:])
    np.testing.assert_allclose(log.effort, moved.effort[:, 6:])
    # Joints follow the plan within hundredths of a radian.
    assert 1e-4 < np.sqrt(np.mean((log.position - np.asarray(log.reference)) ** 2)) < 0.03
    assert np.array_equal(log.contacts.down, moved.down)
    imu, step = log.base.imu, log.step
    # The sensor's place and axes in the world, differentiated.
    base = Rotation.from_quat(log.base.orientation)
    place = np.asarray(log.base.position) + base.apply(np.array(imu.translation))
    second = np.diff(place, n=2, axis=0) / step**2 + [0.0, 0.0, 9.81]
    felt = (base * Rotation.from_matrix(np.array(imu.rotation))).inv()[1:-1].apply(second)
    turned = (base[:-2].inv() * base[2:]).as_rotvec() @ imu.rotation / (2.0 * step)
    # Steps of impacts apart, which a central difference spreads over neighbors.
    accelerometer = np.abs(felt - np.asarray(imu.accelerometer)[1:-1])
    assert np.median(accelerometer) < 0.02
    assert np.median(np.abs(turned - np.asarray(imu.gyroscope)[1:-1])) < 1e-3


def test_feet_bear_the_weight_where_they_touch() -> None:
    run = exact("stand")
    assert np.all(run.motion.down)
    mass = run.theta[:130:10].sum()
    vertical = run.motion.wrenches[:, :, 2].sum(axis=1)
    assert vertical.mean() == pytest.approx(9.81 * mass, rel=0.02)
    trot = exact("trot").motion
    assert 0.4 < trot.down.mean() < 0.9
    assert np.abs(trot.wrenches[~trot.down]).max() == 0.0
    feet = find_legs(robot()).feet(trot.position[:, 7:])
    base = Rotation.from_quat(trot.position[:, 3:7])
    height = np.stack([base.apply(each)[:, 2] for each in feet.transpose(1, 0, 2)], axis=1)
    height += trot.position[:, 2:3] - 0.02
    assert np.array_equal(height < 0.0, trot.down)


def test_channels_come_late_and_gains_are_off() -> None:
    sensors = replace(Sensors.exact(), delays={"effort": 0.002}, effort_gain=1.05)
    run = simulate_legged(robot(), "hang", duration=0.2, seed=1, sensors=sensors)
    np.testing.assert_allclose(run.recording.effort[2:], 1.05 * run.motion.effort[:-2, 6:])
    np.testing.assert_allclose(run.recording.position, run.motion.position[:, 7:])
    assert run.recording.time[0] == pytest.approx(0.0, abs=1e-9)


def test_a_humanoid_walks_on_soles() -> None:
    """A foot is lifted, wrenches of soles obey the equation of motion, and all joints move."""
    talos = sdpid.load_robot("talos_reduced", root="free_flyer")
    run = simulate_legged(talos, "walk", duration=1.0, seed=1, sensors=Sensors.exact())
    moved, log, links = run.motion, run.recording, 10 * talos.n_links
    needed = talos.inverse_dynamics(
        run.theta[:links].reshape(-1, 10), moved.position, moved.velocity, moved.acceleration
    )
    rotor = run.theta[links:].reshape(3, -1)[2]
    needed[:, 6:] += rotor * moved.acceleration[:, 6:] + moved.friction
    residual = needed - moved.effort - contact_torques(run, talos)
    # Of torques of 100 N·m and forces of 900 N.
    assert np.abs(residual).max() < 100.0 * EQUATION
    assert log.contacts.kind == ("plane", "plane")
    assert log.contacts.wrenches is not None
    assert 0 < np.count_nonzero(~moved.down) < len(moved.down)
    assert np.ptp(log.position, axis=0).min() > 1e-3
    refuses(DataError, r"'trot'.*2 soles", simulate_legged, talos, "trot")


def test_dry_friction_follows_a_law_that_friction_terms_know() -> None:
    law = DryFriction(width=0.06, peak=0.4, peak_speed=0.2)
    run = simulate_legged(robot(), "hang", duration=0.2, seed=1, friction=law)
    assert run.friction is law
    coulomb, viscous = run.theta[130:].reshape(3, 12)[:2]
    speed = run.motion.velocity[:, 6:]
    smooth, falling = law.terms
    shape = smooth.shape(speed, speed) + 0.4 * falling.shape(speed, speed)
    np.testing.assert_allclose(run.motion.friction, coulomb * shape + viscous * speed, atol=1e-12)
    refuses(DataError, r"too steep.*limit is 0.03", DryFriction, peak=1.0)


def test_a_light_quadruped_trots_without_chatter() -> None:
    run = simulate_legged("solo12", "trot", duration=2.0, seed=1)
    # Two steps a second of every foot, and few bounces.
    assert np.abs(np.diff(run.motion.down.astype(int), axis=0)).sum() < 2.0 * (2 * 2 * 4 * 2.0)
    assert find_legs(sdpid.load_robot("solo12", root="free_flyer")).radius == pytest.approx(
        0.016, abs=1e-4
    )


def test_changed_links_are_bodies_and_seeds_repeat() -> None:
    theta = changed_parameters(robot(), seed=3)
    bodies, described = theta[:130].reshape(-1, 10), robot().prior
    assert margin(bodies, "pseudo_inertia").min() > 0.0
    assert 0.05 < np.abs(np.log(bodies[:, 0] / described[:, 0])).mean() < 0.3
    assert np.array_equal(theta, changed_parameters(robot(), seed=3))
    np.testing.assert_allclose(
        changed_parameters(robot(), change=0.0)[:130].reshape(-1, 10), described, atol=1e-12
    )


def test_what_cannot_be_simulated_is_refused() -> None:
    fixed = sdpid.load_robot("go1")
    refuses(ModelError, r"fixed base.*free_flyer", simulate_legged, fixed)
    refuses(DataError, r"'dance'.*stand, trot", simulate_legged, robot(), "dance")
    refuses(DataError, "expected 166", simulate_legged, robot(), theta=np.ones(130))
    refuses(DataError, "no channel 'torque'", Sensors, delays={"torque": 0.1})
    refuses(ModelError, "no frame 'paw'", find_legs, robot(), feet=["paw"])
    refuses(ModelError, "mimic", simulate_legged, "talos_full_v2")
    refuses(ModelError, r"romeo.*no body has the parameters", simulate_legged, "romeo_small")
    heavy = np.array(changed_parameters(robot()))
    heavy[:10] *= 30.0
    refuses(DataError, "falls", simulate_legged, robot(), "trot", theta=heavy, duration=3.0)
