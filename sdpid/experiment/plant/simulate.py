"""Simulate a closed-loop experiment in MuJoCo: controller, drives, friction and sensors."""

from __future__ import annotations

import csv
import os

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid._common.files import read_regular
from sdpid._common.progress import progress as progress_bar
from sdpid._common.seeds import generator
from sdpid.errors import DataError, ModelError
from sdpid.experiment.plant.closed_loop import CHUNK, ExactMotion, MujocoPlant, fastest_pole
from sdpid.experiment.plant.default_motion import default_motion
from sdpid.experiment.plant.default_plant import default_drives, default_parameters, follows
from sdpid.experiment.plant.drives import Drives, load_drives, plant_folder
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.description.catalog import bundled_robots
from sdpid.robot.model.model import RobotModel

# A loop whose state after a period is the one before it to this (rad, rad/s) has settled: a
# thousandth of an encoder count, and far above the rounding of a period's steps.
SETTLED = 1e-9


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
    content = read_regular(path)
    try:
        rows = csv.DictReader(content.decode("utf-8").splitlines())
        values = [float(row["value"]) for row in rows]
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
    exact: bool = False,
    progress: bool | None = None,
) -> Recording:
    """Run a trajectory on a simulated robot and record positions and efforts.

    A proportional position controller commands the drives' velocity loop:
    ``torque = velocity_gain·(proportional_gain·(q_d − q) − v)``. Joints have Coulomb and viscous
    friction. Recorded are encoder positions, the desired ones (`Recording.reference`), and noisy
    motor currents, as efforts in N·m.

    The record has `trajectory.n_samples` samples: whole periods from ``Recording.start`` on, after
    one settling period that is not recorded. A motion that ends elsewhere than it starts is run
    once, and its record has no periods.

    With `exact` the robot follows the trajectory exactly, and its efforts are those of its
    equation of motion. So does a robot with mimic joints, and one whose description has so much
    damping that default drives would not move it as desired. `Recording.notes` say so.

    Parameters
    ----------
    robot : RobotModel
        The robot, on a fixed base.
    trajectory : Trajectory, optional
        The desired motion; its joints are the robot's. By default `default_motion`, which is
        five periods of 20 s.
    theta : array_like, shape (10·links + 2n,), optional
        True parameters: the links' standard parameters, then Coulomb and viscous friction of
        all joints. By default those of the bundled robot of this name, or `default_parameters`.
    seed : int or numpy.random.Generator, optional
        The only source of randomness: the current noise.
    drives : Drives, optional
        Motors, gains and sensors; by default those of the bundled robot of this name, or
        `default_drives`.
    unmodeled : bool, optional
        Add `drives.unmodeled`.
    noise : bool, optional
        Without it the same motion and torques are recorded without quantization and noise.
    exact : bool, optional
        Follow the trajectory exactly, without a controller; MuJoCo is not needed.
    progress : bool, optional
        Show a progress bar; by default on a terminal.

    Returns
    -------
    Recording
        The log; its efforts are the measured currents times torque constant and gear ratio.

    Raises
    ------
    DataError
        When joints do not match, theta has the wrong length, or the loop is unstable.
    ModelError
        When theta belongs to no real robot.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).

    Examples
    --------
    >>> run = sdpid.simulate(robot, motion, exact=True, seed=1)
    >>> run
    Recording(38000 samples, 6 joints, 1000 Hz, 2 periods of 10 s, with reference)
    >>> run.notes
    ('simulated without a controller: the robot follows its motion exactly',)
    """
    rng = generator(seed)
    if trajectory is None:
        trajectory = default_motion(robot, rng)
    made_up = drives is None and robot.name not in bundled_robots()
    theta, drives = plant_parts(robot, trajectory, theta, drives)
    exact = exact or robot.expansion.shape != (robot.n, robot.n)
    if made_up and not exact:
        fastest, limit = fastest_pole(robot, trajectory, theta, drives)
        exact = fastest >= limit or not follows(robot, theta, drives, trajectory)
    kind = ExactMotion if exact else MujocoPlant
    plant: MujocoPlant | ExactMotion = kind(robot, trajectory, theta, drives, unmodeled)
    notes = ("simulated without a controller: the robot follows its motion exactly",)
    lead, per_period = trajectory.lead_samples, trajectory.samples_per_period
    settling = per_period if trajectory.closed else 0
    total = trajectory.n_samples + settling
    position = np.empty((trajectory.n_samples, robot.n))
    effort, reference = np.empty_like(position), np.empty_like(position)
    row = 0
    scale, resolution = plant.drives.effort_scale, plant.drives.resolution

    def record(states: Array, first: int) -> None:
        nonlocal row
        count = states.shape[1]
        reference[row : row + count] = trajectory.sample(first, first + count)[0]
        for start in range(0, states.shape[1], CHUNK):
            q, v, torque = states[:, start : start + CHUNK]
            current = (torque + plant.extra_torque(q, v)) / scale
            if noise:
                q = np.rint(q / resolution) * resolution
                current += plant.drives.current_noise * rng.standard_normal(current.shape)
            position[row : row + len(q)] = q
            effort[row : row + len(q)] = current * scale
            row += len(q)

    with progress_bar(total, "simulating", enabled=progress) as advance:
        # Rest, connection and the settling period; the record begins within them.
        record(plant.run(0, lead + settling, advance)[:, settling:], settling)
        settled = False
        for _ in range(trajectory.periods):
            if settled:
                advance(per_period)
            else:
                before = plant.state()
                states = plant.run(lead, lead + per_period, advance)
                settled = bool(np.abs(plant.state() - before).max() <= SETTLED)
            record(states, lead)
        end = trajectory.n_samples
        record(plant.run(end - lead, end, advance), end - lead)
    rate = trajectory.rate_hz
    return Recording(
        time=np.arange(trajectory.n_samples) / rate,
        position=position,
        effort=effort,
        reference=reference,
        joint_names=robot.joint_names,
        period=trajectory.period if trajectory.closed else None,
        start=lead / rate if trajectory.closed else None,
        periods=trajectory.periods if trajectory.closed else None,
        notes=notes if exact else (),
    )


def plant_parts(
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
        theta = true_parameters(robot.name) if bundled else default_parameters(robot)
    parameters = _checked_theta(robot, theta)
    if drives is None:
        drives = (
            load_drives(robot.name) if bundled else default_drives(robot, parameters, trajectory)
        )
    if drives.n != robot.n:
        raise DataError(f"simulate: {drives.n} drives, robot '{robot.name}' has {robot.n} joints.")
    return parameters, drives


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
