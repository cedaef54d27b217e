"""Figures of a motion: joints against limits, rollouts, a base that stands, the mass matrix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid.errors import DataError
from sdpid.plots.figures import (
    BLUE,
    DASHED,
    GRAY,
    PALETTE,
    RED,
    SHADE,
    dress,
    legend,
    legend_above,
    panels,
)
from sdpid.plots.lines import TimeLine, long_line, same_length

# A limit beyond so many times the motion is not drawn: the motion would be a flat line.
_FAR = 4.0

# Beyond this ratio between curves one axis shows the small ones as zero: it is linear up to the
# smallest and logarithmic beyond.
_RATIO = 30.0

# Inches: of a figure's width and a panel's height.
_WIDE, _HIGH = 6.0, 1.3


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
    size = (_WIDE, 0.5 + _HIGH * len(rows))
    drawn = panels(axes, len(rows), size=size, sharex=True)[:, 0]
    for axis, (label, values, lower, upper) in zip(drawn, rows, strict=True):
        axis.margins(x=0.0)
        long_line(axis, time, values, color=BLUE, linewidth=1.0)
        most = float(np.abs(values).max()) or 1.0
        for limit in (lower, upper):
            if limit is not None and abs(limit) <= _FAR * most:
                axis.axhline(limit, **DASHED)
        dress(axis, ylabel=label, xlabel="time [s]" if axis is drawn[-1] else "")
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
    size = (0.6 + 2.4 * len(joints), 0.6 + 1.5 * count)
    axes = panels(axes, count, len(joints), size=size, title=title, sharex=True)
    for column, (name, rows) in zip(axes.T, joints.items(), strict=True):
        plot_against_limits(time, rows, axes=column)
        dress(column[0], title=name)
    return axes


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
    ((axis,),) = panels(axes, size=(7.0, 4.0), title=title)
    others = iter(PALETTE[1:] * len(curves))
    for name, curve in curves.items():
        ours = name == own
        shown = np.where(np.isfinite(curve) & (curve > 0.0), 1e3 * np.asarray(curve), np.nan)
        color, width = (BLUE, 2.2) if ours else (next(others), 1.2)
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
    size = (_WIDE, 0.5 + 1.5 * _HIGH * len(rows))
    drawn = panels(axes, len(rows), size=size, sharex=True)[:, 0]
    for axis, (label, values, names, limit) in zip(drawn, rows, strict=True):
        axis.margins(x=0.0)
        # Red is left to limits.
        colors = [color for color in PALETTE if color != RED]
        for name, column, color in zip(names, np.asarray(values).T, colors, strict=False):
            long_line(axis, time, column, color=color, linewidth=1.0, label=name)
        if limit is not None:
            axis.axhline(limit, **DASHED)
        dress(axis, ylabel=label, xlabel="time [s]" if axis is drawn[-1] else "")
        legend(axis)
    return drawn


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
    ((axis,),) = panels(axes, size=(_WIDE, 2.8))
    _scale(axis, list(values.values()), bound)
    # The last of several is the one that the figure is about.
    colors = (PALETTE * len(values))[: len(values)][::-1]
    for (name, each), color in zip(values.items(), colors, strict=True):
        long_line(axis, line.time, line.broken(each), color=color, linewidth=1.2, label=name)
    if bound is not None:
        axis.axhline(bound, **{**DASHED, "color": BLUE})
    low, high = axis.get_ylim()
    if low < 0.0:
        axis.axhspan(low, 0.0, color=SHADE, alpha=0.6, linewidth=0.0, zorder=0.5)
        axis.set_ylim(low, high)
    axis.axhline(0.0, color=GRAY, linewidth=0.8)
    axis.margins(x=0.0)
    dress(axis, xlabel=line.label, ylabel=f"least eigenvalue [{unit}]")
    legend_above(axis)
    return axis


def _scale(axis: Any, values: Sequence[Array], bound: float | None) -> None:
    """Choose the scale of the vertical axis."""
    least = [float(np.abs(each).max()) for each in values]
    small = min(x for x in (*least, abs(bound or 0.0) or np.inf) if x > 0.0) if any(least) else 0.0
    if small and max(least) >= _RATIO * small:
        axis.set_yscale("symlog", linthresh=small)
