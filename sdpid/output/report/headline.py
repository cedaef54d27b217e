"""The verdict in nine lines: what is missed, found, not to be done, proven, and what comes next."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sdpid._common.kept import kept
from sdpid.assurance.diagnostics.causes import SHARE, Cause
from sdpid.assurance.diagnostics.held_out import (
    DESCRIPTION,
    FRICTION_FITTED,
    LEAST_SQUARES,
    OURS,
)
from sdpid.experiment.processing.process import ON_TIME
from sdpid.output.report.kinds import GOES, LEVELS, percent
from sdpid.output.report.subject import NEGLIGIBLE, Grade, Judged, VerdictSubject
from sdpid.output.report.verdict import CARRIES, COVERED, FAILS, findings
from sdpid.robot.description.urdf import LINK
from sdpid.robot.friction.terms import CLASSES

# What readers and processing made of the recordings, beside what is wrong with them.
_CHANGED = ("time_unit", "units", "joints")

# What predicted the efforts, in short.
_SHORT = {
    DESCRIPTION: "your description",
    FRICTION_FITTED: "with friction fitted",
    LEAST_SQUARES: LEAST_SQUARES,
    OURS: "this estimate",
}


@dataclass(frozen=True)
class Headline:
    """The verdict in short.

    Attributes
    ----------
    error : str
        The error on what was not trained on.
    worst : str
        The joint that is predicted worst, and what its error goes with.
    step : str
        The one thing to do next.
    baseline : str or None
        The error beside those of the description and of least squares, on the same rows.
    tried : str or None
        What was tried where one of these predicts better, and the error that it gives.
    file : str or None
        What identified.urdf misses, and what to use in its place where that is clearly more than
        the estimate misses.
    tilt : str or None
        How the robot's files have a base that was found to be tilted.
    title : str
        The robot, how much was fitted, and what was predicted.
    found : str or None
        What the data showed the model to lack, and how to leave it out.
    warnings : tuple of str
        What not to do with the result, in words that follow "do not".
    proven : str
        What the certificate proves.
    log : tuple of str
        What was changed about the recordings, and what is wrong with them.
    delay : str or None
        Under a known law the delay from command to effort, and what stays open; errors are then of
        positions.
    given_up : str or None
        What the target cannot hold, and what that costs.
    """

    error: str
    worst: str
    step: str
    baseline: str | None
    tried: str | None = None
    file: str | None = None
    tilt: str | None = None
    title: str = ""
    found: str | None = None
    warnings: tuple[str, ...] = ()
    proven: str = ""
    log: tuple[str, ...] = ()
    delay: str | None = None
    given_up: str | None = None

    @property
    def lines(self) -> tuple[str, ...]:
        """The lines as they are printed; one with nothing to say is absent."""
        rows = {
            "missed effort" if self.delay is None else "positions": (self.baseline or self.error,),
            "delay": (self.delay,),
            "given up": (self.given_up,),
            "tried": (self.tried,),
            "found": (self.found,),
            "worst joint": (self.worst,),
            "do not": self.warnings,
            "robot file": (self.file, self.tilt),
            "proven": (self.proven,),
            "next": (self.step,),
            "log": self.log,
        }
        shown = [
            f"{'' if place else label:<14} {text}"
            for label, texts in rows.items()
            for place, text in enumerate(filter(None, texts))
        ]
        return (self.title, *shown)


@kept
def headline(result: Judged) -> Headline:
    """Return the verdict on an identification in short."""
    of = result._subject
    if (drives := result.drives) is not None:
        return Headline(
            error=drives.summary,
            worst=drives.worst,
            step=drives.step,
            baseline=None,
            title=f"{of.robot.name}: {of.robot.n} joints, links and drives fitted to positions",
            warnings=tuple(each.warning for each in findings(result) if each.warning),
            proven="the start, a convex fit to the law's efforts (parameters.json): "
            f"{_proven(of)}; links and drives that were fitted to positions: {drives.proof}",
            log=tuple(_log(result)),
            delay=drives.delay_in_words,
            given_up=drives.given_up,
        )
    # By its level, then by R².
    ranks = {each: (LEVELS.index(each.level), of.fit.moving.r2[each.joint]) for each in of.grades}
    worst = min(ranks, key=lambda each: ranks[each], default=None)
    chosen = [each.words for each in of.problem.origin.effects if each.chosen and each.fall]
    return Headline(
        error=_error(of),
        worst=_joint(of, worst),
        step=next(_steps(of, worst)),
        baseline=_beside(of),
        tried=" | ".join(each.words for each in result.remedies) or None,
        file=_file(of),
        tilt=_tilt(of),
        title=_title(of),
        found=f"{'; '.join(chosen)} (--effects none leaves it out)" if chosen else None,
        warnings=tuple(each.warning for each in findings(result) if each.warning),
        proven=_proven(of),
        log=tuple(_log(result)),
    )


def _log(result: Judged) -> Iterator[str]:
    """Yield what was changed about the recordings, then what is wrong with them."""
    noted = [each for each in result.findings if each.severity == "note"]
    notes = [each.message for each in noted if each.kind in _CHANGED]
    notes += [each for each in result.problem.samples.notes if each.endswith(ON_TIME)]
    yield from (f"changed: {each}" for each in dict.fromkeys(notes))
    for each in result.findings:
        if each.severity != "note" and each.kind != "continued":
            yield each.line()


def _title(of: VerdictSubject) -> str:
    """Return the robot, how long the recordings are, and what was predicted."""
    samples, predicted = of.problem.samples, "nothing else predicted"
    size = f"{len(samples.position)} samples"
    if samples.time is not None:
        pieces = np.split(samples.time, samples.starts[1:])
        size = f"{sum(float(piece[-1] - piece[0]) for piece in pieces):.0f} s"
    if of.other_motion:
        predicted = "another recording predicted"
    elif of.held_out is not None:
        predicted = f"{of.held_out.blocks} blocks of them predicted in turn"
    return f"{of.robot.name}: {of.robot.n - of.robot.n_base} joints, {size} fitted, {predicted}"


def _proven(of: VerdictSubject) -> str:
    """Return what the certificate proves."""
    certificate = of.result.certificate
    if of.problem.consistency == "none":
        return "nothing: links that no body can have were allowed (consistency none)"
    if not certificate.passed:
        return f"no: {certificate.summary()}"
    return f"no physically possible robot of this model fits better (gap {certificate.gap:.1g})"


def _error(of: VerdictSubject) -> str:
    """Return the error on what was held out, in motion and at rest."""
    fit, share, told = of.fit, of.inside_bands, []
    if fit.moving.rows.any():
        told.append(f"{percent(fit.moving.relative)} in motion")
    if fit.resting is not None:
        rest = f"at rest ({percent(of.resting_share)} of the rows)"
        told.append(f"{percent(fit.resting.relative)} {rest}")
    base = ""
    if (errors := fit.floating) is not None:
        base = f"; {errors.force:.3g} N and {errors.torque:.3g} N.m at the base"
    numbers = f"{', '.join(told)} (share of the effort{base})"
    if of.held_out is None:
        return f"{numbers}, on the data that were fitted: nothing could be held out"
    if not of.other_motion:
        return (
            f"{numbers}, on {of.held_out.blocks} blocks held out in turn; other motion is not shown"
        )
    inside = "" if share is None else f"; the 95 % bands hold {percent(share)} of it"
    if share is not None and share < COVERED:
        inside += f", less than {percent(COVERED)}: they are too narrow there"
    return f"{numbers}, on recordings that were not fitted{inside}"


def _beside(of: VerdictSubject) -> str | None:
    """Return the errors of the baselines and of the estimate, on the same rows in motion.

    And where on the motion the mass matrix of least squares is that of no robot.
    """
    if of.held_out is None or not of.fit.moving.rows.any():
        return None
    share, no_robot = float(np.mean(of.least_eigenvalues[LEAST_SQUARES] <= 0.0)), ""
    if share:
        where = "all along" if share == 1.0 else f"on {percent(share)} of it"
        no_robot = f", no robot (M < 0 {where})"
    errors = [
        f"{_SHORT[name]} {percent(fit.moving.relative)}{no_robot if name == LEAST_SQUARES else ''}"
        for name, fit in of.held_out.every.items()
    ]
    return f"{' | '.join(errors)} in motion"


def _joint(of: VerdictSubject, worst: Grade | None) -> str:
    """Return a joint's error in words, and what it goes with."""
    if worst is None:
        return "none has a measured effort"
    name = of.fit.joint_names[worst.joint]
    if not worst.moved:
        return f"{name}, which did not move: how well it is predicted in motion is not known"
    nrmse, r2 = (float(each[worst.joint]) for each in (of.fit.moving.nrmse, of.fit.moving.r2))
    explained = "predicted worse than by a constant" if r2 < 0.0 else f"R² {r2:.3f}"
    why, _ = of.held.get(name, ("its shape shows no cause", ""))
    if (cause := of.causes.get(name)) is not None:
        why = f"{percent(cause.share)} of its variance goes {GOES[cause.kind]}"
    return f"{name}, error {percent(nrmse)} of its effort ({explained}); {why}"


