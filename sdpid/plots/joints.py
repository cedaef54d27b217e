"""Figures of one joint: efforts over time, what the errors look like, friction over velocity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.plots.figures import BLUE, GRAY, RED, SHADE, dress, legend_above, panels
from sdpid.plots.lines import TimeLine, long_line, shade, stretch

# Samples about the largest error that are shown in full.
_DETAIL = 400

# Densities below this share of the highest are not shown: what a filter left above its cut-off is
# nothing to look at.
FLOOR, _TOP = 1e-5, 3.0

# What the autocorrelation of independent errors stays within, nineteen times of twenty.
WITHIN = 1.96

# Room about the curve and the middle of the cloud: single dots further out are cut off.
_ROOM, _MIDDLE = 0.08, 0.995

# Inches: of a figure's width and a panel's height.
_WIDE, _HIGH = 6.0, 1.5


class FrictionCurve(Protocol):
    """Friction of one joint over its velocity, as `sdpid.robot.friction.model` has it."""

    @property
    def velocity(self) -> Array:
        """Velocities, rad/s or m/s, (s,)."""

    @property
    def effort(self) -> Array:
        """Friction and offset, N·m or N, (s,)."""

    @property
    def unit(self) -> str:
        """Unit of the effort."""

    @property
    def lower(self) -> Array | None:
        """Lower end of the interval of each effort, (s,), where it is known."""

    @property
    def upper(self) -> Array | None:
        """Upper end, (s,)."""

    @property
    def level(self) -> float | None:
        """Probability with which each interval should hold the truth."""


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
    parts = [slice(None)]
    if axes is None and stretch(len(t), points=2 * _DETAIL) > 1:
        parts.append(detail(error))
    count = 1 + len(parts)
    drawn = panels(axes, count, size=(_WIDE, 0.5 + _HIGH * count))[:, 0]
    for axis, part in zip(drawn[::2], parts, strict=True):
        axis.margins(x=0.0)
        shade(axis, t[part], ~used[part])
        _band(axis, t[part], predicted[part], half[part], label="95 % band")
        long_line(axis, t[part], measured[part], color=BLUE, linewidth=1.4, label="measured")
        long_line(axis, t[part], predicted[part], color=RED, label="predicted")
        dress(axis, ylabel=f"effort [{unit}]")
    legend_above(drawn[0])
    drawn[1].margins(x=0.0)
    shade(drawn[1], t, ~used)
    _band(drawn[1], t, np.zeros(len(t)), half)
    long_line(drawn[1], t, error, color=GRAY, linewidth=0.6)
    dress(drawn[1], ylabel=f"error [{unit}]", xlabel=line.label)
    if len(parts) > 1:
        dress(drawn[2], xlabel=f"{line.label.partition(',')[0]}, about the largest error")
    return drawn


def _band(axis: Any, t: Array, middle: Array, half: Array, **label: str) -> None:
    """Shade a band, in files of vectors as pixels."""
    if np.any(half > 0.0):
        style = {"color": RED, "alpha": 0.25, "linewidth": 0.0, "rasterized": True}
        axis.fill_between(t, middle - half, middle + half, **style, **label)


def detail(error: Array) -> slice:
    """Return the samples around the largest error, which are drawn in full."""
    size = np.abs(error)
    at = 0 if np.isnan(size).all() else int(np.nanargmax(size))
    first = min(max(at - _DETAIL // 2, 0), max(len(error) - _DETAIL, 0))
    return slice(first, first + _DETAIL)


def plot_joint_errors(
    errors: Any, *, timed: bool = True, unit: str = "N·m", axes: Any = None
) -> Any:
    """Show spectrum, autocorrelation and velocity dependence of a joint's errors.

    Parameters
    ----------
    errors : JointErrors
        Spectra, autocorrelation and means over velocity, as
        `sdpid.assurance.diagnostics.causes` finds them.
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
    >>> from sdpid.assurance.diagnostics.causes import joint_errors
    >>> errors = joint_errors(samples, result.training)
    >>> axes = sdpid.plots.plot_joint_errors(errors[0])
    >>> axes[0].get_xlabel()
    'frequency [Hz]'
    """
    drawn = panels(axes, 3, size=(_WIDE, 0.5 + 3.0 * _HIGH))[:, 0]
    spectrum, correlation, friction = drawn
    f = errors.frequency
    positive = f > 0.0
    top = max(float(errors.effort_density.max()), float(errors.error_density.max())) or 1.0
    ends = (float(f[positive][0]), float(f[-1])) if np.count_nonzero(positive) > 1 else (0.1, 1.0)
    spectrum.set(xscale="log", yscale="log", xlim=ends, ylim=(FLOOR * top, _TOP * top))
    for density, color, label in (
        (errors.effort_density, BLUE, "measured effort"),
        (errors.error_density, RED, "error"),
    ):
        shown = positive & (density > 0.0)
        long_line(spectrum, f[shown], density[shown], color=color, label=label)
    dress(
        spectrum,
        xlabel="frequency [Hz]" if timed else "cycles per sample",
        ylabel=f"{unit}/√Hz" if timed else unit,
    )
    legend_above(spectrum)
    level = WITHIN / float(np.sqrt(errors.independent))
    correlation.axhspan(-level, level, color=SHADE, linewidth=0.0)
    long_line(correlation, errors.lag, errors.autocorrelation, color=RED)
    correlation.set_xlim(0.0, max(float(errors.lag[-1]), 1e-9))
    dress(correlation, xlabel="lag [s]" if timed else "lag [samples]", ylabel="autocorrelation")
    friction.fill_between(errors.velocity, errors.low, errors.high, color=SHADE, linewidth=0.0)
    style = {"color": RED, "marker": "o", "markersize": 2.5, "linewidth": 0.8}
    friction.plot(errors.velocity, errors.mean, **style)
    friction.axhline(0.0, color=GRAY, linewidth=0.6)
    dress(friction, xlabel=_velocity(unit), ylabel=f"error [{unit}]")
    return drawn


def _velocity(unit: str) -> str:
    """Return the label of an axis of velocities, by the unit of the joint's effort."""
    return f"velocity [{'m/s' if unit == 'N' else 'rad/s'}]"


