"""Sensitivities of a controlled motion against differences of simulations."""

from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.experiment.simulation.sensitivities import Loop, sensitivities
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.dynamics import RobotDynamics
from tests.helpers.arm_files import ARM_URDF

RATE = 2000.0
TIME = np.arange(0.0, 2.0, 1.0 / RATE)
TOLD = np.stack([0.8 * np.sin(2.1 * TIME) ** 2, 0.6 * (1.0 - np.cos(3.3 * TIME))], axis=1)
PD = sdpid.controllers.PD(np.array([60.0, 30.0]), np.array([6.0, 3.0]))
PID = sdpid.controllers.PID(np.array([60.0, 30.0]), np.array([90.0, 40.0]), np.array([6.0, 3.0]))
SMOOTH = ("viscous", "rotor_inertia", "offset")


def simulated(model: RobotDynamics, law: Any) -> Any:
    return sdpid.simulate_closed_loop(model, TOLD, law, rate_hz=RATE)


@pytest.mark.parametrize(
    ("terms", "law", "limit"),
    [
        pytest.param(SMOOTH, PD, 2e-4, id="smooth"),
        pytest.param(SMOOTH, PID, 2e-3, id="integral"),
        # Reversals fall between instants: right to a share of a step of the loop.
        pytest.param(("coulomb", "viscous"), PD, 2e-2, id="sticking"),
        pytest.param((sdpid.friction.Coulomb(width=0.2),), PD, 2e-4, id="smooth sign"),
    ],
)
def test_they_are_the_differences_of_simulated_motions(terms: Any, law: Any, limit: float) -> None:
    robot = sdpid.load_robot(ARM_URDF)
    friction = FrictionModel.from_terms(terms, robot.joint_names)
    theta = np.append(robot.prior.ravel(), np.full(len(friction.parameters), 0.4))
    base = structural_base(robot, friction)
    model = RobotDynamics(robot=robot, terms=friction, theta=theta)
    moved = simulated(model, law)
    stiffness, damping = law.slopes(TOLD[:1], TOLD[:1], TOLD[:1], TOLD[:1], None, 0.0 * TOLD[:1])
    ki = law.gains.integral
    loop = Loop(
        time=moved.time,
        position=moved.position,
        velocity=moved.velocity,
        effort=moved.effort,
        stiffness=stiffness[0],
        damping=damping[0],
        integral=ki if ki.any() else None,
    )
    found = sensitivities(model, base, loop)
    for k, place in enumerate(base.kept):
        step = np.zeros_like(theta)
        step[place] = 1e-4
        ahead, behind = (
            simulated(RobotDynamics(robot=robot, terms=friction, theta=theta + s * step), law)
            for s in (1.0, -1.0)
        )
        difference = (ahead.position - behind.position) / 2e-4
        off = np.linalg.norm(found[:, :, k] - difference) / np.linalg.norm(difference)
        assert off < limit, base.names[k]
