"""The instrumental estimate under the constraints of its problem."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.threads import one_thread
from sdpid.errors import DataError, SolverError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.instrumental.moments import Columns
from sdpid.estimation.instrumental.second_stage import SecondStage, require_instrumentable
from sdpid.estimation.instrumental.sources import Instruments, source_of, start_model, with_lag
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.preparation.several import ProcessingOf
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.simulation.law import Controller
from sdpid.robot.model.dynamics import RobotDynamics

# Instruments have settled when the efforts of the estimate change by less than this share of the
# residuals, as in [janot2014]_.
TOLERANCE = 0.025

# Rounds that settle change a third as much each time, and less; where the change does not fall to
# this part of the last, the next model is half-way.
_FALLING = 0.7

# After so many rounds without a smaller change there is no use in going on.
_PATIENCE = 3


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class InstrumentalEstimate(Estimate):
    """An estimate from instruments; `problem` is that of the last instruments.

    Its cost is that of two-stage least squares: what the optimum and its certificate say holds for
    the instruments that were taken last, and no more.

    Attributes
    ----------
    instruments : str
        What the instruments are.
    rounds : int
        How often instruments were made.
    relevance : ndarray, shape (b,)
        Shea's partial R² of each base parameter: how much of its part of the measured regressor
        the instruments see. Its square root is the ratio of the standard errors of least squares
        to those with instruments, for the same noise.
    first_stage : ndarray, shape (b,)
        F statistic of the first stage of each base parameter.
    weak : tuple of str
        Base parameters whose F statistic is below 10: their estimates lean towards least squares.

    Examples
    --------
    >>> second = sdpid.solve_instrumental(problem, log, instruments="periods")
    >>> second.instruments
    'the motion in the other half of the periods'
    >>> second.weak, bool(second.relevance.min() > 0.9)
    ((), True)
    """

    instruments: str
    rounds: int
    relevance: Array = field(repr=False)
    first_stage: Array = field(repr=False)
    weak: tuple[str, ...] = ()


@one_thread
def solve_instrumental(
    problem: Problem,
    recording: Any = None,
    *,
    processing: ProcessingOf = None,
    reference: Any = None,
    controller: Controller | Literal["fit"] | None = None,
    instruments: Instruments | Samples | None = None,
    start: Any = None,
    solver: Callable[[Problem], Estimate] = solve_sdp,
    max_iterations: int = 10,
    tolerance: float = TOLERANCE,
) -> InstrumentalEstimate:
    """Estimate parameters that noise in the measured motion does not bias.

    Least squares takes the measured motion as exact; where encoders are noisy, the regressor's
    noise pulls the estimate off, the more so in closed loop. Instruments are columns that move with
    the regressor but not with the noise [janot2014]_: the regressor of the motion that the model
    makes in the same closed loop, made anew until the estimate no longer changes, of the commanded
    motion, or of other periods. The problem's weights, constraints and prior stay.

    Parameters
    ----------
    problem : Problem
        Of the measured samples.
    recording : Recording or path, or a sequence of these
        What the problem was built of. Not needed with Samples as `instruments`.
    processing : Processing or mapping, optional
        As the problem's samples were processed; by default as `identify` chooses.
    reference : Trajectory or (N, n) array_like, or a sequence of these, optional
        What was commanded: positions at the recording's time stamps, or the trajectory that begins
        with it. By default `Recording.reference`.
    controller : Controller or "fit", optional
        That of the robot, from `sdpid.controllers`, or one fitted to the first recording (see
        `sdpid.controllers.fit_controller`). Wrong gains cost accuracy, but bias nothing.
    instruments : {"simulated", "reference", "periods"} or Samples, optional
        The motion of the model under `controller`; the commanded motion; either half of the
        periods as the other's instrument, as noise of different periods is independent; or another
        motion, processed as the measured one. By default simulated with a controller, else
        periods where there are two, else the commanded motion.
    start : Estimate or RobotDynamics, optional
        The first model to simulate; by default what `solver` makes of the problem.
    solver : callable, optional
        What solves each problem: `solve_sdp`, or `solve_wls` without constraints.
    max_iterations : int, optional
        Largest number of rounds.
    tolerance : float, optional
        The rounds end when the predicted efforts change by less than this share of the residuals.

    Returns
    -------
    InstrumentalEstimate
        With ``method="instrumental"``. Standard errors, intervals and comparisons are sandwich
        estimates of instruments and residuals, as those of any estimate.

    Raises
    ------
    DataError
        When there is no reference and no second period, joints or samples do not match, the model
        cannot follow the reference, or the problem has no rows here, or a weighting without rows.
    IdentifiabilityError
        When the instruments do not move with the measured motion.
    SolverError
        When the rounds do not settle; the last estimate is attached. And whatever the solver
        raises.

    Examples
    --------
    >>> second = sdpid.solve_instrumental(problem, log, instruments="periods")
    >>> second.method, second.status, second.rounds
    ('instrumental', 'optimal', 1)
    >>> bool(np.abs(second.base / estimate.base - 1.0).max() < 0.2)
    True
    >>> sdpid.certify(second).passed
    True
    """
    if max_iterations < 1:
        raise DataError(f"max_iterations: is {max_iterations}, at least 1 is needed.")
    if not 0.0 < tolerance < 1.0:
        raise DataError(f"tolerance: is {tolerance!r}, expected a number between 0 and 1.")
    require_instrumentable(problem, "solve_instrumental")
    source = source_of(
        problem,
        recording,
        purpose="solve_instrumental",
        processing=processing,
        reference=reference,
        controller=controller,
        instruments=instruments,
    )
    began = time.perf_counter()
    model = start_model(problem, start, solver) if source.follows_model else None
    # Without a model there is but one round, and a model of other terms has other parameters.
    base = np.zeros(problem.base.count)
    if model is not None and model.theta.size == problem.n_theta:
        base = problem.base_of(model.theta)
    columns = Columns.of(problem)
    iterations, found, changes = 0, None, []
    for rounds in range(1, max_iterations + 1):
        first = source.first_stage(columns, model)
        first.require_strong(source.words)
        stage = first.second(_meaning(source.words))
        solved = solver(stage.problem)
        iterations += solved.iterations
        changes.append(_change(stage.problem, base, solved.base))
        seconds = time.perf_counter() - began
        note = with_lag(source.note, first, source)
        found = _estimate(solved, stage, source.words, note, rounds, iterations, seconds)
        if not source.follows_model or changes[-1] <= tolerance:
            return found
        if len(changes) > _PATIENCE and min(changes[-_PATIENCE:]) > changes[-_PATIENCE - 1]:
            break
        base, model = solved.base, _next(model, solved.model(), changes)
    assert found is not None
    told = ", ".join(f"{100.0 * each:.2g}" for each in changes[-3:])
    weak = f" Instruments are weak for {', '.join(found.weak)}." if found.weak else ""
    lag = "" if note is None else f" {note[0].upper()}{note[1:]}."
    raise SolverError(
        f"solve_instrumental: not settled after {rounds} rounds: predicted efforts changed by "
        f"{told} % of the residuals in the last ones (limit {100.0 * tolerance:g} %).{weak}{lag} "
        "Check the controller and the reference, take instruments='reference' or 'periods', allow "
        "more (tolerance=), or more rounds (max_iterations=); the last estimate is attached.",
        problem=problem,
        found=found,
    )


def _next(
    before: RobotDynamics | None, after: RobotDynamics, changes: list[float]
) -> RobotDynamics:
    """Return the model to simulate next: half-way, where the rounds do not come closer.

    Consistent parameters are convex: between two models there are only models.
    """
    slow = len(changes) > 1 and changes[-1] > _FALLING * changes[-2]
    if not slow or before is None or before.theta.shape != after.theta.shape:
        return after
    return replace(after, theta=0.5 * (before.theta + after.theta))


def _meaning(words: str) -> str:
    return f"the problem of the last instruments ({words}), no more"


def _change(problem: Problem, before: Array, after: Array) -> float:
    """Return how much predicted efforts change, as a share of the residuals (whitened)."""
    moved = problem.A @ (after - before)
    residual = problem.cost(after)
    return float(np.sqrt(moved @ moved / max(residual, np.finfo(float).tiny)))


def _estimate(
    solved: Estimate,
    stage: SecondStage,
    words: str,
    note: str | None,
    rounds: int,
    iterations: int,
    seconds: float,
) -> InstrumentalEstimate:
    """Return the estimate with what is known of its instruments."""
    weak = stage.weak
    said = [f"instruments: {words}, {rounds} {'round' if rounds == 1 else 'rounds'}"]
    if note is not None:
        said.append(note)
    if weak:
        said.append(f"weak for {', '.join(weak)}")
    own = {each.name: getattr(solved, each.name) for each in fields(Estimate)}
    changes = {
        "method": "instrumental",
        "message": "; ".join([*said, solved.message]),
        "iterations": iterations,
        "solve_time": seconds,
    }
    return InstrumentalEstimate(
        **{**own, **changes},
        instruments=words,
        rounds=rounds,
        relevance=stage.relevance,
        first_stage=stage.first_stage,
        weak=weak,
    )
