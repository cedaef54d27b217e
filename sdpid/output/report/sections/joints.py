"""Joint by joint: errors, pictures, and what the robot was driven to."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sdpid.assurance.diagnostics.residuals import JointErrors
from sdpid.assurance.diagnostics.validation import Errors
from sdpid.output.report.judged import Judged, grades_of, judged
from sdpid.plots.figures import stretch
from sdpid.plots.inline_svg import image_source
from sdpid.plots.joints import COLUMNS, plot_joint, plot_joint_errors

# What the pictures show.
_EFFORTS = "measured against predicted effort, and the error"
_ERRORS = "spectrum, autocorrelation and velocity dependence of the error"


def values(result: Judged, errors: tuple[JointErrors, ...], draw: bool) -> dict[str, Any]:
    """Return the values of the template."""
    samples, _ = judged(result)
    return {
        "fits": list(_fits(result)),
        "held_title": _held_title(result),
        "has_mask": samples.mask is not None,
        "plots": list(_plots(result, errors)) if draw else [],
        "stretch": stretch(samples.n_samples, points=2 * COLUMNS),
    }


def _fits(result: Judged) -> Iterator[dict[str, Any]]:
    """Yield the errors of every joint, on training and validation data."""
    training, free = result.training, result.training_wls
    held = None if result.held_out is None else result.held_out.fit.moving
    levels = {each.joint: each.level for each in grades_of(result)}
    for j, name in enumerate(training.joint_names):
        if training.rows[j] == 0:
            continue
        yield {
            "name": name,
            "level": levels[j],
            "training": _errors(training, j),
            "free": _errors(free, j),
            "held": None if held is None else _errors(held, j),
        }


def _errors(fit: Errors, j: int) -> dict[str, float]:
    return {"rmse": float(fit.rmse[j]), "nrmse": float(fit.nrmse[j]), "r2": float(fit.r2[j])}


def _held_title(result: Judged) -> str:
    """Return what was held out, as the title of columns."""
    if result.held_out is None:
        return ""
    if result.held_out.by == "recording":
        return "validation (held out)"
    return f"{result.held_out.blocks} blocks (held out in turn)"


def _plots(result: Judged, errors: tuple[JointErrors, ...]) -> Iterator[dict[str, Any]]:
    """Yield the figures of every joint."""
    samples, fit = judged(result)
    shown = {each.joint: each for each in errors}
    for j, name in enumerate(fit.joint_names):
        if name not in shown:
            continue
        columns = samples.effort[:, j], fit.effort_predicted[:, j], samples.used[:, j]
        efforts = plot_joint(samples.time, *columns, starts=samples.starts)
        found = plot_joint_errors(shown[name], timed=samples.time is not None)
        yield {
            "name": name,
            "rmse": float(fit.rmse[j]),
            "r2": float(fit.r2[j]),
            "pictures": [
                (image_source(efforts), _EFFORTS),
                (image_source(found), _ERRORS),
            ],
        }
