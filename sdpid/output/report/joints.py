"""Joint by joint: errors, charts, and a figure of all joints."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.diagnostics.causes import JointErrors
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.assurance.intervals.delta_method import joint_curves
from sdpid.errors import SdpidError
from sdpid.output.charts.page import Charts
from sdpid.output.report.recording import driven
from sdpid.output.report.subject import Judged, VerdictSubject
from sdpid.plots.figures import dress, panels
from sdpid.plots.joints import FLOOR, WITHIN, detail, heights, plot_friction_curve, plot_joint
from sdpid.plots.lines import TimeLine, decimate, spans, stretch
from sdpid.robot.friction.model import JointCurve, default_velocities

# Friction is shown up to the speed limit, but no further than this beyond what was recorded.
_BEYOND = 1.5

# Places of a line over time at which it is held, about: the least and the greatest effort of each
# stretch, and as many of the error.
_POINTS = 1500

# Samples that are shown as dots; more would hide the curve.
_DOTS = 400


def values(of: VerdictSubject, charts: Charts, line: TimeLine) -> dict[str, Any]:
    """Return the values of the template, over the time of what was judged."""
    fits = {"training": of.result.training, "free": of.result.training_wls}
    title = "validation (held out)"
    if of.held_out is not None:
        fits["held"] = of.held_out.fit
        if not of.other_motion:
            title = f"{of.held_out.blocks} blocks (held out in turn)"
    # A base that is held in one recording may move in another.
    bases = {key: {} if f.floating is None else dict(f.floating.rows) for key, f in fits.items()}
    return {
        "fits": [
            {"name": of.fit.joint_names[each.joint], "level": each.level}
            | {key: _errors(fit, each.joint) for key, fit in fits.items()}
            for each in of.grades
        ],
        "floating": [
            {"name": name} | {key: sizes.get(name) for key, sizes in bases.items()}
            for name in dict.fromkeys(name for sizes in bases.values() for name in sizes)
        ],
        "held_title": title,
        "timed": of.samples.time is not None,
        "time_label": line.label,
        "plots": list(_plots(of, charts, line)),
        "stretch": stretch(of.samples.n_samples, points=_POINTS),
    }


def _errors(fit: Validation, j: int) -> dict[str, Any]:
    """Return a joint's errors, and whether there was no effort of which they are a share."""
    told = fit.moving if fit.moving.rows[j] else fit
    sizes = {name: float(getattr(told, name)[j]) for name in ("rmse", "nrmse", "r2")}
    return {**sizes, "silent": bool(np.isinf(told.nrmse[j]))}


def _plots(of: VerdictSubject, charts: Charts, line: TimeLine) -> Iterator[dict[str, Any]]:
    """Yield the charts of every joint."""
    curves, seen = _curves(of), list(driven(of))
    for each in of.errors:
        j, curve = of.fit.joint_names.index(each.joint), curves.get(each.joint)
        yield {
            "name": each.joint,
            "unit": "N·m" if curve is None else curve.unit,
            **_errors(of.fit, j),
            "driven": seen[j],
            **_efforts(of, j, line, charts),
            "friction": None if curve is None else _friction(of, j, curve, charts),
            **_error_shapes(each, charts),
        }


def _efforts(of: VerdictSubject, j: int, line: TimeLine, charts: Charts) -> dict[str, Any]:
    """Return efforts over time: of many samples the extremes, and all about the largest error."""
    measured, predicted, used = _efforts_of(of, j)
    columns = {
        "measured": measured,
        "error": np.where(used, measured - predicted, np.nan),
        "predicted": predicted,
    }
    if of.band is not None:
        columns["half"] = of.band[:, j]
    columns = {"x": line.time} | {name: line.broken(y) for name, y in columns.items()}
    error = columns["error"]
    places = np.arange(len(error), dtype=np.float64)
    extremes = [decimate(places, columns[y], points=_POINTS)[0] for y in ("measured", "error")]
    kept = np.unique(np.concatenate(extremes)).astype(np.intp)
    shaded = np.stack(spans(line.time, ~line.kept(used)), axis=1)
    near = detail(error) if len(kept) < len(error) else None
    return {
        "efforts": charts.add(shaded=shaded, **{k: y[kept] for k, y in columns.items()}),
        "near": near and charts.add(**{k: y[near] for k, y in columns.items()}),
    }


def _efforts_of(of: VerdictSubject, j: int) -> tuple[Array, Array, Mask]:
    """Return a joint's measured and predicted efforts, and which rows count, (K,) each."""
    return of.samples.effort[:, j], of.fit.effort_predicted[:, j], of.samples.used[:, j]


def _friction(of: VerdictSubject, j: int, curve: JointCurve, charts: Charts) -> int:
    """Return the friction over the velocity, shaded where it was not driven."""
    low, high = _speeds(of, j)
    beyond = np.array([(curve.velocity.min(), low), (high, curve.velocity.max())])
    cloud = _cloud(of, j, curve)
    at, measured = cloud or (None, None)
    band = {"low": curve.lower, "high": curve.upper, "range": heights(curve, cloud)}
    shown = {"x": curve.velocity, "friction": curve.effort, "at": at, "measured": measured}
    return charts.add(shaded=beyond, **shown, **band)


def _speeds(of: VerdictSubject, j: int) -> tuple[float, float]:
    """Return the least and the greatest velocity of the data that were fitted."""
    velocity = of.problem.samples.velocity[:, j]
    return float(velocity.min()), float(velocity.max())


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


def _curves(of: VerdictSubject) -> dict[str, JointCurve]:
    """Return the friction curve of every joint with friction, over what was driven and beyond."""
    friction = of.problem.friction
    if not friction.parameters:
        return {}
    both = np.abs(np.vstack([of.problem.samples.velocity, of.samples.velocity])).max(axis=0)
    tops = np.fmax(both, np.fmin(_BEYOND * both, of.robot.velocity_limits))[friction.first :]
    velocities = {j: default_velocities(float(top)) for j, top in enumerate(tops)}
    try:
        curves = joint_curves(of.estimate, velocities)
    except SdpidError:  # too few rows for intervals
        model = of.estimate.model()
        curves = tuple(model.friction_curve(j, v) for j, v in velocities.items())
    return {curve.joint: curve for curve in curves}


def _cloud(of: VerdictSubject, j: int, curve: JointCurve) -> tuple[Array, Array] | None:
    """Return velocities, and the curve with the errors of the samples; of many some, evenly."""
    measured, predicted, used = _efforts_of(of, j)
    if not used.any():
        return None
    velocity, error = of.samples.velocity[used, j], (measured - predicted)[used]
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
    of = result._subject
    names, curves, samples = of.fit.joint_names, _curves(of), of.samples
    size = (_WIDTH, 0.6 + _ROW * len(names))
    axes = panels(axes, len(names), 3, size=size, title=title, width_ratios=(3.0, 2.0, 2.0))
    for j, (row, name) in enumerate(zip(axes, names, strict=True)):
        curve, rows = curves.get(name), _efforts_of(of, j)
        band, unit = None if of.band is None else of.band[:, j], curve.unit if curve else "N·m"
        where = {"band": band, "unit": unit, "starts": samples.starts, "axes": row[:2]}
        plot_joint(samples.time, *rows, **where)
        dress(row[0], title=name, xlabel=row[1].get_xlabel())
        if curve is None:
            row[2].set_axis_off()
        else:
            cloud = _cloud(of, j, curve)
            plot_friction_curve(curve, cloud=cloud, driven=_speeds(of, j), axes=row[2])
    return axes
