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
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.experiment.processing.delays.on_time import ON_TIME
from sdpid.output.report.grades import LEVELS, Grade, percent
from sdpid.output.report.held_out_verdict import CARRIES, COVERED, FAILS, inside_bands
from sdpid.output.report.judged import (
    Judged,
    causes_of,
    errors_of_urdf,
    grades_of,
    judged,
    missing_friction,
    terms_of,
)
from sdpid.output.report.prediction_verdict import (
    NEGLIGIBLE,
    goes_with,
    held_of,
    next_step,
    resting_share,
)
from sdpid.output.report.sections.motion import least_eigenvalues
from sdpid.output.report.verdict import findings
from sdpid.output.robots.friction_files import KINDS
from sdpid.robot.description.level import LINK

# Beside the two that have all terms in one.
_CODE = ", or the links of identified.urdf with identified_friction.py (.hpp) for its friction"
_OTHER_MOTION = "record another motion and give it with --validation: this one shows only itself"


# What readers and processing made of the recordings, beside what is wrong with them.
_CHANGED = ("time_unit", "units", "joints")


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

    @property
    def lines(self) -> tuple[str, ...]:
        """The lines as they are printed; one with nothing to say is absent."""
        rows = (
            ("missed effort", (self.baseline or self.error,)),
            ("tried", (self.tried,)),
            ("found", (self.found,)),
            ("worst joint", (self.worst,)),
            ("do not", self.warnings),
            ("robot file", tuple(filter(None, (self.file, self.tilt)))),
            ("proven", (self.proven,)),
            ("next", (self.step,)),
            ("log", self.log),
        )
        shown = [
            f"{label if not place else '':<14} {text}"
            for label, texts in rows
            for place, text in enumerate(texts)
            if text
        ]
        return (self.title, *shown)


