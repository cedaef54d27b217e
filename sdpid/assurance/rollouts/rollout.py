"""`rollout`: simulate the identified robot under measured efforts, and compare with the record."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid._common.threads import one_thread
from sdpid.assurance.rollouts.result import (
    CLOSED_LOOP,
    CONSTANT_VELOCITY,
    FLOOR,
    STAND_STILL,
    MotionErrors,
    Rollout,
)
from sdpid.assurance.rollouts.setting import HORIZONS, Setting, judged_model
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.closed_loop import simulate_closed_loop
from sdpid.experiment.simulation.law import Controller
from sdpid.experiment.simulation.open_loop import Track, simulate_stretches
from sdpid.experiment.simulation.tip import tip_positions
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel

# What the reference itself is called, beside the models.
_REFERENCE = "reference followed exactly"


@one_thread
def rollout(
    estimate: Estimate | RobotDynamics,
    recording: Recording | str | os.PathLike[str] | Samples,
    horizons: Sequence[float] = HORIZONS,
    *,
    free: str | Iterable[str] = "each",
    without_effort: Iterable[str] = (),
    start_every: float | None = None,
    controller: Controller | None = None,
    processing: Processing | Mapping[str, Any] | None = None,
    baselines: bool = True,
    seed: int | np.random.Generator = 0,
) -> Rollout:
    """Simulate the identified robot in open loop under measured efforts, from measured states.

    From many instants of a recording the estimate's equations of motion are integrated under the
    efforts that were measured, and the positions are compared with the measured ones. Nothing
    brings the simulation back to the record, so every defect of the model adds up. Beside the
    estimate stand its description, least squares, what a joint does that keeps its velocity or
    stands still, and what noise alone does: the estimate simulated once more with the sensors'
    noise added to states and efforts, against itself.

    Parameters
    ----------
    estimate : Estimate or RobotDynamics
        The parameters, of an arm on a fixed base; an `Identification` will do. A model alone has
        no least squares and no description beside it.
    recording : Recording, path or Samples
        What was measured: best motion that was not fitted. Samples are taken as they are, and tell
        nothing of the noise.
    horizons : sequence of float, optional
        Times after each start at which errors are told, s. Those that the recording is too short
        for are left out, and a note says so.
    free : {"each", "all"}, str or iterable of str, optional
        ``"each"``: one joint at a time is simulated, the others move as recorded, which shows the
        joints apart. ``"all"``: all joints together, as a simulator would. Or names of joints that
        are free together.
    without_effort : iterable of str, optional
        Joints whose effort was not measured: they move as recorded. Joints of which the estimate
        used no effort do so anyway.
    start_every : float, optional
        Time between starts, s; by default 0.25 s, or what gives 60 starts.
    controller : Controller, optional
        Simulate in closed loop instead: all joints follow the recording's commanded positions
        under this controller (see `sdpid.controllers`), and measured efforts are not used.
    processing : Processing or mapping, optional
        How states and efforts are filtered; by default as `identify` would, or a mapping of
        changes of that. Rows are never masked, and periods not averaged.
    baselines : bool, optional
        Whether description and least squares are simulated too.
    seed : int or numpy.random.Generator, optional
        Of the noise.

    Returns
    -------
    Rollout
        ``.table()``, ``.to_frame()``, ``.plot()``; ``.median`` and ``.diverged`` at the horizons,
        ``.verdict`` and ``.notes`` in words. A simulation that runs away is no error: it counts as
        infinitely wrong.

    Raises
    ------
    DataError
        When the recording is shorter than every horizon, a joint or a horizon is none, or the
        recording cannot be processed.
    ModelError
        When the robot's base floats, or a friction term cannot be simulated.

    Examples
    --------
    >>> moved = sdpid.rollout(estimate, log, horizons=(0.1, 0.5), free="all", baselines=False)
    >>> bool(moved.median[1] < 0.05), moved.diverged.tolist()
    (True, [0.0, 0.0])
    >>> list(moved.models)
    ['this estimate', 'constant velocity', 'stand still', 'noise alone']
    """
    # Names that are no joints are told before anything is solved for.
    _groups(judged_model(estimate)[0].robot, free)
    setting = Setting.of(
        estimate,
        recording,
        horizons,
        without_effort=without_effort,
        start_every=start_every,
        processing=processing,
        baselines=baselines,
        seed=seed,
    )
    return _simulated(setting, free, controller)


@one_thread
def rollouts(
    estimate: Estimate | RobotDynamics,
    recording: Recording | str | os.PathLike[str] | Samples,
    *,
    without_effort: Iterable[str] = (),
    processing: Processing | Mapping[str, Any] | None = None,
) -> tuple[Rollout, Rollout]:
    """Return a recording simulated with all joints free, and with one at a time.

    Parameters
    ----------
    estimate, recording, without_effort, processing
        As of `rollout`; what both have in common is made once.
    """
    setting = Setting.of(estimate, recording, without_effort=without_effort, processing=processing)
    return _simulated(setting, "all"), _simulated(setting, "each")


def _simulated(
    setting: Setting, free: str | Iterable[str], controller: Controller | None = None
) -> Rollout:
    """Simulate all models of a setting with some joints free, and compare."""
    if controller is not None and free == "each":
        free = "all"
    robot, track, first, after = setting.model.robot, setting.track, setting.first, setting.after
    groups, named = _groups(robot, free, setting.absent)
    instants = first[:, None] + after
    measured = track.position[instants]
    reference = None
    if controller is not None:
        if groups != (tuple(range(robot.n)),):
            raise DataError("controller: moves all joints; leave free and without_effort out.")
        controller = getattr(controller, "controller", controller)
        reference = _reference_on(track, robot, setting.log)

    def moved(arm: SimulatedArm, along: Track) -> Array:
        """Return simulated positions (G, S, L, n), not numbers from where one ran away."""
        if controller is not None and reference is not None:
            return _in_closed_loop(arm, along, first, after, reference, controller)
        released = np.zeros((len(groups), len(first), robot.n), dtype=np.bool_)
        for g, group in enumerate(groups):
            released[g, :, list(group)] = True
        starts = np.tile(first, len(groups))
        found = simulate_stretches(arm, along, starts, released.reshape(-1, robot.n), after)
        return found.reshape(len(groups), *instants.shape, robot.n)

    def errors(positions: Array, against: Array = measured) -> MotionErrors:
        return _errors(robot, positions, against, groups, setting.at)

    own = moved(setting.arm, track)
    found = {setting.name: errors(own)}
    for name, model in setting.beside.items():
        found[name] = errors(moved(SimulatedArm.of(model), track))
    here, speed = track.position[first][:, None], track.velocity[first][:, None]
    # Joints that are not free move as recorded.
    held = np.ones((len(groups), 1, 1, robot.n), dtype=np.bool_)
    for g, group in enumerate(groups):
        held[g, ..., list(group)] = False
    ahead = here + speed * (after * track.step)[:, None]
    found[CONSTANT_VELOCITY] = errors(np.where(held, measured, ahead))
    found[STAND_STILL] = errors(np.where(held, measured, here))
    if reference is not None:
        found[_REFERENCE] = errors(reference[instants][None])
    if setting.again is not None:
        # What is compared with is measured with noise, too.
        noise = setting.again.position[instants] - measured
        found[FLOOR] = errors(moved(setting.arm, setting.again), own + noise)
    joints = [j for group in groups for j in group]
    filtered = "under the filtered efforts, which raw ones hardly change"
    steps = f"in steps of {1e3 * track.step:.3g} ms {filtered}"
    way = steps if controller is None else "in closed loop"
    return Rollout(
        robot=robot.name,
        joint_names=tuple(robot.joint_names[j] for j in joints),
        sliding=robot.slides[joints],
        free=named if controller is None else CLOSED_LOOP,
        horizons=setting.horizons,
        time=np.asarray(after * track.step, dtype=np.float64),
        start=track.time[first],
        own=setting.name,
        models=found,
        light=setting.light,
        said=(f"{setting.starts}, simulated {way}", *setting.notes),
    )


def _errors(
    robot: RobotModel,
    positions: Array,
    reference: Array,
    groups: tuple[tuple[int, ...], ...],
    at: Indices,
) -> MotionErrors:
    """Return the errors of positions (G, S, L, n) against a reference that may be of one group."""
    off = np.abs(positions - reference)
    # A simulation that ran away is wrong in all of its joints.
    off[~np.isfinite(off).all(axis=3)] = np.inf
    joint = np.concatenate([off[g][..., list(group)] for g, group in enumerate(groups)], axis=2)

    def tips(given: Array) -> Array:
        seen = np.broadcast_to(given, positions.shape)[:, :, at]
        return tip_positions(robot, seen.reshape(-1, robot.n)).reshape(*seen.shape[:-1], 3)

    squares = np.sum(np.square(tips(positions) - tips(reference)), axis=-1)
    squares = np.where(np.isfinite(squares), squares, np.inf)
    return MotionErrors(joint=joint, tip=np.sqrt(squares.mean(axis=0)), at=at)


def _reference_on(track: Track, robot: RobotModel, log: Recording | None) -> Array:
    """Return commanded positions (T, n) at the instants of a track."""
    from scipy.interpolate import CubicSpline

    commanded = None if log is None else match_joints(robot, log).reference
    if log is None or commanded is None:
        raise DataError(
            "controller: a simulation in closed loop follows commanded positions, and the "
            "recording has none; give a recording with a reference, or leave the controller out."
        )
    return np.asarray(CubicSpline(log.time, commanded)(track.time))


def _in_closed_loop(
    arm: SimulatedArm, track: Track, starts: Indices, after: Indices, reference: Array, law: Any
) -> Array:
    """Return simulated positions (1, S, L, n) of all joints, not numbers from where one ran away.

    Each starts in the measured state; a controller that integrates starts with nothing integrated.
    """
    out = np.full((1, len(starts), len(after), track.position.shape[1]), np.nan)
    for s, first in enumerate(starts):
        moved = simulate_closed_loop(
            arm,
            reference[first : first + int(after[-1]) + 1],
            law,
            rate_hz=1.0 / track.step,
            start=(track.position[first], track.velocity[first]),
        )
        kept = after < len(moved.position)
        out[0, s, kept] = moved.position[after[kept]]
    return out


def _groups(
    robot: RobotModel, free: str | Iterable[str], absent: Iterable[str] = ()
) -> tuple[tuple[tuple[int, ...], ...], str]:
    """Return which joints are free together, and what that is called."""
    driven = [j for j, name in enumerate(robot.joint_names) if name not in absent]
    if free == "each":
        return tuple((j,) for j in driven), "each"
    if free == "all":
        return (tuple(driven),), "all"
    names = (free,) if isinstance(free, str) else tuple(free)
    unknown = [str(name) for name in names if name not in robot.joint_names or name in absent]
    if unknown or not names:
        raise DataError(
            f"free: '{robot.name}' has no joint {', '.join(unknown) or '(none named)'} "
            "whose effort is used; give 'each', 'all' or names of "
            f"{', '.join(robot.joint_names[j] for j in driven)}."
        )
    chosen = sorted({robot.joint_names.index(name) for name in names})
    return (tuple(chosen),), ", ".join(robot.joint_names[j] for j in chosen)
