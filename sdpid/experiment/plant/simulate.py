"""Simulate a closed-loop experiment with an arm: controller, drives, friction and sensors."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, generator, real_array
from sdpid._common.extras import require
from sdpid._common.files import read_regular
from sdpid._common.progress import progress as progress_bar
from sdpid.errors import DataError, ModelError
from sdpid.experiment.plant.default_motion import default_motion
from sdpid.experiment.plant.drives import (
    Drives,
    check_bodies,
    default_drives,
    default_parameters,
    fastest_pole,
    follows,
    load_drives,
    plant_folder,
)
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.closed_loop import simulate_closed_loop
from sdpid.experiment.simulation.controllers import P
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.description.catalog import bundled_robots
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel

# A loop whose state after a period is the one before it to this (rad, rad/s) has settled: a
# thousandth of an encoder count, and far above the rounding of a period's steps.
SETTLED = 1e-9
# Most samples that are simulated at once: enough to drown what a call costs, few enough for memory.
_AT_ONCE = 20_000

# Moves a robot along samples start … stop − 1 from a state (2, n), None for the trajectory's first,
# to positions, velocities and efforts (3, K, n), and the state after them.
Move: TypeAlias = Callable[[int, int, Array | None], tuple[Array, Array]]


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
        Follow the trajectory exactly, without a controller.
    progress : bool, optional
        Show a progress bar; by default on a terminal.

    Returns
    -------
    Recording
        The log; its efforts are the measured currents times torque constant and gear ratio.

    Raises
    ------
    MissingExtraError
        When the arm is simulated under its controller, without the extra ``fast``.
    DataError
        When joints do not match, theta has the wrong length, or the loop is unstable.
    ModelError
        When theta belongs to no real robot.

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
    if unmodeled and exact:
        raise DataError(
            f"simulate: '{robot.name}' follows its motion exactly, as asked, or for mimic joints "
            "or large damping; unmodeled effects are not simulated."
        )
    if unmodeled and drives.unmodeled is None:
        raise DataError("simulate: these drives have no unmodeled effects; set them.")
    terms = FrictionModel.from_terms(("coulomb", "viscous"), robot.joint_names)
    model = RobotDynamics(robot=robot, terms=terms, theta=theta)
    move = _followed(model, trajectory) if exact else controlled(model, trajectory, drives)
    position, effort, reference = np.empty((3, trajectory.n_samples, robot.n))
    row, scale, resolution = 0, drives.effort_scale, drives.resolution
    settling = trajectory.samples_per_period if trajectory.closed else 0
    total = trajectory.n_samples + settling
    with progress_bar(total, "simulating", enabled=progress) as advance:
        for first, (q, v, torque) in _parts(trajectory, settling, move, advance):
            rows = slice(row, row + len(q))
            row += len(q)
            extra = drives.unmodeled.torque(q, v) if unmodeled and drives.unmodeled else 0.0
            current = (torque + extra) / scale
            if noise:
                q = np.rint(q / resolution) * resolution
                current += drives.current_noise * rng.standard_normal(current.shape)
            position[rows], effort[rows] = q, current * scale
            reference[rows] = trajectory.sample(first, first + len(q))[0]
    rate, lead = trajectory.rate_hz, trajectory.lead_samples
    notes = ("simulated without a controller: the robot follows its motion exactly",)
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


def controlled(model: RobotDynamics, trajectory: Trajectory, drives: Drives) -> Move:
    """Return what moves a robot in closed loop along samples of a trajectory.

    Raises
    ------
    MissingExtraError
        Without a compiler, which 100 s of an arm need to take seconds and not minutes.
    ModelError
        When the base floats, a joint has no motor, or links are no bodies.
    DataError
        When the velocity loop is too fast for the sample rate.
    """
    require("numba", extra="fast")
    robot, rate = model.robot, trajectory.rate_hz
    arm = SimulatedArm.of(model)
    check_bodies(robot, model.theta[: 10 * robot.n_links].reshape(-1, 10))
    fastest, limit = fastest_pole(robot, trajectory, model.theta, drives)
    if not fastest < limit:
        raise DataError(
            f"plant of '{robot.name}': the velocity loop's fastest pole is at {fastest:.4g}/s, "
            f"too fast for a rate of {rate:g} Hz (limit {limit:.4g}/s); lower velocity_gain or "
            "raise the sample rate."
        )
    law = P(drives.proportional_gain, drives.velocity_gain)

    def move(start: int, stop: int, state: Array | None) -> tuple[Array, Array]:
        if stop - start > _AT_ONCE:
            middle = (start + stop) // 2
            before, now = move(start, middle, state)
            after, end = move(middle, stop, now)
            return np.concatenate([before, after], axis=1), end
        # With the sample after these, which has the state after them.
        told = np.stack(trajectory.sample(start, min(stop + 1, trajectory.n_samples)))
        # A last sample alone is held.
        told = told if told.shape[1] > 1 else np.repeat(told, 2, axis=1)
        begin = (told[0][0], np.zeros(robot.n)) if state is None else tuple(state)
        found = simulate_closed_loop(arm, tuple(told), law, rate_hz=rate, start=begin)
        if found.diverged is not None:
            raise DataError(
                f"plant: the motion diverges {found.diverged:.3g} s after sample {start}: the loop "
                "is unstable; lower velocity_gain or proportional_gain."
            )
        states = np.stack([found.position, found.velocity, found.effort])
        return states[:, : stop - start], states[:2, -1]

    return move


def _followed(model: RobotDynamics, trajectory: Trajectory) -> Move:
    """Return what follows a trajectory exactly; its state never changes."""

    def move(start: int, stop: int, state: Array | None) -> tuple[Array, Array]:
        states = trajectory.sample(start, stop)
        effort = model.inverse_dynamics(*states)
        return np.stack([*states[:2], effort]), np.zeros((2, model.robot.n))

    return move


def _parts(
    trajectory: Trajectory, settling: int, move: Move, advance: Callable[[float], None]
) -> Iterator[tuple[int, Array]]:
    """Yield the record in parts: the first sample, and positions, velocities and efforts."""
    lead, end, period = trajectory.lead_samples, trajectory.n_samples, trajectory.samples_per_period
    # Rest, connection and the settling period, within which the record begins; then the periods.
    spans = [(0, lead + settling, settling), *[(lead, lead + period, 0)] * trajectory.periods]
    state: Array | None = None
    done, settled = (0, 0, 0), False
    for span in (*spans, (end - lead, end, 0)):
        start, stop, skipped = span
        if start == stop:
            continue
        # A loop that has settled moves as in the period before.
        if span != done or not settled:
            states, after = move(start, stop, state)
            settled = state is not None and bool(np.abs(after - state).max() <= SETTLED)
            done, state = span, after
        advance(stop - start)
        yield start + skipped, states[:, skipped:]


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
    if drives is None:
        drives = load_drives(robot.name) if bundled else default_drives(robot, values, trajectory)
    if drives.n != robot.n:
        raise DataError(f"simulate: {drives.n} drives, robot '{robot.name}' has {robot.n} joints.")
    return values, drives
