"""Estimate parameters from what a simulated robot does, not from the measured motion's noise."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import frozen
from sdpid._common.threads import one_thread
from sdpid.errors import DataError, SolverError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.output_error import closed_loop, didim
from sdpid.estimation.output_error.checks import FOLLOWS, START, ControllerCheck
from sdpid.estimation.output_error.followed import ClosedLoop
from sdpid.estimation.output_error.result import OutputErrorEstimate
from sdpid.estimation.output_error.starts import solver_of, starting
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.several import ProcessingOf
from sdpid.experiment.preparation.twin import Twin
from sdpid.experiment.simulation.law import Controller
from sdpid.robot.friction.posed import LoadFriction
from sdpid.robot.friction.terms import Coupling
from sdpid.robot.model.contacts.open_chain import require_fixed_robot

Method = Literal["didim", "closed_loop"]
METHODS = ("didim", "closed_loop")
_NAMES = {"didim": "didim", "closed_loop": "closed_loop_output_error"}

# The benchmarks' own: a further iteration would move less than this share [leboutet2021]_.
_TOLERANCE = 0.025

# Gains that are off by this share show in the efforts of a few seconds, and every parameter of the
# output error is off by as much.
CONTROLLER = 0.03


@one_thread
def solve_output_error(
    problem: Problem | Estimate,
    recording: Any,
    *,
    method: Method = "didim",
    controller: Controller | Literal["fit"] | None = None,
    reference: Any = None,
    start: ArrayLike | Estimate | None = None,
    solver: Callable[[Problem], Estimate] | None = None,
    processing: ProcessingOf = None,
    control_hz: float | None = None,
    max_iterations: int = 10,
    tolerance: float = _TOLERANCE,
    controller_tolerance: float = CONTROLLER,
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
        What closed the loop, one of `sdpid.controllers`; by default and with "fit" a PD controller
        is fitted to the first recording.
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
    owner = getattr(problem, "estimate", problem)
    given = owner.problem if isinstance(owner, Estimate) else owner
    _check(given, method, max_iterations, tolerance, controller_tolerance)
    begin = time.perf_counter()
    if processing is None:
        processing = getattr(problem, "processing", None)
    twin = Twin.of(given.robot, recording, processing, measured=given.samples)
    law = _controller(controller, twin, method)
    loop = ClosedLoop.of(twin, law, reference, control_hz)
    check = ControllerCheck.of(loop)
    if method == "closed_loop":
        check.require(controller_tolerance)
    if start is None and isinstance(owner, Estimate):
        start = owner
    solve = solver_of(given, solver)
    first = starting(given, start, solve)
    followed = loop.require(first.model(), "the start")
    if (fault := check.fault(loop, followed, START)) is not None:
        raise DataError(fault)
    run = didim.iterate if method == "didim" else closed_loop.iterate
    search = run(given, loop, first, followed, solve, max_iterations, tolerance)
    missed = np.sqrt(np.mean(loop.missed(search.followed) ** 2, axis=0))
    words = (
        f"{len(search.history)} iterations, {search.simulations} simulations; "
        f"{search.estimate.message or 'no step lowers the cost'}"
    )
    estimate = OutputErrorEstimate.of(
        replace(
            search.estimate,
            method=_NAMES[method],
            status=search.status,
            message=words,
            iterations=len(search.history),
            solve_time=time.perf_counter() - begin,
            history=tuple(search.history),
            start=None if first.theta is None else frozen(first.theta),
        ),
        controller=law,
        position_error=frozen(missed),
        effort_ratio=frozen(check.ratio),
        effort_ratio_error=frozen(check.error),
        simulations=search.simulations,
    )
    if (fault := check.fault(loop, search.followed, FOLLOWS)) is not None:
        raise SolverError(fault, problem=given, found=estimate)
    return estimate


def _check(
    problem: Any, method: str, max_iterations: int, tolerance: float, controller_tolerance: float
) -> None:
    """Refuse what cannot be solved, before anything is simulated."""
    if not isinstance(problem, Problem):
        raise DataError(
            f"solve_output_error: problem is {type(problem).__name__} {problem!r:.60}; give a "
            "Problem (sdpid.build_problem) or an Estimate of one."
        )
    if method not in METHODS:
        raise DataError(f"method is {method!r}: use 'didim' or 'closed_loop'.")
    if isinstance(max_iterations, bool) or not max_iterations >= 1:
        raise DataError(f"max_iterations is {max_iterations!r}, at least 1 is needed.")
    for name, value in (("tolerance", tolerance), ("controller_tolerance", controller_tolerance)):
        if not value > 0.0:
            raise DataError(f"{name} is {value!r}; give a positive share, such as 0.025.")
    problem.require_plain("output error")
    require_fixed_robot(problem.robot, "output error")
    if method == "closed_loop":
        _require_smooth(problem)
    problem.require_rows_here("output error")


def _require_smooth(problem: Problem) -> None:
    """Refuse friction whose part in the sensitivities is not known: errors would be too small.

    Friction of the load changes with the whole motion, and friction of two joints' sum jumps where
    neither joint reverses.
    """
    for term in problem.friction.terms:
        if isinstance(term, LoadFriction):
            words = "friction of the load"
        elif isinstance(term, Coupling) and term.width == 0.0:
            words = f"friction of {term.first} and {term.second} together without a width"
        else:
            continue
        raise DataError(
            f"output error: closed_loop cannot take {words}, which is not in the derivatives of "
            "the motion; use method='didim' or sdpid.solve_instrumental, which need none."
        )


def _controller(given: Controller | str | None, twin: Twin, method: Method) -> Controller:
    """Return the controller, fitted where none is given."""
    if isinstance(given, Controller):
        return given
    if given not in (None, "fit"):
        raise DataError(
            f"controller is {given!r:.80}: give one of sdpid.controllers (P, PD, PID, "
            "ComputedTorque), or 'fit'."
        )
    from sdpid.experiment.simulation.fit_controller import fit_controller

    found = fit_controller(twin.logs[0])
    law: Controller | None = found.controller
    if law is not None and (method == "didim" or found.usable):
        return law
    others = "sdpid.solve_instrumental with instruments='reference' or 'periods', which needs none"
    if method != "didim":
        others = f"method='didim', which hardly depends on them, or {others}"
    raise DataError(
        "output error: the controller is not known well enough from this log: "
        f"{'; '.join(found.reasons)}. Give the gains that ran (controller=), look whether the "
        f"commanded positions are those of this log, in rad, or use {others}."
    )