def plot_friction_curve(
    curve: FrictionCurve,
    *,
    cloud: tuple[Array, Array] | None = None,
    driven: tuple[float, float] | None = None,
    axes: Any = None,
) -> Any:
    """Show the friction of a joint over its velocity, with its band.

    Parameters
    ----------
    curve : JointCurve
        From `RobotDynamics.friction_curve` or `Identification.friction_curve`.
    cloud : tuple of ndarray, shapes (K,) and (K,), optional
        Velocities, and measured efforts less what the model predicts beside friction.
    driven : tuple of float, optional
        Least and greatest velocity of the data that were fitted; what is beyond is shaded.
    axes : matplotlib.axes.Axes, optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    matplotlib.axes.Axes

    Examples
    --------
    >>> axes = sdpid.plots.plot_friction_curve(result.friction_curve("joint_1"))
    >>> axes.get_xlabel()
    'velocity [rad/s]'
    """
    ((axis,),) = panels(axes, size=(_WIDE, 3.6))
    ends = float(curve.velocity.min()), float(curve.velocity.max())
    if driven is not None:
        for low, high in ((ends[0], driven[0]), (driven[1], ends[1])):
            if low < high:
                axis.axvspan(low, high, color=SHADE, alpha=0.6, linewidth=0.0)
    if cloud is not None:
        style = {"color": BLUE, "alpha": 0.45, "markersize": 2.5, "rasterized": True}
        axis.plot(*cloud, ".", label="measured", **style)
    if curve.lower is not None and curve.upper is not None:
        band = f"{100.0 * (curve.level or 0.0):g} % band"
        style = {"color": RED, "alpha": 0.25, "linewidth": 0.0, "label": band}
        axis.fill_between(curve.velocity, curve.lower, curve.upper, **style)
    axis.plot(curve.velocity, curve.effort, color=RED, linewidth=1.2, label="friction")
    axis.axhline(0.0, color=GRAY, linewidth=0.6)
    axis.set_xlim(*ends)
    axis.set_ylim(*heights(curve, cloud))
    dress(axis, xlabel=_velocity(curve.unit), ylabel=f"friction [{curve.unit}]")
    legend_above(axis)
    return axis


def heights(curve: FrictionCurve, cloud: tuple[Array, Array] | None) -> tuple[float, float]:
    """Return the ends of the vertical axis: about the curve and nearly all of the cloud."""
    shown = [curve.effort]
    if cloud is not None and len(cloud[1]):
        shown.append(np.quantile(cloud[1], (1.0 - _MIDDLE, _MIDDLE)))
    every = np.concatenate([*shown, [0.0]])
    low, high = float(every.min()), float(every.max())
    room = _ROOM * (high - low) or 1.0
    return low - room, high + room
