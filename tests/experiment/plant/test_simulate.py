"""The simulated experiment obeys the equations that identification assumes."""

from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.experiment.plant import simulate as plant
from sdpid.experiment.plant.legged.simulate import LeggedRun, Sensors
from sdpid.experiment.plant.legged.truth import DryFriction, changed_parameters
from sdpid.experiment.trajectory.drawn import default_motion
from sdpid.robot.description.catalog import bundled_folder
from sdpid.robot.inertia import margin
from sdpid.robot.legs import find_legs
from sdpid.robot.model.jacobians import contact_jacobians
from tests.helpers.data import random_links
from tests.helpers.mujoco_arm import mujoco_motion
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE
from tests.helpers.small_robots import URDFS

NAME = "denso_vp6242"
ROBOT = sdpid.RobotModel.from_mdh(bundled_folder(NAME) / "kinematics.toml")
THETA, DRIVES = plant.true_parameters(NAME), plant.load_drives(NAME)
SHORT = sdpid.paper_excitation(NAME, 5, period=16.0, periods=3)
# Below this speed (rad/s) dry friction may stick.
MOVING = 0.02

# A light hand with the friction that descriptions copy from heavy links.
STIFF = """<robot name="stiff"><link name="base"/>
<link name="a"><inertial><mass value="5"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><mass value="0.3"/>
  <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/></joint>
<joint name="k" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
  <origin xyz="0 0 0.3"/><dynamics damping="10" friction="0.1"/></joint>
</robot>"""


@cache
def recorded(**options: Any) -> sdpid.Recording:
    """Return the short motion as the Denso records it, without noise unless it is asked for."""
    return sdpid.simulate(ROBOT, SHORT, theta=THETA, **({"noise": False} | options))


@pytest.mark.parametrize("name", [NAME, "tree"])
def test_the_motion_is_that_of_mujoco(name: str) -> None:
    """Another library's bodies, friction and integrator of fourth order move alike."""
    robot, theta = sdpid.load_robot(TREE if name == "tree" else name), THETA
    if name == "tree":
        links = random_links(np.random.default_rng(4), robot.n).ravel()
        theta = np.concatenate([links, np.full(robot.n, 0.5), np.full(robot.n, 2.0)])
    trajectory = default_motion(robot, 0, period=7.0, periods=1)
    drives = plant.default_drives(robot, theta, trajectory) if name == "tree" else DRIVES
    log = sdpid.simulate(robot, trajectory, theta=theta, drives=drives, noise=False)
    # The record's period follows one that settles.
    q, v, torque = mujoco_motion(robot, trajectory.with_periods(2), theta, drives)
    lead, period = trajectory.lead_samples, trajectory.samples_per_period
    here, there = slice(lead, lead + period), slice(lead + period, lead + 2 * period)
    assert np.abs(log.position[here] - q[there]).max() < 5e-4 * np.ptp(q)
    off = np.abs(log.effort[here] - torque[there])[np.abs(v[there]) > MOVING]
    assert np.median(off) < 1e-5 * np.abs(torque).max()
    assert np.quantile(off, 0.99) < 1e-2 * np.abs(torque).max()


def test_record_layout_and_sensors() -> None:
    exact, noisy = recorded(), recorded(noise=True, seed=7)
    assert exact.n_samples == noisy.n_samples == SHORT.n_samples
    assert (noisy.start, noisy.period, noisy.periods) == (9.0, 16.0, 3)
    assert noisy.joint_names == ROBOT.joint_names
    np.testing.assert_allclose(DRIVES.effort_scale, [45.6, 60.8, 26.4, 21.0, 21.0, 21.0])
    counts = noisy.position / DRIVES.resolution
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    assert np.all(np.abs(noisy.position - exact.position) <= DRIVES.resolution / 2 * (1 + 1e-9))
    noise = (noisy.effort - exact.effort) / DRIVES.effort_scale
    np.testing.assert_allclose(noise.std(axis=0), 0.05, rtol=0.02)
    assert np.abs(noise.mean(axis=0)).max() < 5 * 0.05 / np.sqrt(len(noise))
    # The record is continuous, through the settling period and both ends of the periods.
    assert np.abs(np.diff(exact.position, axis=0)).max() < 4.0 / SHORT.rate_hz


def test_settled_periods_repeat(monkeypatch: pytest.MonkeyPatch) -> None:
    """Repeating a settled period gives what computing every one gives, and so do runs in halves."""
    repeated = recorded()
    monkeypatch.setattr(plant, "SETTLED", -1.0)
    computed = sdpid.simulate(ROBOT, SHORT, theta=THETA, noise=False)
    np.testing.assert_allclose(repeated.position, computed.position, atol=1e-8)
    np.testing.assert_allclose(repeated.effort, computed.effort, atol=1e-6)
    rows = computed.position[9_000:57_000].reshape(3, 16_000, 6)
    assert np.abs(rows[2] - rows[1]).max() < 1e-8
    monkeypatch.setattr(plant, "_AT_ONCE", 10_000)
    halves = sdpid.simulate(ROBOT, SHORT, theta=THETA, noise=False)
    np.testing.assert_allclose(halves.position, computed.position, atol=1e-8)


