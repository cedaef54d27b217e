"""Simulation of joints that several motors move, and of efforts by position."""

from typing import Any

import mujoco
import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.friction import (
    AtJoints,
    Coulomb,
    Hysteresis,
    PositionTerm,
    RotorInertia,
    Spring,
    Viscous,
)
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics
from tests.helpers.data import random_links
from tests.helpers.refusals import refuses
from tests.helpers.robots import described_arm

MATRIX = [[1.0, 0.0, 0.0], [0.0, 0.5, 0.5], [0.0, 0.5, -0.5], [0.3, -0.7, 0.0]]
NAMES = ("joint_1", "joint_2", "joint_3", "joint_4")
CAM = PositionTerm(((-1.0, -0.2, 0.3, 1.0), (1.0, -2.0, 0.5, 1.0)), "cam", joint="joint_2")


def moved(*terms: Any, values: float = 2.0, matrix: Any = MATRIX) -> RobotDynamics:
    text = described_arm(random_links(np.random.default_rng(3), 4)).urdf
    robot = sdpid.load_robot(text, transmission=sdpid.Transmission(matrix, [0.0, 0.1, -0.2, 0.3]))
    model = FrictionModel.from_terms(terms, robot.joint_names)
    numbers = np.full(len(model.parameters), values)
    return RobotDynamics(
        robot=robot, terms=model, theta=np.concatenate([robot.prior.ravel(), numbers])
    )


SMOOTH = (
    *("viscous", Coulomb(width=0.3), Spring("joint_3"), Spring("joint_4", rest=0.2), CAM),
    Spring("motor_1", rest=0.1, polynomial=(1.0, 2.0)),
    AtJoints(Viscous(), NAMES),
    AtJoints(Coulomb(width=0.2), ("joint_2", "joint_4")),
    AtJoints(RotorInertia(), ("joint_3",)),
)


def states(n: int, count: int = 20) -> tuple[Array, Array, Array]:
    q, v, effort = np.random.default_rng(0).uniform(-1.0, 1.0, (3, count, n))
    return q, v, 5.0 * effort


def test_the_compiled_loops_have_the_dynamics_of_the_model():
    model, (q, v, effort) = moved(*SMOOTH), states(3)
    M, _, a = SimulatedArm.of(model).dynamics(q, v, effort)
    np.testing.assert_allclose(M, model.mass_matrix(q), atol=1e-10)
    np.testing.assert_allclose(a, model.forward_dynamics(q, v, effort), atol=1e-8)
    rest = np.zeros_like(v)
    springs = model.inverse_dynamics(q, rest, rest) - model.friction(rest)
    still = SimulatedArm.of(model).dynamics(q, rest, effort)[1]
    np.testing.assert_allclose(still, springs, atol=1e-10)
    np.testing.assert_allclose(model.inverse_dynamics(q, v, a), effort, atol=1e-8)


def test_dry_friction_behind_a_transmission_holds_what_it_can():
    model = moved(AtJoints(Coulomb(), ("joint_2", "joint_3")), values=50.0)
    arm, still = SimulatedArm.of(model), np.zeros((1, 3))
    effort = model.gravity(still) + np.array([[0.0, 10.0, -5.0]])
    # Efforts of 10 and -5 on the motors ask for 5 and 15 of the joints.
    a = arm.dynamics(still, still, effort)[2]
    np.testing.assert_allclose(a[0, 1:], 0.0, atol=1e-6)
    pushed = arm.dynamics(still, still, effort + np.array([[0.0, 300.0, 0.0]]))[2]
    assert pushed[0, 1] > 1.0


def test_elements_that_slip_follow_the_way():
    """A slow motion against hysteresis needs the effort of the term along that way."""
    term = Hysteresis("joint_2", (0.02, 0.1))
    terms = ("viscous", term)
    model, dt = moved(*terms, values=30.0), 1e-3
    time = dt * np.arange(4001)
    wave = 0.3 * np.sin(2.0 * time)
    q = np.zeros((len(time), 3))
    q[:, 1] = wave
    v, a = np.gradient(q, dt, axis=0), np.gradient(np.gradient(q, dt, axis=0), dt, axis=0)
    effort = model.inverse_dynamics(q, v, a)
    middle = 0.5 * (effort[1:] + effort[:-1])
    start = np.stack([q[:1], v[:1]])[:, None]
    found = SimulatedArm.of(model).run(start, middle[None], dt)[0, 0]
    np.testing.assert_allclose(found[:, 1], q[:, 1], atol=3e-3)
    without = moved(*terms[:1], values=30.0)
    free = SimulatedArm.of(without).run(start, middle[None], dt)[0, 0]
    assert np.abs(free[:, 1] - q[:, 1]).max() > 0.03


