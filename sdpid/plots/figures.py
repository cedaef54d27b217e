"""What all figures share: colors, axes, long lines, shading, and writing to a file."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid._common.files import atomic_path
from sdpid.errors import DataError, ExportError

# Okabe and Ito's palette, which readers with any color vision can tell apart.
BLUE = "#0072B2"
RED = "#D55E00"
GREEN = "#009E73"
ORANGE = "#E69F00"
PURPLE = "#CC79A7"
SKY = "#56B4E9"
GRAY = "#6B7280"
INK = "#1F2933"
FAINT = "#E5E7EB"
SHADE = "#D8DCE2"

METHOD_COLORS = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY)
METHOD_MARKERS = ("o", "s", "^", "D", "v", "P")

SMALL, NORMAL, LARGE = 8.0, 9.5, 12.0

# For texts with names in them: a name such as "$a_{$" is no formula to be typeset.
PLAIN: Final[dict[str, bool]] = {"parse_math": False}

# Pixels across a panel are a few hundred: more points than this a line do not show.
POINTS = 1500

# Between recordings, as a share of all their time.
_GAP = 0.02

# Of PNG, of 1 to 9: beyond, files get hardly smaller and take twice as long.
_COMPRESSION = 4

_FORMATS = (".png", ".svg", ".pdf")


@contextlib.contextmanager
def quiet_glyphs() -> Iterator[None]:
    """Draw names in scripts that the fonts lack without a warning: their place shows it."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"Glyph .* missing from")
        yield


def new_figure(
    width: float, height: float, title: str | None = None, *, layout: str | None = "constrained"
) -> Any:
    """Return an empty figure of `width` × `height` inches that belongs to no window.

    Parameters
    ----------
    width, height : float
        Its size, inches.
    title : str, optional
        Its heading.
    layout : str, optional
        What places the panels; None where the caller does, which saves half of the drawing.

    Raises
    ------
    MissingExtraError
        When matplotlib is not installed (extra ``plot``).
    """
    figure_module = require("matplotlib.figure", extra="plot")
    figure = figure_module.Figure(figsize=(width, height), layout=layout, facecolor="white")
    if title:
        figure.suptitle(title, fontsize=LARGE, fontweight="bold", color=INK, **PLAIN)
    return figure


def axes_of(axes: Any, rows: int, columns: int = 1) -> Any:
    """Return axes that were given, as an array (rows, columns).

    Parameters
    ----------
    axes : matplotlib.axes.Axes, or an array or a sequence of them
        As many as there are panels, row by row.
    rows, columns : int
        Of the panels to draw.

    Raises
    ------
    DataError
        When there are more axes or fewer.
    """
    flat = np.empty(len(given := _flat(axes)), dtype=object)
    flat[:] = given
    if len(flat) != rows * columns:
        raise DataError(
            f"plot: {len(flat)} axes were given to draw in, {rows * columns} are needed "
            f"({rows} x {columns})."
        )
    return flat.reshape(rows, columns)


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


def head(axes: Any, title: str | None) -> None:
    """Set a heading over axes that were given."""
    if title:
        _flat(axes)[0].set_title(title, fontsize=LARGE, color=INK, loc="left", **PLAIN)


def dress(axis: Any, *, title: str | None = None, xlabel: str = "", ylabel: str = "") -> None:
    """Set frame, grid, labels and font sizes of an axis."""
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axis.spines[side].set_color(GRAY)
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


def bottom_legend(
    figure: Any,
    handles: Sequence[Any],
    labels: Sequence[str],
    *,
    loc: str = "outside lower center",
) -> None:
    """Add one legend for all panels below them."""
    made = figure.legend(
        handles,
        labels,
        loc=loc,
        ncols=min(len(labels), 4),
        fontsize=NORMAL,
        frameon=False,
    )
    for line in made.get_lines():
        line.set_linewidth(max(float(line.get_linewidth()), 2.0))
    _plain(made)


def _plain(made: Any) -> None:
    """Show the texts of a legend as they are, without typesetting."""
    for text in made.get_texts():
        text.set_parse_math(False)


def long_line(axis: Any, x: Array, y: Array, **style: Any) -> Any:
    """Draw a line; of many points the least and the greatest of each stretch."""
    options = {"linewidth": 0.9, "solid_joinstyle": "round", **style}
    return axis.plot(*decimate(x, y), **options)[0]


