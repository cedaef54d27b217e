"""Figures of measured against predicted effort."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Mask, real_array
from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.plots.figures import (
    BLUE,
    GRAY,
    INK,
    NORMAL,
    PLAIN,
    RED,
    SHADE,
    SMALL,
    TimeLine,
    axes_of,
    bottom_legend,
    dress,
    head,
    legend,
    long_line,
    new_figure,
    same_length,
    shade,
    stretch,
)

# Of a figure of efforts, inches: its width, what is free at its edges and under a heading, between
# the columns and the rows of panels, from a panel to its label; and the left column's share.
_WIDTH, _LEFT, _RIGHT, _TOP, _BOTTOM, _HEADING = 12.0, 0.95, 0.15, 0.35, 0.95, 0.35
_BETWEEN, _ABOVE, _LABEL, _SHARE = 0.95, 0.42, 0.65, 0.61


class Measured(Protocol):
    """Measured efforts."""

    @property
    def time(self) -> Array | None:
        """Seconds, (K,)."""

    @property
    def effort(self) -> Array:
        """In N·m, (K, n)."""

    @property
    def mask(self) -> Mask | None:
        """True where a row counts, (K, n)."""

    @property
    def starts(self) -> tuple[int, ...]:
        """First sample of each piece recorded without a break."""


class Fit(Protocol):
    """Predicted efforts and their errors."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The n joints."""

    @property
    def rmse(self) -> Array:
        """Root mean square errors, N·m, (n,)."""

    @property
    def effort_predicted(self) -> Array:
        """In N·m, (K, n)."""


def plot_fit(
    samples: Measured,
    fit: Fit,
    *,
    count: int | None = None,
    title: str | None = None,
    axes: Any = None,
) -> Any:
    """Show the effort of samples against its prediction, with the errors beside.

    Parameters
    ----------
    samples : Samples
        The measurements.
    fit : Validation
        Their prediction; the errors in the titles are those of all rows.
    count : int, optional
        Draw the first samples only, so that curves can be told apart.
    title : str, optional
        Heading of the figure.
    axes : array of matplotlib.axes.Axes, shape (n, 2), optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, shape (n, 2)
        Of efforts, and of errors.

    Examples
    --------
    >>> axes = sdpid.plots.plot_fit(samples, result.training, count=500)
    >>> axes.shape
    (6, 2)
    """
    shown = slice(None, count)
    total = len(samples.effort[shown])
    return plot_reconstruction(
        None if samples.time is None else samples.time[shown],
        samples.effort[shown],
        fit.effort_predicted[shown],
        fit.joint_names,
        fit.rmse,
        mask=None if samples.mask is None else samples.mask[shown],
        starts=[start for start in samples.starts if start < total],
        title=title,
        axes=axes,
    )


