"""The friction model of a robot: its terms, their parameters and columns, and curves of joints.

The interface of a term is in `sdpid.robot.friction.term`, the terms themselves are in
`sdpid.robot.friction.terms`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Shown, Table
from sdpid.errors import DataError, ModelError
from sdpid.robot.friction.term import FrictionTerm, Range, SampledMotion, TermParameter
from sdpid.robot.friction.terms import BY_NAME

# Points of a curve on either side of standstill, and the top speed (rad/s or m/s) of a joint whose
# description gives no limit.
_POINTS, _NOMINAL = 100, 1.0


@dataclass(frozen=True)
class FrictionModel:
    """The terms of a robot's joints, in order.

    Attributes
    ----------
    terms : tuple of FrictionTerm
        The terms.
    joint_names : tuple of str
        The joints that have friction: all but a floating base.
    parameters : tuple of TermParameter
        All parameters, term by term over the joints: the tail of theta.
    first : int
        Velocity coordinates before the first of these joints (6 with a floating base).
    """

    terms: tuple[FrictionTerm, ...]
    joint_names: tuple[str, ...]
    parameters: tuple[TermParameter, ...]
    first: int = 0

    @classmethod
    def from_terms(
        cls, terms: Iterable[str | FrictionTerm], joint_names: Sequence[str], *, first: int = 0
    ) -> FrictionModel:
        """Build from names and term objects.

        Parameters
        ----------
        terms : iterable of str or FrictionTerm
            Names are those of `BY_NAME`.
        joint_names : sequence of str
            The robot's velocity coordinates.
        first : int, optional
            How many of them belong to a floating base, which has no friction.

        Raises
        ------
        ModelError
            For an unknown name, a term given twice, or a joint that the robot does not have.
        """
        if isinstance(terms, str | FrictionTerm):
            raise ModelError(f"friction: give a tuple of terms, such as ({terms!r},).")
        objects = []
        for term in terms:
            if isinstance(term, FrictionTerm):
                objects.append(term)
            elif isinstance(term, str) and term in BY_NAME:
                objects.append(BY_NAME[term]())
            else:
                raise ModelError(
                    f"friction: no term is called {term!r}; there are {', '.join(BY_NAME)}, "
                    "or give a FrictionTerm object."
                )
        names = tuple(joint_names)[first:]
        parameters = tuple(p for term in objects for p in term.parameters(names))
        every = [each.name for each in parameters]
        if twice := [name for name in every if every.count(name) > 1]:
            raise ModelError(f"friction: the parameter {twice[0]} is defined twice.")
        return cls(tuple(objects), names, parameters, first)

    def columns(self, velocity: Array, acceleration: Array) -> Array:
        """Return all columns at an instant, shape (K, n, number of parameters).

        Those of terms that depend on the position too are zero: `columns_in` has them.
        """
        v, a, out = velocity[:, self.first :], acceleration[:, self.first :], self._zeros(velocity)
        for term, own in self.placed:
            if not term.posed:
                out[:, self.first :, own] = term.columns(v, a, self.joint_names)
        return out

    def columns_in(self, motion: SampledMotion) -> Array:
        """Return all columns as they stand in filtered efforts, (K, n, number of parameters)."""
        out = self._zeros(motion.velocity)
        for term, own in self.placed:
            out[:, self.first :, own] = term.columns_in(motion, self.joint_names)
        return out

    def enclosed(self, velocity: Range, acceleration: Range) -> Range:
        """Return bounds of all columns, below and above, over ranges of motion (K, n) each.

        Those of terms that depend on the position too are zero.
        """
        v, a = ([each[:, self.first :] for each in pair] for pair in (velocity, acceleration))
        low, high = self._zeros(velocity[0]), self._zeros(velocity[0])
        for term, own in self.placed:
            if not term.posed:
                bounds = term.enclosed((v[0], v[1]), (a[0], a[1]), self.joint_names)
                low[:, self.first :, own], high[:, self.first :, own] = bounds
        return low, high

    def _zeros(self, states: Array) -> Array:
        """Return columns of zeros at as many states, those of a floating base with them."""
        return np.zeros((len(states), self.first + len(self.joint_names), len(self.parameters)))

    @property
    def alike(self) -> tuple[tuple[int, int], ...]:
        """Pairs of parameters, by index, that are believed to be alike."""
        return tuple(
            (own.start + i, own.start + j)
            for term, own in self.placed
            for i, j in term.alike(self.joint_names)
        )

    @cached_property
    def placed(self) -> tuple[tuple[FrictionTerm, slice], ...]:
        """Each term, and where its parameters are among all."""
        ends = np.cumsum([0, *(len(term.parameters(self.joint_names)) for term in self.terms)])
        return tuple(zip(self.terms, map(slice, ends[:-1], ends[1:]), strict=True))

    def characteristic_speeds(self) -> Array:
        """Return speeds (k, joints) at which the columns of each joint bend, such as widths."""
        n = len(self.joint_names)
        return np.concatenate([np.zeros((0, n)), *(t.characteristic_speeds(n) for t in self.terms)])

    def described(self) -> list[dict[str, object]]:
        """Return each term's kind, its settings, and its parameters' names, as plain values."""
        out: list[dict[str, object]] = []
        for term in self.terms:
            own = [*fields(term)] if is_dataclass(term) else list[Any]()
            plain = {each.name: _plain_setting(getattr(term, each.name)) for each in own}
            names = [p.name for p in term.parameters(self.joint_names)]
            out.append({"term": type(term).__name__, **plain, "parameters": names})
        return out


def _plain_setting(value: object) -> object:
    """Return a setting of a term as plain values; functions by their names."""
    if isinstance(value, FrictionTerm):
        return repr(value)
    if callable(value):
        return getattr(value, "__name__", type(value).__name__)
    return [_plain_setting(each) for each in value] if isinstance(value, tuple) else value


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
