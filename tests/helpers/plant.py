"""True states and torques of a simulated plant, which a recording does not show."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

import sdpid
from sdpid._common.arrays import Array
from sdpid.experiment.plant.closed_loop import MujocoPlant
from sdpid.experiment.plant.drives import Drives
from sdpid.experiment.plant.mujoco_model import MujocoModel
from sdpid.experiment.plant.simulate import plant_parts


@dataclass(frozen=True, kw_only=True, eq=False)
class PlantLog:
    """True states and torques of a plant, as sensors without error would show them.

    Attributes
    ----------
    time : ndarray, shape (N,)
        Time from the start of the trajectory in s.
    desired, position, velocity, acceleration : ndarray, shape (N, n)
        Set-points and states in rad, rad/s and rad/s².
    motor_torque : ndarray, shape (N, n)
        Torque that the currents show, in N·m at the joint.
    unmodeled_torque : ndarray, shape (N, n)
        The part of it that supplies the unmodeled effects; zero without them.
    coulomb_torque, viscous_torque : ndarray, shape (N, n)
        Friction acting on the joints: it opposes the motion.
    """

    time: Array
    desired: Array
    position: Array
    velocity: Array
    acceleration: Array
    motor_torque: Array
    unmodeled_torque: Array
    coulomb_torque: Array
    viscous_torque: Array


def run_plant(
    robot: sdpid.RobotModel,
    trajectory: sdpid.Trajectory,
    *,
    theta: ArrayLike | None = None,
    drives: Drives | None = None,
    unmodeled: bool = False,
    start: int = 0,
    stop: int | None = None,
) -> PlantLog:
    """Return true states, torques and friction of a range of samples of a trajectory.

    The trajectory runs from its own start, without a settling period. Arguments are those of
    `sdpid.simulate`.
    """
    theta, drives = plant_parts(robot, trajectory, theta, drives)
    plant = MujocoPlant(robot, trajectory, theta, drives, unmodeled)
    stop = trajectory.n_samples if stop is None else stop
    desired = trajectory.sample(start, stop)[0]
    plant.run(0, start, lambda _: None)
    q, v, torque = plant.run(start, stop, lambda _: None)
    acceleration, coulomb, viscous = _forces(plant.mujoco_model, q, v, desired)
    extra = plant.extra_torque(q, v)
    return PlantLog(
        time=np.arange(start, stop) / trajectory.rate_hz,
        desired=desired,
        position=q,
        velocity=v,
        acceleration=acceleration,
        motor_torque=torque + extra,
        unmodeled_torque=extra,
        coulomb_torque=coulomb,
        viscous_torque=viscous,
    )


def _forces(plant: MujocoModel, q: Array, v: Array, desired: Array) -> tuple[Array, Array, Array]:
    """Return accelerations, Coulomb and viscous friction at given states, each (K, n)."""
    data = mujoco.MjData(plant.model)
    out = np.empty((3, *q.shape))
    for k in range(len(q)):
        data.qpos[plant.qpos] = q[k]
        data.qvel[plant.dof] = v[k]
        data.act[:] = desired[k]
        mujoco.mj_forward(plant.model, data)
        out[0, k] = data.qacc[plant.dof]
        out[1, k] = data.qfrc_constraint[plant.dof]
        out[2, k] = data.qfrc_passive[plant.dof]
    return out[0], out[1], out[2]
