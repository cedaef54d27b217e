"""Find, after a fit, the joint whose effort ruins the parameters of the others."""

from __future__ import annotations

import numpy as np

from sdpid.assurance.diagnostics.validation import validate
from sdpid.errors import SdpidError
from sdpid.estimation.problem import build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.inspection.effort_checks import left_out
from sdpid.experiment.inspection.finding import Finding
from sdpid.experiment.preparation.several import without_efforts
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
_TINY = 1e-12  # N·m, in place of no error
KIND = "effort_spoils"


def spoiling_effort(result: Identification) -> Finding | None:
    """Return the joint without whose effort all others are fitted better; None where all is well.

    Looked for, with a solve a joint, only where a link has lost its mass or the estimate is worse
    than cheaper ones on what was held out.
    """
    problem, theta = result.problem, result.estimate.theta
    robot, samples = problem.robot, problem.samples
    joints = np.flatnonzero(samples.used.any(axis=0))
    why = _suspicion(result)
    if why is None or theta is None or robot.n_base or len(joints) < _LEAST_JOINTS:
        return None
    shares = {}
    for j in joints.tolist():
        others = joints[joints != j]
        try:
            refit = build_problem(
                robot,
                without_efforts(samples, robot, (robot.joint_names[j],)),
                friction=problem.friction.terms,
                weighting=problem.weighting,
                consistency=problem.consistency,
                constraints=problem.constraints,
                prior=None if problem.prior is None else problem.prior.source,
                check_excitation=False,
            )
            errors = validate(solve_sdp(refit), samples).rmse[others]
        except SdpidError:
            continue
        change = np.log(np.maximum(errors, _TINY) / np.maximum(result.training.rmse[others], _TINY))
        shares[j] = float(np.exp(np.mean(change)))
    ranked = sorted(shares, key=lambda each: shares[each])
    if len(ranked) < 2:
        return None
    j, second = ranked[:2]
    if shares[j] > min(_BETTER, _CLEARLY * shares[second]):
        return None
    name = robot.joint_names[j]
    return Finding(
        severity="warning",
        kind=KIND,
        joint=name,
        message=(
            f"effort of {name} contradicts the others, whose error falls to {shares[j]:.2f} "
            f"without it (limit {_BETTER:g}); with it {why}"
        ),
        remedy=left_out(KIND),
        numbers={"share": shares[j], "limit": _BETTER},
    )


def _suspicion(result: Identification) -> str | None:
    """Return what looks wrong with an estimate, in words."""
    bodies, theta = result.problem.robot.prior, result.estimate.theta
    if theta is not None and result.problem.prior is not None:
        masses = theta[: bodies.size : 10]
        light = np.flatnonzero((bodies[:, 0] > 0.0) & (masses < _LIGHT * bodies[:, 0]))
        if light.size:
            i = int(light[0])
            link = result.problem.robot.link_names[i]
            return f"{link} has {masses[i]:.2g} kg of {bodies[i, 0]:.3g} kg described"
    held_out = result.held_out
    beaten = None if held_out is None else held_out.beaten_by
    return None if beaten is None else f"the estimate is worse than {beaten} on what was held out"
