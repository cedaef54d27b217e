"""Joint by joint: errors, pictures, and what the robot was driven to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.bands import effort_band
from sdpid.assurance.diagnostics.residuals import JointErrors
from sdpid.assurance.diagnostics.validation import Errors, Validation
from sdpid.assurance.intervals.friction_curve import joint_curves
from sdpid.errors import SdpidError
from sdpid.experiment.processing.samples import Samples
from sdpid.output.report.judged import Judged, grades_of, judged
from sdpid.output.report.sections.recording import driven
from sdpid.plots.figures import stretch
from sdpid.plots.friction_curve import plot_friction_curve
from sdpid.plots.in_pages import image_source
from sdpid.plots.joints import COLUMNS, plot_joint, plot_joint_errors
from sdpid.robot.friction.curve import JointCurve, default_velocities

# What the pictures show.
_EFFORTS = "measured against predicted effort, and the error"
_FRICTION = (
    "friction over velocity with its band, and the measured effort less the rest of the model"
)
_ERRORS = "spectrum, autocorrelation and velocity dependence of the error"

# Friction is shown up to the speed limit, but no further than this beyond what was recorded.
_BEYOND = 1.5

# Samples that are shown as dots; more would hide the curve.
_DOTS = 400


def values(result: Judged, errors: tuple[JointErrors, ...], draw: bool) -> dict[str, Any]:
    """Return the values of the template."""
    samples, _ = judged(result)
    return {
        "fits": list(_fits(result)),
        "floating": list(_floating(result)),
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
        if j not in levels:
            continue  # Its effort was not measured, or it has no motor.
        yield {
            "name": name,
            "level": levels[j],
            "training": _errors(training, j),
            "free": _errors(free, j),
            "held": None if held is None else _errors(held, j),
        }


def _floating(result: Judged) -> Iterator[dict[str, Any]]:
    """Yield what the equations of a floating base miss, on training and validation data."""
    errors = {
        "training": result.training.floating,
        "free": result.training_wls.floating,
        "held": None if result.held_out is None else result.held_out.fit.floating,
    }
    # A base that is held in one recording may move in another.
    told = next((each for each in errors.values() if each is not None), None)
    for i, (name, _) in enumerate(() if told is None else told.rows):
        sizes = {key: None if each is None else each.rows[i][1] for key, each in errors.items()}
        yield {"name": name, **sizes}


def _errors(fit: Errors, j: int) -> dict[str, float | bool]:
    """Return a joint's errors, and whether there was no effort of which they are a share."""
    return {
        "rmse": float(fit.rmse[j]),
        "nrmse": float(fit.nrmse[j]),
        "r2": float(fit.r2[j]),
        "silent": bool(np.isinf(fit.nrmse[j])),
    }


def _held_title(result: Judged) -> str:
    """Return what was held out, as the title of columns."""
    if result.held_out is None:
        return ""
    if result.held_out.by == "recording":
        return "validation (held out)"
    return f"{result.held_out.blocks} blocks (held out in turn)"


@dataclass(frozen=True, eq=False)
class JointPictures:
    """The pictures of one joint on what the estimate is judged by.

    Attributes
    ----------
    joint : int
        Number of the joint, as of the efforts.
    samples : Samples
        What was measured.
    fit : Validation
        What was predicted.
    band : ndarray, shape (K, n), or None
        Half-width of the band about it.
    curve : JointCurve or None
        Its friction.
    speeds : (float, float)
        Least and greatest velocity of the data that were fitted.
    """

    joint: int
    samples: Samples
    fit: Validation
    band: Array | None
    curve: JointCurve | None
    speeds: tuple[float, float]

    @property
    def name(self) -> str:
        """Name of the joint."""
        return self.fit.joint_names[self.joint]

    @property
    def unit(self) -> str:
        """Unit of its efforts."""
        return "N·m" if self.curve is None else self.curve.unit

    def efforts(self, axes: Any = None) -> Any:
        """Draw measured against predicted effort, and the error, into two axes."""
        samples, j = self.samples, self.joint
        return plot_joint(
            samples.time,
            samples.effort[:, j],
            self.fit.effort_predicted[:, j],
            samples.used[:, j],
            band=None if self.band is None else self.band[:, j],
            starts=samples.starts,
            unit=self.unit,
            axes=axes,
        )

    def friction(self, axes: Any = None) -> Any:
        """Draw the friction over the velocity; None for a joint without friction."""
        if self.curve is None:
            return None
        samples, j = self.samples, self.joint
        used = samples.used[:, j]
        error = (samples.effort - self.fit.effort_predicted)[used, j]
        cloud = _cloud(self.curve, samples.velocity[used, j], error)
        return plot_friction_curve(self.curve, cloud=cloud, driven=self.speeds, axes=axes)


def joint_pictures(result: Judged) -> Iterator[JointPictures]:
    """Yield the pictures of every joint."""
    samples, fit = judged(result)
    seen, curves = list(driven(result)), _curves(result)
    band = _band(result)
    for j, name in enumerate(fit.joint_names):
        yield JointPictures(j, samples, fit, band, curves.get(name), seen[j]["speeds"])


def _plots(result: Judged, errors: tuple[JointErrors, ...]) -> Iterator[dict[str, Any]]:
    """Yield the figures of every joint."""
    samples, fit = judged(result)
    shown = {each.joint: each for each in errors}
    seen = list(driven(result))
    for own in joint_pictures(result):
        j, name = own.joint, own.name
        if name not in shown:
            continue
        pictures = [(image_source(own.efforts()), _EFFORTS)]
        if (friction := own.friction()) is not None:
            pictures.append((image_source(friction), _FRICTION))
        found = plot_joint_errors(shown[name], timed=samples.time is not None, unit=own.unit)
        pictures.append((image_source(found), _ERRORS))
        yield {
            "name": name,
            "unit": own.unit,
            **_errors(fit, j),
            "driven": seen[j],
            "pictures": pictures,
        }


def _band(result: Judged) -> Array | None:
    """Return the half-width (K, n) of the band about the judged prediction, if it is known."""
    samples, fit = judged(result)
    try:
        own = fit.effort_band
        return effort_band(result.estimate, samples) if own is None else own
    except SdpidError:  # no covariance; a picture must not cost the run
        return None


def _curves(result: Judged) -> dict[str, JointCurve]:
    """Return the friction curve of every joint with friction, over what was driven and beyond."""
    problem, (samples, _) = result.problem, judged(result)
    friction, robot = problem.friction, problem.robot
    if not friction.parameters:
        return {}
    both = np.abs(np.vstack([problem.samples.velocity, samples.velocity])).max(axis=0)
    tops = np.fmax(both, np.fmin(_BEYOND * both, robot.velocity_limits))[friction.first :]
    velocities = {j: default_velocities(float(top)) for j, top in enumerate(tops)}
    try:
        curves = joint_curves(result.estimate, velocities)
    except SdpidError:  # too few rows for intervals
        model = result.estimate.model()
        curves = tuple(model.friction_curve(j, v) for j, v in velocities.items())
    return {curve.joint: curve for curve in curves}


def _cloud(curve: JointCurve, velocity: Array, error: Array) -> tuple[Array, Array]:
    """Return velocities, and the curve with the errors of the samples; of many some, evenly."""
    some = np.unique(np.linspace(0, len(velocity) - 1, _DOTS).astype(np.intp))
    v = velocity[some]
    return v, np.interp(v, curve.velocity, curve.effort) + error[some]
