"""`rollout`: simulate the identified robot under measured efforts, and compare with the record."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid._common.seeds import generator
from sdpid._common.threads import one_thread
from sdpid.assurance.diagnostics.held_out import OURS
from sdpid.assurance.diagnostics.motion.light_joints import light_joints
from sdpid.assurance.diagnostics.validation import validate_dynamics
from sdpid.assurance.rollouts.closed import REFERENCE, in_closed_loop, reference_on
from sdpid.assurance.rollouts.errors import Runs
from sdpid.assurance.rollouts.models import CLOSED_LOOP, FLOOR, MODEL, models_beside
from sdpid.assurance.rollouts.noise import noisier
from sdpid.assurance.rollouts.result import Rollout
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.preparation.for_robot import default_processing, prepare
from sdpid.experiment.preparation.several import joints_without
from sdpid.experiment.processing.choose import with_changes
from sdpid.experiment.processing.process import Processing
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.readers.read import read_recording
from sdpid.experiment.recording.floating.refusal import require_fixed_base
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.controllers import Controller
from sdpid.experiment.simulation.open_loop import Track
from sdpid.robot.model.coordinates import sliding
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel

# Simulations start this far apart, s, unless that is too many.
_EVERY, _MOST_STARTS = 0.25, 60

# Instants at which curves over time are drawn.
_INSTANTS = 20


@one_thread
def rollout(
    estimate: Estimate | RobotDynamics,
    recording: Recording | str | os.PathLike[str] | Samples,
    horizons: Sequence[float] = (0.1, 0.5, 2.0),
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
    model, judged, name = _judged(estimate)
    robot, arm = model.robot, SimulatedArm.of(model)
    wanted = _checked_horizons(horizons)
    if controller is not None and free == "each":
        free = "all"
    absent = _without(judged, robot, without_effort)
    groups, named = _groups(robot, free, absent)
    rng = generator(seed)
    log, samples, chosen = _prepared(robot, recording, processing)
    track = Track.of(samples)
    longest = max(
        float(samples.time[part][-1] - samples.time[part][0])  # type: ignore[index]
        for part in samples.parts
    )
    kept = tuple(h for h in wanted if h < longest)
    if not kept:
        raise DataError(
            f"horizons: the shortest is {wanted[0]:g} s, and the recording has {longest:.3g} s "
            "without a break once the filter's ends are cut off; record longer, or give shorter "
            "horizons."
        )
    every = _spacing(start_every, longest - kept[-1])
    first = track.starts(kept[-1], every)
    after, at = _instants(track, kept)
    runs = Runs(robot=robot, first=first, groups=groups, after=after, at=at)
    measured = runs.measured(track)
    reference = None
    if controller is not None:
        if groups != (tuple(range(robot.n)),):
            raise DataError("controller: moves all joints; leave free and without_effort out.")
        controller = getattr(controller, "controller", controller)
        reference = reference_on(track, robot, log)

    def simulated(its: SimulatedArm, along: Track) -> Array:
        if controller is None or reference is None:
            return runs.simulated(its, along)
        return in_closed_loop(its, runs, along, reference, controller)

    own = simulated(arm, track)
    errors = {name: runs.errors(own, measured)}
    beside = models_beside(judged, samples) if judged is not None and baselines else {}
    for other, its in beside.items():
        errors[other] = runs.errors(simulated(SimulatedArm.of(its), track), measured)
    for other, positions in runs.idle(track).items():
        errors[other] = runs.errors(positions, measured)
    if reference is not None:
        commanded = reference[first[:, None] + after]
        errors[REFERENCE] = runs.errors(commanded[None], measured)
    said = [
        f"{len(first)} starts, {every:.3g} s apart, simulated in steps of "
        f"{1e3 * track.step:.3g} ms under the filtered efforts, which raw ones hardly change"
        if controller is None
        else f"{len(first)} starts, {every:.3g} s apart, simulated in closed loop"
    ]
    if absent:
        said.append(f"on the record, as their effort is not used: {', '.join(absent)}")
    if len(kept) < len(wanted):
        left = ", ".join(f"{h:g}" for h in wanted[len(kept) :])
        said.append(f"no horizon of {left} s: the recording has {longest:.3g} s without a break")
    if log is None:
        said.append("no floor of noise: samples do not tell the noise; give the recording")
    else:
        again = Track.of(prepare(robot, noisier(log, rng), chosen))
        moved = simulated(arm, again)
        # What is compared with is measured with noise, too.
        errors[FLOOR] = runs.errors(moved, own + (runs.measured(again) - measured))
    slides = sliding(robot.pin_model, robot.joint_names)
    joints = [j for group in groups for j in group]
    return Rollout(
        robot=robot.name,
        joint_names=tuple(robot.joint_names[j] for j in joints),
        sliding=slides[joints],
        free=named if controller is None else CLOSED_LOOP,
        horizons=kept,
        time=np.asarray(after * track.step, dtype=np.float64),
        start=track.time[first],
        own=name,
        models=errors,
        light=light_joints(model, samples, validate_dynamics(model, samples).moving),
        said=tuple(said),
    )


def _judged(given: Any) -> tuple[RobotDynamics, Estimate | None, str]:
    """Return the model to simulate, the estimate that it is of, and its name."""
    if isinstance(given, RobotDynamics):
        return given, None, MODEL
    found = getattr(given, "estimate", given)
    if not isinstance(found, Estimate):
        raise DataError(
            f"rollout: is given {type(given).__name__} {given!r:.60}; give an Estimate, such as "
            "result.estimate, or its model."
        )
    return found.model(), found, OURS


def _checked_horizons(horizons: Sequence[float]) -> tuple[float, ...]:
    """Return the horizons in rising order."""
    values = np.atleast_1d(np.asarray(horizons, dtype=np.float64))
    if values.ndim != 1 or not values.size or not np.all((values > 0.0) & np.isfinite(values)):
        raise DataError(f"horizons: are {horizons!r:.80}; give times in s, each above 0.")
    return tuple(sorted(set(values.tolist())))


def _without(judged: Estimate | None, robot: RobotModel, given: Iterable[str]) -> tuple[str, ...]:
    """Return the joints whose effort is not used."""
    named = set(joints_without(given))
    if unknown := sorted(named - set(robot.joint_names)):
        raise DataError(
            f"without_effort: '{robot.name}' has no joint {', '.join(unknown)}; it has "
            f"{', '.join(robot.joint_names)}."
        )
    if judged is not None and judged.problem.rows is not None:
        unused = np.flatnonzero(~judged.problem.samples.used.any(axis=0))
        named |= {robot.joint_names[j] for j in unused}
    if named == set(robot.joint_names):
        raise DataError("without_effort: names every joint; no effort is left to simulate under.")
    return tuple(name for name in robot.joint_names if name in named)


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


def _prepared(
    robot: RobotModel,
    recording: Recording | str | os.PathLike[str] | Samples,
    processing: Processing | Mapping[str, Any] | None,
) -> tuple[Recording | None, Samples, Processing | None]:
    """Return the recording sample by sample, its samples, and how they were processed."""
    if isinstance(recording, Samples):
        if recording.time is None:
            raise DataError("samples: have no time; give the recording, or samples with time.")
        return None, recording, None
    log = recording if isinstance(recording, Recording) else read_recording(recording)
    require_fixed_base(log, "rollout")
    log = replace(log, period=None, start=None, periods=None)
    if not isinstance(processing, Processing):
        processing = with_changes(default_processing(log), processing or {})
    chosen = replace(processing, reversal_time=None, covariance=None, decimation=None)
    if chosen.derivative == "spectral":
        chosen = replace(chosen, derivative="central6")
    return log, prepare(robot, log, chosen), chosen


def _spacing(given: float | None, room: float) -> float:
    """Return the time between starts."""
    if given is None:
        return max(_EVERY, room / _MOST_STARTS)
    if not (np.isfinite(given) and given > 0.0):
        raise DataError(f"start_every: is {given!r}; give a time in s, above 0.")
    return float(given)


def _instants(track: Track, horizons: Sequence[float]) -> tuple[Indices, Indices]:
    """Return the steps after which errors are taken, and which of them are horizons."""
    ends = np.array([track.steps(h) for h in horizons])
    curve = np.linspace(1, ends[-1], min(_INSTANTS, ends[-1])).round().astype(np.intp)
    after = np.unique(np.concatenate([ends, curve]))
    return after, np.searchsorted(after, ends)
