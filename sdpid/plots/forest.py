"""Parameters one below the other, each on its own scale: a forest plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.plots.figures import BLUE, FAINT, GRAY, INK, PLAIN, RED, SMALL, legend, new_figure
from sdpid.plots.panels import WIDTH

# Points: of a row, above with the keys, below, and beside the frame with names and numbers.
_ROW, _ABOVE, _BELOW, _LEFT, _RIGHT = 11.5, 17.0, 4.0, 36.0, 84.0

# Rows reach to one either way; what lies beyond this is drawn there, as an arrow.
_EDGE = 1.12

# Numbers with more decimals are written with a power of ten.
_DECIMALS = 5

# Where the smaller side of an interval is a smaller share of the larger, its ends are written.
_EVEN = 0.9

# Colors and marks of what is shown beside the last, which is drawn with its intervals.
_BESIDE: tuple[tuple[str, str, dict[str, str]], ...] = (
    (GRAY, "D", {"markerfacecolor": "none"}),
    (RED, "x", {}),
)


def plot_forest(
    names: Sequence[str],
    estimates: Mapping[str, ArrayLike],
    *,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    axes: Any = None,
) -> Any:
    """Show parameters one below the other, each on its own scale, zero in the middle.

    A row's scale is the largest of the values but the second last's (least squares may be out by
    any factor); what lies beyond the frame is an arrow at its edge. Numbers stand on the right.

    Parameters
    ----------
    names : sequence of str
        The k parameters.
    estimates : mapping of str to array_like, shape (k,)
        One to three sets of values, the most important last; NaN where there is none.
    lower, upper : array_like, shape (k,), optional
        Intervals of the last values; NaN or infinite where there are none.
    axes : matplotlib.axes.Axes, optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    DataError
        When there is nothing to draw, or lengths do not fit.

    Examples
    --------
    >>> names = ("Fv1", "Fv2", "zzr1")
    >>> wls = [result.wls.named()[name] for name in names]
    >>> best = [estimate.named()[name] for name in names]
    >>> axes = sdpid.plots.plot_forest(names, {"least squares": wls, "this estimate": best})
    >>> axes.figure is not None
    True
    """
    count = len(names)
    values = {name: _column(each, name, count) for name, each in estimates.items()}
    if not count or not 1 <= len(values) <= 1 + len(_BESIDE):
        raise DataError(
            f"plot: {count} parameters and {len(values)} sets of values; give at least one "
            f"parameter, and one to {1 + len(_BESIDE)} sets."
        )
    *beside, (ours, own) = values.items()
    ends = [
        _column(np.full(count, np.nan) if e is None else e, "ends", count) for e in (lower, upper)
    ]
    scale = row_scales(own, [each for _, each in beside][:-1], ends)
    axis = _axis(count) if axes is None else axes
    # The names of the sets are wider than the frame.
    over = axis.figure.transFigure if axes is None else axis.transAxes
    _frame(axis, names)
    at = np.arange(count, dtype=np.float64)
    known = np.isfinite(ends[0]) & np.isfinite(ends[1])
    low, high = (np.clip(each / scale, -_EDGE, _EDGE)[known] for each in ends)
    axis.hlines(at[known], low, high, color=BLUE, linewidth=1.6)
    for (name, each), (color, mark, look) in zip(
        beside, _BESIDE[len(_BESIDE) - len(beside) :], strict=True
    ):
        _marks(axis, each / scale, at, color, mark, name, **look)
    _marks(axis, own / scale, at, BLUE, "o", ours)
    for k in range(count):
        halves = (float(own[k] - ends[0][k]), float(ends[1][k] - own[k])) if known[k] else None
        style = {"transform": axis.get_yaxis_transform(), "va": "center", "fontsize": SMALL}
        axis.text(1.03, k, told(float(own[k]), halves), color=INK, clip_on=False, **style, **PLAIN)
    place = {"loc": "upper center" if axes is None else "lower center", "bbox_transform": over}
    legend(axis, bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, borderpad=0.1, **place)
    return axis


def _column(values: ArrayLike, name: str, count: int) -> Array:
    found = np.asarray(values, dtype=np.float64)
    if found.shape != (count,):
        raise DataError(f"plot: {name} has shape {found.shape}, there are {count} names.")
    return found


def row_scales(own: Array, described: Sequence[Array], ends: Sequence[Array]) -> Array:
    """Return the scale (k,) of each row: the largest size of what it shows beside least squares."""
    sizes = np.abs(np.stack([own, *described, *ends]))
    largest = np.max(np.where(np.isfinite(sizes), sizes, 0.0), axis=0)
    return np.where(largest > 0.0, largest, 1.0)


def _marks(axis: Any, x: Array, y: Array, color: str, mark: str, label: str, **look: Any) -> None:
    """Draw values, and arrows at the edge where they lie beyond it."""
    style = {"color": color, "linestyle": "none", "markersize": 4.0}
    inside = np.abs(x) <= _EDGE
    axis.plot(x[inside], y[inside], marker=mark, label=label, **style, **look)
    for sign, arrow in ((-1.0, "<"), (1.0, ">")):
        out = sign * x > _EDGE
        axis.plot(np.full(out.sum(), sign * _EDGE), y[out], marker=arrow, **style)


def _axis(count: int) -> Any:
    """Return the axis of a figure with this many rows."""
    high = _ABOVE + _ROW * count + _BELOW
    figure = new_figure(WIDTH / 72.0, high / 72.0, layout=None)
    figure.patch.set_visible(False)
    wide = (WIDTH - _LEFT - _RIGHT) / WIDTH
    return figure.add_axes((_LEFT / WIDTH, _BELOW / high, wide, _ROW * count / high))


def _frame(axis: Any, names: Sequence[str]) -> None:
    """Set the rows with their names, and the line at zero."""
    axis.set_facecolor("white")
    for side in axis.spines.values():
        side.set_visible(False)
    axis.set_xlim(-1.2, 1.2)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_xticks([])
    axis.set_yticks(np.arange(len(names)), names, fontsize=SMALL, color=INK, **PLAIN)
    axis.tick_params(length=0.0, left=False, bottom=False)
    axis.hlines(np.arange(len(names)), -1.2, 1.2, color=FAINT, linewidth=0.7, zorder=0.5)
    axis.axvline(0.0, color=GRAY, linewidth=0.8, zorder=0.6)


def told(value: float, halves: tuple[float, float] | None) -> str:
    """Return a value with its interval, in as many digits as that allows.

    The interval is what is below and what is above: its half width, or its ends where a limit
    cuts off one side.
    """
    half = 0.0 if halves is None else max(halves)
    if halves is None or not half > 0.0:
        return f"{value:.3g}".replace("-", "−")
    decimals = 1 - int(np.floor(np.log10(half)))
    fixed = 0 <= decimals <= _DECIMALS

    def text(number: float) -> str:
        # Adding zero makes −0 of what is rounded to nothing 0.
        return f"{round(number, decimals) + 0.0:.{decimals}f}" if fixed else f"{number:.2g}"

    if min(halves) < _EVEN * half:
        words = f"{text(value - halves[0])} … {text(value + halves[1])}"
    else:
        words = f"{text(value)} ± {text(half)}"
    return words.replace("-", "−")
