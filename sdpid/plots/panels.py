"""Figures of panels under each other, as wide as a phone's screen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sdpid._common.extras import require
from sdpid.plots.figures import SMALL, axes_of, dress, legend, new_figure

# Points.
WIDTH = 280.0

# Of a panel beside its frame, points: keys above, a label below.
_KEYS, _WORDS = 15.0, 35.0

# Approximate numbers of ticks.
_TICKS_X, _TICKS_Y = 6, 4

# Numbers beyond these powers of ten get a common factor, so that they fit on the left.
_POWERS = (-3, 4)


@dataclass(frozen=True)
class Panel:
    """The size and the labels of a panel.

    Attributes
    ----------
    height : float
        Of the frame, points.
    y, x : str
        What its axes show; where `x` is empty, the panel shares that axis with the one below it.
    keys : bool
        Whether there is room for a legend above.
    """

    height: float
    y: str
    x: str = ""
    keys: bool = False


def stacked(panels: Sequence[Panel], axes: Any = None) -> Any:
    """Return the axes of panels under each other, top first.

    Parameters
    ----------
    panels : sequence of Panel
        From the top; the last has an `x`.
    axes : sequence of matplotlib.axes.Axes, optional
        To be used for them as they are placed; by default the panels get a figure of their own.

    Returns
    -------
    ndarray of matplotlib.axes.Axes

    Raises
    ------
    DataError
        When there are not as many axes as panels.
    MissingExtraError
        When matplotlib is not installed (extra ``plot``).
    """
    if axes is not None:
        given = axes_of(axes, len(panels))[:, 0]
        for axis, panel in zip(given, panels, strict=True):
            dress(axis, xlabel=panel.x, ylabel=panel.y)
        return given
    ticker = require("matplotlib.ticker", extra="plot")
    heights = [panel.height for panel in panels]
    high = sum(heights) + sum(_KEYS * panel.keys + _WORDS * bool(panel.x) for panel in panels)
    figure = new_figure(WIDTH / 72.0, high / 72.0)
    placed = figure.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
    for k, (axis, panel) in enumerate(zip(placed, panels, strict=True)):
        dress(axis, xlabel=panel.x, ylabel=panel.y)
        axis.xaxis.label.set_fontsize(SMALL)
        axis.yaxis.label.set_fontsize(SMALL)
        axis.tick_params(length=0.0, labelbottom=bool(panel.x))
        axis.ticklabel_format(scilimits=_POWERS)
        axis.xaxis.set_major_locator(ticker.MaxNLocator(_TICKS_X, steps=(1, 2, 5, 10)))
        axis.yaxis.set_major_locator(ticker.MaxNLocator(_TICKS_Y, steps=(1, 2, 5, 10)))
        for part in (axis.xaxis, axis.yaxis):
            part.offsetText.set_fontsize(SMALL)
        if not panel.x:
            axis.sharex(placed[k + 1])
            axis.xaxis.offsetText.set_visible(False)
    return placed


def logarithmic(axis: Any, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Set both axes of a panel to logarithmic scales between the given ends, with few ticks."""
    ticker = require("matplotlib.ticker", extra="plot")
    axis.set(xscale="log", yscale="log", xlim=x, ylim=y)
    for part, (low, high), count in ((axis.xaxis, x, _TICKS_X), (axis.yaxis, y, _TICKS_Y)):
        # Powers of ten; numbers between them where there may be fewer than two.
        subs = (1.0,) if high >= 100.0 * low else (1.0, 2.0, 5.0)
        part.set_major_locator(ticker.LogLocator(subs=subs, numticks=count))
        part.set_minor_locator(ticker.NullLocator())
        # Without mathematical typesetting, which takes half as long as all the rest.
        part.set_major_formatter(ticker.StrMethodFormatter("{x:g}"))


def keys(axis: Any) -> None:
    """Add a legend above a panel."""
    place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.0}
    legend(axis, **place, ncols=3, frameon=False, borderpad=0.2, handlelength=1.5)
