"""Estimate parameters from a closed loop, not from the measured motion's noise."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen
from sdpid._common.threads import one_thread
from sdpid.errors import DataError, ModelError, SolverError
from sdpid.estimation.closed_loop.instruments import Instruments, source_of
from sdpid.estimation.closed_loop.loop import FOLLOWS, START, ClosedLoop, ControllerCheck
from sdpid.estimation.closed_loop.rounds import (
    MEANING,
    DidimRounds,
    InstrumentRounds,
    SensitivityRounds,
    Solver,
    iterate,
)
from sdpid.estimation.estimate import FEASIBLE, Estimate, extended
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp, solved_or_found
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.preparation.prepare import ProcessingOf
from sdpid.experiment.preparation.twin import Twin
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.simulation.controllers import PD, Controller
from sdpid.experiment.simulation.law import under_law
from sdpid.robot.friction.posed import LoadFriction, PositionFriction
from sdpid.robot.friction.terms import Coupling
from sdpid.robot.model.arms import require_fixed_robot
from sdpid.robot.model.dynamics import RobotDynamics

Method = Literal["didim", "closed_loop"]
METHODS = {"didim": DidimRounds, "closed_loop": SensitivityRounds}

# Iterations end when one changes less than this share: predicted efforts of the residuals for
# instruments, as in [janot2014]_, the cost of itself for output error, as the benchmarks'
# [leboutet2021]_.
TOLERANCE = 0.025

# Gains that are off by this share show in the efforts of a few seconds, and every parameter of the
# output error is off by as much.
CONTROLLER = 0.03


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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class OutputErrorEstimate(Estimate):
    """An estimate whose simulated motion is the measured one.

    `problem` is the last linearized problem. It is what certificates, standard errors and
    intervals speak of: nothing says that no other parameters simulate better.

    Attributes
    ----------
    controller : Controller
        What closed the loop.
    position_error : ndarray, shape (n,)
        Root mean square of measured less simulated positions of each joint, filtered alike, rad
        (m).
    effort_ratio : ndarray, shape (n,)
        Measured efforts over those that the controller gives on the measured motion, by
        instruments. Far from one, the controller is another.
    effort_ratio_error : ndarray, shape (n,)
        Its standard error; infinite where a joint has no effort.
    simulations : int
        How often the recordings were simulated.

    Examples
    --------
    >>> law = sdpid.controllers.PD(np.full(6, 4000.0), np.full(6, 200.0))
    >>> found = sdpid.solve_output_error(problem, log, controller=law, reference=log.position)
    >>> found.status, found.simulations == found.iterations + 1
    ('optimal', True)
    >>> print(sdpid.certify(found).summary())
    of the last linearized problem, and no more: feasible with margin ...
    """

    controller: Controller
    position_error: Array = field(repr=False)
    effort_ratio: Array = field(repr=False)
    effort_ratio_error: Array = field(repr=False)
    simulations: int

    def __repr__(self) -> str:
        return f"{super().__repr__()[:-1]}, of {MEANING})"


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
    solver: Solver = solve_sdp,
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
    _check(max_iterations, tolerance=tolerance)
    purpose = "solve_instrumental"
    given, _ = problem_of(problem, purpose)
    source = source_of(given, recording, purpose, processing, reference, controller, instruments)
    began = time.perf_counter()
    model = None if source.loop is None else starting(given, start, solver)[0]
    rounds = InstrumentRounds(source, model, tolerance)
    status, first = iterate(rounds, solver, max_iterations), rounds.first
    count = len(rounds.changes)
    note = source.note(first)
    weak = f"weak for {', '.join(first.weak)}" if first.weak else None
    counted = f"{count} {'round' if count == 1 else 'rounds'}"
    said = (f"instruments: {source.words}, {counted}", note, weak, rounds.found.message)
    found = extended(
        InstrumentalEstimate,
        rounds.found,
        method="instrumental",
        message="; ".join(filter(None, said)),
        iterations=rounds.iterations,
        solve_time=time.perf_counter() - began,
        instruments=source.words,
        rounds=count,
        relevance=first.relevance,
        first_stage=first.statistics,
        weak=first.weak,
    )
    if status == "optimal":
        return found
    told = ", ".join(f"{100.0 * each:.2g}" for each in rounds.changes[-3:])
    lag = "" if note is None else f" {note[0].upper()}{note[1:]}."
    few = "" if weak is None else f" Instruments are {weak}."
    raise SolverError(
        f"solve_instrumental: not settled after {count} rounds: predicted efforts changed "
        f"by {told} % of the residuals in the last ones (limit {100.0 * tolerance:g} %)."
        f"{few}{lag} "
        "Check the controller and the reference, take instruments='reference' or 'periods', allow "
        "more (tolerance=), or more rounds (max_iterations=); the last estimate is attached.",
        problem=given,
        found=found,
    )


@one_thread
def solve_output_error(
    problem: Problem | Estimate,
    recording: Any,
    *,
    method: Method = "didim",
    controller: Controller | Literal["fit"] | None = None,
    reference: Any = None,
    start: ArrayLike | Estimate | None = None,
    solver: Solver | None = None,
    processing: ProcessingOf = None,
    control_hz: float | None = None,
    max_iterations: int = 10,
    tolerance: float = TOLERANCE,
    controller_tolerance: float = CONTROLLER,
    law: PD | None = None,
) -> OutputErrorEstimate:
    """Fit the motion of a simulated robot, in closed loop with its controller, to a recording.

    Encoders' noise is in the measured regressor and biases least squares. It is not in the motion
    of a simulated robot that follows the same commands. Every iteration simulates, and solves a
    semidefinite program under all constraints, so that every iterate is consistent. Which method
    to take: docs/guides/closed_loop.md.

    Parameters
    ----------
    problem : Problem or Estimate
        Built of the recording, with its rows. Its constraints, prior and weighting are kept.
    recording : Recording or path, or a sequence of these
        What the problem was built of, with the commanded positions (`Recording.reference`).
    method : {"didim", "closed_loop"}, optional
        ``"didim"`` [gautier2013]_ takes the measured efforts and the regressor of the simulated
        motion. It takes two or three iterations and hardly depends on the controller.
        ``"closed_loop"`` fits simulated positions to measured ones by Gauss-Newton with their
        sensitivities. It is the most precise where the controller is known exactly, and as wrong
        as the controller where not.
    controller : Controller or "fit", optional
        What closed the loop, one of `sdpid.controllers`; by default and with "fit" a controller is
        fitted to the first recording: PD, P or PID, the first that explains it.
    reference : Trajectory, ndarray of shape (N, n), or a sequence of these, optional
        What was commanded, where the recordings do not hold it; a trajectory begins with the
        recording.
    start : Estimate, or array_like of shape (p,) or (b,), optional
        Parameters that are simulated first, made consistent where they are not; by default the
        solution of the problem.
    solver : callable, optional
        What solves each linearized problem: by default `solve_sdp`, or `solve_wls` where the
        problem demands no consistency.
    processing : Processing or mapping, optional
        As the problem's samples were made; by default as `build_problem` does it.
    control_hz : float, optional
        Rate at which the controller runs, Hz; by default it is continuous.
    max_iterations : int, optional
        Largest number of linearized problems.
    tolerance : float, optional
        Iterations end when one lowers the cost by no more than this share.
    controller_tolerance : float, optional
        Largest share by which measured efforts may differ from those of the controller on the
        measured motion, three standard errors allowed for, for ``"closed_loop"``; ``inf`` allows
        any.
    law : sdpid.controllers.PD, optional
        In place of `controller`, where the problem was built with a law (`build_problem`): it made
        the efforts, and its commands act after its delay.

    Returns
    -------
    OutputErrorEstimate
        Its `problem` is the last linearized one, for certificates and errors; `history` has the
        cost of each iteration, all with the last variances of the joints.

    Raises
    ------
    ModelError
        When the robot has a floating base.
    DataError
        When options make no sense, nothing says what was commanded, the robot of the start does
        not follow it as it did in the recording, or ``"closed_loop"`` is asked for with a
        controller that is not that of the recording, or not known well enough, or with friction of
        the load or a coupling without a width.
    IdentifiabilityError
        When the simulated motion leaves a base parameter undetermined.
    SolverError
        When a simulated motion diverges, or does not follow the measured one; what was found so
        far is attached.

    Examples
    --------
    >>> run = sdpid.simulate(robot, motion, seed=1)
    >>> law = sdpid.controllers.fit_controller(run, "p").require()
    >>> whole = sdpid.build_problem(robot, sdpid.process(run))
    >>> found = sdpid.solve_output_error(whole, run, controller=law)
    >>> found.method, found.status, found.feasible
    ('didim', 'optimal', True)
    >>> found.problem.origin.meaning
    'the last linearized problem, and no more'
    """
    _check(max_iterations, tolerance=tolerance, controller_tolerance=controller_tolerance)
    if method not in METHODS:
        raise DataError(f"method is {method!r}: use 'didim' or 'closed_loop'.")
    given, estimate = problem_of(problem, "output error")
    if method == "closed_loop":
        _require_smooth(given)
    begin = time.perf_counter()
    if processing is None:
        processing = getattr(problem, "processing", None)
    if law is not None:
        if controller is not None or reference is not None:
            raise DataError(
                "law: says what closed the loop, and the recording what was commanded; leave "
                "controller and reference out."
            )
        controller, recording = under_law(given.robot, recording, law, "output error")
    loop = ClosedLoop(
        Twin.of(given.robot, recording, processing, measured=given.samples),
        controller,
        reference,
        control_hz=control_hz,
        exact=method != "didim",
        law=law is not None,
    )
    check = ControllerCheck(loop)
    if method == "closed_loop":
        check.require(controller_tolerance)
    solve = solver or (solve_wls if given.consistency == "none" else solve_sdp)
    model, first = starting(given, estimate if start is None else start, solve)
    if first is None:
        raise DataError("output error: start has other friction terms than the problem.")
    motions = loop.require(model, "the start")
    if (fault := check.fault(motions, START)) is not None:
        raise DataError(fault)
    rounds = METHODS[method](given, loop, first, motions, tolerance)
    status, history = iterate(rounds, solve, max_iterations), rounds.history
    words = (
        f"{len(history)} iterations, {rounds.simulations} simulations; "
        f"{rounds.at.message or 'no step lowers the cost'}"
    )
    found = extended(
        OutputErrorEstimate,
        rounds.at,
        method=rounds.method,
        status=status,
        message=words,
        iterations=len(history),
        solve_time=time.perf_counter() - begin,
        history=history,
        start=None if first.theta is None else frozen(first.theta),
        controller=loop.controller,
        position_error=frozen(np.sqrt(np.mean(loop.missed(rounds.motions) ** 2, axis=0))),
        effort_ratio=frozen(check.ratio),
        effort_ratio_error=frozen(check.error),
        simulations=rounds.simulations,
    )
    if (fault := check.fault(rounds.motions, FOLLOWS)) is not None:
        raise SolverError(fault, problem=given, found=found)
    return found


def _check(max_iterations: Any, **shares: float) -> None:
    """Refuse options that make no sense, before anything is simulated."""
    if isinstance(max_iterations, bool) or not max_iterations >= 1:
        raise DataError(f"max_iterations: is {max_iterations!r}, at least 1 is needed.")
    for name, value in shares.items():
        if not value > 0.0:
            raise DataError(f"{name}: is {value!r}; give a positive share, such as 0.025.")


def _require_smooth(problem: Problem) -> None:
    """Refuse friction whose part in the sensitivities is not known: errors would be too small."""
    # Friction of the load changes with the whole motion, and friction of two joints' sum jumps
    # where neither joint reverses.
    for term in problem.friction.terms:
        if isinstance(term, LoadFriction):
            words = "friction of the load"
        elif isinstance(term, PositionFriction):
            words = "friction over position"
        elif isinstance(term, Coupling) and term.width == 0.0:
            words = f"friction of {term.first} and {term.second} together without a width"
        else:
            continue
        raise DataError(
            f"output error: closed_loop cannot take {words}, which is not in the derivatives of "
            "the motion; use method='didim' or sdpid.solve_instrumental, which need none."
        )


def problem_of(given: Any, purpose: str) -> tuple[Problem, Estimate | None]:
    """Return a problem that motions in closed loop can be taken for, and its estimate if given.

    Raises
    ------
    ModelError
        When the robot has a floating base.
    DataError
        When it is no problem, its rows were not kept or are elsewhere, or it is not plain.
    """
    owner = getattr(given, "estimate", given)
    estimate = owner if isinstance(owner, Estimate) else None
    problem = owner if estimate is None else estimate.problem
    if not isinstance(problem, Problem):
        raise DataError(
            f"{purpose}: problem is {type(given).__name__} {given!r:.60}; give a Problem "
            "(sdpid.build_problem) or an Estimate of one."
        )
    problem.require_plain(purpose)
    rows = problem.require_rows_here(purpose)
    require_fixed_robot(problem.robot, purpose)
    if rows.samples.contacts is not None:
        raise DataError(
            f"{purpose}: contacts tie the rows of a sample together, and other motions are made "
            "for single rows; use solve_sdp."
        )
    return problem, estimate


def starting(problem: Problem, start: Any, solver: Solver) -> tuple[RobotDynamics, Estimate | None]:
    """Return the model that is simulated first, and its estimate; None of other friction terms.

    Parameters
    ----------
    problem : Problem
        Of the measured samples.
    start : Estimate, RobotDynamics, or array_like of shape (p,) or (b,), optional
        Standard or base parameters. Such as are not feasible are replaced by the feasible ones
        whose predicted efforts are nearest: base parameters that are off by 15 % each make mass
        matrices indefinite, and what has one cannot be simulated. By default the solution of the
        problem.
    solver : callable
        What solves the problem.

    Raises
    ------
    ModelError
        When it is of another robot.
    DataError
        When it is no estimate, or its numbers have another shape or are not finite.
    """
    if start is None:
        found = solved_or_found(problem, solver)
        return found.model(), found
    values = getattr(start, "estimate", start)
    if isinstance(values, (Estimate, RobotDynamics)):
        model = values.model() if isinstance(values, Estimate) else values
        if model.robot.joint_names != problem.robot.joint_names:
            raise ModelError(
                f"start: is of '{model.robot.name}', the problem of '{problem.robot.name}'."
            )
        if model.theta.size != problem.n_theta:
            return model, None
        values = model.theta if values.theta is not None else values.base
    found = _nearest_feasible(problem, values, solver)
    return found.model(), found


def _nearest_feasible(problem: Problem, start: Any, solver: Solver) -> Estimate:
    """Return standard or base parameters as an estimate, the nearest feasible one."""
    try:
        values = np.asarray(start, dtype=np.float64)
        said = f"has shape {values.shape}"
    except (TypeError, ValueError):
        values, said = np.zeros(0), f"is {start!r:.80}"
    p, b = problem.n_theta, problem.base.count
    if values.shape not in ((p,), (b,)) or not np.all(np.isfinite(values)):
        raise DataError(
            f"start: {said}; give an Estimate, its model(), or ({p},) standard or ({b},) base "
            "parameters, all finite."
        )
    free = solver is solve_wls or problem.consistency == "none"
    if values.shape == (p,) and (free or problem.feasible.violation(values) <= FEASIBLE):
        return Estimate.of_theta(problem, values, method="given", status="given")
    base = frozen(values if values.shape == (b,) else problem.base_of(values))
    if free:
        return Estimate(problem=problem, method="given", base=base, theta=None, status="given")
    return solve_sdp(replace(problem, rhs=frozen(problem.A @ base), floor=0.0, prior=None))
