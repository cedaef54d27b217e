"""Robots that move along a trajectory: in closed loop on MuJoCo, or exactly."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.experiment.plant.drives import Drives
from sdpid.experiment.plant.mujoco_model import MujocoModel, build_mujoco
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.model.model import RobotModel

# Integrator steps are never longer than this (s): with the case study's gains the fastest pole is
# near 1300/s.
_LONGEST_STEP = 1e-3
# Runge-Kutta's method of fourth order is stable on the negative real axis down to -2.785.
_STABLE = 2.7
# Samples a call of the rollout: long enough to drown its overhead, short enough for the progress
# bar and for memory.
CHUNK = 10_000
# No joint of a working plant moves this fast (rad/s): what does is an unstable loop.
_RUNAWAY = 1e4


class ExactMotion:
    """A robot that follows its trajectory exactly: no controller, no solver of motion."""

    def __init__(
        self,
        robot: RobotModel,
        trajectory: Trajectory,
        theta: Array,
        drives: Drives,
        unmodeled: bool,
    ) -> None:
        if unmodeled:
            raise DataError(
                f"simulate: '{robot.name}' follows its motion exactly, as asked, or for mimic "
                "joints or large damping; unmodeled effects are not simulated."
            )
        self.drives = drives
        self._robot, self._trajectory = robot, trajectory
        bodies, friction = theta[: 10 * robot.n_links], theta[10 * robot.n_links :]
        self._bodies = bodies.reshape(-1, 10)
        self._coulomb, self._viscous = friction.reshape(2, robot.n)
        self._state = np.zeros(2 * robot.n)

    def state(self) -> Array:
        """Return a state that never changes: the motion has settled from its start on."""
        return self._state

    def extra_torque(self, position: Array, velocity: Array) -> Array:
        """Return zeros: there are no unmodeled effects."""
        return np.zeros_like(position)

    def run(self, start: int, stop: int, advance: Callable[[float], None]) -> Array:
        """Return positions, velocities and torques at samples start … stop − 1."""
        q, v, a = self._trajectory.sample(start, stop)
        torque = self._robot.inverse_dynamics(self._bodies, q, v, a)
        advance(stop - start)
        return np.stack([q, v, torque + self._coulomb * np.sign(v) + self._viscous * v])


class MujocoPlant:
    """A robot in closed loop along a trajectory, with MuJoCo's state."""

    def __init__(
        self,
        robot: RobotModel,
        trajectory: Trajectory,
        parameters: Array,
        drives: Drives,
        unmodeled: bool,
    ) -> None:
        mujoco = require("mujoco", extra="sim")
        if unmodeled and drives.unmodeled is None:
            raise DataError("simulate: these drives have no unmodeled effects; set them.")
        self.drives = drives
        self._effects = drives.unmodeled if unmodeled else None
        self._trajectory = trajectory
        self._substeps = _substeps(trajectory)
        step = 1.0 / (trajectory.rate_hz * self._substeps)
        self._mujoco: Any = mujoco
        self.mujoco_model: MujocoModel = build_mujoco(robot, parameters, drives, timestep=step)
        self._data: Any = mujoco.MjData(self.mujoco_model.model)
        self._data.qpos[self.mujoco_model.qpos] = trajectory.center
        fastest, limit = fastest_pole(robot, trajectory, parameters, drives)
        if not fastest < limit:
            raise DataError(
                f"plant of '{robot.name}': the velocity loop's fastest pole is at {fastest:.4g}/s, "
                f"too fast for a step of {step:g} s (limit {limit:.4g}/s); lower velocity_gain or "
                "raise the sample rate."
            )

    def state(self) -> Array:
        """Return positions and velocities, shape (2n,)."""
        data, where = self._data, self.mujoco_model
        return np.concatenate([data.qpos[where.qpos], data.qvel[where.dof]])

    def extra_torque(self, position: Array, velocity: Array) -> Array:
        """Return the torque of the unmodeled effects, (K, n)."""
        if self._effects is None:
            return np.zeros_like(position)
        return self._effects.torque(position, velocity)

    def run(self, start: int, stop: int, advance: Callable[[float], None]) -> Array:
        """Simulate samples start … stop − 1 of the trajectory, from the present state on.

        Returns
        -------
        ndarray, shape (3, stop - start, n)
            Positions, velocities and torques at the samples.
        """
        from mujoco import rollout

        model, data, n = self.mujoco_model.model, self._data, self._trajectory.n
        kind = self._mujoco.mjtState.mjSTATE_FULLPHYSICS
        state = np.empty(self._mujoco.mj_stateSize(model, kind))
        out = np.empty((3, stop - start, n))
        for first in range(start, stop, CHUNK):
            last = min(first + CHUNK, stop)
            desired = self._set_points(first, last + 1)
            # The integrated command starts anew in each chunk, so rounding does not add up.
            data.act[:] = desired[0]
            data.time = 0.0
            self._mujoco.mj_getState(model, data, state, kind)
            rates = np.diff(desired, axis=0) * self._trajectory.rate_hz
            states, sensors = rollout.rollout(
                model, data, state[None], np.repeat(rates, self._substeps, axis=0)[None]
            )
            # Sensors show the state at the start of each step: the sample itself.
            values = sensors[0, :: self._substeps].reshape(last - first, 3, n)
            out[:, first - start : last - start] = values.transpose(1, 0, 2)
            self._mujoco.mj_setState(model, data, np.ascontiguousarray(states[0, -1]), kind)
            speed = np.abs(values[:, 1]).max() if last > first else 0.0
            if not speed < _RUNAWAY:
                raise DataError(
                    f"plant: joints reach {speed:.3g} rad/s near sample {first}: the loop is "
                    "unstable; lower velocity_gain or proportional_gain."
                )
            advance(last - first)
        return out

    def _set_points(self, start: int, stop: int) -> Array:
        """Return desired positions, held at the end of the trajectory."""
        end = min(stop, self._trajectory.n_samples)
        desired = self._trajectory.sample(start, end)[0]
        if end < stop:
            desired = np.concatenate([desired, desired[-1:]])
        return desired


def fastest_pole(
    robot: RobotModel, trajectory: Trajectory, theta: Array, drives: Drives
) -> tuple[float, float]:
    """Return the velocity loop's fastest pole along a trajectory, and what is stable, in 1/s."""
    speed = drives.velocity_gain + theta[10 * robot.n_links + robot.n :]
    period = trajectory.position_period
    fastest = 0.0
    for q in period[:: max(1, len(period) // 20)]:
        M = robot.mass_matrix(theta, q)
        # M⁻¹·D is similar to a symmetric matrix, so its eigenvalues are real.
        root = np.sqrt(speed)
        poles = np.linalg.eigvalsh(root[:, None] * np.linalg.inv(M) * root)
        fastest = max(fastest, float(poles[-1]))
    return fastest, _STABLE * trajectory.rate_hz * _substeps(trajectory)


def _substeps(trajectory: Trajectory) -> int:
    """Return how many steps of the integrator there are in one sample."""
    return int(np.ceil(1.0 / (trajectory.rate_hz * _LONGEST_STEP) - 1e-9))