def test_unmodeled_effects_show_in_the_current_only() -> None:
    log, other, effects = recorded(), recorded(unmodeled=True), DRIVES.unmodeled
    np.testing.assert_array_equal(other.position, log.position)
    velocity = np.gradient(log.position, axis=0) * SHORT.rate_hz
    extra = effects.torque(log.position, velocity)
    # Velocities of differences are off where a joint reverses.
    off = np.abs(other.effort - log.effort - extra)[np.abs(velocity) > MOVING]
    # The agreed accuracy of the plant's torques, N·m.
    assert np.quantile(off, 0.99) < 1e-3
    assert np.abs(extra).max() > 1.0
    for sign in (1.0, -1.0):
        slow = effects.torque(np.zeros((1, 6)), np.full((1, 6), sign * 1e-9))[0]
        expected = sign * effects.stribeck_torque + effects.coulomb_asymmetry
        np.testing.assert_allclose(slow, expected)


def test_what_an_arm_cannot_do_is_refused(tmp_path: Path) -> None:
    tree = sdpid.load_robot(TREE)
    few = plant.Drives(**{each.name: np.ones(3) for each in fields(plant.Drives)[:6]})
    fast = replace(DRIVES, velocity_gain=np.full(6, 3000.0), unmodeled=None)
    loose = replace(DRIVES, proportional_gain=np.full(6, 1e6))
    unreal, massless, negative = (THETA.copy() for _ in range(3))
    unreal[59], massless[50], negative[60] = 0.0, 0.0, -1.0
    for error, words, given in (
        (DataError, "fastest pole", {"drives": fast}),
        (DataError, "diverges .* s after sample", {"drives": loose}),
        (DataError, "no unmodeled effects", {"drives": fast, "unmodeled": True}),
        (DataError, "exactly", {"exact": True, "unmodeled": True}),
        (DataError, "72", {"theta": THETA[:60]}),
        (ModelError, "link_6", {"theta": unreal}),
        (ModelError, "link_6", {"theta": massless}),
        (ModelError, "friction", {"theta": negative}),
        (DataError, "3 drives, robot 'denso_vp6242' has 6 joints", {"drives": few}),
    ):
        refuses(error, words, sdpid.simulate, ROBOT, SHORT, **({"theta": THETA} | given))
    refuses(DataError, "lift", sdpid.simulate, tree, SHORT, theta=THETA)
    refuses(DataError, "lengths differ", replace, few, gear_ratio=np.ones(2))
    (tmp_path / "drives.toml").write_text("torque_constant = [1.0]")
    refuses(DataError, "not understood", plant.load_drives, tmp_path)
    refuses(DataError, r"at least 6\.25 s", default_motion, tree, period=5.0)
    floating = sdpid.load_robot(TREE, root="free_flyer")
    refuses(ModelError, "floating base", default_motion, floating)


@pytest.mark.parametrize("name", [STIFF, "z1", NAME], ids=["stiff", "z1", "asked"])
def test_large_damping_is_followed_exactly_and_any_robot_where_asked(name: str) -> None:
    """Friction does not hold a joint that is told to move."""
    robot = sdpid.load_robot(name)
    theta = THETA if name == NAME else plant.default_parameters(robot)
    motion = default_motion(robot, 1, period=6.25, periods=1)
    log = sdpid.simulate(robot, motion, noise=False, exact=name == NAME, progress=False)
    lead = motion.lead_samples
    q, v, a = motion.sample(lead)
    np.testing.assert_array_equal(log.position[lead:], q)
    dry, viscous = theta[10 * robot.n_links :].reshape(2, -1)
    effort = robot.inverse_dynamics(theta, q, v, a) + dry * np.sign(v) + viscous * v
    np.testing.assert_allclose(log.effort[lead:], effort, atol=1e-9)
    assert "without a controller" in log.notes[0]


