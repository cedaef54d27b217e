"""The least eigenvalue of mass matrices along a motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.plots.figures import BLUE, GRAY, GREEN, RED, SHADE, TimeLine, same_length
from sdpid.plots.panels import Panel, keys, stacked

_HEIGHT = 150.0

# Beyond this ratio between curves one axis shows the small ones as zero: it is linear up to the
# smallest and logarithmic beyond.
_RATIO = 30.0

# The last of several is the one that the picture is about.
_COLORS = (GRAY, RED, GREEN)


def plot_mass_matrix(
    time: ArrayLike | None,
    eigenvalues: Mapping[str, ArrayLike],
    *,
    bound: float | None = None,
    starts: Sequence[int] = (0,),
    unit: str = "kg·m²",
    axes: Any = None,
) -> Any:
    """Show the least eigenvalue of mass matrices along a motion; below zero none is possible.

    Parameters
    ----------
    time : array_like, shape (K,), or None
        In s; None: the positions are counted.
    eigenvalues : mapping of str to array_like, shape (K,)
        Least eigenvalue by model, the most important last.
    bound : float, optional
        No position has a smaller one of the last model; drawn dashed.
    starts : sequence of int, optional
        First position of each piece recorded without a break.
    unit : str, optional
        Of the eigenvalues.
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
    >>> matrices = estimate.mass_matrix(samples.position)
    >>> least = np.linalg.eigvalsh(matrices)[:, 0]
    >>> axes = sdpid.plots.plot_mass_matrix(samples.time, {"this estimate": least})
    >>> axes.get_ylabel()
    'least eigenvalue [kg·m²]'
    """
    values = {name: real_array(each, name, ndim=1) for name, each in eigenvalues.items()}
    if not values:
        raise DataError("plot: no eigenvalues; nothing to draw.")
    first = next(iter(values.values()))
    t = None if time is None else real_array(time, "time", ndim=1)
    same_length(values.items(), len(first if t is None else t))
    line = TimeLine.of(t, len(first), starts)
    panel = Panel(_HEIGHT, f"least eigenvalue [{unit}]", x=line.label, keys=True)
    (axis,) = stacked([panel], axes=axes)
    _scale(axis, list(values.values()), bound)
    colors = dict(zip(values, _COLORS[: len(values) - 1], strict=False)) | {[*values][-1]: BLUE}
    for name, each in values.items():
        axis.plot(line.time, line.broken(each), color=colors.get(name, GREEN), lw=1.2, label=name)
    if bound is not None:
        axis.axhline(bound, color=BLUE, linewidth=0.9, linestyle=(0, (4, 2)))
    low, high = axis.get_ylim()
    if low < 0.0:
        axis.axhspan(low, 0.0, color=SHADE, alpha=0.6, linewidth=0.0, zorder=0.5)
        axis.set_ylim(low, high)
    axis.axhline(0.0, color=GRAY, linewidth=0.8)
    axis.margins(x=0.0)
    keys(axis)
    return axis


def _scale(axis: Any, values: Sequence[Array], bound: float | None) -> None:
    """Choose the scale of the vertical axis."""
    least = [float(np.abs(each).max()) for each in values]
    small = min(x for x in (*least, abs(bound or 0.0) or np.inf) if x > 0.0) if any(least) else 0.0
    if not small or max(least) < _RATIO * small:
        return
    ticker = require("matplotlib.ticker", extra="plot")
    axis.set_yscale("symlog", linthresh=small)
    axis.yaxis.set_major_locator(ticker.FixedLocator(_ticks(small, np.concatenate(values))))
    axis.yaxis.set_minor_locator(ticker.NullLocator())
    axis.yaxis.set_major_formatter(ticker.FuncFormatter(lambda x, _: _short(x)))


def _ticks(small: float, values: Array) -> list[float]:
    """Return zero, one tick of the linear part, and the powers of ten beyond it."""
    decades = 10.0 ** np.arange(np.ceil(np.log10(3.0 * small)), 13.0)
    inside = 10.0 ** np.floor(np.log10(0.999 * small))
    low, high = float(values.min()), float(values.max())
    linear = [float(inside * factor) for factor in (5, 2, 1) if inside * factor <= small][:1]
    return [*(-decades[decades <= -low])[::-1], 0.0, *linear, *decades[decades <= high]]


def _short(x: float) -> str:
    """Return a tick's number in few characters."""
    return f"{x:g}" if x == 0.0 or abs(x) >= 1e-3 else f"{x:.0e}".replace("e-0", "e-")
