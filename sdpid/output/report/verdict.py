"""The verdict on an identification: checks, each of a number against a limit.

Every limit is a constant here or in `subject`, with its reason; the words stand in `kinds`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid._common.kept import kept
from sdpid.assurance.diagnostics.active_constraints import ConstraintState, constraint_states
from sdpid.assurance.diagnostics.causes import Cause
from sdpid.assurance.diagnostics.light_joints import light_joints
from sdpid.assurance.diagnostics.provenance import directions_told, provenance
from sdpid.assurance.diagnostics.rest import rest_speeds
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.errors import SdpidError
from sdpid.estimation.compression.contact_noise import contact_noise
from sdpid.estimation.posterior import Posterior, gain_errors
from sdpid.estimation.problem import Problem
from sdpid.experiment.processing.samples import Samples
from sdpid.output.report.kinds import GOES, Level, VerdictFinding, found, listed, named, percent
from sdpid.output.report.subject import MARGIN, SMALL, Judged, Prediction, VerdictSubject
from sdpid.robot.model.model import RobotModel

# Held-out over training error. Another motion weighs the same defects differently, which makes
# some 20 % either way; at 1.5 half as much again is wrong on what was not seen as on what was.
CARRIES, FAILS = 1.2, 1.5

# Bands that should hold 95 % of the rows are believed down to this share.
COVERED = 0.9

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

# A parameter is as good as its gains where more than half of its variance is theirs: no longer
# record halves it.
MOSTLY = 0.5

# A force on the base that is off by this share of the weight matters to no controller of balance:
# 0.5 N of a quadruped of 2.5 kg.
_FORCE = 0.02

# A number is told by the data where more than this share of its prior's uncertainty is gone.
_TOLD = 0.5

# Of the ten parameters of a link: those of its mass, center of mass, and moments about its axes.
_PARTS = {"mass": slice(0, 1), "center of mass": slice(1, 4), "inertia": slice(4, 10)}
_AXES = {"roll": 4, "pitch": 6, "yaw": 9}

# Errors of forces above this many stated deviations are more than a guess of these is off by.
_STATED = 2.0

_TINY = np.finfo(float).tiny


def recordings(of: VerdictSubject) -> Iterator[VerdictFinding]:
    """Yield what the inspection of the recordings found."""
    for each in of.result.findings:
        if each.severity == "refuse":
            yield found("recording", finding=each)


def efforts(of: Prediction) -> Iterator[VerdictFinding]:
    """Sort the joints by how well their efforts are predicted."""
    fit, joints = of.fit, defaultdict(list)
    for each in of.grades:
        kind: str = each.level
        j, words = each.joint, _explained(fit, each.joint)
        if not each.moved:
            unit = "m/s" if fit.slides[j] else "rad/s"
            kind, words = "still", f"never faster than {rest_speeds(fit.slides)[j]:g} {unit}"
        elif not each.shown:
            kind = "unshown"
        elif kind == "caution" and fit.moving.r2[j] < 0.0:
            kind = "flat"
        joints[kind].append(f"{fit.joint_names[j]} ({words})")
    every = len(joints["good"]) == len(fit.joint_names) - fit.n_base
    which, limits = "every joint" if every else "the joints", {"margin": MARGIN, "small": SMALL}
    for kind in ("good", "unshown", "caution", "flat", "bad", "still"):
        yield from named(f"effort_{kind}", joints[kind], where=of.where, which=which, **limits)
    rest, motion = fit.resting, fit.moving
    if rest is not None and motion.rows.any() and rest.relative > motion.relative:
        yield found("rest", share=of.resting_share, rest=rest, motion=motion)


def _explained(fit: Validation, joint: int) -> str:
    """Return R² in words: below zero the mean effort predicts better."""
    errors = fit.moving if fit.moving.rows[joint] else fit
    r2, nrmse = float(errors.r2[joint]), float(errors.nrmse[joint])
    if r2 < 0.0:
        error = f", error {percent(nrmse)} of the effort" if nrmse <= SMALL else ""
        return f"worse than a constant{error}"
    return "over 99.9 %" if r2 > 0.999 else percent(r2)


def floating(of: VerdictSubject) -> Iterator[VerdictFinding]:
    """Yield what a floating base's equations miss, and what the recordings tell of the links."""
    theta = of.estimate.theta
    if of.robot.free_flyer and theta is not None:
        yield from _base(of, theta)
        yield from _forces(of.problem)
        yield from _told(of)


