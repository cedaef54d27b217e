"""A controlled arm moved by the compiled loop, by Pinocchio in a loop, and by MuJoCo's rollout.

Ten seconds of the Denso under its drives' position loop at 5 kHz, viscous and Coulomb friction.
Pinocchio's loop is the least one can write: a semi-implicit step, with the sign of the velocity as
friction. MuJoCo has the controller as its actuators, and friction as its constraint solver has.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from harness import Bench, Row

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.experiment.plant.legged.model import add_bodies, set_options
from sdpid.experiment.plant.simulate import Drives, load_drives, true_parameters
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.closed_loop import simulate_closed_loop
from sdpid.experiment.simulation.controllers import P
from sdpid.experiment.trajectory.paper import paper_excitation
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel

ROBOT, RATE_HZ = "denso_vp6242", 5000.0


def _mujoco_arm(
    mujoco: Any, robot: RobotModel, theta: Array, drives: Drives, timestep: float
) -> Any:
    """Return MuJoCo's model of an arm with its drives, which interpolate set-points."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = spec.compiler.balanceinertia = False
    set_options(mujoco, spec, robot, timestep)
    add_bodies(mujoco, spec, robot, theta[: 10 * robot.n_links].reshape(-1, 10))
    gains = zip(robot.joint_names, drives.velocity_gain, drives.proportional_gain, strict=True)
    for name, damping, proportional in gains:
        actuator = spec.add_actuator(name=name, target=name)
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        actuator.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
        actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.gainprm[0] = damping * proportional
        actuator.biasprm[1], actuator.biasprm[2] = -damping * proportional, -damping
    model = spec.compile()
    model.dof_frictionloss[:], model.dof_damping[:] = theta[10 * robot.n_links :].reshape(2, -1)
    model.dof_solref[:], model.dof_solimp[:, :2] = (2.0 * timestep, 1.0), 0.9999
    return model


def measure(bench: Bench) -> Iterator[Row]:
    """Measure three ways of ours against either reference."""
    import pinocchio as pin

    mujoco = require("mujoco", extra="sim")
    rollout = require("mujoco.rollout", extra="sim")
    robot, theta, drives = load_robot(ROBOT), true_parameters(ROBOT), load_drives(ROBOT)
    friction = FrictionModel.from_terms(("coulomb", "viscous"), robot.joint_names)
    model = RobotDynamics(robot=robot, terms=friction, theta=theta)
    arm = SimulatedArm.of(model)
    seconds = bench.size(10.0, 6.0)
    motion = paper_excitation(ROBOT, 0, periods=1, period=seconds)
    first = motion.lead_samples
    told = motion.sample(first, first + round(seconds * motion.rate_hz))
    law = P(drives.proportional_gain, drives.velocity_gain)
    steps, dt = round(seconds * RATE_HZ), 1.0 / RATE_HZ
    fine = np.repeat(told[0], round(RATE_HZ / motion.rate_hz), axis=0)

    def ours(hold: float | None = RATE_HZ, step: float = dt) -> None:
        moved = simulate_closed_loop(
            arm, told, law, rate_hz=motion.rate_hz, control_hz=hold, step=step
        )
        assert moved.diverged is None

    links = model.to_pinocchio()
    data, coulomb, viscous = links.createData(), theta[60:66], theta[66:]

    def loop() -> None:
        q, v = told[0][0].copy(), told[1][0].copy()
        stiffness = law.velocity_gain * law.proportional_gain
        for desired in fine:
            effort = stiffness * (desired - q) - law.velocity_gain * v
            a = pin.aba(links, data, q, v, effort - coulomb * np.sign(v) - viscous * v)
            v = v + dt * a
            q = q + dt * v

    plant = _mujoco_arm(mujoco, robot, theta, drives, dt)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(plant, kind))
    held: Any = mujoco.MjData(plant)
    held.qpos[:], held.act[:] = told[0][0], told[0][0]
    mujoco.mj_getState(plant, held, state, kind)
    rates = np.diff(fine, axis=0, append=fine[-1:]) * RATE_HZ

    def engine() -> None:
        rollout.rollout(plant, held, state[None], rates[None])

    found = bench.seconds(
        held=ours,
        free=lambda: ours(None),
        coarse=lambda: ours(None, 1e-3),
        loop=loop,
        engine=engine,
    )
    for what, action in (
        (f"{steps} steps, control held at 5 kHz", "held"),
        (f"{steps} steps, continuous control", "free"),
        (f"{round(seconds * 1e3)} steps, continuous control", "coarse"),
    ):
        python = "a Python loop over pinocchio.aba, 5 kHz"
        yield Row.of(what, found[action], python, found["loop"])
        yield Row.of(what, found[action], "mujoco.rollout, 5 kHz", found["engine"])
