"""Where instruments come from: a simulated motion, the commanded one, or other periods."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError, SolverError
from sdpid.estimation.commanded import commanded
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.instrumental.lag import lag_words
from sdpid.estimation.instrumental.moments import Columns
from sdpid.estimation.instrumental.second_stage import FirstStage
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.preparation.several import ProcessingOf, chosen_processing, recordings
from sdpid.experiment.preparation.twin import Twin
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.floating.robots import require_fixed_base
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.closed_loop import simulate_closed_loop
from sdpid.experiment.simulation.fit_controller import fit_controller
from sdpid.experiment.simulation.law import Controller
from sdpid.robot.model.dynamics import RobotDynamics

Instruments = Literal["simulated", "reference", "periods"]
KINDS: tuple[Instruments, ...] = ("simulated", "reference", "periods")

# Laws that are tried, the most common first.
_FITTED = ("pd", "p", "pid")

# Each half of the periods is at least one.
_FEWEST_PERIODS = 2


class Source(Protocol):
    """Something that makes instruments for a problem."""

    @property
    def words(self) -> str:
        """What the instruments are."""

    @property
    def note(self) -> str | None:
        """What one should know of the choice."""

    @property
    def follows_model(self) -> bool:
        """Whether another model gives other instruments."""

    def first_stage(self, columns: Columns, model: RobotDynamics | None) -> FirstStage:
        """Return the instrumental estimate with the instruments that a model gives."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GivenMotion:
    """Another motion of the same samples."""

    instruments: Samples
    words: str
    note: str | None = None
    follows_model: bool = False

    def first_stage(self, columns: Columns, model: RobotDynamics | None) -> FirstStage:
        """Return the estimate with this motion as instrument."""
        return FirstStage.of_motion(columns, self.instruments)


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedMotion:
    """The motion of a model in the closed loop of the recordings.

    Attributes
    ----------
    twin : Twin
        The recordings.
    commanded : tuple of ndarray, shape (N, n)
        Reference of each.
    controller : Controller
        What follows it.
    """

    twin: Twin
    commanded: tuple[Array, ...]
    controller: Controller
    words: str = "the motion of the model in closed loop"
    note: str | None = None
    follows_model: bool = True

    def first_stage(self, columns: Columns, model: RobotDynamics | None) -> FirstStage:
        """Simulate the model, and return the estimate with its motion as instrument.

        Raises
        ------
        DataError
            When the simulated robot runs away.
        """
        assert model is not None
        positions, velocities = [], []
        for log, reference in zip(self.twin.logs, self.commanded, strict=True):
            motion = simulate_closed_loop(model, replace(log, reference=reference), self.controller)
            if motion.diverged is not None:
                raise DataError(
                    f"controller: cannot make the model follow the reference: the simulated motion "
                    f"diverges at {motion.diverged:.4g} s of {log.duration:.4g} s; check the "
                    "controller's gains and units, start from a consistent estimate (solve_sdp), "
                    "or take the reference itself (instruments='reference')."
                )
            positions.append(motion.position)
            velocities.append(motion.velocity)
        instruments = self.twin.samples(positions, velocity=velocities)
        return FirstStage.of_motion(columns, instruments)


@dataclass(frozen=True, kw_only=True, eq=False)
class OtherPeriods:
    """Either half of a record's periods, as the other's instrument."""

    first: Samples
    second: Samples
    words: str = "the motion in the other half of the periods"
    note: str | None = None
    follows_model: bool = False

    def first_stage(self, columns: Columns, model: RobotDynamics | None) -> FirstStage:
        """Return the estimate with the halves as each other's instruments."""
        return FirstStage.of_halves(columns, self.first, self.second)


def with_lag(note: str | None, first: FirstStage, source: Source) -> str | None:
    """Return the note on a choice, with a lag that should not be.

    A robot comes later than what is commanded, but never earlier; and its model in the same loop
    moves when it does.
    """
    lag = first.lag
    if lag is None or (lag > 0.0 and not source.follows_model):
        return note
    cause = "the commanded positions are not those of these times"
    if source.follows_model:
        cause += ", or the controller is not that of this log"
    told = f"{source.words}: {lag_words(lag)}, so {cause}"
    return told if note is None else f"{note}; {told}"


def source_of(
    problem: Problem,
    recording: Any,
    *,
    purpose: str,
    processing: ProcessingOf = None,
    reference: Any = None,
    controller: Controller | Literal["fit"] | None = None,
    instruments: Instruments | Samples | None = None,
) -> Source:
    """Return where instruments for a problem come from.

    Parameters
    ----------
    problem : Problem
        The problem.
    recording : Recording or path, a sequence of these, or None
        What it was built of.
    purpose : str
        For messages.
    processing, reference, controller, instruments
        As for `solve_instrumental`.

    Raises
    ------
    DataError
        When there is nothing to take, or what is given does not belong to the problem.
    """
    if isinstance(instruments, Samples):
        return _given(problem, instruments)
    if instruments is not None and instruments not in KINDS:
        raise DataError(
            f"instruments: is {instruments!r:.80}; use one of {', '.join(map(repr, KINDS))}, or "
            "Samples of another motion."
        )
    if recording is None:
        raise DataError(
            f"{purpose}: needs the recording that the problem was built of, to know what was "
            "commanded or to split its periods; give it, or instruments=Samples(...)."
        )
    read = recordings(recording, "recording")
    for log in read:
        require_fixed_base(log, purpose)
    logs = tuple(match_joints(problem.robot, log) for log in read)
    chosen, _ = chosen_processing(logs, processing)
    twin = Twin.of(problem.robot, logs, chosen, measured=problem.samples)
    told = commanded(twin.logs, reference)
    if instruments is None:
        instruments = _best(twin.logs, told, controller)
    if instruments == "periods":
        return _periods(problem, twin, purpose)
    if told is None:
        raise DataError(
            f"{purpose}: instruments={instruments!r} needs what was commanded; read the log with "
            "its columns of commanded positions (Recording.reference), or give reference=."
        )
    if instruments == "reference":
        return _reference(twin, told)
    return _simulated(twin, told, controller, purpose)