@pytest.mark.parametrize(
    "name", ["ur_description/ur5_robot", "panda_description/panda", "double_pendulum", *URDFS]
)
def test_any_robot_is_simulated_and_found_again(name: str) -> None:
    """Defaults for everything: the Panda has mimic fingers, the pendulum no limits."""
    robot = sdpid.load_robot(name)
    trajectory = default_motion(robot, 1, period=10.0, periods=2)
    log = sdpid.simulate(robot, trajectory, noise=False, progress=False)
    assert log.n_samples == trajectory.n_samples
    settings = sdpid.Processing(covariance=None, cutoff_hz=20.0, order=4)
    problem = sdpid.build_problem(
        robot, sdpid.process(log, settings), friction=("coulomb", "viscous")
    )
    fit = sdpid.solve_wls(problem)
    # The filter takes some of the fastest motion; 1e-4 of the effort is left.
    assert sdpid.validate(fit).relative < 3e-4
    truth = problem.base.matrix @ plant.default_parameters(robot)
    scale = np.linalg.norm(problem.A @ truth)
    assert np.linalg.norm(problem.A @ (fit.base - truth)) < 1e-3 * scale


def test_defaults_of_a_simulation() -> None:
    robot = sdpid.load_robot("ur_description/ur5_robot")
    motion = default_motion(robot, 7, period=8.0, periods=1)
    low, high = robot.position_limits.T
    assert (motion.position_period.min(axis=0) >= low).all()
    assert (motion.position_period.max(axis=0) <= high).all()
    assert (motion.velocity_peak <= motion.velocity_limit).all()
    assert (motion.velocity_limit <= robot.velocity_limits).all()
    one, again, other = (
        sdpid.simulate(robot, motion, seed=s, progress=False).effort for s in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, again)
    noise = (one - other).std(axis=0) / np.sqrt(2.0)
    rms = np.sqrt(np.mean(one**2, axis=0))
    assert (noise < 0.05 * rms).all()
    assert (noise > 1e-4 * rms).all()


# Quadrupeds obey the equation of motion that identification assumes, and sensors say so.


# What forces from the simulator may leave of the equation of motion, N and N·m.
EQUATION = 1e-6


@cache
def go1() -> sdpid.RobotModel:
    return sdpid.load_robot("go1", root="free_flyer")


@cache
def exact(motion: str) -> LeggedRun:
    # Three steps of the trot, and the first half of the walk's first.
    return sdpid.simulate_legged(go1(), motion, duration=0.8, seed=1, sensors=Sensors.exact())


def residual(run: LeggedRun, robot: sdpid.RobotModel) -> Array:
    """Return what is left of the equation of motion with the true parameters and wrenches."""
    moved, links = run.motion, 10 * robot.n_links
    needed = robot.inverse_dynamics(run.theta, moved.position, moved.velocity, moved.acceleration)
    rotor = run.theta[links:].reshape(3, -1)[2]
    needed[:, 6:] += rotor * moved.acceleration[:, 6:] + moved.friction
    J = contact_jacobians(robot, moved.position, run.recording.contacts.frames)
    return needed - moved.effort - np.einsum("kcmn,kcm->kn", J, moved.wrenches)


@pytest.mark.parametrize("motion", ["stand", "trot", "walk", "hang"])
def test_the_equation_of_motion_holds_with_the_simulators_forces(motion: str) -> None:
    assert np.abs(residual(exact(motion), go1())).max() < EQUATION


def test_motors_that_move_joints_together_obey_it_too() -> None:
    rows = {
        "FL_thigh_joint": {"left": 0.5, "right": 0.5, "offset": 0.1},
        "FL_calf_joint": {"left": 0.5, "right": -0.5},
        "RR_calf_joint": {"screw": 2.0, "offset": -0.2},
    }
    robot = sdpid.load_robot("go1", root="free_flyer", transmission={"joints": rows})
    run = sdpid.simulate_legged(robot, "trot", duration=0.1, seed=1, sensors=Sensors.exact())
    assert run.recording.joint_names == robot.joint_names[6:]
    assert np.abs(residual(run, robot)).max() < EQUATION


@pytest.mark.parametrize("motion", ["trot", "hang"])
def test_the_sensors_measure_the_motion(motion: str) -> None:
    log, moved = exact(motion).recording, exact(motion).motion
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
    assert np.median(np.abs(felt - np.asarray(imu.accelerometer)[1:-1])) < 0.02
    assert np.median(np.abs(turned - np.asarray(imu.gyroscope)[1:-1])) < 1e-3


def test_feet_bear_weight_where_they_touch() -> None:
    assert np.all(exact("stand").motion.down)
    trot = exact("trot").motion
    assert 0.4 < trot.down.mean() < 0.9
    assert np.abs(trot.wrenches[~trot.down]).max() == 0.0
    feet = find_legs(go1()).feet(trot.position[:, 7:])
    base = Rotation.from_quat(trot.position[:, 3:7])
    height = np.stack([base.apply(each)[:, 2] for each in feet.transpose(1, 0, 2)], axis=1)
    assert np.array_equal(height + trot.position[:, 2:3] - 0.02 < 0.0, trot.down)


