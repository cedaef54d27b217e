"""The whole way with defaults: a robot and recordings in, certified parameters out."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import replace
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid._common.progress import progress
from sdpid._common.threads import one_thread
from sdpid.assurance.certificate.certificate import certify
from sdpid.assurance.diagnostics.validation import validate
from sdpid.assurance.intervals.intervals import Intervals, Method, confidence_intervals
from sdpid.assurance.intervals.parameters import ParameterFunctions
from sdpid.errors import DataError, IdentifiabilityError, SolverError
from sdpid.estimation.compression.covariance import Weighting
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.preparation.for_robot import default_friction
from sdpid.experiment.preparation.several import (
    Logs,
    Prepared,
    ProcessingOf,
    prepare_recordings,
)
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import Consistency
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from sdpid.workflow.result import Identification

__all__ = ["Identification", "formulate", "identify", "mass_matrix"]

# What `identify` takes for its intervals. Profile bounds say most, but take several hundred solves,
# 5 to 9 s for arms of six and seven joints; Gauss-Markov intervals take some 20 ms.
DEFAULT_INTERVALS: Method = "gauss_markov"

# Unconstrained fit, estimate, certificate, intervals.
_STEPS = 4


def _tuple_of_terms(
    friction: Iterable[str | FrictionTerm] | None,
) -> tuple[str | FrictionTerm, ...] | None:
    """Return the terms, perhaps of a generator, in a tuple.

    Raises
    ------
    DataError
        When they are one name, or nothing that has terms in it.
    """
    if friction is None:
        return None
    if isinstance(friction, (str, FrictionTerm)):
        raise DataError(f"friction: is {friction!r}; give a tuple of terms, ({friction!r},).")
    try:
        return tuple(friction)
    except TypeError:
        raise DataError(
            f"friction: is {friction!r}; give a tuple of terms, such as ('coulomb', 'viscous')."
        ) from None


def formulate(
    robot: RobotModel | str | os.PathLike[str],
    log: Logs | Prepared,
    *,
    processing: ProcessingOf = None,
    without_effort: Iterable[str] = (),
    friction: Iterable[str | FrictionTerm] | None = None,
    weighting: Weighting | None = None,
    consistency: Consistency = "pseudo_inertia",
    constraints: Constraints | None = None,
    prior: Prior | bool | None = None,
) -> Problem:
    """Build the problem that `identify` solves; arguments and errors are those of `identify`.

    `log` may also be recordings that are prepared already (see `prepare_recordings`).
    """
    robot = robot if isinstance(robot, RobotModel) else load_robot(robot)
    friction = _tuple_of_terms(friction)
    if not isinstance(log, Prepared):
        log = prepare_recordings(robot, log, processing, without_effort=without_effort)
    samples = log.samples
    chosen: Weighting = weighting or ("residual" if samples.covariance is None else "gls")
    if prior is None:
        # Friction of a joint without effort is known from a prior or not at all.
        wanted = chosen == "residual" or (chosen == "gls" and bool(log.without_effort))
        prior = wanted and bool(np.any(robot.prior[:, 0] > 0.0))
    if isinstance(prior, bool):
        prior = Prior() if prior else None
    return build_problem(
        robot,
        samples,
        friction=default_friction(log.logs[0]) if friction is None else friction,
        weighting=chosen,
        consistency=consistency,
        constraints=Constraints.of_size(robot) if constraints is None else constraints,
        prior=prior,
    )


@one_thread
def identify(
    robot: RobotModel | str | os.PathLike[str],
    log: Logs,
    *,
    validation: Logs | None = None,
    processing: ProcessingOf = None,
    without_effort: Iterable[str] = (),
    friction: Iterable[str | FrictionTerm] | None = None,
    weighting: Weighting | None = None,
    consistency: Consistency = "pseudo_inertia",
    constraints: Constraints | None = None,
    prior: Prior | bool | None = None,
    intervals: bool | Method = True,
    folds: int | None = None,
) -> Identification:
    """Identify a robot from one recording or several, with defaults for everything.

    Parameters
    ----------
    robot : RobotModel, name or path
        The robot (see `load_robot`).
    log : Recording or path, or a sequence of these
        What was measured (see `read_recording`). Several recordings are processed alike, each
        alone, and fitted together; none of them may have periods then.
    validation : Recording or path, or a sequence of these, optional
        Other recordings to predict; nothing is chosen by them.
    processing : Processing or mapping, optional
        By default `default_processing`; of several recordings that of the one with the median
        cut-off. A mapping changes some settings of the default, such as ``{"cutoff_hz": 10.0}``.
    without_effort : iterable of str, optional
        Joints whose efforts nobody measured, or that are wrong. Their motion counts, their
        efforts do not; their friction is then the prior's.
    friction : iterable, optional
        By default `default_friction`.
    weighting : str, optional
        By default ``gls`` for records with periods, else ``residual``.
    consistency : str, optional
        What every link must obey.
    constraints : Constraints, optional
        Margins and bounds; by default bounds that follow the robot's size
        (`Constraints.of_size`).
    prior : Prior or bool, optional
        What is believed beside the data. By default the description's own inertias, with a
        strength of one nat, for records without periods of a robot whose description has masses;
        none otherwise.
    intervals : bool or str, optional
        Find intervals of the parameters (see `sdpid.confidence_intervals`): True by Gauss-Markov,
        which takes a moment; ``"profile"`` says more and takes some seconds; or ``"bootstrap"``.
        Where the data do not allow them, `Identification.intervals_note` says why.
    folds : int, optional
        Also hold out so many blocks of the recordings in turn (see `sdpid.cross_validate`).

    Returns
    -------
    Identification

    Raises
    ------
    SdpidError
        A child that says what is wrong: `DataError`, `ModelError`, `IdentifiabilityError`,
        `InfeasibleError` or `SolverError`.
    """
    if not isinstance(intervals, bool) and intervals not in get_args(Method):
        raise DataError(
            f"intervals: is {intervals!r}; use True, False or one of {', '.join(get_args(Method))}."
        )
    friction = _tuple_of_terms(friction)
    model = robot if isinstance(robot, RobotModel) else load_robot(robot)
    prepared = prepare_recordings(model, log, processing, without_effort=without_effort)
    fresh = None if validation is None else prepared.others(validation)
    findings = prepared.findings
    findings += () if fresh is None else fresh.findings
    # Gaps and wrapped angles stand in the notes of the samples.
    notes = [str(finding) for finding in findings if finding.kind != "continued"]
    notes += prepared.notes
    problem = formulate(
        model,
        prepared,
        friction=friction,
        weighting=weighting,
        consistency=consistency,
        constraints=constraints,
        prior=prior,
    )
    with progress(_STEPS, "estimating") as advance:
        wls = solve_wls(replace(problem, prior=None))
        advance(1)
        estimate = solve_sdp(problem)
        advance(1)
        certificate = certify(estimate)
        advance(1)
        found, beware = _intervals(estimate, intervals)
        advance(1)
    crossed = None
    if folds is not None:
        from sdpid.workflow.cross_validation import cross_validate

        crossed = cross_validate(
            model,
            prepared.logs,
            folds=folds,
            processing=processing,
            without_effort=prepared.without_effort,
            friction=friction,
            weighting=weighting,
            consistency=consistency,
            constraints=constraints,
            prior=prior,
        )
    return Identification(
        problem=problem,
        wls=wls,
        estimate=estimate,
        certificate=certificate,
        training=validate(estimate),
        training_wls=validate(wls),
        validation=None if fresh is None else validate(estimate, fresh.samples),
        validation_samples=None if fresh is None else fresh.samples,
        intervals=found,
        cross_validation=crossed,
        intervals_note=beware,
        notes=tuple(notes),
        findings=findings,
    )


def _intervals(estimate: Estimate, wanted: bool | Method) -> tuple[Intervals | None, str | None]:
    """Return intervals, and why there are none or what to beware of."""
    if wanted is False:
        return None, None
    method: Method = DEFAULT_INTERVALS if wanted is True else wanted
    try:
        found = confidence_intervals(estimate, method=method)
    except (DataError, IdentifiabilityError, SolverError) as reason:
        return None, f"no intervals of the parameters ({method}): {reason}"
    outside = _outside(estimate, found)
    if not outside:
        return found, None
    return found, (
        f"{outside} of {len(found)} intervals do not hold the estimate: they are about the "
        "unconstrained fit, from which physics or the prior moves it farther than the data's "
        "scatter; intervals='profile' (--interval-method profile) respects physics and takes some "
        "seconds"
    )


def _outside(estimate: Estimate, found: Intervals) -> int:
    """Return how many intervals of the unconstrained fit do not hold the estimate."""
    if found.method != "gauss_markov":
        return 0
    shown = ParameterFunctions.of(estimate.problem, found.names)
    return int(np.count_nonzero(~found.contains(shown.functionals @ estimate.base)))


def mass_matrix(estimate: Estimate, q: ArrayLike) -> Array:
    """Return the mass matrix of an estimate.

    Parameters
    ----------
    estimate : Estimate
        With or without standard parameters: base parameters determine the mass matrix, so any
        standard ones that have them will do.
    q : array_like, shape (n,) or (K, n)
        Joint positions.

    Returns
    -------
    ndarray, shape (n, n) or (K, n, n)
    """
    problem = estimate.problem
    if estimate.theta is not None:
        return problem.robot.mass_matrix(estimate.theta, q)
    return problem.robot.mass_matrix(np.linalg.pinv(problem.base.matrix) @ estimate.base, q)
