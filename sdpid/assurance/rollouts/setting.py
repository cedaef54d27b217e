"""What a rollout needs whichever joints are free: states, starts, and the models beside."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Indices
from sdpid._common.seeds import generator
from sdpid.assurance.diagnostics.held_out import OURS
from sdpid.assurance.diagnostics.motion.light_joints import LightJoint, light_joints
from sdpid.assurance.diagnostics.validation import validate_dynamics
from sdpid.assurance.rollouts.models import MODEL, models_beside
from sdpid.assurance.rollouts.noise import noisier
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.preparation.for_robot import prepare
from sdpid.experiment.preparation.several import joints_without
from sdpid.experiment.processing.choose import default_processing, with_changes
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.readers.read import read_recording
from sdpid.experiment.recording.floating.robots import require_fixed_base
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.open_loop import Track
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel

# Times after each start at which errors are told, s.
HORIZONS = (0.1, 0.5, 2.0)

# Simulations start this far apart, s, unless that is too many.
_EVERY, _MOST_STARTS = 0.25, 60

# Instants at which curves over time are drawn.
_INSTANTS = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Setting:
    """Simulations of one recording, but for which joints are free.

    Attributes
    ----------
    model, arm : RobotDynamics, SimulatedArm
        What is judged, and what of it is simulated.
    name : str
        Its name.
    beside : dict of str to RobotDynamics
        What else is simulated.
    absent : tuple of str
        Joints whose effort is not used.
    log : Recording or None
        The recording; None where samples were given.
    track, again : Track, Track or None
        The recording, and with as much noise again.
    wanted, horizons : tuple of float
        Horizons asked for, and those that the recording is long enough for, s.
    longest : float
        The longest stretch of the recording without a break, s.
    every : float
        Time between starts, s.
    first : ndarray of int, shape (S,)
        Instants of the track at which simulations start.
    after, at : ndarray of int, shapes (L,) and (H,)
        Steps after which errors are taken, and which of them are horizons.
    light : tuple of LightJoint
        Joints of the model that are too light.
    """

    model: RobotDynamics
    arm: SimulatedArm
    name: str
    beside: Mapping[str, RobotDynamics]
    absent: tuple[str, ...]
    log: Recording | None
    track: Track
    again: Track | None
    wanted: tuple[float, ...]
    horizons: tuple[float, ...]
    longest: float
    every: float
    first: Indices
    after: Indices
    at: Indices
    light: tuple[LightJoint, ...]

    @classmethod
    def of(
        cls,
        estimate: Estimate | RobotDynamics,
        recording: Recording | str | os.PathLike[str] | Samples,
        horizons: Sequence[float] = HORIZONS,
        *,
        without_effort: Iterable[str] = (),
        start_every: float | None = None,
        processing: Processing | Mapping[str, Any] | None = None,
        baselines: bool = True,
        seed: int | np.random.Generator = 0,
    ) -> Setting:
        """Prepare what is given, as `sdpid.rollout` takes it."""
        model, judged, name = judged_model(estimate)
        robot, arm = model.robot, SimulatedArm.of(model)
        wanted = _checked_horizons(horizons)
        absent = _without(judged, robot, without_effort)
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
                "without a break once the filter's ends are cut off; record longer, or give "
                "shorter horizons."
            )
        every = _spacing(start_every, longest - kept[-1])
        after, at = _instants(track, kept)
        again = None
        if log is not None:
            again = Track.of(prepare(robot, noisier(log, rng), chosen))
        return cls(
            model=model,
            arm=arm,
            name=name,
            beside=models_beside(judged, samples) if judged is not None and baselines else {},
            absent=absent,
            log=log,
            track=track,
            again=again,
            wanted=wanted,
            horizons=kept,
            longest=longest,
            every=every,
            first=track.starts(kept[-1], every),
            after=after,
            at=at,
            light=light_joints(model, samples, validate_dynamics(model, samples).moving),
        )

    def said(self, *, in_loop: bool) -> tuple[str, ...]:
        """Return what is done, in words; in a loop efforts are those of a controller."""
        starts = f"{len(self.first)} starts, {self.every:.3g} s apart, simulated"
        steps = f"in steps of {1e3 * self.track.step:.3g} ms"
        under = f"{steps} under the filtered efforts, which raw ones hardly change"
        said = [f"{starts} {'in closed loop' if in_loop else under}"]
        if self.absent:
            said.append(f"on the record, as their effort is not used: {', '.join(self.absent)}")
        if len(self.horizons) < len(self.wanted):
            left = ", ".join(f"{h:g}" for h in self.wanted[len(self.horizons) :])
            without = f"the recording has {self.longest:.3g} s without a break"
            said.append(f"no horizon of {left} s: {without}")
        if self.log is None:
            said.append("no floor of noise: samples do not tell the noise; give the recording")
        return tuple(said)


def judged_model(given: Any) -> tuple[RobotDynamics, Estimate | None, str]:
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
