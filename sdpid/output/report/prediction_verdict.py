"""Findings about a prediction: how well efforts are explained, and what the errors go with."""

from __future__ import annotations

from collections.abc import Iterator

from sdpid.assurance.diagnostics.causes import find_causes
from sdpid.assurance.diagnostics.residuals import joint_errors
from sdpid.assurance.diagnostics.rest import rest_speeds
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.experiment.processing.samples import Samples
from sdpid.output.report.cause_words import cause_findings
from sdpid.output.report.finding import Finding, listed, percent
from sdpid.output.report.grades import MARGIN, SMALL, Grade, graded
from sdpid.robot.model.model import RobotModel


def prediction_findings(
    robot: RobotModel, samples: Samples, fit: Validation
) -> tuple[Finding, ...]:
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
    tuple of Finding
        The most important first.
    """
    return (
        *effort_findings(samples, fit, "this recording"),
        *cause_findings(
            fit, find_causes(robot, robot.prior, samples, fit, joint_errors(samples, fit))
        ),
    )


def effort_findings(
    samples: Samples, fit: Validation, where: str, given: tuple[Grade, ...] | None = None
) -> Iterator[Finding]:
    """Yield which joints' efforts are predicted well, roughly or badly; `where` names the data.

    By the given grades, or else by those of this prediction alone.
    """
    given = tuple(graded(samples, fit)) if given is None else given
    named: dict[str, list[str]] = {
        key: [] for key in ("good", "caution", "bad", "still", "flat", "unshown")
    }
    for each in given:
        name, words = fit.joint_names[each.joint], _explained(fit, each.joint)
        if not each.moved:
            limit = f"{rest_speeds(fit.slides)[each.joint]:g}"
            unit = "m/s" if fit.slides[each.joint] else "rad/s"
            named["still"].append(f"{name} (never faster than {limit} {unit})")
        elif not each.shown:
            named["unshown"].append(f"{name} ({words})")
        elif each.level == "caution" and float(fit.moving.r2[each.joint]) < 0.0:
            named["flat"].append(f"{name} ({words})")
        else:
            named[each.level].append(f"{name} ({words})")
    if named["good"]:
        every = len(named["good"]) == len(fit.joint_names) - fit.n_base
        which = "every joint" if every else "the joints"
        yield Finding(
            "good",
            f"Trust it for the effort of {which} in motion like the recorded, as feed-forward and "
            f"simulation need; share of the effort's variance explained on {where}: "
            f"{listed(named['good'], 99)}.",
        )
    if named["unshown"]:
        yield Finding(
            "caution",
            f"Not shown on other motion: {listed(named['unshown'], 99)}. In brackets: share of the "
            f"effort's variance explained on {where}. That is the same motion, and errors on "
            f"another are up to {MARGIN:g} times as large and more: too large there to be sure. "
            "Record another motion and give it with --validation.",
        )
    if named["caution"]:
        yield Finding(
            "caution",
            f"Expect it to be roughly right, not exact, for {listed(named['caution'], 99)}; "
            "feedback has to make up for the rest. In brackets: share of the effort's variance "
            f"explained on {where}.",
        )
    if named["flat"]:
        yield Finding(
            "caution",
            f"Do not rely on it for how the effort varies of {listed(named['flat'], 99)}: on "
            f"{where} the effort is nearly constant. The error is small beside it (limit "
            f"{percent(SMALL)}), but its mean predicts better. Validate on a motion in which the "
            "effort varies.",
        )
    if named["bad"]:
        yield Finding(
            "bad",
            f"Do not trust it for the effort of {listed(named['bad'], 99)}: too little of the "
            "variance is explained. Contact cannot be told from model error there.",
            f"trust the effort of {listed(named['bad'], 99)}; in brackets: variance explained",
        )
    if named["still"]:
        yield Finding(
            "bad",
            f"Joints that did not move on {where}: {listed(named['still'], 99)}. How well "
            "their effort is predicted in motion is not known. Record them moving.",
            f"trust the effort of {listed(named['still'], 99)} in motion",
        )
    yield from _rest(fit)


def _rest(fit: Validation) -> Iterator[Finding]:
    """Yield by how much the effort is missed at rest, where it is missed by more than in motion."""
    rest = fit.resting
    if rest is None or not fit.moving.rows.any() or rest.relative <= fit.moving.relative:
        return
    yield Finding(
        "caution",
        f"At rest ({percent(resting_share(fit))} of the rows) the error is "
        f"{percent(rest.relative)} of the effort, in motion {percent(fit.moving.relative)}: "
        "stiction holds there, which no function of the velocity tells. Errors here are "
        "those in motion.",
    )


def resting_share(fit: Validation) -> float:
    """Return the share of the rows in motion and at rest that are at rest."""
    if fit.resting is None:
        return 0.0
    rest = int(fit.resting.rows.sum())
    return rest / max(rest + int(fit.moving.rows.sum()), 1)


def _explained(fit: Validation, joint: int) -> str:
    """Return R² in words: below zero the mean effort predicts better."""
    errors = fit.moving
    if not errors.rows[joint]:
        errors = fit
    r2, nrmse = float(errors.r2[joint]), float(errors.nrmse[joint])
    if r2 < 0.0:
        error = f", error {percent(nrmse)} of the effort" if nrmse <= SMALL else ""
        return f"worse than a constant{error}"
    return "over 99.9 %" if r2 > 0.999 else percent(r2)
