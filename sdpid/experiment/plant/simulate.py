"""Simulate a closed-loop experiment in MuJoCo: controller, drives, friction and sensors."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid._common.extras import require
from sdpid._common.progress import progress as progress_bar
from sdpid.errors import DataError, ModelError
from sdpid.experiment.plant.default_motion import default_motion
from sdpid.experiment.plant.default_plant import default_drives, default_parameters
from sdpid.experiment.plant.drives import Drives, load_drives, plant_folder
from sdpid.experiment.plant.mujoco_model import MujocoModel, build_mujoco
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.description.catalog import bundled_robots
from sdpid.robot.model.model import RobotModel

# Integrator steps are never longer than this (s): with the case study's gains the fastest pole is
# near 1300/s.
_LONGEST_STEP = 1e-3
# Runge-Kutta's method of fourth order is stable on the negative real axis down to -2.785.
_STABLE = 2.7
# Samples a call of the rollout: long enough to drown its overhead, short enough for the progress
# bar and for memory.
_CHUNK = 10_000
# A loop whose state after a period is the one before it to this (rad, rad/s) has settled: a
# thousandth of an encoder count, and far above the rounding of a period's steps.
SETTLED = 1e-9
# No joint of a working plant moves this fast (rad/s): what does is an unstable loop.
_RUNAWAY = 1e4


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


def true_parameters(folder: str | os.PathLike[str]) -> Array:
    """Read theta of a plant from ``true_parameters.csv`` of a bundled robot or a folder.

    Returns
    -------
    ndarray, shape (10·links + 2n,)

    Raises
    ------
    DataError
        When the file is missing or its column ``value`` is not all numbers.
    """
    path = plant_folder(folder) / "true_parameters.csv"
    try:
        with path.open(encoding="utf-8", newline="") as file:
            values = [float(row["value"]) for row in csv.DictReader(file)]
    except OSError as cause:
        raise DataError(f"cannot read {path}: {cause.strerror}.") from None
    except (KeyError, TypeError, ValueError) as cause:
        raise DataError(f"{path}: {cause!r}; it needs a column 'value' of numbers.") from None
    return np.array(values)


def simulate(
    robot: RobotModel,
    trajectory: Trajectory | None = None,
    *,
    theta: ArrayLike | None = None,
    seed: int | np.random.Generator = 0,
    drives: Drives | None = None,
    unmodeled: bool = False,
    noise: bool = True,
    progress: bool | None = None,
) -> Recording:
    """Run a trajectory on a simulated robot and record positions and currents.

    The loop is a proportional position controller into the drives' velocity loop:
    ``torque = velocity_gain·(proportional_gain·(q_d − q) − v)``. Joints have Coulomb and viscous
    friction. Recorded are encoder positions and noisy motor currents.

    One period that is not among the recorded ones lets the loop settle. The record starts
    rest + connection before the first of its periods, that is within the settling period, and it
    is continuous: with `trajectory.n_samples` samples, whole periods from ``Recording.start`` on,
    then the connection and the rest.

    The controller is not fed with measurement errors, so the settled motion is periodic. Once
    the state at the end of a period equals that at its start to `SETTLED`, the remaining periods
    repeat the last one instead of being computed again; their noise is drawn anew.

    A robot with mimic joints has no closed loop here: it follows the trajectory exactly, and its
    efforts are those of its equation of motion.

    Parameters
    ----------
    robot : RobotModel
        The robot, on a fixed base.
    trajectory : Trajectory, optional
        The desired motion; its joints are the robot's. By default `default_motion`.
    theta : array_like, shape (10·links + 2n,), optional
        True parameters: the links' standard parameters, then Coulomb and viscous friction of
        all joints. By default those of the bundled robot of this name, or `default_parameters`.
    seed : int or numpy.random.Generator
        The only source of randomness: the current noise.
    drives : Drives, optional
        Motors, gains and sensors; by default those of the bundled robot of this name, or
        `default_drives`.
    unmodeled : bool
        Add `drives.unmodeled`.
    noise : bool
        Without it the same motion and torques are recorded without quantization and noise.
    progress : bool, optional
        Show a progress bar; by default on a terminal.

    Returns
    -------
    Recording
        Efforts are currents in A, with their `effort_scale`; with `default_drives` efforts in
        N·m.

    Raises
    ------
    DataError
        When joints do not match, theta has the wrong length, or the loop is unstable.
    ModelError
        When theta belongs to no real robot.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).
    """
    rng = np.random.default_rng(seed)
    if trajectory is None:
        trajectory = default_motion(robot, rng)
    theta, drives = _parts(robot, trajectory, theta, drives)
    if robot.expansion.shape != (robot.n, robot.n):
        plant: _Plant | _Exact = _Exact(robot, trajectory, theta, drives, unmodeled)
    else:
        plant = _Plant(robot, trajectory, theta, drives, unmodeled)
    lead, per_period = trajectory.lead_samples, trajectory.samples_per_period
    total = (trajectory.periods + 1) * per_period + 2 * lead
    position = np.empty((trajectory.n_samples, robot.n))
    effort = np.empty_like(position)
    row = 0
    scale, resolution = plant.drives.effort_scale, plant.drives.resolution

    def record(states: Array) -> None:
        nonlocal row
        for start in range(0, states.shape[1], _CHUNK):
            q, v, torque = states[:, start : start + _CHUNK]
            current = (torque + plant.extra_torque(q, v)) / scale
            if noise:
                q = np.rint(q / resolution) * resolution
                current += plant.drives.current_noise * rng.standard_normal(current.shape)
            position[row : row + len(q)] = q
            effort[row : row + len(q)] = current
            row += len(q)

    with progress_bar(total, "simulating", enabled=progress) as advance:
        # Rest, connection and the settling period; the record begins within them.
        record(plant.run(0, lead + per_period, advance)[:, per_period:])
        settled = False
        for _ in range(trajectory.periods):
            if settled:
                advance(per_period)
            else:
                before = plant.state()
                states = plant.run(lead, lead + per_period, advance)
                settled = bool(np.abs(plant.state() - before).max() <= SETTLED)
            record(states)
        end = trajectory.n_samples
        record(plant.run(end - lead, end, advance))
    rate = trajectory.rate_hz
    return Recording(
        time=np.arange(trajectory.n_samples) / rate,
        position=position,
        effort=effort,
        joint_names=robot.joint_names,
        period=trajectory.period,
        start=lead / rate,
        periods=trajectory.periods,
        effort_scale=None if np.all(scale == 1.0) else scale,
    )


def run_plant(
    robot: RobotModel,
    trajectory: Trajectory,
    *,
    theta: ArrayLike | None = None,
    drives: Drives | None = None,
    unmodeled: bool = False,
    start: int = 0,
    stop: int | None = None,
) -> PlantLog:
    """Return true states, torques and friction of a range of samples of a trajectory.

    The trajectory runs from its own start, without a settling period. Arguments and errors are
    those of `simulate`.

    Parameters
    ----------
    robot, trajectory, theta, drives, unmodeled
        See `simulate`.
    start, stop : int
        Samples to return; `stop` is excluded and by default the end.

    Returns
    -------
    PlantLog
    """
    theta, drives = _parts(robot, trajectory, theta, drives)
    plant = _Plant(robot, trajectory, theta, drives, unmodeled)
    stop = trajectory.n_samples if stop is None else stop
    desired = trajectory.sample(start, stop)[0]
    plant.run(0, start, lambda _: None)
    q, v, torque = plant.run(start, stop, lambda _: None)
    acceleration, coulomb, viscous = plant.forces(q, v, desired)
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


def _parts(
    robot: RobotModel, trajectory: Trajectory, theta: ArrayLike | None, drives: Drives | None
) -> tuple[Array, Drives]:
    """Return parameters and drives: the given ones, the bundled robot's, or made-up ones."""
    if trajectory.joint_names != robot.joint_names:
        raise DataError(
            f"simulate: the trajectory moves {', '.join(trajectory.joint_names)}; robot "
            f"'{robot.name}' has {', '.join(robot.joint_names)}."
        )
    bundled = robot.name in bundled_robots()
    if theta is None:
        theta = true_parameters(robot.name) if bundled else default_parameters(robot, trajectory)
    parameters = _checked_theta(robot, theta)
    if drives is None:
        drives = (
            load_drives(robot.name) if bundled else default_drives(robot, parameters, trajectory)
        )
    if drives.n != robot.n:
        raise DataError(f"simulate: {drives.n} drives, robot '{robot.name}' has {robot.n} joints.")
    return parameters, drives


