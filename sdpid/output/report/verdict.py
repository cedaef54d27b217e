"""The verdict on an identification: findings in words, each from a number against a limit.

Every limit is a constant here or in `grades`, with its reason.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.kept import kept
from sdpid.assurance.diagnostics.active_constraints import ConstraintState, constraint_states
from sdpid.assurance.diagnostics.held_out import LEAST_SQUARES
from sdpid.assurance.diagnostics.light_joints import light_joints
from sdpid.assurance.diagnostics.provenance import provenance
from sdpid.assurance.diagnostics.rest import rest_speeds
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import Problem
from sdpid.output.report.efforts_verdict import floating_findings, gains_findings
from sdpid.output.report.grades import Finding, listed, percent
from sdpid.output.report.held_out_verdict import held_out_findings
from sdpid.output.report.judged import (
    Judged,
    causes_of,
    grades_of,
    judged,
    missing_friction,
    seen_on,
    terms_of,
)
from sdpid.output.report.prediction_verdict import (
    cause_findings,
    effort_findings,
    held_back_findings,
)

# The constraints' share in the error: where they make the relative residual larger by this, they
# contradict the data by more than rounding and noise, which cost a correct model far below 1 %.
PRICE = 0.05

# A parameter is the prior's where more than half of the uncertainty that it would leave remains.
PRIOR = 0.5

# Motion beyond the recorded range by more than a tenth of it is extrapolation.
BEYOND = 0.1

# A description's speed limit is hardly reached in a recording; below half of it friction and
# inertia at full speed are guesses.
SLOW = 0.5

# No joint turns as fast as this, rad/s: descriptions have 1000 where nobody knew a limit (Solo12).
NO_LIMIT = 200.0

# Ten squares of standard normal numbers are above this once in a hundred times. Pairs of trotting
# quadrupeds that are mirror images stayed below 2; of such whose links were 15 % off, believed
# within 5 %, some of each robot's were above.
UNLIKE = 23.2


def verdict(identification: Judged) -> tuple[str, ...]:
    """Return the verdict on an identification as sentences.

    Parameters
    ----------
    identification : Identification
        The result of `sdpid.identify`.

    Returns
    -------
    tuple of str
        Statements, the most important first.
    """
    return tuple(finding.text for finding in findings(identification))


# Terminal, page and JSON ask for the same findings.
@kept
def findings(identification: Judged) -> tuple[Finding, ...]:
    """Return the findings of the verdict, each with its level; computed once a result.

    Parameters
    ----------
    identification : Identification
        What `identify` found.

    Returns
    -------
    tuple of Finding
    """
    return (
        *_recordings(identification),
        *effort_findings(
            *judged(identification), seen_on(identification), grades_of(identification)
        ),
        *floating_findings(identification),
        *held_out_findings(identification),
        *cause_findings(
            judged(identification)[1],
            causes_of(identification),
            terms_of(identification),
            identification.problem.origin.effects,
        ),
        *_friction(identification),
        *_rollouts(identification),
        *_light(identification),
        *held_back_findings(identification),
        *gains_findings(identification),
        *_bias(identification),
        *_reach(identification),
        *_one_way(identification),
        *_without_rows(identification),
        *_weak(identification),
        *_sources(identification),
        *_constraints(identification),
        *_unlike(identification),
        *_proof(identification),
    )


def _recordings(identification: Judged) -> Iterator[Finding]:
    """Yield what the inspection of the recordings found."""
    for each in identification.findings:
        if each.severity == "refuse":
            yield Finding(
                "bad",
                f"The recording is not what it says: {each}.",
                f"trust this recording: {each.message}",
            )


def _friction(result: Judged) -> Iterator[Finding]:
    """Tell a set of terms without Coulomb or viscous friction, which every joint has."""
    if missing := missing_friction(result):
        terms = ", ".join(sorted(terms_of(result))) or "none"
        yield Finding(
            "caution",
            f"No term describes {' or '.join(missing)} friction (terms: {terms}), which every "
            "joint has: its effort goes into the other parameters or into the error. --friction "
            "+TERM adds a term to the default ones, --friction TERM replaces them.",
        )


def _bias(result: Judged) -> Iterator[Finding]:
    """Report that noise in the measured motion biases the fit."""
    if result.bias is not None and result.bias.biased:
        yield Finding(
            "bad", result.bias.verdict, f"trust the standard errors: {result.bias.verdict}"
        )


def _rollouts(result: Judged) -> Iterator[Finding]:
    """Say how the simulated robot moves, where that was looked at."""
    for each in result.rollouts:
        how = "One joint free at a time: " if each.free == "each" else ""
        warning = f"simulate it without feedback: {each.verdict}" if each.level == "bad" else ""
        yield Finding(each.level, f"{how}{each.verdict}", warning)


def _light(result: Judged) -> Iterator[Finding]:
    """Name joints whose own effort error drives them farther than they go."""
    problem = result.problem
    found = light_joints(result.estimate.model(), problem.samples, result.training.moving)
    if not found:
        return
    worst = max(found, key=lambda each: each.ratio)
    names = listed([each.joint for each in found])
    yield Finding(
        "caution",
        f"Do not simulate {names} under efforts with it. {worst.words[:1].upper()}"
        f"{worst.words[1:]}. {worst.remedy[:1].upper()}{worst.remedy[1:]}.",
        f"simulate {names} under efforts: too light for the error of their efforts",
    )


def _reach(result: Judged) -> Iterator[Finding]:
    """Name joints whose speed or acceleration goes beyond the training data."""
    problem, samples = result.problem, result.problem.samples
    robot = problem.robot
    joints = range(robot.n_base, robot.n)
    peaks = np.abs(_speeds(problem)).max(axis=0)
    slow = [
        f"{robot.joint_names[j]} ({peaks[j]:.2g} of {robot.velocity_limits[j]:.2g} "
        f"{'m/s' if robot.slides[j] else 'rad/s'})"
        for j in joints
        if robot.velocity_limits[j] < NO_LIMIT and peaks[j] < SLOW * robot.velocity_limits[j]
    ]
    if slow:
        yield Finding(
            "caution",
            "Beyond the recorded speeds it extrapolates; these joints stayed below half of what "
            f"the description allows: {listed(slow)}.",
        )
    fresh = result.validation_samples
    if fresh is None:
        return
    beyond = []
    for j in joints:
        for what, own, other in (
            ("velocity", samples.velocity, fresh.velocity),
            ("acceleration", samples.acceleration, fresh.acceleration),
        ):
            highest = np.abs(own[:, j]).max()
            if np.abs(other[:, j]).max() > (1.0 + BEYOND) * highest:
                beyond.append(f"{robot.joint_names[j]} ({what})")
    if beyond:
        yield Finding(
            "caution",
            f"The validation motion goes beyond the training motion: {listed(beyond)}. Its errors "
            "include extrapolation.",
        )


def _one_way(result: Judged) -> Iterator[Finding]:
    """Name joints with friction that moved in one direction only."""
    robot, friction = result.problem.robot, result.problem.friction
    moving = friction.columns(np.ones((1, robot.n)), np.zeros((1, robot.n)))[0]
    lowest, highest = _speeds(result.problem)
    slow = rest_speeds(robot.slides)
    named = []
    for j in range(robot.n_base, robot.n):
        forwards, backwards = highest[j] > slow[j], lowest[j] < -slow[j]
        if forwards != backwards and moving[j].any():
            named.append(f"{robot.joint_names[j]} ({'forwards' if forwards else 'backwards'})")
    if named:
        yield Finding(
            "caution",
            f"Joints that moved in one direction only: {listed(named, 99)}. Their friction in the "
            "other direction is an extrapolation: in one direction Coulomb friction and an offset "
            "cannot be told apart. Record them moving both ways.",
        )


def _without_rows(result: Judged) -> Iterator[Finding]:
    """Name joints of whose friction nothing is known, for none of their efforts was used."""
    problem = result.problem
    names, first = problem.robot.joint_names, problem.robot.n_base
    unused = np.flatnonzero(~problem.samples.used[:, first:].any(axis=0))
    if unused.size and problem.friction.parameters:
        yield Finding(
            "caution",
            f"Friction of {listed([names[first + j] for j in unused])} is unknown: no effort of "
            "theirs was used. In parameters and files stands what was believed before, next to "
            "none; give it from elsewhere.",
        )


def _speeds(problem: Problem) -> Array:
    """Return the lowest and the highest velocity (2, n) of each joint on the rows in use."""
    pieces = problem.require_rows("verdict").map(_speeds_of)
    found = np.array(pieces)
    return np.stack([found[:, 0].min(axis=0), found[:, 1].max(axis=0)])


def _speeds_of(rows: RowSource) -> Array:
    """Return lowest and highest velocities (2, n) of one recording; 0 for a joint without rows."""
    samples = rows.samples
    found = np.zeros((2, samples.n))
    for j in range(samples.n):
        v = samples.velocity[samples.used[:, j], j]
        if len(v):
            found[:, j] = v.min(), v.max()
    return found


def _weak(result: Judged) -> Iterator[Finding]:
    """Name the weakly excited directions of the base parameters."""
    weak = result.problem.excitation.weak()
    if not weak:
        return
    count = len(result.problem.base.names)
    shown = [" with ".join(names) or "a mixture of many" for _, names in weak[::-1]]
    held = (
        "the description's inertias decide there"
        if result.problem.prior is not None
        else "their values are as good as arbitrary, and other motion may bring that to light"
    )
    yield Finding(
        "caution",
        f"{len(weak)} of {count} directions of the base parameters are weakly excited; {held}. "
        f"The weakest: {listed(shown)}. Do not read these parameters one by one.",
    )


def _sources(result: Judged) -> Iterator[Finding]:
    """Count the standard parameters that come mostly from the prior."""
    if result.estimate.theta is None:
        return
    sources = provenance(result.estimate)
    from_prior = int(np.count_nonzero(sources.prior > PRIOR))
    if not from_prior:
        return
    links = result.problem.robot.link_names
    masses = [name for i, name in enumerate(links) if sources.prior[10 * i] > PRIOR]
    which = f" The mass is the description's for {listed(masses)}." if masses else ""
    yield Finding(
        "caution",
        f"{from_prior} of {len(sources.names)} standard parameters are the description's or the "
        "choice nearest to it, not measured: many do not act on the effort at all. The effort is "
        f"predicted all the same; do not quote them as masses or inertias of the robot.{which}",
    )


def _constraints(result: Judged) -> Iterator[Finding]:
    """Report what the constraints cost in residual, and parameters at a numerical limit."""
    own, free = (each.told.relative for each in (result.training, result.training_wls))
    states = [s for s in constraint_states(result.estimate) if s.active]
    pressing = sorted((s for s in states if s.multiplier), key=lambda s: -abs(s.multiplier or 0.0))
    if own > (1.0 + PRICE) * free:
        names = listed([s.name for s in pressing]) if pressing else "none"
        if result.problem.prior is None:
            why = "The constraints contradict the data"
            end = "Something is not in the model, or a limit is wrong."
        else:
            why, end = "The prior and the constraints hold the fit back", _whether_it_pays(result)
        yield Finding(
            "caution",
            f"{why}: the relative residual in motion on the fitted rows is {percent(own)}, "
            f"without them {percent(free)}. {end} Active constraints: {names} "
            "(cost_of_constraints tells what each costs).",
        )
    ends = [s for s in states if s.kind == "theta_max"]
    held = [s.name for s in ends if _rises(result, s) > PRICE]
    if held:
        yield Finding(
            "bad",
            f"A numerical limit contradicts the data: {listed(held)}. The robot may well have "
            "more: widen theta_max (of links) or friction_max of the constraints.",
            f"keep the numerical limit of {listed(held)}: it contradicts the data",
        )
    if open_ends := [s.name for s in ends if s.name not in held]:
        yield Finding(
            "bad",
            f"Nothing but a numerical limit holds {listed(open_ends)}: the data do not determine "
            "these parameters. Use a prior, or a richer motion.",
            f"read {listed(open_ends)}: nothing but a numerical limit holds them",
        )
    heavy = [s.name for s in states if s.kind == "mass" and s.side == "most"]
    if heavy:
        yield Finding(
            "caution",
            f"Masses are as large as is allowed: {listed(heavy)}. The data hardly tell them from "
            "those of their neighbors; lower --mass-max to what the link can weigh, or use a "
            "prior.",
        )


def _rises(result: Judged, state: ConstraintState) -> float:
    """Return by which share the cost would fall, were a limit twice as far: to first order."""
    size = abs(state.limit or 0.0)
    return abs(state.multiplier or 0.0) * size / max(result.estimate.cost, 1e-300)


def _unlike(result: Judged) -> Iterator[Finding]:
    """Name links that are believed to be mirror images and that the recordings tell apart."""
    theta, prior = result.estimate.theta, result.problem.prior
    if theta is None or prior is None:
        return
    links, found = result.problem.robot.link_names, []
    for each in prior.alike:
        size = float(np.sum((each.rows @ theta) ** 2))
        if size > UNLIKE:
            off = np.sqrt(size / len(each.rows))
            found.append(f"{links[each.first]} and {links[each.second]} ({off:.2g} times)")
    if found:
        yield Finding(
            "caution",
            "The recordings tell links apart that are believed to be mirror images, by more than "
            f"the standard deviation of the belief: {listed(found)}. Give a larger one "
            "(--mirror-within), and no --mirror.",
        )


def _whether_it_pays(result: Judged) -> str:
    """Return whether the constraints lower the error on held-out data, in words."""
    if result.held_out is None:
        return "Only held-out data tell whether that pays."
    held, free = result.held_out.fit.moving, result.held_out.baselines[LEAST_SQUARES].moving
    if not held.rows.any():
        return "Only held-out data in motion tell whether that pays."
    where = "the validation data" if result.held_out.by == "recording" else "blocks held out"
    outcome = "it pays" if held.relative <= free.relative else "it does not pay"
    return (
        f"On {where} {outcome}: in motion {percent(held.relative)}, least squares without them "
        f"{percent(free.relative)}."
    )


def _proof(result: Judged) -> Iterator[Finding]:
    """Report whether the optimum is proven."""
    if result.certificate.passed:
        if result.problem.consistency != "none":
            yield Finding(
                "good",
                "Every link is physically possible, and no possible parameters fit better: proven "
                "in exact arithmetic. That says nothing about what the model leaves out.",
            )
    elif result.problem.consistency != "none":
        yield Finding(
            "bad",
            f"It is not proven to be the best fit: {result.certificate.summary()}",
            "call it the best fit: that is not proven",
        )