def _base(of: VerdictSubject, theta: Array) -> Iterator[VerdictFinding]:
    """Say how well force and torque on the base are predicted, beside the weight."""
    errors, mass = of.fit.floating, float(theta[: 10 * of.robot.n_links : 10].sum())
    weight = mass * float(np.linalg.norm(of.robot.gravity))
    if errors is None or not weight > 0.0:
        return
    share = errors.force / weight
    careful = share > _FORCE
    trust = "Do not rely on it for" if careful else "Trust it for"
    fields = {"errors": errors, "share": share, "mass": mass, "limit": _FORCE, "trust": trust}
    yield found("base_force", careful=careful, **fields)


def _forces(problem: Problem) -> Iterator[VerdictFinding]:
    """Say by how much measured forces are off as residuals show, beside what was stated."""
    rows = problem.require_rows("verdict")
    contacts = rows.samples.contacts
    if contacts is None or contacts.force_covariance is None or problem.weighting != "residual":
        return
    variance = np.diagonal(contacts.force_covariance, axis1=1, axis2=2)[:, :3]
    known = variance[np.isfinite(variance)]
    if not known.any():
        return
    stated = float(np.sqrt(known.mean()))
    scale = float(np.sqrt(contact_noise(rows.with_force_scale(1.0))[2]))
    counts = "The residuals' number counts."
    if scale <= 1.0:
        counts = (
            "The stated one counts: an error that all forces have alike, as of their scale, hardly "
            "shows in residuals."
        )
    fields = {"found": scale * stated, "stated": stated, "counts": counts}
    yield found("contact_forces", careful=scale > _STATED, **fields)


def _told(of: VerdictSubject) -> Iterator[VerdictFinding]:
    """Say what recordings tell beyond the description, and what motion would tell more."""
    told = directions_told(of.estimate)
    if told is None:
        return
    data = provenance(of.estimate).data[: 10 * of.robot.n_links].reshape(-1, 10)
    # Nothing is advised where every motion that helps was recorded: what is dark then stays so.
    dark, advice = "; ".join(_dark(of, data)), "; ".join(_advice(of, data[0]))
    fields = {
        "dark": f" Mostly the description's: {dark}." if dark else "",
        "more": f" More would tell: {advice}." if advice else "",
        "friction": len(of.problem.friction.parameters),
    }
    yield found("told", careful=bool(dark), told=told, base=of.problem.base, **fields)


def _dark(of: VerdictSubject, data: Array) -> Iterator[str]:
    """Yield the masses, centers of mass and inertias that the data hardly tell, and whose."""
    for name, part in _PARTS.items():
        dark = np.flatnonzero(data[:, part].mean(axis=1) < _TOLD)
        if len(dark):
            whose = "every link" if len(dark) == len(data) else _links(of, dark)
            yield f"{name} of {whose}"


def _advice(of: VerdictSubject, trunk: Array) -> Iterator[str]:
    """Yield motions that were not recorded and would tell more; `trunk` is the base's shares."""
    contacts = of.problem.samples.contacts
    if contacts is None:
        return
    # What holds the base still is a contact with moments; with no foot down it is in the air.
    feet = np.array([kind != "plane" for kind in contacts.kind], dtype=bool)
    free = ~contacts.down[:, feet].any(axis=1)
    if not free.any():
        yield "hang it by its base (a contact of kind plane at its link) with all legs moving"
    if free.all():
        root = of.robot.link_names[0]
        yield f"let it stand with a swaying base, or trot: nothing moves {root}"
        return
    loaded = contacts.down[~free]
    if bool(np.all(loaded.all(axis=0) == loaded.any(axis=0))):
        yield "let it trot, or lift its feet one by one: no foot ever left the ground"
    turns = [name for name, axis in _AXES.items() if trunk[axis] < _TOLD]
    if turns:
        yield f"turn the base more, in {listed(turns)}"


