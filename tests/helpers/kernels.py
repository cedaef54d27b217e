"""Numba's cache, made before worker processes would each make it."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor

import numpy as np

import sdpid
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model import regressor_kernel
from sdpid.robot.model.dynamics import RobotDynamics
from tests.helpers.robots import pendulum


def compile_kernels() -> None:
    """Compile the loops of the regressor and of the simulation, where Numba is installed."""
    with ProcessPoolExecutor(2) as pool:
        for made in [pool.submit(_simulation), pool.submit(_regressor)]:
            made.result()


def _regressor() -> None:
    still = np.zeros((1, 1))
    regressor_kernel.regressor(pendulum().tree, still, still, still, worth=True)


def _simulation() -> None:
    robot = pendulum()
    terms = FrictionModel.from_terms((), robot.joint_names)
    body = [1.0, 0.1, 0.0, 0.0, 0.05, 0.0, 0.05, 0.0, 0.0, 0.05]
    model = RobotDynamics(robot=robot, terms=terms, theta=np.array(body))
    arm, still = SimulatedArm.of(model), np.zeros((1, 1))
    arm.dynamics(still, still, still)
    arm.run(np.zeros((2, 1, 1, 1)), np.zeros((1, 2, 1)), 0.01)
    law = sdpid.controllers.PD(np.ones(1), np.ones(1))
    sdpid.simulate_closed_loop(model, np.zeros((5, 1)), law, rate_hz=100.0)
