"""Joint by joint: errors, charts, what the robot was driven to, and a figure of all joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.diagnostics.bands import effort_band
from sdpid.assurance.diagnostics.causes import JointErrors
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.assurance.intervals.delta_method import joint_curves
from sdpid.errors import SdpidError
from sdpid.output.charts.charts import Charts
from sdpid.output.report.judged import Judged, grades_of, judged
from sdpid.output.report.sections.recording import driven
from sdpid.plots.figures import dress, panels
from sdpid.plots.joints import FLOOR, WITHIN, detail, heights, plot_friction_curve, plot_joint
from sdpid.plots.lines import TimeLine, decimate, spans, stretch
from sdpid.robot.friction.curve import JointCurve, default_velocities

# Friction is shown up to the speed limit, but no further than this beyond what was recorded.
_BEYOND = 1.5

# Places of a line over time at which it is held, about: the least and the greatest effort of each
# stretch, and as many of the error.
_POINTS = 1500

# Samples that are shown as dots; more would hide the curve.
_DOTS = 400


def values(
    result: Judged, errors: tuple[JointErrors, ...], charts: Charts, line: TimeLine
) -> dict[str, Any]:
    """Return the values of the template, over the time of what was judged."""
    samples, _ = judged(result)
    return {
        "fits": list(_fits(result)),
        "floating": list(_floating(result)),
        "held_title": _held_title(result),
        "has_mask": samples.mask is not None,
        "timed": samples.time is not None,
        "time_label": line.label,
        "plots": list(_plots(result, errors, charts, line)),
        "stretch": stretch(samples.n_samples, points=_POINTS),
    }


def _fits(result: Judged) -> Iterator[dict[str, Any]]:
    """Yield the errors of every joint, on training and validation data."""
    training, free = result.training, result.training_wls
    held = None if result.held_out is None else result.held_out.fit
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


def _errors(fit: Validation, j: int) -> dict[str, float | bool]:
    """Return a joint's errors, and whether there was no effort of which they are a share."""
    told = fit.moving if fit.moving.rows[j] else fit
    found: dict[str, float | bool] = {
        name: float(getattr(told, name)[j]) for name in ("rmse", "nrmse", "r2")
    }
    return {**found, "silent": bool(np.isinf(told.nrmse[j]))}


def _held_title(result: Judged) -> str:
    """Return what was held out, as the title of columns."""
    if result.held_out is None:
        return ""
    if result.held_out.by == "recording":
        return "validation (held out)"
    return f"{result.held_out.blocks} blocks (held out in turn)"


@dataclass(frozen=True, eq=False)
class JointShown:
    """What is shown of one joint on what the estimate is judged by.

    Attributes
    ----------
    name, unit : str
        The joint, and the unit of its efforts.
    measured, predicted : ndarray, shape (K,)
        Efforts.
    used : ndarray of bool, shape (K,)
        Which rows count.
    half : ndarray, shape (K,), or None
        Half-width of the band about the prediction.
    curve : JointCurve or None
        Its friction.
    cloud : (ndarray, ndarray) or None
        Velocities, ascending, and the curve with the errors of some samples.
    speeds : (float, float)
        Least and greatest velocity of the data that were fitted.
    """

    name: str
    unit: str
    measured: Array
    predicted: Array
    used: Mask
    half: Array | None
    curve: JointCurve | None
    cloud: tuple[Array, Array] | None
    speeds: tuple[float, float]


def joints_shown(result: Judged) -> Iterator[JointShown]:
    """Yield what is shown of every joint."""
    samples, fit = judged(result)
    curves, band, error = _curves(result), _band(result), samples.effort - fit.effort_predicted
    for j, (name, seen) in enumerate(zip(fit.joint_names, driven(result), strict=True)):
        curve, used = curves.get(name), samples.used[:, j]
        velocity = samples.velocity[used, j]
        yield JointShown(
            name=name,
            unit="N·m" if curve is None else curve.unit,
            measured=samples.effort[:, j],
            predicted=fit.effort_predicted[:, j],
            used=used,
            half=None if band is None else band[:, j],
            curve=curve,
            cloud=_cloud(curve, velocity, error[used, j]) if curve and used.any() else None,
            speeds=seen["speeds"],
        )


def _plots(
    result: Judged, errors: tuple[JointErrors, ...], charts: Charts, line: TimeLine
) -> Iterator[dict[str, Any]]:
    """Yield the charts of every joint."""
    _, fit = judged(result)
    shown = {each.joint: each for each in errors}
    for j, (own, seen) in enumerate(zip(joints_shown(result), driven(result), strict=True)):
        if own.name in shown:
            yield {
                "name": own.name,
                "unit": own.unit,
                **_errors(fit, j),
                "driven": seen,
                **_efforts(own, line, charts),
                "friction": None if own.curve is None else _friction(own, own.curve, charts),
                **_error_shapes(shown[own.name], charts),
            }