def held_out(of: VerdictSubject) -> Iterator[VerdictFinding]:
    """Compare what was held out with the training, with what costs less, and with the bands."""
    if of.held_out is None:
        yield found("nothing_held_out")
        return
    held, own = of.fit.moving.relative, of.result.training.moving.relative
    numbers = f"relative residual in motion {percent(held)}, on the training data {percent(own)}"
    level, ratio = _carries(held, own)
    if not of.fit.moving.rows.any():
        yield found("nothing_moves")
    elif of.other_motion:
        yield found(f"motion_{level}", numbers=numbers, ratio=ratio)
    elif level == "bad":
        numbers = f"on blocks held out in turn {numbers}"
        yield found("not_seen", numbers=numbers, ratio=ratio, what="blocks")
    else:
        yield found("blocks", numbers=numbers)
    if (better := of.held_out.beaten_by) is not None:
        other, own = (each.told.relative for each in (of.held_out.every[better], of.fit))
        remedies = "; ".join(each.words for each in of.result.remedies)
        tried = f" Tried: {remedies}." if remedies else ""
        yield found("beaten", better=better, other=other, own=own, tried=tried)
    if (share := of.inside_bands) is not None:
        yield found("bands_hold" if share >= COVERED else "bands_narrow", share=share)


def _carries(held: float, own: float) -> tuple[Level, float]:
    """Return what an error on what was not seen means, and how many times the training's it is."""
    ratio = held / max(own, _TINY)
    return "good" if ratio <= CARRIES else "caution" if ratio <= FAILS else "bad", ratio


def crossed(of: VerdictSubject) -> Iterator[VerdictFinding]:
    """Compare the error of the cross-validation that was asked for with the training error."""
    crossed = of.result.cross_validation
    if crossed is None:
        return
    what = "blocks of time" if crossed.by == "time" else "recordings"
    low, high = float(crossed.relatives.min()), float(crossed.relatives.max())
    numbers = (
        f"with {len(crossed.relatives)} {what} held out in turn, and every choice made without "
        f"them, the relative residual in motion is {percent(crossed.relative)} ({percent(low)} to "
        f"{percent(high)}), on the training data {percent(crossed.training)}"
    )
    level, ratio = _carries(crossed.relative, crossed.training)
    if level == "bad":
        yield found("not_seen", numbers=numbers, ratio=ratio, what=what)
    else:
        yield found(f"crossed_{'blocks' if crossed.by == 'time' else level}", numbers=numbers)


def causes(of: Prediction) -> Iterator[VerdictFinding]:
    """Name the joints whose errors go with something, by what they go with."""
    kinds: dict[str, list[Cause]] = defaultdict(list)
    for cause in of.causes.values():
        if not of.negligible(cause.joint):
            kinds[cause.kind].append(cause)
    for kind, own in kinds.items():
        joints = [
            f"{each.joint} ({percent(each.share)}"
            + ("" if each.frequency is None else f" at {each.frequency:.3g} Hz")
            + ")"
            for each in own
        ]
        step = of.step(own[0])
        step = f" Next: {step}." if step else ""
        yield found("cause", goes=GOES[kind], names=joints, step=step)


def model(of: VerdictSubject) -> Iterator[VerdictFinding]:
    """Tell what the model lacks, how it moves when simulated, and which joints are held back."""
    if of.missing_friction:
        terms = ", ".join(sorted(of.terms)) or "none"
        yield found("missing_friction", missing=" or ".join(of.missing_friction), terms=terms)
    for each in of.result.rollouts:
        how = "One joint free at a time: " if each.free == "each" else ""
        kind = "simulated_badly" if each.level == "bad" else "simulated"
        yield found(kind, careful=each.level == "caution", how=how, words=each.verdict)
    # Their own effort error drives them farther than they go.
    light = light_joints(of.estimate.model(), of.problem.samples, of.result.training.moving)
    worst = max(light, key=lambda each: each.ratio, default=None)
    if worst is not None:
        words, remedy = (f"{each[:1].upper()}{each[1:]}" for each in (worst.words, worst.remedy))
        yield found("light", names=[each.joint for each in light], words=words, remedy=remedy)
    for joint, (words, step) in of.held.items():
        yield found("held_back", joint=joint, words=words, step=step)


