"""Find, after a fit, the joint whose effort ruins the parameters of the others."""

from __future__ import annotations

import numpy as np

from sdpid.assurance.diagnostics.validation import validate
from sdpid.errors import SdpidError
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.inspection.kinds import Finding, found
from sdpid.experiment.preparation.prepare import Prepared
from sdpid.workflow.formulate import Formulation
from sdpid.workflow.result import Identification

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
