"""Figures of one joint for the report: efforts and errors over time, and what the errors look like.

No names stand in them, so nothing that a robot's description says is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.plots.figures import BLUE, GRAY, RED, SHADE, TimeLine, decimate, envelope, shade, stretch
from sdpid.plots.panels import Panel, keys, logarithmic, stacked

# Stretches along a line, of which the least and the greatest value are kept: more than a page shows
# of it in pixels would not be seen.
COLUMNS = 400

# Stretches of a band about zero, which hardly varies.
_SMOOTH = 100

# Heights of the panels, points (they are 280 wide): of two, of three of which two share an axis,
# and of three. All pictures are as high, and three joints fit on a printed page.
_EFFORT, _ERROR, _SHARED, _THIRD = 116.0, 86.0, 57.0, 50.0

# Densities below this share of the highest are not shown: what a filter left above its cut-off is
# nothing to look at.
FLOOR, _TOP = 1e-5, 3.0

# What the autocorrelation of independent errors stays within, nineteen times of twenty.
WITHIN = 1.96


class JointErrors(Protocol):
    """The errors of one joint, as `sdpid.assurance.diagnostics.residuals` finds them."""

    @property
    def frequency(self) -> Array:
        """In Hz, or per sample, (f,)."""

    @property
    def effort_density(self) -> Array:
        """Amplitude density of the measured effort, N·m/√Hz, (f,)."""

    @property
    def error_density(self) -> Array:
        """Amplitude density of the error, N·m/√Hz, (f,)."""

    @property
    def lag(self) -> Array:
        """In s, or in samples, (l,)."""

    @property
    def autocorrelation(self) -> Array:
        """Of the errors, (l,)."""

    @property
    def independent(self) -> float:
        """About how many independent errors the rows are worth."""

    @property
    def velocity(self) -> Array:
        """Mean velocity of each bin, rad/s, (bins,)."""

    @property
    def mean(self) -> Array:
        """Mean error of each bin, N·m, (bins,)."""

    @property
    def low(self) -> Array:
        """Error of each bin that a tenth of its errors are below, N·m, (bins,)."""

    @property
    def high(self) -> Array:
        """Error of each bin that a tenth of its errors are above, N·m, (bins,)."""


def plot_joint(
    time: Array | None,
    measured: Array,
    predicted: Array,
    used: Mask,
    *,
    band: Array | None = None,
    unit: str = "N·m",
    starts: Sequence[int] = (0,),
    axes: Any = None,
) -> Any:
    """Show measured against predicted effort of a joint, and the error below.

    Parameters
    ----------
    time : ndarray, shape (K,), or None
        In s; None: the samples are counted.
    measured, predicted : ndarray, shape (K,)
        Efforts, in `unit`.
    used : ndarray of bool, shape (K,)
        True where a row counts; the others are shaded.
    band : ndarray, shape (K,), optional
        Half-width of the 95 % band about the predicted efforts.
    unit : str, optional
        Unit of the efforts.
    starts : sequence of int, optional
        First sample of each piece recorded without a break; they are drawn behind each other.
    axes : sequence of two matplotlib.axes.Axes, optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    ndarray of matplotlib.axes.Axes
        Of effort and error; in a figure of its own, of a long record, a third with what is about
        the largest error.

    Examples
    --------
    >>> predicted = result.training.effort_predicted
    >>> axes = sdpid.plots.plot_joint(
    ...     samples.time, samples.effort[:, 0], predicted[:, 0], samples.used[:, 0])
    >>> len(axes), axes[0].get_ylabel()
    (3, 'effort [N·m]')
    """
    line = TimeLine.of(time, len(measured), starts)
    t, used = line.time, line.kept(used)
    half = line.broken(np.zeros(len(measured)) if band is None else band)
    measured, predicted = line.broken(measured), line.broken(predicted)
    error = np.where(used, measured - predicted, np.nan)
    # Of a long record, what is about the largest error once more in full.
    near = detail(error) if axes is None and _is_long(t) else None
    high = (_EFFORT, _ERROR) if near is None else (_SHARED, _SHARED)
    panels = [
        Panel(high[0], f"effort [{unit}]", keys=True),
        Panel(high[1], f"error [{unit}]", x=line.label),
    ]
    if near is not None:
        label = f"{line.label.partition(',')[0]}, about the largest error"
        panels.append(Panel(_SHARED, f"effort [{unit}]", x=label))
    drawn = stacked(panels, axes)
    above, below, *more = drawn
    _efforts(above, t, measured, predicted, half, used)
    keys(above)
    shade(below, t, ~used)
    _band(below, t, np.zeros(len(t)), half, points=_SMOOTH)
    _line(below, t, error, color=GRAY, linewidth=0.6)
    if near is not None:
        signals = t[near], measured[near], predicted[near], half[near]
        _efforts(more[0], *signals, used[near])
    return drawn


def _is_long(time: Array) -> bool:
    """Return whether a picture of all samples leaves some out."""
    return stretch(len(time), points=2 * COLUMNS) > 1


def _efforts(
    axis: Any, t: Array, measured: Array, predicted: Array, half: Array, used: Mask
) -> None:
    axis.margins(x=0.0)
    shade(axis, t, ~used)
    _band(axis, t, predicted, half, points=COLUMNS, label="95 % band")
    _line(axis, t, measured, color=BLUE, linewidth=1.4, label="measured")
    _line(axis, t, predicted, color=RED, linewidth=0.8, label="predicted")


def _band(axis: Any, t: Array, middle: Array, half: Array, *, points: int, **style: Any) -> None:
    """Shade a band; of a long one what each of some `points` stretches holds."""
    if not np.any(half > 0.0):
        return
    ends = envelope(t, middle - half, middle + half, points=points)
    axis.fill_between(*ends, color=RED, alpha=0.25, linewidth=0.0, **style)


def detail(error: Array) -> slice:
    """Return the samples around the largest error, which are drawn in full."""
    size = np.abs(error)
    at = 0 if np.isnan(size).all() else int(np.nanargmax(size))
    first = min(max(at - COLUMNS // 2, 0), max(len(error) - COLUMNS, 0))
    return slice(first, first + COLUMNS)


def plot_joint_errors(
    errors: JointErrors, *, timed: bool = True, unit: str = "N·m", axes: Any = None
) -> Any:
    """Show spectrum, autocorrelation and velocity dependence of a joint's errors.

    Parameters
    ----------
    errors : JointErrors
        Spectra, autocorrelation and means over velocity.
    timed : bool, optional
        Whether frequencies are in Hz and lags in s, rather than in samples.
    unit : str, optional
        Unit of the efforts.
    axes : sequence of three matplotlib.axes.Axes, optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, shape (3,)

    Examples
    --------
    >>> from sdpid.assurance.diagnostics.residuals import joint_errors
    >>> errors = joint_errors(samples, result.training)
    >>> axes = sdpid.plots.plot_joint_errors(errors[0])
    >>> axes[0].get_xlabel()
    'frequency [Hz]'
    """
    frequency = "frequency [Hz]" if timed else "cycles per sample"
    panels = (
        Panel(_THIRD, f"{unit}/√Hz" if timed else unit, x=frequency, keys=True),
        Panel(_THIRD, "autocorrelation", x="lag [s]" if timed else "lag [samples]"),
        Panel(_THIRD, f"error [{unit}]", x=f"velocity [{'m/s' if unit == 'N' else 'rad/s'}]"),
    )
    drawn = stacked(panels, axes)
    spectrum, correlation, friction = drawn
    _spectrum(spectrum, errors)
    level = WITHIN / float(np.sqrt(errors.independent))
    correlation.axhspan(-level, level, color=SHADE, linewidth=0.0)
    _line(correlation, errors.lag, errors.autocorrelation, color=RED, linewidth=0.8)
    correlation.set_xlim(0.0, max(float(errors.lag[-1]), 1e-9))
    if len(errors.velocity):
        friction.fill_between(errors.velocity, errors.low, errors.high, color=SHADE, linewidth=0.0)
        friction.plot(
            errors.velocity, errors.mean, color=RED, marker="o", markersize=2.5, linewidth=0.8
        )
    friction.axhline(0.0, color=GRAY, linewidth=0.6)
    return drawn


def _spectrum(axis: Any, errors: JointErrors) -> None:
    f = errors.frequency
    positive = f > 0.0
    top = max(float(errors.effort_density.max()), float(errors.error_density.max())) or 1.0
    ends = (0.1, 1.0)
    if np.count_nonzero(positive) > 1:
        ends = float(f[positive][0]), float(f[-1])
    logarithmic(axis, ends, (FLOOR * top, _TOP * top))
    for density, color, label in (
        (errors.effort_density, BLUE, "measured effort"),
        (errors.error_density, RED, "error"),
    ):
        shown = positive & (density > 0.0)
        _line(axis, f[shown], density[shown], color=color, linewidth=0.8, label=label)
    keys(axis)


def _line(axis: Any, x: Array, y: Array, **style: Any) -> None:
    """Draw a line; of a long one the least and the greatest of each of `COLUMNS` stretches."""
    axis.plot(*decimate(x, y, points=2 * COLUMNS), solid_joinstyle="round", **style)
