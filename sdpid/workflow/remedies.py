"""Try, after a fit, what may help: other choices, and a joint whose effort ruins the others."""

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
from sdpid.experiment.inspection.kinds import Finding, found
from sdpid.experiment.preparation.prepare import Prepared
from sdpid.output.report.kinds import listed
from sdpid.workflow.formulate import Formulation
from sdpid.workflow.result import Identification

# Of a link that is as heavy as it may be.
_HEAVIEST = ("mass", "most")

# Bounds are tried this many times as wide.
_WIDER = 10.0

# Links of good recordings keep at least 27 % of their described mass: below this share something
# pulls them away.
_LIGHT = 0.05
# Without the effort that spoils them the other joints are fitted with less than this share of their
# errors (geometric mean), 0.78 on a real arm whose lift has another unit, at least 0.93 on good
# recordings; and less than this share of what leaving out any other effort makes of them: two
# efforts that contradict each other do not tell which of them is wrong.
_BETTER, _CLEARLY = 0.85, 0.9
# With fewer joints there are no others to tell one from.
_LEAST_JOINTS = 3
# Errors in place of none, N·m.
_TINY = 1e-12


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


def spoiling_effort(
    result: Identification, prepared: Prepared, formulation: Formulation
) -> Finding | None:
    """Return the joint without whose effort all others are fitted better; None where all is well.

    Looked for, with a solve a joint, only where a link has lost its mass or the estimate is worse
    than cheaper ones on what was held out.
    """
    why, robot, samples = _suspicion(result), prepared.robot, prepared.samples
    joints = np.flatnonzero(samples.used.any(axis=0)).tolist()
    if why is None or robot.n_base or len(joints) < _LEAST_JOINTS:
        return None
    fixed = formulation.without_choices(result.problem)
    shares = {}
    for j in joints:
        less = prepared.without(robot.joint_names[j])
        try:
            estimate = solve_sdp(fixed.problem(robot, less))
        except SdpidError:
            continue
        errors = np.array([result.training.rmse, validate(estimate, samples).rmse])
        logs = np.log(np.maximum(errors[:, [k for k in joints if k != j]], _TINY))
        shares[j] = float(np.exp(np.mean(logs[1] - logs[0])))
    j, second, *_ = sorted(joints, key=lambda each: shares.get(each, np.inf))
    share = shares.get(j, np.inf)
    if share > min(_BETTER, _CLEARLY * shares.get(second, np.inf)):
        return None
    return found("effort_spoils", robot.joint_names[j], why=why, share=share, limit=_BETTER)


def _suspicion(result: Identification) -> str | None:
    """Return what looks wrong with an estimate, in words."""
    problem, theta = result.problem, result.estimate.theta
    if theta is not None and problem.prior is not None:
        described = problem.robot.prior[:, 0]
        masses = theta[: 10 * len(described) : 10]
        light = np.flatnonzero(masses < _LIGHT * described)
        for i in light[:1]:
            link = problem.robot.link_names[i]
            return f"{link} has {masses[i]:.2g} kg of {described[i]:.3g} kg described"
    beaten = None if result.held_out is None else result.held_out.beaten_by
    return None if beaten is None else f"the estimate is worse than {beaten} on what was held out"