def _best(
    logs: tuple[Recording, ...], commanded: object | None, controller: object | None
) -> Instruments:
    """Return the instruments that are strongest, of those that there are."""
    if commanded is not None and controller is not None:
        return "simulated"
    layout = logs[0].period_layout
    repeats = layout is not None and layout[2] >= _FEWEST_PERIODS
    # A robot may lag far behind what is commanded, but follows itself.
    return "periods" if commanded is None or repeats else "reference"


def _given(problem: Problem, instruments: Samples) -> GivenMotion:
    """Return another motion that was processed elsewhere."""
    samples = problem.samples
    if instruments.position.shape != samples.position.shape or instruments.starts != samples.starts:
        raise DataError(
            f"instruments: {instruments!r} do not stand beside the problem's {samples!r}, row by "
            "row; process both alike (sdpid.Processing) and keep every sample."
        )
    return GivenMotion(instruments=instruments, words="the motion given")


def _reference(twin: Twin, commanded: tuple[Array, ...], note: str | None = None) -> GivenMotion:
    """Return the commanded motion as instrument."""
    samples = twin.samples(commanded)
    return GivenMotion(instruments=samples, words="the commanded motion", note=note)


def _simulated(
    twin: Twin,
    commanded: tuple[Array, ...],
    controller: Controller | Literal["fit"] | None,
    purpose: str,
) -> SimulatedMotion:
    """Return the motion of a model under a controller that is given, or fitted.

    Raises
    ------
    DataError
        When there is no controller, or the recordings do not show it well enough.
    """
    words = SimulatedMotion.words
    if isinstance(controller, str):
        if controller != "fit":
            raise DataError(
                f"{purpose}: controller is {controller!r}; give one of sdpid.controllers, or 'fit'."
            )
        log = replace(twin.logs[0], reference=commanded[0])
        controller = _fitted(log)
        words = f"{words}, its controller fitted"
    if controller is None:
        raise DataError(
            f"{purpose}: instruments='simulated' needs the controller that followed the reference; "
            "give one of sdpid.controllers, or controller='fit', or take instruments='reference'."
        )
    return SimulatedMotion(twin=twin, commanded=commanded, controller=controller, words=words)


def _fitted(log: Recording) -> Controller:
    """Return a controller that explains a log's efforts: of the kinds that need nothing else.

    Raises
    ------
    DataError
        When none is known well enough.
    """
    tried = [fit_controller(log, kind) for kind in _FITTED]
    usable = [each for each in tried if each.usable]
    return (usable or tried)[0].require()


def _periods(problem: Problem, twin: Twin, purpose: str) -> OtherPeriods:
    """Return the halves of a record's periods.

    Raises
    ------
    DataError
        When there are fewer than two periods.
    """
    log = twin.logs[0]
    layout = log.period_layout
    if layout is None or layout[2] < _FEWEST_PERIODS:
        raise DataError(
            f"{purpose}: the recording has neither commanded positions nor two periods, so "
            "nothing tells its motion from its noise; read the log with its columns of commanded "
            "positions (Recording.reference), give reference=, or record the motion twice."
        )
    first, length, count = layout
    half = count // 2
    plain = replace(twin.processing, covariance=None)
    begin = log.stamps.first + first * log.step
    samples = problem.samples
    halves = []
    for start, periods in ((0, half), (half, count - half)):
        own = replace(log, start=begin + start * length * log.step, periods=periods)
        found = process(own, plain, progress=False)
        halves.append(
            replace(found, mask=samples.mask, block=samples.block, covariance=samples.covariance)
        )
    return OtherPeriods(first=halves[0], second=halves[1])


def start_model(
    problem: Problem, start: Any, solver: Callable[[Problem], Estimate] = solve_sdp
) -> RobotDynamics:
    """Return the model that instruments start from: a given one, or what a solver finds.

    Raises
    ------
    DataError
        When it is no estimate, or of another robot.
    """
    if start is None:
        return _first(problem, solver).model()
    if isinstance(start, RobotDynamics):
        model = start
    elif hasattr(start, "model"):
        model = start.model()
    else:
        raise DataError(f"start: is {start!r:.80}; give an Estimate, or its model().")
    if model.robot.joint_names != problem.robot.joint_names:
        raise ModelError(
            f"start: is of '{model.robot.name}', the problem of '{problem.robot.name}'."
        )
    return model


def _first(problem: Problem, solver: Callable[[Problem], Estimate]) -> Estimate:
    """Return a solver's estimate; what it found where it proves no optimum will do for a start."""
    try:
        return solver(problem)
    except SolverError as error:
        found = error.found
        if not isinstance(found, Estimate) or not found.feasible:
            raise
        return found