def test_a_differential_moves_as_in_mujoco(tmp_path: Any):
    square = MATRIX[:3]
    text = described_arm(random_links(np.random.default_rng(3), 3)).urdf
    robot = sdpid.load_robot(text, transmission=sdpid.Transmission(square))
    terms = FrictionModel.from_terms(("viscous", Spring("joint_2", rest=0.2)), robot.joint_names)
    theta = np.concatenate([robot.prior.ravel(), np.full(4, 3.0)])
    model = RobotDynamics(robot=robot, terms=terms, theta=theta)
    rng, dt, steps = np.random.default_rng(1), 1e-3, 500
    effort = np.repeat(5.0 * rng.normal(size=(5, 3)), steps // 5, axis=0)
    found = SimulatedArm.of(model).run(np.zeros((2, 1, 1, 3)), effort[None], dt)[0, 0]
    q, v, a = (rng.normal(size=(50, 3)) for _ in range(3))
    samples = sdpid.Samples(
        position=q, velocity=v, acceleration=a, effort=model.inverse_dynamics(q, v, a)
    )
    problem = sdpid.build_problem(robot, samples, friction=terms.terms, weighting="residual")
    sdpid.write_mjcf(sdpid.solve_sdp(problem), target=tmp_path / "arm.xml")
    compiled = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    compiled.opt.timestep, compiled.opt.integrator = dt, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(compiled)
    for k in range(steps):
        data.ctrl[:] = effort[k]
        mujoco.mj_step(compiled, data)
    np.testing.assert_allclose(robot.expansion @ found[-1], data.qpos, atol=2e-4)


def test_controlled_motions_of_a_differential_are_followed():
    model = moved("viscous", Coulomb(width=0.1), Spring("joint_2", rest=0.0), matrix=MATRIX)
    law = sdpid.controllers.ComputedTorque(model, np.full(3, 400.0), np.full(3, 40.0))
    time = np.arange(0.0, 2.0, 0.01)
    desired = 0.3 * np.sin(np.outer(time, [1.0, 2.0, 3.0]))
    run = sdpid.simulate_closed_loop(model, desired, law, rate_hz=100.0)
    assert np.abs(run.position - desired).max() < 5e-3


def test_code_of_ones_own_is_not_simulated():
    model = moved(PositionTerm(np.sin, "cam", joint="joint_2"))
    refuses(ModelError, "function of your own, which is not simulated", SimulatedArm.of, model)


@pytest.mark.parametrize("count", [1, 3])
def test_stiffness_of_springs_is_told(count: int):
    model, (q, _, _) = moved(Spring("joint_3", rest=0.0)), states(3, count)
    E = model.robot.expansion[2]
    np.testing.assert_allclose(model.stiffness(q), np.tile(2.0 * np.outer(E, E), (count, 1, 1)))


@pytest.mark.parametrize("gear", [20.0, 100.0])
def test_motors_in_front_of_gears_are_as_fast_and_turn_as_far_as_gears_let_them(gear: float):
    """What is degrees or a jump of a joint is no more than the motion of its motor."""
    text = described_arm(random_links(np.random.default_rng(3), 4)).urdf
    robot = sdpid.load_robot(text, transmission=sdpid.Transmission(np.eye(4) / gear))
    time, rates = np.arange(0.0, 10.0, 0.005), np.array([3.0, 4.0, 5.0, 6.0])
    angle = time[:, None] * rates
    position = gear * np.sin(angle)
    states = position, gear * rates * np.cos(angle), -(rates**2) * position
    effort = robot.inverse_dynamics(robot.prior, *states)
    log = sdpid.Recording(time=time, position=position, effort=effort)
    wrong = {"position_jumps", "position_in_degrees"}
    assert wrong & {each.kind for each in sdpid.inspect_recording(log).findings}
    assert not wrong & {each.kind for each in sdpid.inspect_recording(log, robot).findings}
    sdpid.identify(robot, log, friction=("viscous",), effects="none", intervals=False)
    position[700] += 2.0 * gear
    log = sdpid.Recording(time=time, position=position, effort=effort)
    assert not sdpid.inspect_recording(log, robot).ok
