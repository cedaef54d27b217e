"""Small plots of one joint, for a page that is read on a phone as well: one column of panels.

No names stand in them, so nothing that a robot's description says is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdpid._arrays import Array, Mask
from sdpid.assurance.residuals import JointErrors
from sdpid.output.figures import BLUE, GREY, RED, TimeLine, stretch
from sdpid.output.vector import COLUMNS, Axis, Panel, picture

# Heights of the panels, in units of the picture (it is 420 wide): of two, of three of which two
# share an axis, and of three. All pictures are as high, and three joints fit on a printed page.
_EFFORT, _ERROR, _SHARED, _THIRD = 174.0, 128.0, 86.0, 74.0

# Densities below this share of the highest are not shown: what a filter left above its cut-off is
# nothing to look at.
_FLOOR, _TOP = 1e-5, 3.0

# About so many ticks under a picture.
_TICKS = 6

# What the autocorrelation of independent errors stays within, nineteen times of twenty.
_WITHIN = 1.96


def plot_joint(
    time: Array | None,
    measured: Array,
    predicted: Array,
    used: Mask,
    *,
    starts: Sequence[int] = (0,),
) -> str:
    """Show measured against predicted effort of a joint, and the error below.

    Parameters
    ----------
    time : ndarray, shape (K,), or None
        In s; None: the samples are counted.
    measured, predicted : ndarray, shape (K,)
        Efforts, N·m.
    used : ndarray of bool, shape (K,)
        True where a row counts; the others are shaded.
    starts : sequence of int, optional
        First sample of each piece recorded without a break; they are drawn behind each other.

    Returns
    -------
    str
        SVG.
    """
    line = TimeLine.of(time, len(measured), starts)
    t, used = line.time, line.kept(used)
    measured, predicted = line.broken(measured), line.broken(predicted)
    error = np.where(used, measured - predicted, np.nan)
    long = stretch(len(t), points=2 * COLUMNS) > 1
    across = Axis(float(t[0]), float(t[-1]), line.label, count=_TICKS)
    above = Panel(across, Axis.around("effort [N·m]", measured, predicted), _EFFORT)
    below = Panel(across, Axis.around("error [N·m]", error), _ERROR)
    panels = [above, below]
    if long:
        above.height = below.height = _SHARED
        # Between two instants that are samples, in full.
        part = detail(error)
        near, y, z = t[part], measured[part], predicted[part]
        label = f"{line.label.partition(',')[0]}, about the largest error"
        along = Axis(float(near[0]), float(near[-1]), label)
        panels.append(Panel(along, Axis.around("effort [N·m]", y, z), _SHARED))
        _efforts(panels[-1], near, y, z, used[part])
    _efforts(above, t, measured, predicted, used)
    above.keys = [("measured", BLUE), ("predicted", RED)]
    below.shade(t, ~used)
    below.line(t, error, GREY, 0.9)
    return picture(panels, "measured against predicted effort, and the error")


def _efforts(panel: Panel, t: Array, measured: Array, predicted: Array, used: Mask) -> None:
    panel.shade(t, ~used)
    panel.line(t, measured, BLUE, 2.2)
    panel.line(t, predicted, RED, 1.2)


def detail(error: Array) -> slice:
    """Return which of many samples are shown in full: those about the largest error."""
    size = np.abs(error)
    at = 0 if np.isnan(size).all() else int(np.nanargmax(size))
    first = min(max(at - COLUMNS // 2, 0), max(len(error) - COLUMNS, 0))
    return slice(first, first + COLUMNS)


def plot_joint_errors(errors: JointErrors, *, timed: bool = True) -> str:
    """Show spectrum, autocorrelation and velocity dependence of a joint's errors.

    Parameters
    ----------
    errors : JointErrors
        From `sdpid.assurance.residuals.joint_errors`.
    timed : bool, optional
        Whether frequencies are in Hz and lags in s, rather than in samples.

    Returns
    -------
    str
        SVG.
    """
    panels = (_spectrum(errors, timed), _correlation(errors, timed), _friction(errors))
    return picture(panels, "spectrum, autocorrelation and velocity dependence of the error")


def _spectrum(errors: JointErrors, timed: bool) -> Panel:
    f = errors.frequency
    positive = f > 0.0
    top = max(float(errors.effort_density.max()), float(errors.error_density.max())) or 1.0
    ends = (float(f[positive][0]), float(f[-1])) if positive.any() else (0.1, 1.0)
    across = Axis(*ends, "frequency [Hz]" if timed else "cycles per sample", log=True, count=_TICKS)
    unit = "N·m/√Hz" if timed else "N·m"
    panel = Panel(across, Axis(_FLOOR * top, _TOP * top, unit, log=True), _THIRD)
    for density, colour, label in (
        (errors.effort_density, BLUE, "measured effort"),
        (errors.error_density, RED, "error"),
    ):
        shown = positive & (density > 0.0)
        panel.line(f[shown], density[shown], colour, 1.0, label=label)
    return panel


def _correlation(errors: JointErrors, timed: bool) -> Panel:
    level = _WITHIN / float(np.sqrt(errors.independent))
    end = max(float(errors.lag[-1]), 1e-9)
    band = np.array([-level, level])
    panel = Panel(
        Axis(0.0, end, "lag [s]" if timed else "lag [samples]", count=_TICKS),
        Axis.around("autocorrelation", errors.autocorrelation, band),
        _THIRD,
    )
    panel.area(np.array([0.0, end]), np.full(2, -level), np.full(2, level))
    panel.line(errors.lag, errors.autocorrelation, RED, 1.2)
    return panel


def _friction(errors: JointErrors) -> Panel:
    v = errors.velocity
    across = Axis.around("velocity [rad/s]", v)
    along = Axis.around("error [N·m]", errors.low, errors.high, np.zeros(1))
    panel = Panel(across, along, _THIRD)
    if len(v):
        panel.area(v, errors.low, errors.high)
    panel.line(np.array([across.low, across.high]), np.zeros(2), GREY, 0.8)
    if len(v):
        panel.line(v, errors.mean, RED, 1.2, dots=True)
    return panel
