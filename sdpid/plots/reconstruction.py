"""Figures of measured against predicted effort, and of signals before and after filtering."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Mask, real_array
from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.plots.figures import (
    BLUE,
    GRAY,
    RED,
    SHADE,
    SMALL,
    dress,
    figure_of,
    legend_of_all,
    panels,
)
from sdpid.plots.lines import TimeLine, long_line, same_length, shade, stretch


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
    height = 1.3 + 1.75 * n + 0.35 * bool(title)
    shape = {"sharex": True, "width_ratios": (0.61, 0.39)}
    own, axes = axes is None, panels(axes, n, 2, size=(12.0, height), title=title, **shape)
    for j, (left, right) in enumerate(axes):
        for axis in (left, right):
            shade(axis, t, ~shown[:, j])
        error = np.where(used[:, j], y[:, j] - z[:, j], np.nan)
        efforts = {"measured": line.broken(y[:, j]), "predicted": line.broken(z[:, j])}
        _compare(left, right, t, efforts, line.broken(error), line.label if j == n - 1 else "")
        share = f"  ({100.0 * errors[j] / sizes[j]:.2g} % of RMS)" if sizes[j] > 0.0 else ""
        dress(left, title=joint_names[j], ylabel=f"effort [{unit[j]}]")
        heading = f"RMSE {errors[j]:#.3g} {unit[j]}{share}"
        dress(right, title=heading, ylabel=f"error [{unit[j]}]")
    patch = require("matplotlib.patches", extra="plot").Patch
    unused = patch(facecolor=SHADE, edgecolor=GRAY, linewidth=0.5, label="rows not used")
    legend_of_all(axes, *([] if used.all() else [unused]))
    if own and (each := stretch(len(t))) > 1:
        note = f"drawn: least and greatest value of each {each} samples"
        figure_of(axes).text(0.99, 0.08 / height, note, ha="right", fontsize=SMALL, c=GRAY)
    return axes


def _compare(
    left: Any, right: Any, t: Array, values: Mapping[str, Array], error: Array, xlabel: str
) -> None:
    """Draw two lines that should agree, and their difference beside them."""
    for (name, each), color, width in zip(values.items(), (BLUE, RED), (1.6, 0.9), strict=True):
        long_line(left, t, each, color=color, label=name, linewidth=width)
    long_line(right, t, error, color=GRAY)
    left.set_xlim(t[0], t[-1])
    for axis in (left, right):
        dress(axis, xlabel=xlabel)


def _rmse(error: Array, used: np.ndarray) -> Array:
    count = np.maximum(used.sum(axis=0), 1)
    return np.asarray(np.sqrt(np.square(np.where(used, error, 0.0)).sum(axis=0) / count))


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
    size = (11.0, 1.2 + 1.95 * len(names))
    axes = panels(axes, len(names), 2, size=size, title=title, sharex=True)
    for name, (left, right) in zip(names, axes, strict=True):
        symbol = units.get(name, "") if units else ""
        unit = f" [{symbol}]" if symbol else ""
        y, z = raw[name][inside], smooth[name][inside]
        shown = {"before filtering": y, "after filtering": z}
        _compare(left, right, t, shown, y - z, "time [s]" if name == names[-1] else "")
        rms = float(np.sqrt(np.mean(np.square(y - z))))
        dress(left, ylabel=f"{name[:1].upper()}{name[1:]}{unit}")
        heading = f"RMS {rms:#.3g} {symbol}".rstrip()
        dress(right, title=heading, ylabel=f"error{unit}")
    legend_of_all(axes)
    return axes