def test_channels_come_late_and_gains_are_off() -> None:
    sensors = replace(Sensors.exact(), delays={"effort": 0.002}, effort_gain=1.05)
    run = sdpid.simulate_legged(go1(), "hang", duration=0.2, seed=1, sensors=sensors)
    np.testing.assert_allclose(run.recording.effort[2:], 1.05 * run.motion.effort[:-2, 6:])
    np.testing.assert_allclose(run.recording.position, run.motion.position[:, 7:])
    assert run.recording.time[0] == pytest.approx(0.0, abs=1e-9)


def test_a_humanoid_walks_on_soles() -> None:
    """A foot is lifted, wrenches of soles obey the equation of motion, and all joints move."""
    talos = sdpid.load_robot("talos_reduced", root="free_flyer")
    run = sdpid.simulate_legged(talos, "walk", duration=1.0, seed=1, sensors=Sensors.exact())
    log, down = run.recording, run.motion.down
    # Of torques of 100 N·m and forces of 900 N.
    assert np.abs(residual(run, talos)).max() < 100.0 * EQUATION
    assert log.contacts.kind == ("plane", "plane")
    assert log.contacts.wrenches is not None
    assert 0 < np.count_nonzero(~down) < len(down)
    assert np.ptp(log.position, axis=0).min() > 1e-3
    refuses(DataError, r"'trot'.*2 soles", sdpid.simulate_legged, talos, "trot")


@pytest.mark.parametrize(
    "law", [DryFriction(), DryFriction(width=0.06, peak=0.4, peak_speed=0.2)], ids=repr
)
def test_dry_friction_follows_a_law_that_friction_terms_know(law: DryFriction) -> None:
    run = sdpid.simulate_legged(go1(), "hang", duration=0.2, seed=1, friction=law)
    assert run.friction is law
    coulomb, viscous = run.theta[130:].reshape(3, 12)[:2]
    speed = run.motion.velocity[:, 6:]
    shape = sum(
        size * term.shape(speed, speed)
        for size, term in zip((1.0, law.peak), law.terms, strict=False)
    )
    np.testing.assert_allclose(run.motion.friction, coulomb * shape + viscous * speed, atol=1e-12)


def test_a_light_quadruped_trots_without_chatter() -> None:
    run = sdpid.simulate_legged("solo12", "trot", duration=2.0, seed=1)
    # Two steps a second of every foot, and few bounces.
    assert np.abs(np.diff(run.motion.down.astype(int), axis=0)).sum() < 2.0 * (2 * 2 * 4 * 2.0)
    solo = sdpid.load_robot("solo12", root="free_flyer")
    assert find_legs(solo).radius == pytest.approx(0.016, abs=1e-4)


def test_changed_links_are_bodies_and_seeds_repeat() -> None:
    theta, again = (changed_parameters(go1(), seed=3) for _ in range(2))
    bodies, described = theta[:130].reshape(-1, 10), go1().prior
    assert margin(bodies, "pseudo_inertia").min() > 0.0
    assert 0.05 < np.abs(np.log(bodies[:, 0] / described[:, 0])).mean() < 0.3
    assert np.array_equal(theta, again)
    same = changed_parameters(go1(), change=0.0)[:130].reshape(-1, 10)
    np.testing.assert_allclose(same, described, atol=1e-12)


def test_what_cannot_be_simulated_is_refused() -> None:
    heavy = np.array(changed_parameters(go1()))
    heavy[:10] *= 30.0
    falls = {"theta": heavy, "duration": 3.0}
    for error, words, robot, motion, options in (
        (ModelError, r"fixed base.*free_flyer", sdpid.load_robot("go1"), "stand", {}),
        (DataError, r"'dance'.*stand, trot", go1(), "dance", {}),
        (DataError, "expected 166", go1(), "stand", {"theta": np.ones(130)}),
        (DataError, "rate_hz: 10, limits", go1(), "stand", {"rate_hz": 10.0}),
        (DataError, "the least is two samples", go1(), "stand", {"duration": 1e-4}),
        (DataError, "the limit is 1 s", go1(), "stand", {"sensors": Sensors(delays={"imu": 2.0})}),
        (ModelError, "mimic", "talos_full_v2", "stand", {}),
        (ModelError, r"romeo.*no body has the parameters", "romeo_small", "stand", {}),
        (DataError, "falls", go1(), "trot", falls),
    ):
        refuses(error, words, sdpid.simulate_legged, robot, motion, **options)
    for words, kind, options in (
        ("no channel 'torque'", Sensors, {"delays": {"torque": 0.1}}),
        ("not negative", Sensors, {"delays": {"imu": -0.1}}),
        (r"too steep.*limit is 0.03", DryFriction, {"peak": 1.0}),
        ("width: 0", DryFriction, {"width": 0.0}),
        ("peak: -1", DryFriction, {"peak": -1.0}),
    ):
        refuses(DataError, words, kind, **options)
    refuses(ModelError, "no frame 'paw'", find_legs, go1(), feet=["paw"])
