"""Figures in a notebook: PNG of what a cell returns."""

from __future__ import annotations

import functools
import io
from typing import Any

import numpy as np

from sdpid._common.extras import require
from sdpid.plots.figures import figure_of

# Dots an inch: a figure of 14 inches is wider than the page of a notebook, which scales it down.
_DPI = 100.0


class _AxesArray(np.ndarray):
    """An array of axes."""

    def _repr_png_(self) -> bytes:
        return _png(self)


def in_notebook(drawn: Any, axes: Any = None) -> Any:
    """Return what was drawn, so that a notebook shows the figure where it is a cell's last value.

    Figures of this package belong to no window, so that none is left open, and a notebook shows
    by itself those of pyplot only.

    Parameters
    ----------
    drawn : matplotlib.axes.Axes, or an array of them
        What a plot returned.
    axes : any, optional
        The axes that the plot was given. Their figure is shown by whom it belongs to.
    """
    if axes is not None:
        return drawn
    if isinstance(drawn, np.ndarray):
        return drawn.view(_AxesArray)
    drawn._repr_png_ = functools.partial(_png, drawn)
    return drawn


def _png(drawn: Any) -> bytes:
    """Return the figure of axes as PNG."""
    if not np.size(drawn):
        return b""
    canvas = require("matplotlib.backends.backend_agg", extra="plot").FigureCanvasAgg
    figure, out = figure_of(drawn), io.BytesIO()
    own = figure.dpi
    try:
        figure.set_dpi(_DPI)
        canvas(figure).print_png(out)
    finally:
        figure.set_dpi(own)
    return out.getvalue()
