"""Figures of a motion: joints against limits, rollouts, a base that stands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.plots.figures import (
    BLUE,
    GRAY,
    GREEN,
    INK,
    NORMAL,
    ORANGE,
    PLAIN,
    PURPLE,
    RED,
    SKY,
    SMALL,
    axes_of,
    decimate,
    dress,
    head,
    legend,
    new_figure,
)
from sdpid.plots.panels import Panel, stacked

# Heights of panels, points.
_SMALL, _STANDING = 52.0, 90.0

# A limit beyond so many times the motion is not drawn: the motion would be a flat line.
_FAR = 4.0

# Points of a line.
_POINTS = 800

# Of lines in one panel; red is left to limits.
COLORS = (BLUE, GREEN, ORANGE, PURPLE, SKY, GRAY, INK)


# Of models beside the one that is judged, which is blue.
_OTHERS = (RED, ORANGE, PURPLE, GREEN, GRAY, SKY)


def plot_against_limits(
    time: Array,
    rows: Sequence[tuple[str, Array, float | None, float | None]],
    *,
    axes: Any = None,
) -> Any:
    """Show quantities of a joint over time, and the limits of each as dashed lines.

    Parameters
    ----------
    time : ndarray, shape (K,)
        In s.
    rows : sequence of (str, ndarray of shape (K,), float or None, float or None)
        Label with unit, values, lower and upper limit (None: none).
    axes : sequence of matplotlib.axes.Axes, optional
        Where to draw, one for each quantity; by default in a figure of its own.

    Returns
    -------
    ndarray of matplotlib.axes.Axes

    Examples
    --------
    >>> speed = samples.velocity[:, 0]
    >>> rows = [("velocity, rad/s", speed, -2.0, 2.0)]
    >>> axes = sdpid.plots.plot_against_limits(samples.time, rows)
    >>> axes[0].get_ylabel()
    'velocity, rad/s'
    """
    last = len(rows) - 1
    panels = [
        Panel(_SMALL, label, x="time [s]" if k == last else "")
        for k, (label, _, _, _) in enumerate(rows)
    ]
    drawn = stacked(panels, axes)
    for axis, (_, values, lower, upper) in zip(drawn, rows, strict=True):
        axis.margins(x=0.0)
        _line(axis, time, values, color=BLUE, linewidth=1.0)
        most = float(np.abs(values).max()) or 1.0
        for limit in (lower, upper):
            if limit is not None and abs(limit) <= _FAR * most:
                axis.axhline(limit, color=RED, linewidth=0.9, linestyle=(0, (4, 2)))
    return drawn


def plot_motion(
    time: Array,
    joints: Mapping[str, Sequence[tuple[str, Array, float | None, float | None]]],
    *,
    title: str | None = None,
    axes: Any = None,
) -> Any:
    """Show quantities of all joints over time, with their limits: one column a joint.

    Parameters
    ----------
    time : ndarray, shape (K,)
        In s.
    joints : mapping of str to sequence of (str, ndarray of shape (K,), float or None, ...)
        For each joint the same quantities, as `plot_against_limits` takes them.
    title : str, optional
        Heading of the figure.
    axes : array of matplotlib.axes.Axes, shape (quantities, n), optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, shape (quantities, n)

    Raises
    ------
    DataError
        When there is nothing to draw, or joints have different numbers of quantities.

    Examples
    --------
    >>> joints = {name: [("velocity, rad/s", samples.velocity[:, j], -3.0, 3.0)]
    ...           for j, name in enumerate(robot.joint_names)}
    >>> axes = sdpid.plots.plot_motion(samples.time, joints)
    >>> axes.shape
    (1, 6)
    """
    counts = {len(rows) for rows in joints.values()}
    if len(counts) != 1 or 0 in counts:
        raise DataError(f"plot: {len(joints)} joints with {sorted(counts)} quantities; draw one.")
    (count,) = counts
    if axes is None:
        figure = new_figure(0.6 + 2.4 * len(joints), 0.6 + 1.5 * count, title)
        axes = figure.subplots(count, len(joints), sharex=True, squeeze=False)
    else:
        axes = axes_of(axes, count, len(joints))
        head(axes, title)
    for column, (name, rows) in zip(axes.T, joints.items(), strict=True):
        plot_against_limits(time, rows, axes=column)
        column[0].set_title(name, fontsize=NORMAL, color=INK, loc="left", **PLAIN)
        for axis in column:
            axis.yaxis.label.set_fontsize(SMALL)
    return axes


def _line(axis: Any, x: ArrayLike, y: ArrayLike, **style: Any) -> None:
    axis.plot(*decimate(x, y, points=_POINTS), solid_joinstyle="round", **style)


def plot_rollout(
    time: Array,
    curves: Mapping[str, Array],
    *,
    own: str | None = None,
    title: str | None = None,
    axes: Any = None,
) -> Any:
    """Show errors of simulated positions over the time since the start, model by model.

    Parameters
    ----------
    time : ndarray, shape (L,)
        Time since the start, s.
    curves : mapping of str to ndarray, shape (L,)
        Errors of each model, rad; a curve ends where it is infinite.
    own : str, optional
        The model that is drawn stronger.
    title : str, optional
        Heading of the figure.
    axes : matplotlib.axes.Axes, optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    MissingExtraError
        When matplotlib is not installed (extra ``plot``).

    Examples
    --------
    >>> time = np.array([0.1, 0.5, 2.0])
    >>> axes = sdpid.plots.plot_rollout(time, {"model": 0.01 * time})
    >>> axes.get_ylabel()
    'position error, mrad'
    """
    if axes is None:
        axis = new_figure(7.0, 4.0, title).subplots()
    else:
        axis = axes_of(axes, 1)[0, 0]
        head(axis, title)
    colors = iter(_OTHERS * len(curves))
    for name, curve in curves.items():
        ours = name == own
        shown = np.where(np.isfinite(curve) & (curve > 0.0), 1e3 * np.asarray(curve), np.nan)
        color, width = (BLUE, 2.2) if ours else (next(colors), 1.2)
        axis.plot(time, shown, label=name, color=color, linewidth=width)
    axis.set_yscale("log")
    dress(axis, xlabel="time since the start, s", ylabel="position error, mrad")
    if curves:
        legend(axis)
    return axis


def plot_standing(
    time: Array,
    position: Array,
    angles: Array,
    feet: Sequence[str],
    normal: Array,
    used: Array,
    *,
    load: float = 0.0,
    axes: Any = None,
) -> Any:
    """Show how the base of a standing robot moves, and what its feet bear.

    Parameters
    ----------
    time : ndarray, shape (K,)
        In s.
    position, angles : ndarray, shape (K, 3)
        Displacement of the base, m; roll, pitch and yaw, rad.
    feet : sequence of str
        The c feet.
    normal : ndarray, shape (K, c)
        Normal forces, N.
    used : ndarray, shape (K, c)
        Share of the friction that may be used.
    load : float, optional
        Least normal force, N, drawn dashed.
    axes : array of matplotlib.axes.Axes, shape (4,), optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, shape (4,)
    """
    rows = (
        ("base, m", position, ("x", "y", "z"), None),
        ("base, rad", angles, ("roll", "pitch", "yaw"), None),
        ("normal force, N", normal, tuple(feet), load),
        ("friction used", used, tuple(feet), 1.0),
    )
    last = len(rows) - 1
    panels = [
        Panel(_STANDING, label, x="time [s]" if k == last else "")
        for k, (label, *_) in enumerate(rows)
    ]
    drawn = stacked(panels, axes)
    step = max(1, len(time) // _POINTS)
    for axis, (_, values, names, limit) in zip(drawn, rows, strict=True):
        axis.margins(x=0.0)
        for name, column, color in zip(names, np.asarray(values).T, COLORS, strict=False):
            axis.plot(time[::step], column[::step], color=color, linewidth=1.0, label=name)
        if limit is not None:
            axis.axhline(limit, color=RED, linewidth=0.9, linestyle=(0, (4, 2)))
        legend(axis)
    return drawn
