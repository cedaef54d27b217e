"""What all figures share: axes to draw in, colors and labels, and writing to a file."""

from __future__ import annotations

import functools
import io
import os
import warnings
from pathlib import Path
from typing import Any, Final

import numpy as np

from sdpid._common.extras import require
from sdpid._common.files import atomic_path
from sdpid.errors import DataError, ExportError

# Okabe and Ito's palette, which readers with any color vision can tell apart.
BLUE, RED, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
PURPLE, SKY = "#CC79A7", "#56B4E9"
GRAY, INK, FAINT, SHADE = "#6B7280", "#1F2933", "#E5E7EB", "#D8DCE2"

# Of what is told apart in one panel, the most important first.
PALETTE = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY, GRAY, INK)
MARKERS = ("o", "s", "^", "D", "v", "P")

SMALL, NORMAL, LARGE = 8.0, 9.5, 12.0

# For texts with names in them: a name such as "$a_{$" is no formula to be typeset.
PLAIN: Final[dict[str, bool]] = {"parse_math": False}

# Of limits.
DASHED: Final[dict[str, Any]] = {"color": RED, "linewidth": 0.9, "linestyle": (0, (4, 2))}

# Of PNG, of 1 to 9: beyond, files get hardly smaller and take twice as long.
_COMPRESSION = 4

# Dots an inch in a notebook, whose page is narrower than some figures and scales them down.
_NOTEBOOK_DPI = 100.0

# What is written into files of each format beside the picture: no dates.
_FORMATS: Final[dict[str, dict[str, Any]]] = {
    ".png": {},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}


class _Axes(np.ndarray):
    """An array of axes, whose figure a notebook shows."""

    def _repr_png_(self) -> bytes:
        return _png(self) if self.size else b""


def panels(
    axes: Any,
    rows: int = 1,
    columns: int = 1,
    *,
    size: tuple[float, float],
    title: str | None = None,
    **options: Any,
) -> Any:
    """Return the axes of panels: those that were given, or of a figure of its own.

    The figure belongs to no window, so that none is left open; a notebook shows it where its axes
    are the last value of a cell. The figure of given axes is shown by whom it belongs to.

    Parameters
    ----------
    axes : matplotlib.axes.Axes, an array or a sequence of them, or None
        As many as there are panels, row by row.
    rows, columns : int
        Of the panels.
    size : (float, float)
        Width and height of a figure of its own, inches.
    title : str, optional
        Its heading; over given axes, that of the first.
    **options
        Of `matplotlib.figure.Figure.subplots`.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, shape (rows, columns)

    Raises
    ------
    DataError
        When there are more axes or fewer.
    MissingExtraError
        When matplotlib is not installed (extra ``plot``).
    """
    if axes is not None:
        given = _flat(axes)
        if len(given) != rows * columns:
            raise DataError(
                f"plot: {len(given)} axes were given to draw in, {rows * columns} are needed "
                f"({rows} x {columns})."
            )
        flat = np.empty(len(given), dtype=object)
        flat[:] = given
        if title:
            given[0].set_title(title, fontsize=LARGE, color=INK, loc="left", **PLAIN)
        return flat.reshape(rows, columns)
    figure = require("matplotlib.figure", extra="plot").Figure(
        figsize=size, layout="constrained", facecolor="white"
    )
    if title:
        figure.suptitle(title, fontsize=LARGE, fontweight="bold", color=INK, **PLAIN)
    drawn = figure.subplots(rows, columns, squeeze=False, **options)
    for axis in drawn.flat:
        axis._repr_png_ = functools.partial(_png, axis)
    return drawn.view(_Axes)


def _flat(axes: Any) -> list[Any]:
    """Return axes one after the other."""
    if isinstance(axes, np.ndarray | list | tuple):
        return [each for part in axes for each in _flat(part)]
    return [axes]


def figure_of(drawn: Any) -> Any:
    """Return the whole figure of axes, of an array of them, or the figure that was given."""
    first = _flat(drawn)[0]
    # Of axes it may be a part of a figure; the figure of that is the whole.
    return first.figure.figure


