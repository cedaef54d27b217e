"""`rollout`: simulate the identified robot under measured efforts, and compare with the record."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.threads import one_thread
from sdpid.assurance.rollouts.closed import REFERENCE, in_closed_loop, reference_on
from sdpid.assurance.rollouts.errors import Runs
from sdpid.assurance.rollouts.models import CLOSED_LOOP, FLOOR
from sdpid.assurance.rollouts.result import Rollout
from sdpid.assurance.rollouts.setting import HORIZONS, Setting, judged_model
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.law import Controller
from sdpid.experiment.simulation.open_loop import Track
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel


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
    robot, track, first = setting.model.robot, setting.track, setting.first
    groups, named = _groups(robot, free, setting.absent)
    runs = Runs(robot=robot, first=first, groups=groups, after=setting.after, at=setting.at)
    measured = runs.measured(track)
    reference = None
    if controller is not None:
        if groups != (tuple(range(robot.n)),):
            raise DataError("controller: moves all joints; leave free and without_effort out.")
        controller = getattr(controller, "controller", controller)
        reference = reference_on(track, robot, setting.log)

    def simulated(its: SimulatedArm, along: Track) -> Array:
        if controller is None or reference is None:
            return runs.simulated(its, along)
        return in_closed_loop(its, runs, along, reference, controller)

    own = simulated(setting.arm, track)
    errors = {setting.name: runs.errors(own, measured)}
    for other, model in setting.beside.items():
        errors[other] = runs.errors(simulated(SimulatedArm.of(model), track), measured)
    for other, positions in runs.idle(track).items():
        errors[other] = runs.errors(positions, measured)
    if reference is not None:
        commanded = reference[first[:, None] + setting.after]
        errors[REFERENCE] = runs.errors(commanded[None], measured)
    if setting.again is not None:
        moved = simulated(setting.arm, setting.again)
        # What is compared with is measured with noise, too.
        errors[FLOOR] = runs.errors(moved, own + (runs.measured(setting.again) - measured))
    joints = [j for group in groups for j in group]
    return Rollout(
        robot=robot.name,
        joint_names=tuple(robot.joint_names[j] for j in joints),
        sliding=robot.slides[joints],
        free=named if controller is None else CLOSED_LOOP,
        horizons=setting.horizons,
        time=np.asarray(setting.after * track.step, dtype=np.float64),
        start=track.time[first],
        own=setting.name,
        models=errors,
        light=setting.light,
        said=setting.said(in_loop=controller is not None),
    )


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