def stretch(count: int, *, points: int = POINTS) -> int:
    """Return the length of the stretches of which `decimate` keeps two samples; 1 keeps all."""
    return 1 if count <= points else -(-count // max(points // 2, 1))


def decimate(x: ArrayLike, y: ArrayLike, *, points: int = POINTS) -> tuple[Array, Array]:
    """Return at most about `points` points that draw the same line.

    Each stretch keeps its least and its greatest value at their own places, so that peaks and the
    thickness of noise stay; the first and the last point stay too. Where y is NaN the line is
    broken.

    Parameters
    ----------
    x, y : array_like, shape (K,)
        The line.
    points : int, optional
        About how many points to keep.

    Returns
    -------
    x, y : ndarray
    """
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    count = len(y)
    if count <= points:
        return x, y
    size = stretch(count, points=points)
    # The last stretch is filled up with the last point; gaps count as nothing, and stay gaps.
    padded = np.concatenate([y, np.full(-count % size, y[-1])])
    gaps = np.isnan(padded).reshape(-1, size)
    blocks = np.where(gaps, 0.0, padded.reshape(-1, size))
    at = np.arange(len(blocks)) * size
    kept = [at + blocks.argmin(axis=1), at + blocks.argmax(axis=1), [0, count - 1]]
    kept.append((at + gaps.argmax(axis=1))[gaps.any(axis=1)])
    index = np.unique(np.minimum(np.concatenate(kept), count - 1))
    return x[index], y[index]


def envelope(
    x: Array, low: Array, high: Array, *, points: int = POINTS
) -> tuple[Array, Array, Array]:
    """Return x, low and high of at most `points` stretches of a band.

    Each stretch keeps the least of `low` and the greatest of `high`, and its first x.
    """
    size = -(-len(x) // points)
    if size <= 1:
        return x, low, high
    fill = -len(x) % size

    def blocks(y: Array) -> Array:
        return np.concatenate([y, np.full(fill, y[-1])]).reshape(-1, size)

    return blocks(x)[:, 0], blocks(low).min(axis=1), blocks(high).max(axis=1)


@dataclass(frozen=True, eq=False)
class TimeLine:
    """The time axis of a plot, with recordings one after the other.

    No line is drawn from one piece to the next, and a gap is left between them.

    Attributes
    ----------
    time : ndarray, shape (K + pieces - 1,)
        With one instant more in every gap.
    label : str
        Of the axis.
    """

    time: Array
    label: str
    _breaks: tuple[int, ...]

    @classmethod
    def of(cls, time: Array | None, count: int, starts: Sequence[int]) -> TimeLine:
        """Lay out `count` samples; without time they are counted."""
        own = np.arange(count, dtype=np.float64) if time is None else np.array(time)
        label = "sample" if time is None else "time [s]"
        breaks = tuple(starts[1:])
        if not breaks:
            return cls(own, label, ())
        pieces = [piece - piece[0] for piece in np.split(own, breaks)]
        gap = _GAP * sum(float(piece[-1]) for piece in pieces)
        shifted, begin = [pieces[0]], float(pieces[0][-1])
        for piece in pieces[1:]:
            shifted += [np.array([begin + 0.5 * gap]), begin + gap + piece]
            begin = float(shifted[-1][-1])
        return cls(np.concatenate(shifted), f"{label}, recordings behind each other", breaks)

    @property
    def instants(self) -> Array:
        """Where the samples are on the axis, (K,)."""
        return np.delete(self.time, np.add(self._breaks, range(len(self._breaks))).astype(int))

    def broken(self, y: Array) -> Array:
        """Return values (K,) with a break in every gap."""
        return np.insert(y, self._breaks, np.nan) if self._breaks else y

    def kept(self, flags: Any) -> Any:
        """Return flags (K, ...) that are set in the gaps."""
        return np.insert(flags, self._breaks, True, axis=0) if self._breaks else flags


def runs(flags: ArrayLike) -> list[tuple[int, int]]:
    """Return (first, last + 1) of every stretch of true values."""
    padded = np.concatenate([[False], np.asarray(flags, dtype=bool), [False]])
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def shade(axis: Any, x: Array, flags: ArrayLike, **style: Any) -> None:
    """Shade the stretches of x where a flag is set, over the full height."""
    shade_spans(axis, *spans(x, flags), **style)


def shade_spans(axis: Any, low: Array, high: Array, **style: Any) -> None:
    """Shade stretches of the horizontal axis, (k,) from `low` to `high`, over the full height."""
    if not len(low):
        return
    corners = np.zeros((len(low), 4, 2))
    corners[:, :2, 0], corners[:, 2:, 0], corners[:, 1:3, 1] = low[:, None], high[:, None], 1.0
    # As one path: a file has no more parts for more stretches.
    path = require("matplotlib.path", extra="plot").Path.make_compound_path_from_polys(corners)
    paths = require("matplotlib.collections", extra="plot").PathCollection
    options = {"facecolor": SHADE, "linewidth": 0, "zorder": 0.5, **style}
    placed = axis.get_xaxis_transform()
    axis.add_collection(paths([path], transform=placed, **options), autolim=False)


def spans(x: Array, flags: ArrayLike) -> tuple[Array, Array]:
    """Return where the stretches of x begin and end in which a flag is set.

    A sample stands for what is nearer to it than to its neighbors.
    """
    edges = np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]])
    ends = np.array(runs(flags), dtype=np.int64).reshape(-1, 2)
    return edges[ends[:, 0]], edges[ends[:, 1]]


def same_length(arrays: Iterable[tuple[str, Array]], length: int) -> None:
    """Check that arrays have `length` rows.

    Raises
    ------
    DataError
        Naming the first that has not.
    """
    for name, array in arrays:
        if len(array) != length:
            raise DataError(f"plot: {name} has {len(array)} rows, time has {length}.")


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
    figure = figure_of(drawn)
    matplotlib = require("matplotlib", extra="plot")
    # Drawn once: `savefig` draws twice, the first time to see where everything ends up, which
    # matters only to those who have it cut to size.
    canvas = require("matplotlib.backends.backend_agg", extra="plot").FigureCanvasAgg
    undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    metadata = cast("dict[str, Any] | None", undated.get(suffix))
    style = matplotlib.rc_context({"svg.hashsalt": "sdpid"})
    with atomic_path(target) as temporary, style, quiet_glyphs():
        if suffix == ".png":
            own = figure.dpi
            figure.set_dpi(dpi)
            try:
                canvas(figure).print_png(temporary, pil_kwargs={"compress_level": _COMPRESSION})
            finally:
                figure.set_dpi(own)
        else:
            figure.savefig(temporary, format=suffix[1:], dpi=dpi, metadata=metadata)
    return target