def _steps(of: VerdictSubject, worst: Grade | None) -> Iterator[str]:
    """Yield what could be done, the most important first."""
    for finding in of.result.findings:
        if finding.severity == "refuse" and finding.remedy:
            yield finding.remedy + (f" (for {finding.joint})" if finding.joint else "")
    name = "" if worst is None else of.fit.joint_names[worst.joint]
    if worst is not None and not worst.moved:
        yield f"record {name} moving"
    wrong = worst is not None and worst.level != "good"
    if wrong and of.missing_friction:
        yield (
            f"let {' and '.join(of.missing_friction)} friction in, which every joint has: "
            "--friction +TERM adds a term to the default ones, --friction TERM replaces them"
        )
    best = min(of.result.remedies, key=lambda each: each.error / each.before, default=None)
    if best is not None and best.helps:
        yield f"identify again with {best.option}: {best.cause}"
    if name in of.held and name not in of.causes:
        yield of.held[name][1]
    # The cause that explains most of the whole error, or else that of the worst joint.
    weights = {joint: _weight(of, cause) for joint, cause in of.causes.items()}
    largest = max(weights, key=lambda joint: weights[joint], default=name)
    if weights.get(largest, 0.0) < SHARE:
        largest = name
    if largest in of.causes:
        of_all = f", {percent(weights[largest])} of all joints' squared errors"
        yield f"{of.step(of.causes[largest])} (for {largest}{'' if largest == name else of_all})"
    if not of.other_motion:
        yield "record another motion and give it with --validation: this one shows only itself"
    elif of.fit.moving.relative > FAILS * of.result.training.moving.relative:
        yield "train on both recordings: the first shows too little of what the other needs"
    if wrong:
        yield "record a motion that asks more of the worst joint: its error hides its dynamics"
    good = of.urdf_errors is not None and _file(of) is None
    what = "identified.urdf" if good else _whole(of)
    yield f"none: use {what}, and validate again when the load or the temperature changes"


