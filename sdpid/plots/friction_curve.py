"""Friction of a joint over its velocity: the curve, its band, what was measured and driven."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.plots.figures import BLUE, GRAY, RED, shade_spans
from sdpid.plots.panels import Panel, keys, stacked

# Points; the picture is as high as the others of a joint.
_HEIGHT = 212.0

# A dot is a dash of this share of the axis with round ends, of this width in points: many dashes
# are one path.
_DASH, _DOT = 5e-4, 1.8

# Room about the curve and the middle of the cloud: single dots further out are cut off.
_ROOM, _MIDDLE = 0.08, 0.995


class FrictionCurve(Protocol):
    """Friction of one joint over its velocity, as `sdpid.robot.friction.curve` has it."""

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
    rate = "m/s" if curve.unit == "N" else "rad/s"
    panel = Panel(_HEIGHT, f"friction [{curve.unit}]", x=f"velocity [{rate}]", keys=True)
    (axis,) = stacked([panel], axes=axes)
    ends = float(curve.velocity.min()), float(curve.velocity.max())
    if driven is not None:
        _shade_beyond(axis, ends, driven)
    if cloud is not None:
        _dots(axis, *cloud, width=ends[1] - ends[0])
    if curve.lower is not None and curve.upper is not None:
        band = f"{100.0 * (curve.level or 0.0):g} % band"
        style = {"color": RED, "alpha": 0.25, "linewidth": 0.0, "label": band}
        axis.fill_between(curve.velocity, curve.lower, curve.upper, **style)
    axis.plot(curve.velocity, curve.effort, color=RED, linewidth=1.2, label="friction")
    axis.axhline(0.0, color=GRAY, linewidth=0.6)
    axis.set_xlim(*ends)
    axis.set_ylim(*heights(curve, cloud))
    keys(axis)
    return axis


def _shade_beyond(axis: Any, ends: tuple[float, float], driven: tuple[float, float]) -> None:
    """Shade the velocities that were not driven."""
    sides = ((ends[0], driven[0]), (driven[1], ends[1]))
    beyond = np.array([side for side in sides if side[0] < side[1]]).reshape(-1, 2)
    shade_spans(axis, *beyond.T, alpha=0.6)


def _dots(axis: Any, x: Array, y: Array, *, width: float) -> None:
    """Draw many dots as one path."""
    path = require("matplotlib.path", extra="plot").Path
    paths = require("matplotlib.collections", extra="plot").PathCollection
    half = 0.5 * _DASH * width
    dashes = np.stack([np.c_[x - half, y], np.c_[x + half, y]], axis=1).reshape(-1, 2)
    codes = np.tile([path.MOVETO, path.LINETO], len(x))
    style = {"edgecolor": BLUE, "facecolor": "none", "alpha": 0.45, "linewidth": _DOT}
    drawn = paths([path(dashes, codes)], capstyle="round", **style)
    axis.add_collection(drawn, autolim=False)
    # For the legend alone.
    style = {"color": BLUE, "marker": "o", "markersize": 1.5 * _DOT, "markeredgewidth": 0.0}
    axis.plot([], [], linestyle="none", label="measured", **style)


def heights(curve: FrictionCurve, cloud: tuple[Array, Array] | None) -> tuple[float, float]:
    """Return the ends of the vertical axis: about the curve and nearly all of the cloud."""
    shown = [curve.effort]
    if cloud is not None and len(cloud[1]):
        shown.append(np.quantile(cloud[1], (1.0 - _MIDDLE, _MIDDLE)))
    every = np.concatenate([*shown, [0.0]])
    low, high = float(every.min()), float(every.max())
    room = _ROOM * (high - low) or 1.0
    return low - room, high + room