def dress(axis: Any, *, title: str | None = None, xlabel: str = "", ylabel: str = "") -> None:
    """Set frame, grid, labels and font sizes of an axis."""
    for side, spine in axis.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(GRAY)
    axis.grid(visible=True, color=FAINT, linewidth=0.7)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=SMALL, color=GRAY, labelcolor=INK)
    axis.set_facecolor("white")
    if title:
        axis.set_title(title, fontsize=NORMAL, color=INK, loc="left", **PLAIN)
    if xlabel:
        axis.set_xlabel(xlabel, fontsize=NORMAL, color=INK, **PLAIN)
    if ylabel:
        axis.set_ylabel(ylabel, fontsize=NORMAL, color=INK, **PLAIN)


def legend(axis: Any, **options: Any) -> None:
    """Add a legend in the common style."""
    defaults = {"fontsize": SMALL, "frameon": True, "framealpha": 0.9, "edgecolor": FAINT}
    _plain(axis.legend(**{**defaults, **options}))


def legend_above(axis: Any) -> None:
    """Add a legend over the right corner of an axis."""
    place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.0}
    legend(axis, **place, ncols=3, frameon=False)


def legend_of_all(drawn: Any, *extra: Any) -> None:
    """Add one legend for all panels of a figure of its own below them, else in the first.

    Parameters
    ----------
    drawn : ndarray of matplotlib.axes.Axes
        From `panels`.
    *extra
        Artists with a label that stand in no panel.
    """
    handles = [*drawn[0, 0].get_legend_handles_labels()[0], *extra]
    labels = [each.get_label() for each in handles]
    if not isinstance(drawn, _Axes):
        legend(drawn[0, 0], handles=handles, labels=labels)
        return
    style = {"ncols": min(len(labels), 4), "fontsize": NORMAL, "frameon": False}
    made = figure_of(drawn).legend(handles, labels, loc="outside lower center", **style)
    for line in made.get_lines():
        line.set_linewidth(max(float(line.get_linewidth()), 2.0))
    _plain(made)


def _plain(made: Any) -> None:
    """Show the texts of a legend as they are, without typesetting."""
    for text in made.get_texts():
        text.set_parse_math(False)


def save_figure(drawn: Any, path: str | os.PathLike[str], *, dpi: float = 150.0) -> Path:
    """Write a figure as PNG, SVG or PDF, whole or not at all.

    The same figure gives the same file: no dates and no random names are put in.

    Parameters
    ----------
    drawn : matplotlib.figure.Figure, matplotlib.axes.Axes, or an array of them
        The figure, or axes of it: the whole figure is written.
    path : str or path
        Where to; its suffix says the format.
    dpi : float, optional
        Dots an inch of a PNG.

    Returns
    -------
    Path

    Raises
    ------
    ExportError
        For another suffix, or a folder that cannot be written to.

    Examples
    --------
    >>> axes = sdpid.plots.plot_friction_curve(result.friction_curve("joint_1"))
    >>> sdpid.plots.save_figure(axes, "friction.png", dpi=100).name
    'friction.png'
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in _FORMATS:
        raise ExportError(
            f"figure {target.name}: no format is known by '{target.suffix}'; use "
            f"{', '.join(_FORMATS)}."
        )
    matplotlib = require("matplotlib", extra="plot")
    style = matplotlib.rc_context({"svg.hashsalt": "sdpid"})
    with atomic_path(target) as temporary, style:
        _write(drawn, temporary, suffix, dpi)
    return target


def _png(drawn: Any) -> bytes:
    """Return the figure of axes as PNG."""
    out = io.BytesIO()
    _write(drawn, out, ".png", _NOTEBOOK_DPI)
    return out.getvalue()


def _write(drawn: Any, out: Any, suffix: str, dpi: float) -> None:
    """Write a figure in a format."""
    figure = figure_of(drawn)
    own = figure.dpi
    with warnings.catch_warnings():
        # Names in scripts that the fonts lack: their place shows it.
        warnings.filterwarnings("ignore", message=r"Glyph .* missing from")
        if suffix != ".png":
            figure.savefig(out, format=suffix[1:], metadata=_FORMATS[suffix])
            return
        # Drawn once: `savefig` draws twice, which matters where edges are cut off.
        canvas = require("matplotlib.backends.backend_agg", extra="plot").FigureCanvasAgg
        figure.set_dpi(dpi)
        try:
            canvas(figure).print_png(out, pil_kwargs={"compress_level": _COMPRESSION})
        finally:
            figure.set_dpi(own)
