"""`rollout`: simulate the identified robot under measured efforts, and compare with the record."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen, generator
from sdpid._common.threads import one_thread
from sdpid.assurance.diagnostics.described import described_dynamics
from sdpid.assurance.diagnostics.held_out import (
    DESCRIPTION,
    FRICTION_FITTED,
    LEAST_SQUARES,
    OURS,
    friction_fitted,
)
from sdpid.assurance.diagnostics.light_joints import light_joints
from sdpid.assurance.diagnostics.validation import validate_dynamics
from sdpid.assurance.rollouts.result import (
    CLOSED_LOOP,
    CONSTANT_VELOCITY,
    FLOOR,
    REFERENCE,
    STAND_STILL,
    MotionErrors,
    Rollout,
)
from sdpid.errors import DataError, SdpidError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.preparation.prepare import joints_without, samples_of
from sdpid.experiment.processing.choose import default_processing, with_changes
from sdpid.experiment.processing.motion import noise_of
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.readers.read import read_recording
from sdpid.experiment.recording.joints import match_joints, require_fixed_base
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.arm import SimulatedArm, Track, simulate_stretches, tip_positions
from sdpid.experiment.simulation.closed_loop import simulate_closed_loop
from sdpid.experiment.simulation.controllers import PD, Controller
from sdpid.experiment.simulation.law import CommandedMotion, under_law
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel

# Times after each start at which errors are told, s.
_HORIZONS = (0.1, 0.5, 2.0)

# Simulations start this far apart, s, unless that is too many.
_EVERY, _MOST_STARTS = 0.25, 60

# Instants at which curves over time are drawn.
_INSTANTS = 20

# A model that comes without an estimate.
_MODEL = "this model"


@one_thread
def rollout(
    estimate: Estimate | RobotDynamics,
    recording: Recording | str | os.PathLike[str] | Samples,
    horizons: Sequence[float] = _HORIZONS,
    *,
    free: str | Iterable[str] = "each",
    without_effort: Iterable[str] = (),
    start_every: float | None = None,
    controller: Controller | None = None,
    law: PD | None = None,
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
    law : sdpid.controllers.PD, optional
        The law that moved a robot whose efforts were not measured, with its delay: as `controller`,
        but with the commands of a delay before, which are steps where the recording has steps.
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
    robot = _judged(estimate)[0].robot
    if law is not None:
        if controller is not None or isinstance(recording, Samples):
            raise DataError(
                "law: says what closed the loop along a recording; leave controller out, and give "
                "the recording, as samples hold no commands."
            )
        controller, (recording,) = under_law(robot, [recording], law, "rollout")
    # Names that are no joints are told before anything is solved for.
    _free_joints(robot, free, controller)
    simulations = _Simulations(
        estimate,
        recording,
        horizons,
        without_effort=without_effort,
        start_every=start_every,
        processing=processing,
        baselines=baselines,
        seed=seed,
    )
    return simulations.rollout(free, controller, of_law=law is not None)


@one_thread
def rollouts(
    estimate: Estimate | RobotDynamics,
    recording: Recording | str | os.PathLike[str] | Samples,
    **options: Any,
) -> tuple[Rollout, Rollout]:
    """Return a recording simulated with all joints free, and with one at a time.

    Parameters
    ----------
    estimate, recording, **options
        As of `rollout`, such as ``processing``; what both have in common is made once.
    """
    simulations = _Simulations(estimate, recording, **options)
    return simulations.rollout("all"), simulations.rollout("each")


class _Simulations:
    """What simulations of a recording need, whichever joints are free; arguments of `rollout`."""

    def __init__(
        self,
        estimate: Estimate | RobotDynamics,
        recording: Recording | str | os.PathLike[str] | Samples,
        horizons: Sequence[float] = _HORIZONS,
        *,
        without_effort: Iterable[str] = (),
        start_every: float | None = None,
        processing: Processing | Mapping[str, Any] | None = None,
        baselines: bool = True,
        seed: int | np.random.Generator = 0,
    ) -> None:
        model, judged, self.name = _judged(estimate)
        self.robot = robot = model.robot
        self.arms = {self.name: SimulatedArm.of(model)}
        self.absent, rng = _without(judged, robot, without_effort), generator(seed)
        self.log, samples, chosen = _prepared(robot, recording, processing)
        self.track, time = Track.of(samples), np.asarray(samples.time)
        longest = max(float(np.ptp(time[part])) for part in samples.parts)
        self.horizons, left = _horizons(horizons, longest)
        # What is left out.
        notes = {
            f"on the record, as their effort is not used: {', '.join(self.absent)}": self.absent,
            f"no horizon of {left} s: the recording has {longest:.3g} s without a break": left,
            "no floor of noise: samples do not tell the noise; give the recording": self.log
            is None,
        }
        self.notes = [words for words, told in notes.items() if told]
        last = self.horizons[-1]
        every = max(_EVERY, (longest - last) / _MOST_STARTS) if start_every is None else start_every
        if not (np.isfinite(every) and every > 0.0):
            raise DataError(f"start_every: is {every!r}; give a time in s, above 0.")
        noisier = None if self.log is None else _noisier(self.log, rng)
        self.again = None if noisier is None else Track.of(samples_of(robot, noisier, chosen))
        self.first = self.track.starts(last, every)
        self.starts = f"{len(self.first)} starts, {every:.3g} s apart"
        ends = np.array([self.track.steps(h) for h in self.horizons])
        curve = np.linspace(1, ends[-1], min(_INSTANTS, ends[-1])).round().astype(np.intp)
        self.after = np.unique(np.concatenate([ends, curve]))
        self.at = np.searchsorted(self.after, ends)
        if judged is not None and baselines:
            for name, beside in _models_beside(judged, samples).items():
                self.arms[name] = SimulatedArm.of(beside)
        self.light = light_joints(model, samples, validate_dynamics(model, samples).moving)

    def rollout(
        self,
        free: str | Iterable[str],
        controller: Controller | None = None,
        *,
        of_law: bool = False,
    ) -> Rollout:
        """Simulate all models with some joints free, and compare; commands act as under a law."""
        robot, track, first = self.robot, self.track, self.first
        which, named = _free_joints(robot, free, controller, self.absent)
        joints, instants = np.nonzero(which)[1].tolist(), first[:, None] + self.after
        measured, reference = track.position[instants], None
        way = f"in steps of {1e3 * track.step:.3g} ms under the filtered efforts, which raw ones "
        way += "hardly change"
        motion: CommandedMotion | None = None
        if of_law:
            assert self.log is not None
            assert isinstance(controller, PD)
            motion = CommandedMotion.under(match_joints(robot, self.log), controller)
            reference = motion.at(track.time - motion.begin)[:, 0]
            way = f"in closed loop, {1e3 * motion.delay:.3g} ms after the commands"
        elif controller is not None:
            reference, way = _reference_on(track, robot, self.log), "in closed loop"
            controller = getattr(controller, "controller", controller)

        def moved(name: str, along: Track = track) -> Array:
            """Return simulated positions (G, S, L, n), not numbers from where one ran away."""
            if reference is not None:
                return self._in_closed_loop(
                    self.arms[name], along, reference if motion is None else motion, controller
                )
            released, starts = np.repeat(which, len(first), axis=0), np.tile(first, len(which))
            found = simulate_stretches(self.arms[name], along, starts, released, self.after)
            return found.reshape(len(which), *measured.shape)

        positions = {name: moved(name) for name in self.arms}
        here, speed = track.position[first][:, None], track.velocity[first][:, None]
        ahead = here + speed * (self.after * track.step)[:, None]
        # Joints that are not free move as recorded.
        positions[CONSTANT_VELOCITY] = np.where(which[:, None, None], ahead, measured)
        positions[STAND_STILL] = np.where(which[:, None, None], here, measured)
        if reference is not None:
            positions[REFERENCE] = reference[instants][None]
        found = {name: self._errors(each, measured, which) for name, each in positions.items()}
        if self.again is not None:
            # What is compared with is measured with noise, too.
            noise = self.again.position[instants] - measured
            noisy, own = moved(self.name, self.again), positions[self.name]
            found[FLOOR] = self._errors(noisy, own + noise, which)
        return Rollout(
            robot=robot.name,
            joint_names=tuple(robot.joint_names[j] for j in joints),
            sliding=robot.slides[joints],
            free=named,
            horizons=self.horizons,
            time=np.asarray(self.after * track.step, dtype=np.float64),
            start=track.time[first],
            own=self.name,
            models=found,
            light=self.light,
            said=(f"{self.starts}, simulated {way}", *self.notes),
        )

    def _in_closed_loop(
        self, arm: SimulatedArm, track: Track, reference: Array | CommandedMotion, law: Any
    ) -> Array:
        """Return simulated positions (1, S, L, n), each from the measured state.

        A controller that integrates starts with nothing integrated.
        """
        out = np.full((1, len(self.first), len(self.after), self.robot.n), np.nan)
        count = int(self.after[-1]) + 1
        for s, first in enumerate(self.first):
            if isinstance(reference, CommandedMotion):
                time = np.asarray(track.step * np.arange(count))
                begin = float(track.time[first])
                desired: Any = replace(reference, time=time, begin=begin)
            else:
                desired = reference[first : first + count]
            moved = simulate_closed_loop(
                arm,
                desired,
                law,
                rate_hz=1.0 / track.step,
                start=(track.position[first], track.velocity[first]),
            )
            kept = self.after < len(moved.position)
            out[0, s, kept] = moved.position[self.after[kept]]
        return out

    def _errors(self, positions: Array, reference: Array, free: Mask) -> MotionErrors:
        """Return the errors of positions against a reference that may be of one group."""
        off = np.abs(positions - reference)
        # A simulation that ran away is wrong in all of its joints.
        off[~np.isfinite(off).all(axis=3)] = np.inf
        joint = np.concatenate([own[..., j] for own, j in zip(off, free, strict=True)], axis=2)

        def tips(given: Array) -> Array:
            seen = np.broadcast_to(given, positions.shape)[:, :, self.at].reshape(-1, self.robot.n)
            return tip_positions(self.robot, seen).reshape(*off.shape[:2], len(self.at), 3)

        squares = np.sum(np.square(tips(positions) - tips(reference)), axis=-1)
        squares = np.where(np.isfinite(squares), squares, np.inf)
        return MotionErrors(joint=joint, tip=np.sqrt(squares.mean(axis=0)), at=self.at)


def _judged(given: Any) -> tuple[RobotDynamics, Estimate | None, str]:
    """Return the model to simulate, the estimate that it is of, and its name."""
    if isinstance(given, RobotDynamics):
        return given, None, _MODEL
    drives = getattr(given, "drives", None)
    found = getattr(given, "estimate", given) if drives is None else drives.estimate()
    if not isinstance(found, Estimate):
        raise DataError(
            f"rollout: is given {type(given).__name__} {given!r:.60}; give an Estimate, such as "
            "result.estimate, or its model."
        )
    return found.model(), found, OURS


def _free_joints(
    robot: RobotModel,
    free: str | Iterable[str],
    controller: Controller | None,
    absent: Iterable[str] = (),
) -> tuple[Mask, str]:
    """Return which joints are free together, (G, n), and what that is called."""
    driven = ~np.isin(robot.joint_names, list(absent))
    names = (free,) if isinstance(free, str) else tuple(free)
    if names in (("each",), ("all",)):
        (named,) = names
        alone = named == "each" and controller is None
        which = np.diag(driven)[driven] if alone else driven[None]
    else:
        there = [name for name, own in zip(robot.joint_names, driven, strict=True) if own]
        unknown = [str(name) for name in names if name not in there]
        if unknown or not names:
            raise DataError(
                f"free: '{robot.name}' has no joint {', '.join(unknown) or '(none named)'} "
                "whose effort is used; give 'each', 'all' or names of "
                f"{', '.join(there)}."
            )
        which = np.isin(robot.joint_names, names)[None]
        named = ", ".join(name for name in there if name in names)
    if controller is None:
        return which, named
    if not which.all():
        raise DataError("controller: moves all joints; leave free and without_effort out.")
    return which, CLOSED_LOOP


def _without(judged: Estimate | None, robot: RobotModel, given: Iterable[str]) -> list[str]:
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
    return [name for name in robot.joint_names if name in named]


def _horizons(given: Sequence[float], longest: float) -> tuple[tuple[float, ...], str]:
    """Return the horizons that a recording is long enough for, and which others were asked for."""
    wanted = np.atleast_1d(np.asarray(given, dtype=np.float64))
    if wanted.ndim != 1 or not wanted.size or not np.all((wanted > 0) & np.isfinite(wanted)):
        raise DataError(f"horizons: are {given!r:.80}; give times in s, each above 0.")
    wanted = np.unique(wanted)
    kept = tuple(wanted[wanted < longest].tolist())
    if not kept:
        raise DataError(
            f"horizons: the shortest is {wanted[0]:g} s, and the recording has {longest:.3g} s "
            "without a break once the filter's ends are cut off; record longer, or give "
            "shorter horizons."
        )
    return kept, ", ".join(f"{h:g}" for h in wanted[len(kept) :])


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
    return log, samples_of(robot, log, chosen), chosen


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


def _models_beside(estimate: Estimate, samples: Samples) -> dict[str, RobotDynamics]:
    """Return the robots to simulate beside an estimate, by name.

    Its description as it is and with friction fitted, where the description has masses, and the
    least-squares fit of the same rows, where the estimate is not one itself.
    """
    found: dict[str, RobotDynamics] = {}
    problem = estimate.problem
    if np.any(problem.robot.prior[:, 0] > 0.0):
        found[DESCRIPTION] = described_dynamics(problem.robot, samples)
        found[FRICTION_FITTED] = replace(estimate.model(), theta=frozen(friction_fitted(estimate)))
    if estimate.method != "wls":
        # Where no rows determine it, the others stand.
        with contextlib.suppress(SdpidError):
            found[LEAST_SQUARES] = solve_wls(replace(problem, prior=None)).model()
    return found


def _noisier(log: Recording, rng: np.random.Generator) -> Recording:
    """Return a recording with white noise added that is as strong as its own."""

    def again(signals: Array) -> Array:
        levels = noise_of(signals, log.rate_hz)
        return np.asarray(signals + levels * rng.standard_normal(signals.shape))

    return replace(
        log,
        position=again(log.position),
        effort=again(log.effort),
        velocity=None if log.velocity is None else again(log.velocity),
    )
