"""An arm in closed loop in MuJoCo: another library's physics, to compare ours with."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from mujoco import rollout

import sdpid
from sdpid._common.arrays import Array
from sdpid.experiment.plant.legged.model import add_bodies, set_options
from sdpid.experiment.plant.simulate import Drives

# MuJoCo's dry friction is a soft constraint. With an impedance next to 1 and the shortest time
# constant that the step allows it saturates from speeds of less than 1e-3 rad/s on.
_IMPEDANCE, _STEPS = 0.9999, 2.0


def mujoco_arm(robot: sdpid.RobotModel, theta: Array, drives: Drives, timestep: float) -> Any:
    """Return a compiled model whose actuators interpolate their set-points linearly.

    Actuator and sensor j belong to joint j; sensors are positions, velocities and torques.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree, spec.compiler.balanceinertia = False, False
    set_options(mujoco, spec, robot, timestep)
    add_bodies(mujoco, spec, robot, theta[: 10 * robot.n_links].reshape(-1, 10))
    stiffness = drives.velocity_gain * drives.proportional_gain
    for j, name in enumerate(robot.joint_names):
        actuator = spec.add_actuator(name=name, target=name)
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        actuator.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
        actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        # torque = gain·(Kp·(q_d − q) − v), with q_d the integrated command.
        actuator.gainprm[0] = stiffness[j]
        actuator.biasprm[1], actuator.biasprm[2] = -stiffness[j], -drives.velocity_gain[j]
    for kind in ("JOINTPOS", "JOINTVEL", "JOINTACTFRC"):
        for name in robot.joint_names:
            spec.add_sensor(
                name=f"{kind}_{name}",
                type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"),
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=name,
            )
    model = spec.compile()
    dof = [model.joint(name).dofadr[0] for name in robot.joint_names]
    model.dof_frictionloss[dof], model.dof_damping[dof] = theta[10 * robot.n_links :].reshape(2, -1)
    model.dof_solref[:] = _STEPS * timestep, 1.0
    model.dof_solimp[:, :2] = _IMPEDANCE
    return model


def mujoco_motion(
    robot: sdpid.RobotModel, trajectory: sdpid.Trajectory, theta: Array, drives: Drives
) -> Array:
    """Return positions, velocities and torques (3, K, n) at a trajectory's samples."""
    desired = trajectory.sample()[0]
    steps = int(np.ceil(1.0 / (trajectory.rate_hz * 1e-3)))
    model = mujoco_arm(robot, theta, drives, 1.0 / (trajectory.rate_hz * steps))
    data: Any = mujoco.MjData(model)
    data.qpos[[model.joint(name).qposadr[0] for name in robot.joint_names]] = desired[0]
    data.act[:] = desired[0]
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    rates = np.diff(desired, axis=0, append=desired[-1:]) * trajectory.rate_hz
    _, sensors = rollout.rollout(model, data, state[None], np.repeat(rates, steps, axis=0)[None])
    return np.asarray(sensors[0, ::steps].reshape(len(desired), 3, -1).swapaxes(0, 1))