def plot_reconstruction(
    time: ArrayLike | None,
    measured: ArrayLike,
    predicted: ArrayLike,
    joint_names: Sequence[str],
    rmse: ArrayLike | None = None,
    *,
    mask: ArrayLike | None = None,
    starts: Sequence[int] = (0,),
    units: str | Sequence[str] = "N·m",
    title: str | None = None,
    axes: Any = None,
) -> Any:
    """Show arrays of measured and predicted effort, joint by joint, with the errors beside.

    Parameters
    ----------
    time : array_like, shape (K,), or None
        Time in s; None: the samples are counted.
    measured, predicted : array_like, shape (K, n)
        Efforts.
    joint_names : sequence of str
        The n joints.
    rmse : array_like, shape (n,), optional
        Root mean square errors for the titles; by default those of the rows in use.
    mask : array_like of bool, shape (K, n), optional
        True where a row is used; the others are shaded.
    starts : sequence of int, optional
        First sample of each piece recorded without a break; they are drawn behind each other.
    units : str or sequence of str, optional
        Unit of the efforts, one for all or one a joint.
    title : str, optional
        Heading of the figure.
    axes : array of matplotlib.axes.Axes, shape (n, 2), optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, shape (n, 2)
        Of efforts, and of errors.

    Raises
    ------
    DataError
        When shapes do not fit.

    Examples
    --------
    >>> axes = sdpid.plots.plot_reconstruction(
    ...     samples.time, samples.effort, problem.predict(estimate.base), robot.joint_names)
    >>> axes.shape
    (6, 2)
    """
    y = real_array(measured, "measured", ndim=2)
    z = real_array(predicted, "predicted", ndim=2)
    K, n = y.shape
    t = np.arange(K, dtype=np.float64) if time is None else real_array(time, "time", ndim=1)
    same_length([("measured", y), ("predicted", z)], len(t))
    used = np.ones((K, n), dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
    unit = [units] * n if isinstance(units, str) else list(units)
    for name, size in (("joint_names", len(joint_names)), ("units", len(unit))):
        if size != n:
            raise DataError(f"plot: {name} has {size} entries, measured has {n} columns.")
    if z.shape != (K, n) or used.shape != (K, n) or K < 2:
        raise DataError(
            f"plot: measured has shape {(K, n)}, predicted {z.shape}, mask {used.shape}; they "
            "must agree and have at least two rows."
        )
    errors = _rmse(y - z, used) if rmse is None else real_array(rmse, "rmse", ndim=1)
    if len(errors) != n:
        raise DataError(f"plot: rmse has {len(errors)} entries, measured has {n} columns.")
    sizes = _rmse(y, used)
    line = TimeLine.of(None if time is None else t, K, starts)
    t, shown = line.time, line.kept(used)
    ticker = require("matplotlib.ticker", extra="plot")
    height = 1.75 * n + _TOP + _BOTTOM + (_HEADING if title else 0.0)
    figure = None
    if axes is None:
        figure = new_figure(_WIDTH, height, title, layout=None)
        axes = _placed(figure, n, height, _HEADING if title else 0.0)
    else:
        axes = axes_of(axes, n, 2)
    for j in range(n):
        left, right = axes[j]
        for axis in (left, right):
            shade(axis, t, ~shown[:, j])
        long_line(left, t, line.broken(y[:, j]), color=BLUE, label="measured", linewidth=1.8)
        long_line(left, t, line.broken(z[:, j]), color=RED, label="predicted", linewidth=0.9)
        error = y[:, j] - z[:, j]
        long_line(right, t, line.broken(np.where(used[:, j], error, np.nan)), color=GRAY)
        last = line.label if j == n - 1 else ""
        size = sizes[j]
        share = f"  ({100.0 * errors[j] / size:.2g} % of RMS)" if size > 0.0 else ""
        dress(left, ylabel=f"effort [{unit[j]}]", xlabel=last)
        dress(right, ylabel=f"error [{unit[j]}]", xlabel=last)
        heading = f"RMSE {errors[j]:#.3g} {unit[j]}{share}"
        for axis, words in ((left, joint_names[j]), (right, heading)):
            # With a height, so that nothing is measured to find one.
            axis.set_title(words, fontsize=NORMAL, color=INK, loc="left", y=1.0, **PLAIN)
            axis.yaxis.set_major_locator(ticker.MaxNLocator(5, steps=(1, 2, 5, 10)))
        left.set_xlim(t[0], t[-1])
    # Shared by all panels. Few ticks: each costs as much as a line.
    axes[0, 0].xaxis.set_major_locator(ticker.MaxNLocator(6, steps=(1, 2, 5, 10)))
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if not used.all():
        patches = require("matplotlib.patches", extra="plot")
        handles.append(patches.Patch(facecolor=SHADE, edgecolor=GRAY, linewidth=0.5))
        labels.append("rows not used")
    if figure is None:
        head(axes, title)
        legend(axes[0, 0], handles=handles, labels=labels)
        return axes
    bottom_legend(figure, handles, labels, loc="lower center")
    if (each := stretch(len(t))) > 1:
        note = f"drawn: least and greatest value of each {each} samples"
        figure.text(1.0 - _RIGHT / _WIDTH, 0.08 / height, note, ha="right", fontsize=SMALL, c=GRAY)
    return axes


def _placed(figure: Any, n: int, height: float, heading: float) -> Any:
    """Return axes (n, 2) of a wide and a narrow panel a row, at fixed places."""
    across = _WIDTH - _LEFT - _RIGHT - _BETWEEN
    widths = np.array([_SHARE, 1.0 - _SHARE]) * across
    tall = (height - _TOP - _BOTTOM - heading - (n - 1) * _ABOVE) / n
    axes = figure.subplots(
        n,
        2,
        sharex=True,
        squeeze=False,
        gridspec_kw={
            "width_ratios": widths,
            "left": _LEFT / _WIDTH,
            "right": 1.0 - _RIGHT / _WIDTH,
            "bottom": _BOTTOM / height,
            "top": 1.0 - (_TOP + heading) / height,
            "wspace": 2.0 * _BETWEEN / across,
            "hspace": _ABOVE / tall,
        },
    )
    for row in axes:
        for axis, width in zip(row, widths, strict=True):
            axis.yaxis.set_label_coords(-_LABEL / width, 0.5)
            axis.xaxis.set_label_coords(0.5, -0.34 / tall)
    return axes


def _rmse(error: Array, used: np.ndarray) -> Array:
    count = np.maximum(used.sum(axis=0), 1)
    return np.asarray(np.sqrt(np.square(np.where(used, error, 0.0)).sum(axis=0) / count))