def gains(of: VerdictSubject) -> Iterator[VerdictFinding]:
    """Say what errors of the gains do to the parameters, or that none are counted."""
    errors, rows, names = gain_errors(of.problem), of.problem.rows, of.problem.base.names
    gains = None if rows is None else rows.samples.gains
    if gains is None:
        return
    if errors is None:
        yield found("gains_exact")
        return
    shares = gains.standard_errors / gains.gains
    ends = dict.fromkeys(f"{100.0 * share:.2g} %" for share in (shares.min(), shares.max()))
    try:
        own = Posterior.of(of.estimate).share(errors, of.problem.base.matrix)
    except SdpidError:  # no covariance; a verdict must not cost the run
        own = np.zeros(0)
    most = [names[i] for i in np.argsort(-own)[: np.count_nonzero(own > MOSTLY)]]
    what = "Intervals count that; no parameter hangs on it mostly."
    if most:
        what = (
            f"It is most of what is not known of {len(most)} of {len(names)} base parameters: "
            f"{listed(most)}. Better gains sharpen them, a longer record does not."
        )
    fields = {"ends": " to ".join(ends), "common": 100.0 * gains.common_factor, "what": what}
    yield found("gains_known", careful=bool(most), **fields)


def motion(of: VerdictSubject) -> Iterator[VerdictFinding]:
    """Tell noise in the recorded motion, and what joints of it are extrapolation."""
    if of.result.bias is not None and of.result.bias.biased:
        yield found("bias", words=of.result.bias.verdict)
    robot, names, limits = of.robot, of.robot.joint_names, of.robot.velocity_limits
    joints, (lowest, highest) = range(robot.n_base, robot.n), of.speeds
    peaks = np.maximum(-lowest, highest)
    slow = [
        f"{names[j]} ({peaks[j]:.2g} of {limits[j]:.2g} {'m/s' if robot.slides[j] else 'rad/s'})"
        for j in joints
        if limits[j] < NO_LIMIT and peaks[j] < SLOW * limits[j]
    ]
    yield from named("speeds", slow)
    yield from named("beyond", [f"{names[j]} ({what})" for j in joints for what in _beyond(of, j)])
    one = np.ones((1, robot.n))
    rubs = np.any(of.problem.friction.columns(one, 0.0 * one), axis=(0, 2)).tolist()
    rests = rest_speeds(robot.slides)
    forwards, backwards = np.array([highest > rests, lowest < -rests])
    one_way = [
        f"{names[j]} ({'forwards' if forwards[j] else 'backwards'})"
        for j in joints
        if rubs[j] and forwards[j] != backwards[j]
    ]
    yield from named("one_way", one_way)
    if of.problem.friction.parameters:
        used = of.problem.samples.used
        yield from named("without_rows", [names[j] for j in joints if not used[:, j].any()])


def _beyond(of: VerdictSubject, joint: int) -> Iterator[str]:
    """Yield what of a joint's validation motion is beyond that of the training."""
    fresh = of.result.validation_samples
    for what in () if fresh is None else ("velocity", "acceleration"):
        both = (np.abs(getattr(s, what)[:, joint]).max() for s in (fresh, of.problem.samples))
        if next(both) > (1.0 + BEYOND) * next(both):
            yield what


def parameters(of: VerdictSubject) -> Iterator[VerdictFinding]:
    """Name weakly excited directions, and count parameters that come mostly from the prior."""
    if weak := of.problem.excitation.weak():
        held = "the description's inertias decide there"
        if of.problem.prior is None:
            held = "their values are as good as arbitrary, and other motion may bring that to light"
        shown = [" with ".join(names) or "a mixture of many" for _, names in weak[::-1]]
        yield found("weak", weak=len(weak), count=of.problem.base.count, held=held, shown=shown)
    if of.estimate.theta is None:
        return
    mostly = provenance(of.estimate).prior > PRIOR
    if mostly.any():
        masses = np.flatnonzero(mostly[: 10 * of.robot.n_links : 10])
        which = f" The mass is the description's for {_links(of, masses)}." if len(masses) else ""
        yield found("sources", prior=int(mostly.sum()), count=len(mostly), which=which)


def _links(of: VerdictSubject, which: Indices) -> str:
    """Return the names of some links."""
    return listed(of.robot.link_names[k] for k in which)