class _Exact:
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
                f"simulate: '{robot.name}' has mimic joints; unmodeled effects are not simulated."
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


class _Plant:
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
        self._substeps = int(np.ceil(1.0 / (trajectory.rate_hz * _LONGEST_STEP) - 1e-9))
        step = 1.0 / (trajectory.rate_hz * self._substeps)
        self._mujoco: Any = mujoco
        self._robot: MujocoModel = build_mujoco(robot, parameters, drives, timestep=step)
        self._data: Any = mujoco.MjData(self._robot.model)
        self._data.qpos[self._robot.qpos] = trajectory.center
        self._check_stability(robot, parameters, step)

    def _check_stability(self, robot: RobotModel, theta: Array, step: float) -> None:
        """Raise when the velocity loop is too fast for the step, where the trajectory goes."""
        speed = self.drives.velocity_gain + theta[10 * robot.n_links + robot.n :]
        period = self._trajectory.position_period
        for q in period[:: max(1, len(period) // 20)]:
            M = robot.mass_matrix(theta, q)
            # M⁻¹·D is similar to a symmetric matrix, so its eigenvalues are real.
            root = np.sqrt(speed)
            fastest = np.linalg.eigvalsh(root[:, None] * np.linalg.inv(M) * root)[-1]
            if not fastest * step < _STABLE:
                raise DataError(
                    f"plant of '{robot.name}': the velocity loop's fastest pole is at "
                    f"{fastest:.4g}/s, too fast for a step of {step:g} s (limit "
                    f"{_STABLE / step:.4g}/s); lower velocity_gain or raise the sample rate."
                )

    def state(self) -> Array:
        """Return positions and velocities, shape (2n,)."""
        data, where = self._data, self._robot
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

        model, data, n = self._robot.model, self._data, self._trajectory.n
        kind = self._mujoco.mjtState.mjSTATE_FULLPHYSICS
        state = np.empty(self._mujoco.mj_stateSize(model, kind))
        out = np.empty((3, stop - start, n))
        for first in range(start, stop, _CHUNK):
            last = min(first + _CHUNK, stop)
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

    def forces(self, q: Array, v: Array, desired: Array) -> tuple[Array, Array, Array]:
        """Return accelerations, Coulomb and viscous friction at given states, each (K, n)."""
        model, where = self._robot.model, self._robot
        data = self._mujoco.MjData(model)
        out = np.empty((3, *q.shape))
        for k in range(len(q)):
            data.qpos[where.qpos] = q[k]
            data.qvel[where.dof] = v[k]
            data.act[:] = desired[k]
            self._mujoco.mj_forward(model, data)
            out[0, k] = data.qacc[where.dof]
            out[1, k] = data.qfrc_constraint[where.dof]
            out[2, k] = data.qfrc_passive[where.dof]
        return out[0], out[1], out[2]


def _checked_theta(robot: RobotModel, theta: ArrayLike) -> Array:
    values = real_array(theta, "theta", ndim=1, error=ModelError)
    expected = 10 * robot.n_links + 2 * robot.n
    if values.shape != (expected,):
        raise DataError(
            f"theta: {values.size} numbers, a plant of '{robot.name}' needs {expected}: "
            f"10 for each of {robot.n_links} links, then Coulomb and viscous friction of "
            f"{robot.n} joints."
        )
    friction = values[10 * robot.n_links :]
    if friction.min() < 0.0:
        raise ModelError(f"theta: friction of {friction.min():.3g}; it cannot be negative.")
    return values
