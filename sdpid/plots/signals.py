"""Figures of signals before and after filtering."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import real_array
from sdpid.errors import DataError
from sdpid.plots.figures import (
    BLUE,
    GRAY,
    INK,
    PLAIN,
    RED,
    SMALL,
    axes_of,
    bottom_legend,
    dress,
    figure_of,
    head,
    legend,
    long_line,
    new_figure,
    same_length,
)


def plot_signals(
    time: ArrayLike,
    before: Mapping[str, ArrayLike],
    after: Mapping[str, ArrayLike],
    *,
    units: Mapping[str, str] | None = None,
    window: tuple[float, float] | None = None,
    title: str | None = None,
    axes: Any = None,
) -> Any:
    """Show signals before and after filtering, and their differences.

    Parameters
    ----------
    time : array_like, shape (K,)
        Time in s.
    before, after : mapping of str to array_like, shape (K,)
        Signals by name (position, torque, velocity, acceleration), the same names in both; one
        row of panels each, in the order of `before`.
    units : mapping of str to str, optional
        Unit of each signal, such as ``"rad/s"``.
    window : (float, float), optional
        Instants between which to show them, s; by default all.
    title : str, optional
        Heading of the figure.
    axes : array of matplotlib.axes.Axes, shape (signals, 2), optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, shape (signals, 2)
        Of the signals, and of what filtering took away.

    Raises
    ------
    DataError
        When names or lengths differ, or the window holds fewer than two samples.

    Examples
    --------
    >>> noisy = np.sin(samples.time) + 0.01 * np.cos(99.0 * samples.time)
    >>> axes = sdpid.plots.plot_signals(
    ...     samples.time, {"position": noisy}, {"position": np.sin(samples.time)})
    >>> axes.shape
    (1, 2)
    """
    t = real_array(time, "time", ndim=1)
    names = list(before)
    if not names or set(names) != set(after):
        raise DataError(
            f"plot: signals before filtering are {', '.join(before) or 'none'}, after it "
            f"{', '.join(after) or 'none'}; give the same names."
        )
    raw = {k: real_array(before[k], f"{k} before", ndim=1) for k in names}
    smooth = {k: real_array(after[k], f"{k} after", ndim=1) for k in names}
    for signals in (raw, smooth):
        same_length(signals.items(), len(t))
    inside = np.ones(len(t), dtype=bool)
    if window is not None:
        inside = (t >= window[0]) & (t <= window[1])
        if np.count_nonzero(inside) < 2:
            raise DataError(
                f"plot: the window {window[0]:g} to {window[1]:g} s holds no samples; the record "
                f"runs from {t.min():g} to {t.max():g} s."
            )
    t = t[inside]
    own = axes is None
    if own:
        figure = new_figure(11.0, 1.2 + 1.95 * len(names), title)
        axes = figure.subplots(len(names), 2, sharex=True, squeeze=False)
    else:
        axes = axes_of(axes, len(names), 2)
        head(axes, title)
    for i, name in enumerate(names):
        symbol = units.get(name, "") if units else ""
        unit = f" [{symbol}]" if symbol else ""
        y, z = raw[name][inside], smooth[name][inside]
        left, right = axes[i]
        long_line(left, t, y, color=BLUE, label="before filtering")
        long_line(left, t, z, color=RED, label="after filtering", linewidth=1.1)
        error = y - z
        long_line(right, t, error, color=GRAY)
        last = "time [s]" if i == len(names) - 1 else ""
        label = name[:1].upper() + name[1:]
        dress(left, ylabel=f"{label}{unit}", xlabel=last)
        dress(right, ylabel=f"error{unit}", xlabel=last)
        rms = float(np.sqrt(np.mean(np.square(error))))
        size = f"RMS {rms:#.3g} {symbol}".rstrip()
        right.set_title(size, fontsize=SMALL, color=INK, loc="right", **PLAIN)
        left.set_xlim(t[0], t[-1])
    if own:
        bottom_legend(figure_of(axes), *axes[0, 0].get_legend_handles_labels())
        figure_of(axes).align_ylabels(axes)
    else:
        legend(axes[0, 0])
    return axes