@kept
def headline(result: Judged) -> Headline:
    """Return the verdict on an identification in short."""
    causes = causes_of(result)
    every = grades_of(result)
    worst = _worst(result, every)
    return Headline(
        error=_error(result),
        worst=_joint(result, worst, causes),
        step=_step(result, worst, causes),
        baseline=_beside(result),
        tried=" | ".join(each.words for each in result.remedies) or None,
        file=_file(result),
        tilt=_tilt(result),
        title=_title(result),
        found=_found(result),
        warnings=tuple(each.warning for each in findings(result) if each.warning),
        proven=_proven(result),
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


def _title(result: Judged) -> str:
    """Return the robot, how long the recordings are, and what was predicted."""
    robot, samples, held_out = result.problem.robot, result.problem.samples, result.held_out
    size = f"{len(samples.position)} samples"
    if samples.time is not None:
        pieces = np.split(samples.time, samples.starts[1:])
        size = f"{sum(float(piece[-1] - piece[0]) for piece in pieces):.0f} s"
    if held_out is None:
        predicted = "nothing else predicted"
    elif held_out.by == "blocks":
        predicted = f"{held_out.blocks} blocks of them predicted in turn"
    else:
        predicted = "another recording predicted"
    return f"{robot.name}: {robot.n - robot.n_base} joints, {size} fitted, {predicted}"


def _found(result: Judged) -> str | None:
    """Return the effects that were chosen by the data."""
    chosen = [each.words for each in result.problem.origin.effects if each.chosen and each.fall]
    return f"{'; '.join(chosen)} (--effects none leaves it out)" if chosen else None


def _proven(result: Judged) -> str:
    """Return what the certificate proves."""
    certificate = result.certificate
    if result.problem.consistency == "none":
        return "nothing: links that no body can have were allowed (consistency none)"
    if not certificate.passed:
        return f"no: {certificate.summary()}"
    return f"no physically possible robot of this model fits better (gap {certificate.gap:.1g})"


def _no_robot(result: Judged) -> str:
    """Return where on the motion the mass matrix of least squares is that of no robot."""
    _, least = least_eigenvalues(result)
    share = float(np.mean(least[LEAST_SQUARES] <= 0.0))
    if not share:
        return ""
    return f", no robot (M < 0 {'all along' if share == 1.0 else f'on {percent(share)} of it'})"


def _error(result: Judged) -> str:
    """Return the error on what was held out, in motion and at rest."""
    _, fit = judged(result)
    rest = f"at rest ({percent(resting_share(fit))} of the rows)"
    shares = {"in motion": fit.moving if fit.moving.rows.any() else None, rest: fit.resting}
    told = [f"{percent(e.relative)} {where}" for where, e in shares.items() if e is not None]
    base = ""
    if (errors := fit.floating) is not None:
        base = f"; {errors.force:.3g} N and {errors.torque:.3g} N.m at the base"
    numbers = f"{', '.join(told)} (share of the effort{base})"
    held_out = result.held_out
    if held_out is None:
        return f"{numbers}, on the data that were fitted: nothing could be held out"
    if held_out.by == "blocks":
        return f"{numbers}, on {held_out.blocks} blocks held out in turn; other motion is not shown"
    share = inside_bands(result)
    inside = "" if share is None else f"; the 95 % bands hold {percent(share)} of it"
    if share is not None and share < COVERED:
        inside += f", less than {percent(COVERED)}: they are too narrow there"
    return f"{numbers}, on recordings that were not fitted{inside}"


def _worst(result: Judged, every: tuple[Grade, ...]) -> Grade | None:
    """Return the grade of the joint that is predicted worst: by its level, then by R²."""
    _, fit = judged(result)
    if not every:
        return None
    return min(every, key=lambda each: (LEVELS.index(each.level), float(fit.moving.r2[each.joint])))


def _joint(result: Judged, worst: Grade | None, causes: dict[str, Cause]) -> str:
    """Return a joint's error in words, and what it goes with."""
    _, fit = judged(result)
    if worst is None:
        return "none has a measured effort"
    name = fit.joint_names[worst.joint]
    if not worst.moved:
        return f"{name}, which did not move: how well it is predicted in motion is not known"
    nrmse, r2 = float(fit.moving.nrmse[worst.joint]), float(fit.moving.r2[worst.joint])
    explained = "predicted worse than by a constant" if r2 < 0.0 else f"R² {r2:.3f}"
    cause, held = causes.get(name), held_of(result).get(name)
    if cause is not None:
        why = f"{percent(cause.share)} of its variance goes {goes_with(cause)}"
    else:
        why = "its shape shows no cause" if held is None else held.words
    return f"{name}, error {percent(nrmse)} of its effort ({explained}); {why}"


def _step(result: Judged, worst: Grade | None, causes: dict[str, Cause]) -> str:
    """Return the one thing to do next: the first of those that apply."""
    return next(_steps(result, worst, causes))


def _steps(result: Judged, worst: Grade | None, causes: dict[str, Cause]) -> Iterator[str]:
    """Yield what could be done, the most important first."""
    _, fit = judged(result)
    for finding in result.findings:
        if finding.severity == "refuse" and finding.remedy:
            yield finding.remedy + (f" (for {finding.joint})" if finding.joint else "")
    if worst is not None and not worst.moved:
        yield f"record {fit.joint_names[worst.joint]} moving"
    name = None if worst is None else fit.joint_names[worst.joint]
    missing = missing_friction(result)
    if missing and worst is not None and worst.level != "good":
        yield (
            f"let {' and '.join(missing)} friction in, which every joint has: --friction +TERM "
            "adds a term to the default ones, --friction TERM replaces them"
        )
    helping = min(result.remedies, key=lambda each: each.error / each.before, default=None)
    if helping is not None and helping.helps:
        yield f"identify again with {helping.option}: {helping.cause}"
    if name in held_of(result) and name not in causes:
        yield held_of(result)[name].step
    # The cause that explains most of the whole error, or else that of the worst joint.
    weights = {name: _weight(fit, cause) for name, cause in causes.items()}
    largest = max(weights, key=lambda name: weights[name], default=None)
    if largest is None or weights[largest] < SHARE:
        largest = name
    if largest in causes:
        step = next_step(causes[largest], terms_of(result), result.problem.origin.effects)
        of_all = f", {percent(weights[largest])} of all joints' squared errors"
        yield f"{step} (for {largest}{'' if largest == name else of_all})"
    held_out = result.held_out
    if held_out is None or held_out.by == "blocks":
        yield _OTHER_MOTION
    elif held_out.fit.moving.relative > FAILS * result.training.moving.relative:
        yield "train on both recordings: the first shows too little of what the other needs"
    if worst is not None and worst.level != "good":
        yield "record a motion that asks more of the worst joint: its error hides its dynamics"
    good = errors_of_urdf(result) is not None and _file(result) is None
    what = "identified.urdf" if good else _whole(result)
    yield f"none: use {what}, and validate again when the load or the temperature changes"


def _weight(fit: Validation, cause: Cause) -> float:
    """Return the share of the squared errors of all joints that a cause explains.

    0 where the joint's error is negligible.
    """
    joint = fit.joint_names.index(cause.joint)
    if fit.moving.nrmse[joint] < NEGLIGIBLE:
        return 0.0
    squares = fit.moving.rows * fit.moving.rmse**2
    return float(cause.share * squares[joint] / max(float(squares.sum()), np.finfo(float).tiny))


def _file(result: Judged) -> str | None:
    """Return what identified.urdf misses, and what to use instead where that is clearly more.

    As good is an error that differs by no more than another motion makes, or does not matter.
    """
    errors = errors_of_urdf(result)
    if errors is None or errors.file <= max(CARRIES * errors.estimate, NEGLIGIBLE):
        return None
    where = "fitted" if result.validation_samples is None else "validation"
    return (
        f"do not use identified.urdf alone for efforts: in motion on the {where} "
        f"recordings it misses {errors}; use {_whole(result)}, which leave nothing out"
    )


def _tilt(result: Judged) -> str | None:
    """Return how robots are written whose base was found to be tilted."""
    if "Tilt" not in terms_of(result):
        return None
    gravity = ", ".join(f"{x:.4g}" for x in result.estimate.model().tilted_gravity)
    return (
        f"the base stands tilted, as found: identified.urdf on a new root link '{LINK}', "
        f"identified.xml under gravity ({gravity}) m/s²"
    )


def _whole(result: Judged) -> str:
    """Return in words what has all terms: no code has terms of one's own, a URDF has the tilt."""
    code = _CODE if terms_of(result) <= KINDS.keys() | {"Tilt"} else ""
    return f"estimate.model() or parameters.json{code}"


def _beside(result: Judged) -> str | None:
    """Return the errors of the baselines and of the estimate, on the same rows in motion."""
    held_out = result.held_out
    if held_out is None or not held_out.fit.moving.rows.any():
        return None
    words = {
        DESCRIPTION: "your description",
        FRICTION_FITTED: "with friction fitted",
        OURS: "this estimate",
    }
    errors = [
        f"{words.get(name, name)} {percent(fit.moving.relative)}"
        + (_no_robot(result) if name == LEAST_SQUARES else "")
        for name, fit in held_out.every.items()
    ]
    return f"{' | '.join(errors)} in motion"
