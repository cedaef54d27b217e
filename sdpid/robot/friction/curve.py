"""Friction of one joint as a curve over its velocity."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Shown, Table
from sdpid.errors import DataError

# Points of a curve on either side of standstill, and the top speed (rad/s or m/s) of a joint whose
# description gives no limit.
_POINTS, _NOMINAL = 100, 1.0


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class JointCurve(Shown):
    """Friction of one joint over its velocity, all other joints at rest.

    Attributes
    ----------
    joint : str
        The joint.
    velocity : ndarray, shape (s,)
        Velocities, rad/s or m/s.
    effort : ndarray, shape (s,)
        Friction and offset, N·m or N.
    unit : str
        Unit of the effort: ``"N·m"``, or ``"N"`` of a sliding joint.
    lower, upper : ndarray, shape (s,), or None
        Ends of the interval of each effort, where they are known.
    level : float or None
        Probability with which each interval should hold the truth.
    """

    joint: str
    velocity: Array
    effort: Array
    unit: str = "N·m"
    lower: Array | None = None
    upper: Array | None = None
    level: float | None = None

    _facts = ("joint", "_range", "level")

    def _tables(self) -> Iterator[Table]:
        """Yield the curve at some velocities."""
        some = np.unique(np.linspace(0, len(self.velocity) - 1, 11).astype(int))
        columns = {"velocity": self.velocity, f"effort, {self.unit}": self.effort}
        if self.lower is not None and self.upper is not None:
            columns |= {"lower": self.lower, "upper": self.upper}
        yield Table.of_columns({name: x[some].tolist() for name, x in columns.items()})

    def plot(self, *, axes: Any = None) -> Any:
        """Show the curve, with its band where that is known; needs the extra ``plot``.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to draw; by default in a figure of its own.

        Returns
        -------
        matplotlib.axes.Axes
        """
        from sdpid.plots.joints import plot_friction_curve

        return plot_friction_curve(self, axes=axes)

    @property
    def _range(self) -> str:
        if not self.velocity.size:
            return "no velocity"
        rate = "m/s" if self.unit == "N" else "rad/s"
        ends = f"{self.velocity.min():.4g} to {self.velocity.max():.4g} {rate}"
        return f"{len(self.velocity)} velocities from {ends}"


def joint_number(joint_names: Sequence[str], joint: str | int) -> int:
    """Return the place of a joint, given by name or by its place.

    Raises
    ------
    DataError
        When there is none.
    """
    n = len(joint_names)
    if isinstance(joint, str):
        if joint in joint_names:
            return joint_names.index(joint)
    elif isinstance(joint, int | np.integer) and not isinstance(joint, bool) and joint in range(n):
        return int(joint)
    raise DataError(
        f"joint: {joint!r:.80} is none of the {n} joints that have friction; give a "
        f"place from 0 to {n - 1}, or a name: {', '.join(joint_names)}."
    )


def default_velocities(limit: float) -> Array:
    """Return velocities (s,) of both signs up to a limit, closer together near standstill.

    Standstill itself is left out: there, friction may jump.
    """
    top = limit if 0.0 < limit < np.inf else _NOMINAL
    ahead = top * np.linspace(0.0, 1.0, _POINTS + 1)[1:] ** 2
    return np.concatenate([-ahead[::-1], ahead])
