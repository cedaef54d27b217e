"""Small plots of one joint, for a page that is read on a phone as well: one column of panels.

No names stand in them, so nothing that a robot's description says is drawn.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from sdpid._arrays import Array, Mask
from sdpid._extras import require
from sdpid.assurance.residuals import JointErrors
from sdpid.output.figures import (
    BLUE,
    GREY,
    INK,
    RED,
    SHADE,
    TimeLine,
    decimate,
    dress,
    legend,
    new_figure,
    shade,
)

# Inches; at the width of a phone (some 340 pixels) letters of 8 points stay readable.
_WIDTH, _HEIGHT = 4.6, 4.4

# Points a line: the page shows it some 600 pixels wide, each with a low and a high.
_POINTS = 1000

# Densities below this share of the highest are not shown.
_FLOOR = 1e-4


def plot_joint(
    time: Array | None,
    measured: Array,
    predicted: Array,
    used: Mask,
    *,
    starts: Sequence[int] = (0,),
) -> Any:
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
    matplotlib.figure.Figure
    """
    line = TimeLine.of(time, len(measured), starts)
    t, used = line.time, line.kept(used)
    measured, predicted = line.broken(measured), line.broken(predicted)
    figure = new_figure(_WIDTH, _HEIGHT)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1.5, 1.0))
    for axis in (above, below):
        shade(axis, t, ~used)
    _line(above, t, measured, color=BLUE, label="measured", linewidth=1.4)
    _line(above, t, predicted, color=RED, label="predicted", linewidth=0.8)
    _line(below, t, np.where(used, measured - predicted, np.nan), color=GREY, linewidth=0.8)
    dress(above, ylabel="effort [N·m]")
    dress(below, ylabel="error [N·m]", xlabel=line.label)
    below.set_xlim(t[0], t[-1])
    legend(above, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
    figure.align_ylabels((above, below))
    return figure


def plot_joint_errors(errors: JointErrors, *, timed: bool = True) -> Any:
    """Show spectrum, autocorrelation and velocity dependence of a joint's errors.

    Parameters
    ----------
    errors : JointErrors
        From `sdpid.assurance.residuals.joint_errors`.
    timed : bool, optional
        Whether frequencies are in Hz and lags in s, rather than in samples.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = new_figure(_WIDTH, _HEIGHT)
    spectrum, correlation, friction = figure.subplots(3, 1)
    for density, colour, label in (
        (errors.effort_density, BLUE, "measured effort"),
        (errors.error_density, RED, "error"),
    ):
        shown = (errors.frequency > 0.0) & (density > 0.0)
        if np.any(shown):
            spectrum.loglog(
                errors.frequency[shown], density[shown], color=colour, linewidth=0.9, label=label
            )
    # What a filter left above its cut-off is nothing to look at.
    top = max(float(errors.effort_density.max()), float(errors.error_density.max()))
    if top > 0.0:
        spectrum.set_ylim(_FLOOR * top, 3.0 * top)
    dress(spectrum, ylabel="N·m/√Hz" if timed else "N·m")
    spectrum.set_xlabel("frequency [Hz]" if timed else "cycles per sample", fontsize=8, color=INK)
    legend(spectrum, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
    _line(correlation, errors.lag, errors.autocorrelation, color=RED, linewidth=1.0)
    # What the autocorrelation of independent errors stays within, nineteen times of twenty.
    level = 1.96 / np.sqrt(errors.independent)
    correlation.axhspan(-level, level, color=SHADE, alpha=0.6, linewidth=0)
    dress(correlation, ylabel="autocorrelation")
    correlation.set_xlabel("lag [s]" if timed else "lag [samples]", fontsize=8, color=INK)
    correlation.set_xlim(0.0, max(float(errors.lag[-1]), 1e-9))
    if len(errors.velocity):
        friction.fill_between(errors.velocity, errors.low, errors.high, color=SHADE, linewidth=0)
        friction.plot(errors.velocity, errors.mean, color=RED, marker="o", markersize=2.5, lw=1.0)
    friction.axhline(0.0, color=GREY, linewidth=0.6)
    dress(friction, ylabel="error [N·m]")
    friction.set_xlabel("velocity [rad/s]", fontsize=8, color=INK)
    for axis in (spectrum, correlation, friction):
        axis.yaxis.label.set_fontsize(8)
    figure.align_ylabels((spectrum, correlation, friction))
    return figure


def svg(figure: Any) -> bytes:
    """Return a figure as SVG; the same figure gives the same bytes."""
    matplotlib = require("matplotlib", extra="plot")
    out = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "sdpid"}):
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def _line(axis: Any, x: Array, y: Array, **style: Any) -> None:
    axis.plot(*decimate(x, y, points=_POINTS), **style)