def _efforts(own: JointShown, line: TimeLine, charts: Charts) -> dict[str, Any]:
    """Return efforts over time: of many samples the extremes, and all about the largest error."""
    error = line.broken(np.where(own.used, own.measured - own.predicted, np.nan))
    columns = {"x": line.time, "measured": line.broken(own.measured), "error": error}
    columns["predicted"] = line.broken(own.predicted)
    if own.half is not None:
        columns["half"] = line.broken(own.half)
    places = np.arange(len(error), dtype=np.float64)
    extremes = [decimate(places, columns[y], points=_POINTS)[0] for y in ("measured", "error")]
    kept = np.unique(np.concatenate(extremes)).astype(np.intp)
    shaded = np.stack(spans(line.time, ~line.kept(own.used)), axis=1)
    near = detail(error) if len(kept) < len(error) else None
    return {
        "efforts": charts.add(shaded=shaded, **{k: each[kept] for k, each in columns.items()}),
        "near": near and charts.add(**{k: each[near] for k, each in columns.items()}),
    }


def _friction(own: JointShown, curve: JointCurve, charts: Charts) -> int:
    """Return the friction over the velocity, shaded where it was not driven."""
    ends = float(curve.velocity.min()), float(curve.velocity.max())
    beyond = np.array([(ends[0], own.speeds[0]), (own.speeds[1], ends[1])])
    at, measured = own.cloud or (None, None)
    band = {"low": curve.lower, "high": curve.upper, "range": heights(curve, own.cloud)}
    shown = {"x": curve.velocity, "friction": curve.effort, "at": at, "measured": measured}
    return charts.add(shaded=beyond, **shown, **band)


def _error_shapes(errors: JointErrors, charts: Charts) -> dict[str, int | None]:
    """Return spectrum (exponents of ten), autocorrelation and velocity dependence of the error.

    A joint that hardly moves has no velocities to show its error over.
    """
    densities = np.stack([errors.effort_density, errors.error_density])[:, errors.frequency > 0.0]
    seen = densities > FLOOR * densities.max(initial=0.0)
    powers = np.log10(densities, where=seen, out=np.full(densities.shape, np.nan))
    frequency = np.log10(errors.frequency[errors.frequency > 0.0])
    level = np.full(len(errors.lag), WITHIN / float(np.sqrt(errors.independent)))
    over = {"mean": errors.mean, "low": errors.low, "high": errors.high}
    return {
        "spectrum": charts.add(x=frequency, **{"measured effort": powers[0], "error": powers[1]}),
        "memory": charts.add(x=errors.lag, autocorrelation=errors.autocorrelation, level=level),
        "over_velocity": charts.add(x=errors.velocity, **over) if len(errors.velocity) else None,
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
    some = some[np.argsort(velocity[some])]
    v = velocity[some]
    return v, np.interp(v, curve.velocity, curve.effort) + error[some]


# Inches: of the figure, and of a row.
_WIDTH, _ROW = 14.0, 2.1


def plot_overview(result: Judged, *, title: str | None = None, axes: Any = None) -> Any:
    """Show effort, error and friction of every joint, with their bands: one row a joint.

    Parameters
    ----------
    result : Identification
        The result; shown is what it is judged by, held out where there is something held out.
    title : str, optional
        Heading of the figure.
    axes : array of matplotlib.axes.Axes, shape (n, 3), optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, shape (n, 3)
        Of effort and error over time, and of friction over velocity; the last of a row is empty
        where a joint has no friction.
    """
    (samples, _), joints = judged(result), list(joints_shown(result))
    starts = samples.starts
    size = (_WIDTH, 0.6 + _ROW * len(joints))
    axes = panels(axes, len(joints), 3, size=size, title=title, width_ratios=(3.0, 2.0, 2.0))
    for row, own in zip(axes, joints, strict=True):
        rows = own.measured, own.predicted, own.used
        plot_joint(samples.time, *rows, band=own.half, unit=own.unit, starts=starts, axes=row[:2])
        dress(row[0], title=own.name, xlabel=row[1].get_xlabel())
        if own.curve is None:
            row[2].set_axis_off()
        else:
            plot_friction_curve(own.curve, cloud=own.cloud, driven=own.speeds, axes=row[2])
    return axes