def _weight(of: VerdictSubject, cause: Cause) -> float:
    """Return the share of the squared errors of all joints that a cause explains.

    0 where the joint's error is negligible.
    """
    if of.negligible(cause.joint):
        return 0.0
    squares = of.fit.moving.rows * of.fit.moving.rmse**2
    own = squares[of.fit.joint_names.index(cause.joint)]
    return float(cause.share * own / max(float(squares.sum()), np.finfo(float).tiny))


def _file(of: VerdictSubject) -> str | None:
    """Return what identified.urdf misses, and what to use instead where that is clearly more.

    As good is an error that differs by no more than another motion makes, or does not matter.
    """
    errors = of.urdf_errors
    if errors is None or errors.file <= max(CARRIES * errors.estimate, NEGLIGIBLE):
        return None
    where = "fitted" if of.result.validation_samples is None else "validation"
    return (
        f"do not use identified.urdf alone for efforts: in motion on the {where} "
        f"recordings it misses efforts by {errors}; use {_whole(of)}, which leave nothing out"
    )


def _tilt(of: VerdictSubject) -> str | None:
    """Return how robots are written whose base was found to be tilted."""
    if "Tilt" not in of.terms:
        return None
    gravity = ", ".join(f"{x:.4g}" for x in of.estimate.model().tilted_gravity)
    return (
        f"the base stands tilted, as found: identified.urdf on a new root link '{LINK}', "
        f"identified.xml under gravity ({gravity}) m/s²"
    )


def _whole(of: VerdictSubject) -> str:
    """Return in words what has all terms: no code has terms of one's own, a URDF has the tilt."""
    both = "estimate.model() or parameters.json"
    if of.terms <= CLASSES.keys():
        both += (
            ", or the links of identified.urdf with identified_friction.py (.hpp) for its friction"
        )
    return both
