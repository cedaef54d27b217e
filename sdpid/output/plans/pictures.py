"""Pictures of a plan: joints against their limits, distances, spectrum, errors over duration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid.output.plans.played import Played
from sdpid.output.plots.figures import (
    BLUE,
    GRAY,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    RED,
    SKY,
    decimate,
)
from sdpid.output.plots.panels import Panel, logarithmic, stacked

# Heights of panels, points.
_SMALL, _LARGE = 52.0, 130.0

# A limit beyond so many times the motion is not drawn: the motion would be a flat line.
_FAR = 4.0

# Points of a line.
_POINTS = 800

# Amplitudes below this share of the highest are not shown.
_FLOOR = 1e-3

# More room than this is not shown, mm.
_ROOM = 500.0

# Of lines in one panel; red is left to limits.
COLORS = (BLUE, GREEN, ORANGE, PURPLE, SKY, GRAY, INK)


def plot_against_limits(
    time: Array, rows: Sequence[tuple[str, Array, float | None, float | None]]
) -> Any:
    """Show quantities of a joint over time, and the limits of each as dashed lines.

    Parameters
    ----------
    time : ndarray, shape (K,)
        In s.
    rows : sequence of (str, ndarray of shape (K,), float or None, float or None)
        Label with unit, values, lower and upper limit (None: none).

    Returns
    -------
    matplotlib.figure.Figure
    """
    last = len(rows) - 1
    panels = [
        Panel(_SMALL, label, x="time [s]" if k == last else "")
        for k, (label, _, _, _) in enumerate(rows)
    ]
    figure, axes = stacked(panels)
    for axis, (_, values, lower, upper) in zip(axes, rows, strict=True):
        axis.margins(x=0.0)
        _line(axis, time, values, color=BLUE, linewidth=1.0)
        most = float(np.abs(values).max()) or 1.0
        for limit in (lower, upper):
            if limit is not None and abs(limit) <= _FAR * most:
                axis.axhline(limit, color=RED, linewidth=0.9, linestyle=(0, (4, 2)))
    return figure


def plot_distances(time: Array, room: Array) -> tuple[Any, list[tuple[str, int]]]:
    """Show how far the nearest pairs stay from their least distances over time.

    Parameters
    ----------
    time : ndarray, shape (K,)
        In s.
    room : ndarray, shape (K, P)
        Distances of P pairs less what is asked of each, m.

    Returns
    -------
    matplotlib.figure.Figure
    list of (str, int)
        Color and index of the pairs that are shown, the nearest first.
    """
    figure, (axis,) = stacked([Panel(_LARGE, "room left [mm]", x="time [s]")])
    axis.margins(x=0.0)
    shown = list(zip(COLORS, np.argsort(room.min(axis=0)).tolist(), strict=False))
    for color, pair in shown:
        _line(axis, time, 1e3 * room[:, pair], color=color, linewidth=1.0)
    axis.axhline(0.0, color=RED, linewidth=0.9, linestyle=(0, (4, 2)))
    axis.set_ylim(min(0.0, 1e3 * float(room.min())), min(_ROOM, 1.05e3 * float(room.max())))
    return figure, shown


def plot_spectrum(motion: Played) -> Any:
    """Show the amplitude spectrum of each joint's acceleration."""
    figure, (axis,) = stacked([Panel(_LARGE, "acceleration [rad/s²]", x="frequency [Hz]")])
    count = len(motion.time)
    frequency = np.fft.rfftfreq(count, 1.0 / motion.rate_hz)[1:]
    amplitude = 2.0 / count * np.abs(np.fft.rfft(motion.acceleration, axis=0))[1:]
    top = float(amplitude.max()) or 1.0
    seen = np.flatnonzero((amplitude > _FLOOR * top).any(axis=1))
    last = int(seen[-1]) + 1 if len(seen) else count // 2
    logarithmic(axis, (float(frequency[0]), float(frequency[last - 1])), (_FLOOR * top, 2.0 * top))
    for j in range(amplitude.shape[1]):
        color = COLORS[j % len(COLORS)]
        _line(axis, frequency[:last], amplitude[:last, j], color=color, linewidth=0.9)
    return figure


def plot_over_duration(seconds: Array, shares: Sequence[Array]) -> Any:
    """Show how the half widths of expected intervals fall with the duration of the run.

    Parameters
    ----------
    seconds : ndarray, shape (D,)
        Durations.
    shares : sequence of ndarray, shape (D,)
        Half widths as shares of the values; in the order of `COLORS`.
    """
    figure, (axis,) = stacked([Panel(_LARGE, "95 % interval, ± [%]", x="duration [s]")])
    values = 100.0 * np.stack(list(shares))
    ends = 0.8 * float(values.min()), 1.25 * float(values.max())
    logarithmic(axis, (0.95 * float(seconds.min()), 1.1 * float(seconds.max())), ends)
    for color, each in zip(COLORS, values, strict=False):
        axis.plot(seconds, each, color=color, marker="o", markersize=3.0, linewidth=1.0)
    return figure


def _line(axis: Any, x: ArrayLike, y: ArrayLike, **style: Any) -> None:
    axis.plot(*decimate(x, y, points=_POINTS), solid_joinstyle="round", **style)
