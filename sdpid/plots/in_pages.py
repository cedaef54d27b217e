"""Figures within pages: SVG in a data URI, the ``src`` of an image, and PNG in a notebook.

An image cannot run anything, fetches nothing, and shares no names or styles with its page.
"""

from __future__ import annotations

import base64
import functools
import io
import re
from typing import Any

import numpy as np

from sdpid._common.extras import require
from sdpid.plots.figures import figure_of, quiet_glyphs
from sdpid.plots.schemes import in_both_schemes

# Letters are written as letters, in a font of the reader's; matplotlib measures them in a wide one
# that it brings itself. Names of parts are the same each time.
_STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "sdpid",
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans", "Verdana", "Arial"],
    "path.simplify": True,
}

# Places in a line have six decimals; two are a hundredth of a point.
_DECIMALS = re.compile(r"(\.\d\d)\d+")

# Dots an inch: a figure of 14 inches is wider than the page of a notebook, which scales it down.
_DPI = 100.0


def svg_text(drawn: Any) -> str:
    """Return a figure as SVG, in light or dark colors; the same figure gives the same text.

    Parameters
    ----------
    drawn : matplotlib.figure.Figure, matplotlib.axes.Axes, or an array of them
        The figure, or axes of it, with fixed places.

    Returns
    -------
    str

    Raises
    ------
    MissingExtraError
        When matplotlib is not installed (extra ``plot``).
    """
    figure = figure_of(drawn)
    matplotlib = require("matplotlib", extra="plot")
    canvas = require("matplotlib.backends.backend_svg", extra="plot").FigureCanvasSVG
    out = io.StringIO()
    own = figure.dpi
    with matplotlib.rc_context(_STYLE), quiet_glyphs():
        # Drawn once: `savefig` draws twice, the first time to see where everything ends up.
        try:
            canvas(figure).print_svg(out, metadata={"Date": None})
        finally:
            figure.set_dpi(own)
    return in_both_schemes(re.sub(r' d="[^"]*"', _shortened, out.getvalue()))


def _shortened(path: re.Match[str]) -> str:
    """Shorten a path: two decimals, and no letter before a line, which is the default."""
    return _DECIMALS.sub(r"\1", path[0]).replace("\nL ", " ")


def image_source(drawn: Any) -> str:
    """Return a figure as a data URI with the SVG of `svg_text`."""
    encoded = base64.b64encode(svg_text(drawn).encode()).decode("ascii")
    return f"data:image/svg+xml;base64,{encoded}"


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
