"""What a rollout needs whichever joints are free: states, starts, and the models beside."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen
from sdpid._common.seeds import generator
from sdpid.assurance.diagnostics.described import described_dynamics
from sdpid.assurance.diagnostics.held_out import (
    DESCRIPTION,
    FRICTION_FITTED,
    LEAST_SQUARES,
    OURS,
    friction_fitted,
)
from sdpid.assurance.diagnostics.light_joints import LightJoint, light_joints
from sdpid.assurance.diagnostics.validation import validate_dynamics
from sdpid.errors import DataError, SdpidError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.preparation.for_robot import prepare
from sdpid.experiment.preparation.several import joints_without
from sdpid.experiment.processing.choose import default_processing, with_changes
from sdpid.experiment.processing.motion import noise_of
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

# A model that comes without an estimate.
MODEL = "this model"


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
    horizons : tuple of float
        Those of the horizons asked for that the recording is long enough for, s.
    first : ndarray of int, shape (S,)
        Instants of the track at which simulations start.
    after, at : ndarray of int, shapes (L,) and (H,)
        Steps after which errors are taken, and which of them are horizons.
    light : tuple of LightJoint
        Joints of the model that are too light.
    starts : str
        How many there are, how far apart.
    notes : tuple of str
        What is left out.
    """

    model: RobotDynamics
    arm: SimulatedArm
    name: str
    beside: Mapping[str, RobotDynamics]
    absent: tuple[str, ...]
    log: Recording | None
    track: Track
    again: Track | None
    horizons: tuple[float, ...]
    first: Indices
    after: Indices
    at: Indices
    light: tuple[LightJoint, ...]
    starts: str
    notes: tuple[str, ...]

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
        arm = SimulatedArm.of(model)
        wanted = np.atleast_1d(np.asarray(horizons, dtype=np.float64))
        if wanted.ndim != 1 or not wanted.size or not np.all((wanted > 0) & np.isfinite(wanted)):
            raise DataError(f"horizons: are {horizons!r:.80}; give times in s, each above 0.")
        wanted = np.unique(wanted)
        absent = _without(judged, model.robot, without_effort)
        rng = generator(seed)
        log, samples, chosen = _prepared(model.robot, recording, processing)
        track = Track.of(samples)
        time = np.asarray(samples.time)
        longest = max(float(time[part][-1] - time[part][0]) for part in samples.parts)
        kept = tuple(wanted[wanted < longest].tolist())
        if not kept:
            raise DataError(
                f"horizons: the shortest is {wanted[0]:g} s, and the recording has {longest:.3g} s "
                "without a break once the filter's ends are cut off; record longer, or give "
                "shorter horizons."
            )
        every = start_every
        if every is None:
            every = max(_EVERY, (longest - kept[-1]) / _MOST_STARTS)
        elif not (np.isfinite(every) and every > 0.0):
            raise DataError(f"start_every: is {every!r}; give a time in s, above 0.")
        first = track.starts(kept[-1], every)
        ends = np.array([track.steps(h) for h in kept])
        curve = np.linspace(1, ends[-1], min(_INSTANTS, ends[-1])).round().astype(np.intp)
        after = np.unique(np.concatenate([ends, curve]))
        notes = []
        if absent:
            notes.append(f"on the record, as their effort is not used: {', '.join(absent)}")
        if left := ", ".join(f"{h:g}" for h in wanted[len(kept) :]):
            notes.append(
                f"no horizon of {left} s: the recording has {longest:.3g} s without a break"
            )
        if log is None:
            notes.append("no floor of noise: samples do not tell the noise; give the recording")
        again = None if log is None else Track.of(prepare(model.robot, _noisier(log, rng), chosen))
        return cls(
            model=model,
            arm=arm,
            name=name,
            beside=_models_beside(judged, samples) if judged is not None and baselines else {},
            absent=absent,
            log=log,
            track=track,
            again=again,
            horizons=kept,
            first=first,
            after=after,
            at=np.searchsorted(after, ends),
            light=light_joints(model, samples, validate_dynamics(model, samples).moving),
            starts=f"{len(first)} starts, {every:.3g} s apart",
            notes=tuple(notes),
        )


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
