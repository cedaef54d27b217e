"""Try what may help where the estimate predicts worse than what costs less."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid.assurance.diagnostics.active_constraints import constraint_states
from sdpid.assurance.diagnostics.held_out import LEAST_SQUARES, Remedy, hold_out
from sdpid.assurance.diagnostics.validation import Errors, validate
from sdpid.errors import SdpidError
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.preparation.prepare import Prepared
from sdpid.output.report.kinds import listed
from sdpid.workflow.formulate import Formulation
from sdpid.workflow.result import Identification

# Of a link that is as heavy as it may be.
_HEAVIEST = ("mass", "most")

# Bounds are tried this many times as wide.
_WIDER = 10.0


def tried_remedies(
    result: Identification, prepared: Prepared, formulation: Formulation
) -> tuple[Remedy, ...]:
    """Return what other choices make of the error, where what costs less predicts better.

    Friction terms and effects stay. Tried are no prior, wider bounds where bounds hold the fit
    back, and no effort of the joint whose error is the largest beside that of least squares.
    """
    if result.held_out is None or result.held_out.beaten_by is None:
        return ()
    fixed = formulation.without_choices(result.problem)
    return tuple(_tried(result, prepared, fixed))


def _tried(result: Identification, prepared: Prepared, fixed: Formulation) -> Iterator[Remedy]:
    """Yield the remedies that could be solved."""
    held_out, fresh, names = result.held_out, result.validation_samples, prepared.robot.joint_names
    assert held_out is not None
    for cause, option, problem, left_out in _choices(result, prepared, fixed):
        try:
            estimate = solve_sdp(problem())
            again = None if fresh is not None else hold_out(estimate, result.wls, None)
        except SdpidError:
            continue
        fit = validate(estimate, fresh) if fresh is not None else again and again.fit
        if fit:
            before, error = (_share(each.told, left_out) for each in (held_out.fit, fit))
            others = "" if left_out is None else f" of the joints beside {names[left_out]}"
            yield Remedy(cause=cause, option=option, before=before, error=error, of=others)


def _choices(
    result: Identification, prepared: Prepared, fixed: Formulation
) -> Iterator[tuple[str, str, Any, int | None]]:
    """Yield a cause, the option against it, what makes the problem, and a joint left out."""
    problem, robot, held_out = result.problem, prepared.robot, result.held_out
    assert held_out is not None
    if problem.prior is not None:
        cause = "the belief in the description's inertias holds it back"
        yield cause, "--no-prior", lambda: replace(problem, prior=None), None
    active = [each for each in constraint_states(result.estimate) if each.active]
    bounds = [s.name for s in active if s.kind == "theta_max" or (s.kind, s.side) == _HEAVIEST]
    if bounds:
        given = problem.constraints
        mass, size = _WIDER * given.mass_max, _WIDER * given.theta_max
        wide = given.replace(mass_max=mass, theta_max=size)
        cause = f"bounds hold it back ({listed(bounds)})"
        yield cause, f"--mass-max {mass:g}", lambda: problem.constrained(constraints=wide), None
    # The joint that is farther off than by least squares, in squares of the whole error.
    own, free = held_out.fit.moving, held_out.baselines[LEAST_SQUARES].moving
    more = own.rows * (own.rmse**2 - free.rmse**2)
    worst = int(np.argmax(more))
    if not robot.n_base and more[worst] > 0.0 and np.count_nonzero(own.rows) > 1:
        name = robot.joint_names[worst]

        def without() -> Problem:
            return fixed.problem(robot, prepared.without(name))

        cause = f"the effort of {name} or its links in the description contradict the others"
        yield cause, f"--without-effort {name}", without, worst


def _share(errors: Errors, left_out: int | None) -> float:
    """Return the relative residual, of all joints or without one."""
    if left_out is None:
        return errors.relative
    rows = np.array(errors.rows, dtype=float)
    rows[left_out] = 0.0
    told = np.isfinite(errors.nrmse) & (errors.nrmse > 0.0)
    effort = np.divide(errors.rmse, errors.nrmse, out=np.zeros(len(rows)), where=told)
    return float(np.sqrt(rows @ errors.rmse**2 / max(rows @ effort**2, np.finfo(float).tiny)))
