"""Friction terms with open parameters, and their columns at values to be tried."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.robot.friction.term import FrictionTerm, JointwiseTerm, OpenParameter
from sdpid.robot.friction.terms import Coulomb, SigmoidFriction, Stribeck

# Terms whose shape at a joint depends on that joint's motion and speeds alone, and on none of its
# neighbours: one joint at many speeds is then computed as many joints are. A subclass may know
# better which joint is which.
_ALIKE: tuple[type[JointwiseTerm], ...] = (Coulomb, SigmoidFriction, Stribeck)


@dataclass(eq=False)
class OpenTerm:
    """A term with open parameters, and their present values.

    Attributes
    ----------
    place : int
        Its place among the robot's terms.
    term : FrictionTerm
        The term as given.
    parameters : tuple of OpenParameter
        What is open.
    values : list of float
        Present values; at first the middles of the limits.
    flat : list of (float, float)
        For each the range of values that are as good.
    """

    place: int
    term: FrictionTerm
    parameters: tuple[OpenParameter, ...]
    values: list[float] = field(default_factory=list)
    flat: list[tuple[float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.values = [float(np.sqrt(p.lower * p.upper)) for p in self.parameters]
        self.flat = [(p.lower, p.upper) for p in self.parameters]

    @property
    def closed(self) -> FrictionTerm:
        """The term with the present values."""
        return self.term.with_values(self.values)

    def changed(self, i: int, value: float) -> FrictionTerm:
        """Return the term with another value of parameter i."""
        return self.term.with_values([*self.values[:i], value, *self.values[i + 1 :]])


class MovedColumns:
    """The columns of a term that depend on one of its parameters, the others being held.

    Parameters
    ----------
    each : OpenTerm
        The term, with the present values of all parameters.
    i : int
        Which parameter is to have other values.
    velocity, acceleration : ndarray, shape (K, n)
        Of the joints that have friction.
    joint_names : sequence of str
        Their names.

    Attributes
    ----------
    moved : ndarray of int, shape (m,)
        Which of the term's columns depend on the parameter.
    """

    def __init__(
        self,
        each: OpenTerm,
        i: int,
        velocity: Array,
        acceleration: Array,
        joint_names: Sequence[str],
    ) -> None:
        self._each, self._i = each, i
        self._velocity, self._acceleration = velocity, acceleration
        self._names = joint_names
        self._alone: JointwiseTerm | None = None
        if type(each.term) in _ALIKE:
            # Open speeds are in order of the fields, and within a field of the joints.
            field, joint = divmod(i, len(joint_names))
            self.moved: Indices = np.array([joint], dtype=np.intp)
            self._alone, self._field = _of_joint(each, field, joint)
            self._velocity = np.ascontiguousarray(velocity[:, [joint]])
            self._acceleration = np.ascontiguousarray(acceleration[:, [joint]])
        else:
            p = each.parameters[i]
            low, high = (self._whole(value) for value in (p.lower, p.upper))
            self.moved = np.flatnonzero(np.any(low != high, axis=(0, 1)))

    def at(self, values: Array) -> tuple[Indices, Array]:
        """Return the joints that the columns act on, and the columns (joints, K, values, m)."""
        if self._alone is not None:
            return self.moved, self._alike(self._alone, values)
        columns = np.stack([self._whole(float(x))[:, :, self.moved] for x in values], axis=2)
        joints = np.flatnonzero(columns.any(axis=(0, 2, 3)))
        return joints, np.ascontiguousarray(np.swapaxes(columns, 0, 1)[joints])

    def _whole(self, value: float) -> Array:
        term = self._each.changed(self._i, value)
        return term.columns(self._velocity, self._acceleration, self._names)

    def _alike(self, alone: JointwiseTerm, values: Array) -> Array:
        """Return the column of one joint for all values, as if each were a joint."""
        many = replace(alone, **{self._field: tuple(values.tolist())})
        velocity, acceleration = self._velocity, self._acceleration
        if values.size > 1:
            velocity = np.repeat(velocity, values.size, axis=1)
            acceleration = np.repeat(acceleration, values.size, axis=1)
        return many.shape(velocity, acceleration)[None, :, :, None]


def _of_joint(each: OpenTerm, field: int, joint: int) -> tuple[JointwiseTerm, str]:
    """Return a term with the speeds of one joint for all, and the name of an open field."""
    closed = each.closed
    assert isinstance(closed, JointwiseTerm)
    opened = [name for name in closed.speed_fields if getattr(each.term, name) is None]
    n = len(each.parameters) // len(opened)
    speeds = {name: float(closed.speed(name, n)[joint]) for name in closed.speed_fields}
    return replace(closed, **speeds), opened[field]
