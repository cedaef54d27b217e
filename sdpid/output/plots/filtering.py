"""Figures of one joint's signals before and after filtering."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import real_array
from sdpid.errors import DataError
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.processing.stages import filter_stages
from sdpid.experiment.recording.recording import Recording
from sdpid.output.plots.figures import (
    BLUE,
    GRAY,
    INK,
    PLAIN,
    RED,
    SMALL,
    bottom_legend,
    dress,
    long_line,
    new_figure,
    same_length,
)

_UNITS = {"position": "rad", "torque": "N·m", "velocity": "rad/s", "acceleration": "rad/s²"}


def plot_filtering(
    log: Recording,
    joint: int = 0,
    *,
    window: tuple[float, float],
    processing: Processing | None = None,
    title: str | None = None,
) -> Any:
    """Show position, torque, velocity and acceleration of a joint before and after filtering.

    Parameters
    ----------
    log : Recording
        The recording.
    joint : int, optional
        Index of the joint.
    window : (float, float)
        Instants between which to show them, s.
    processing : Processing, optional
        By default `Processing.paper`.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    DataError
        When the window holds too few samples, or the joint does not exist.
    """
    stages = filter_stages(log, joint, window, processing)
    return plot_signals(stages.time, stages.before, stages.after, units=_UNITS, title=title)


def plot_signals(
    time: ArrayLike,
    before: Mapping[str, ArrayLike],
    after: Mapping[str, ArrayLike],
    *,
    units: Mapping[str, str] | None = None,
    window: tuple[float, float] | None = None,
    title: str | None = None,
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

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    DataError
        When names or lengths differ, or the window holds fewer than two samples.
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
    figure = new_figure(11.0, 1.2 + 1.95 * len(names), title)
    axes = figure.subplots(len(names), 2, sharex=True, squeeze=False)
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
    bottom_legend(figure, *axes[0, 0].get_legend_handles_labels())
    figure.align_ylabels(axes)
    return figure