def constraints(of: VerdictSubject) -> Iterator[VerdictFinding]:
    """Report what the constraints cost in residual, and parameters at a numerical limit."""
    own, free = (each.told.relative for each in (of.result.training, of.result.training_wls))
    states = [s for s in constraint_states(of.estimate) if s.active]
    if own > (1.0 + PRICE) * free:
        why = "The constraints contradict the data"
        end = "Something is not in the model, or a limit is wrong."
        if of.problem.prior is not None:
            why, end = "The prior and the constraints hold the fit back", _whether_it_pays(of)
        pressing = sorted(
            (s for s in states if s.multiplier), key=lambda s: -abs(s.multiplier or 0)
        )
        names = [s.name for s in pressing] or ["none"]
        yield found("price", why=why, own=own, free=free, end=end, names=names)
    limits = defaultdict(list)
    for s in states:
        if s.kind == "theta_max":
            limits["limit_contradicts" if _presses(of, s) else "limit_alone"].append(s.name)
        elif s.kind == "mass" and s.side == "most":
            limits["heavy"].append(s.name)
    for kind in ("limit_contradicts", "limit_alone", "heavy"):
        yield from named(kind, limits[kind])


def _presses(of: VerdictSubject, state: ConstraintState) -> bool:
    """Return whether the cost would fall, were a limit twice as far: to first order."""
    fall = abs(state.multiplier or 0.0) * abs(state.limit or 0.0)
    return fall > PRICE * max(of.estimate.cost, 1e-300)


def _whether_it_pays(of: VerdictSubject) -> str:
    """Return whether the constraints lower the error on held-out data, in words."""
    held, free = of.fit.moving, of.free.moving
    if of.held_out is None:
        return "Only held-out data tell whether that pays."
    if not held.rows.any():
        return "Only held-out data in motion tell whether that pays."
    where = "the validation data" if of.other_motion else "blocks held out"
    outcome = "it pays" if held.relative <= free.relative else "it does not pay"
    return (
        f"On {where} {outcome}: in motion {percent(held.relative)}, least squares without them "
        f"{percent(free.relative)}."
    )


def beliefs(of: VerdictSubject) -> Iterator[VerdictFinding]:
    """Name links that recordings tell apart against belief, and report whether it is proven."""
    prior, links, pairs = of.problem.prior, of.robot.link_names, []
    for each in () if prior is None or of.estimate.theta is None else prior.alike:
        off = np.sqrt(np.sum((each.rows @ of.estimate.some_theta) ** 2) / len(each.rows))
        if off**2 * len(each.rows) > UNLIKE:
            pairs.append(f"{links[each.first]} and {links[each.second]} ({off:.2g} times)")
    yield from named("unlike", pairs)
    if of.problem.consistency != "none":
        certificate = of.result.certificate
        proven = "proven" if of.result.drives is None else "proven_start"
        yield found(proven if certificate.passed else "unproven", why=certificate.summary())


# The most important first.
CHECKS: tuple[Callable[[VerdictSubject], Iterator[VerdictFinding]], ...] = (
    recordings,
    efforts,
    floating,
    held_out,
    crossed,
    causes,
    model,
    gains,
    motion,
    parameters,
    constraints,
    beliefs,
)


def positions(of: VerdictSubject) -> Iterator[VerdictFinding]:
    """Say how well positions under a known law are predicted, and what stays open."""
    drives = of.result.drives
    if drives is not None:
        words: dict[str, Any] = {
            "error": drives.summary,
            "delay": drives.delay_in_words,
            "lost": drives.given_up,
            "proof": drives.proof,
        }
        yield found("positions", target=drives.target, **words)
        if "kp" in drives.kinds:
            kp = drives.rich["kp"]
            yield found("kp_found", low=float(kp.min()), high=float(kp.max()))
        for each in drives.warnings:
            yield found("law_contradicted", words=each)


# Under a law efforts are not measured: what is said of their errors says nothing.
_UNDER_LAW = (recordings, positions, beliefs)


@kept
def findings(result: Judged) -> tuple[VerdictFinding, ...]:
    """Return the findings of the verdict, each with its level; computed once a result."""
    checks = CHECKS if result.drives is None else _UNDER_LAW
    return tuple(each for check in checks for each in check(result._subject))


def verdict(result: Judged) -> tuple[str, ...]:
    """Return the verdict on an identification as sentences, the most important first."""
    return tuple(each.text for each in findings(result))


def prediction_findings(
    robot: RobotModel, samples: Samples, fit: Validation
) -> tuple[VerdictFinding, ...]:
    """Return the findings about a prediction of one recording by a robot's description.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    samples : Samples
        The measurements that were predicted.
    fit : Validation
        Their prediction.

    Returns
    -------
    tuple of VerdictFinding
        The most important first.
    """
    of = Prediction(robot, samples, fit)
    return (*efforts(of), *causes(of))
