"""A robot whose parameters are known: its inverse and forward dynamics, friction included."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid.errors import DataError, ModelError
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.motion import Motion
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.model import RobotModel

# Forward dynamics with friction of the load: friction a tenth of the load shrinks the error tenfold
# a round, and ends where it is this share of the largest effort.
_SETTLED = 1e-12
_ROUNDS = 50


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RobotDynamics:
    """The equations of motion of a robot with known parameters, to compute with.

    ``effort = mass_matrix(q) @ a + coriolis(q, v) @ v + gravity(q) + friction(v)``, and friction
    that grows with load where the model has it, which depends on all three.

    Arguments are one state, (n,), or many, (K, n), all alike; results follow. With a floating base
    positions are configurations, (nq,) or (K, nq). Efforts are in N·m, of sliding joints in N.

    Attributes
    ----------
    robot : RobotModel
        The kinematics.
    terms : FrictionModel
        The terms beside the links' inertia.
    theta : ndarray, shape (p,)
        Parameters of the links, ten each, then those of the terms.
    """

    robot: RobotModel
    terms: FrictionModel
    theta: Array

    def __repr__(self) -> str:
        terms = ", ".join(type(term).__name__ for term in self.terms.terms) or "none"
        return f"RobotDynamics('{self.robot.name}', {self.robot.n} joints, terms: {terms})"

    def to_pinocchio(self) -> Any:
        """Return a new Pinocchio model with these links and, as its armature, rotor inertias.

        Pinocchio's algorithms know neither friction nor couplings between joints: its ``damping``
        and ``friction`` are zero, and the effort of `friction` is to be added. Gravity is tilted
        where the model says so. Joints that mimic others are joints of their own there.
        """
        model = self._links.copy()
        for term, values in self._posed():
            if isinstance(term, Tilt):
                model.gravity.linear += values @ term.change(self.robot.gravity)
        drives = np.diag(self._drive_inertia)
        for i in range(1, model.njoints):
            if model.names[i] in self.robot.joint_names:
                coordinate = self.robot.joint_names.index(model.names[i])
                model.armature[model.joints[i].idx_v] = drives[coordinate]
        return model

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return the mass matrix, rotor inertias and couplings included.

        Parameters
        ----------
        q : array_like, shape (n,) or (K, n)
            Joint positions, rad or m.

        Returns
        -------
        ndarray, shape (n, n) or (K, n, n)

        Raises
        ------
        DataError
            When a shape does not fit or a value is not finite; so all methods do.
        """
        import pinocchio as pin

        state = self._state(q)
        upper = np.triu(state.each(pin.crba))
        links = upper + np.triu(upper, 1).swapaxes(1, 2)
        return state.result(self._of_coordinates(links) + self._drive_inertia)

    def coriolis(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the Coriolis matrix C: ``C @ v`` is the effort of velocity-dependent forces.

        It is that of Pinocchio; on a fixed base dM/dt − 2·C is skew-symmetric.

        Parameters
        ----------
        q, v : array_like, shape (n,) or (K, n)
            Joint positions and velocities.

        Returns
        -------
        ndarray, shape (n, n) or (K, n, n)
        """
        import pinocchio as pin

        state = self._state(q, velocity=v)
        return state.result(self._of_coordinates(state.each(pin.computeCoriolisMatrix)))

    def gravity(self, q: ArrayLike) -> Array:
        """Return the effort that holds the links against gravity, tilted where the model says so.

        Parameters
        ----------
        q : array_like, shape (n,) or (K, n)
            Joint positions.

        Returns
        -------
        ndarray, shape (n,) or (K, n)
        """
        import pinocchio as pin

        state = self._state(q)
        upright = state.each(pin.computeGeneralizedGravity) @ self.robot.expansion
        rest = np.zeros((len(upright), self.robot.n))
        return state.result(upright + self._effort_of_posed(q, rest, rest, kind=Tilt))

    def friction(self, v: ArrayLike) -> Array:
        """Return the effort of joint friction and offsets: the curve itself, not filtered.

        Friction that grows with load is not in it: its load depends on the whole motion.

        Parameters
        ----------
        v : array_like, shape (n,) or (K, n)
            Joint velocities, rad/s or m/s.

        Returns
        -------
        ndarray, shape (n,) or (K, n)
        """
        velocity = _many(v, "velocity", self.robot.n)
        found = self._effort_of_terms(velocity, np.zeros_like(velocity))
        return found[0] if _single(v) else found

    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return the effort of a motion, friction and drives included.

        Parameters
        ----------
        q, v, a : array_like, shape (n,) or (K, n)
            Joint positions, velocities and accelerations.

        Returns
        -------
        ndarray, shape (n,) or (K, n)
        """
        import pinocchio as pin

        state = self._state(q, velocity=v, acceleration=a)
        links = state.each(pin.rnea) @ self.robot.expansion
        terms = self._effort_of_terms(*state.rates) + self._effort_of_posed(q, *state.rates)
        return state.result(links + terms)

    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> Array:
        """Return the acceleration under an effort, rad/s² or m/s².

        Friction is the curve's value at the velocity: nothing holds a joint at rest, as stiction
        would.

        Parameters
        ----------
        q, v, tau : array_like, shape (n,) or (K, n)
            Joint positions, velocities and efforts.

        Returns
        -------
        ndarray, shape (n,) or (K, n)

        Raises
        ------
        ModelError
            When a mass matrix is singular.
        """
        state = self._state(q, velocity=v, tau=tau)
        positions, (velocity, effort) = np.atleast_2d(np.asarray(q)), state.rates
        found, scale = np.zeros_like(velocity), float(np.abs(effort).max(initial=0.0))
        masses = self.mass_matrix(positions)
        try:
            for _ in range(_ROUNDS):
                left = effort - self.inverse_dynamics(positions, velocity, found)
                found = found + np.linalg.solve(masses, left[..., None])[..., 0]
                if not self._load or float(np.abs(left).max(initial=0.0)) <= _SETTLED * scale:
                    break
        except np.linalg.LinAlgError:
            raise ModelError(
                f"'{self.robot.name}': a mass matrix is singular, so that no acceleration follows "
                "from the effort; identify with a consistency, which makes every link a body."
            ) from None
        return state.result(np.asarray(found))

    @cached_property
    def _links(self) -> Any:
        """Pinocchio's model with these links, without armature and friction."""
        model = self.robot.with_inertias(self.theta)
        model.damping = model.friction = np.zeros(model.nv)
        return model

    @cached_property
    def _drive_inertia(self) -> Array:
        """Effort of the terms per unit acceleration, (n, n): rotor inertias and couplings."""
        unit = np.eye(self.robot.n)
        rest = np.zeros_like(unit)
        moved = self._effort_of_terms(rest, unit) - self._effort_of_terms(rest, rest)
        return np.asarray(moved.T)

    def _effort_of_terms(self, v: Array, a: Array) -> Array:
        coefficients = self.theta[10 * self.robot.n_links :]
        return np.asarray(self.terms.columns(v, a) @ coefficients)

    @cached_property
    def _load(self) -> bool:
        """Whether there is friction that depends on the acceleration."""
        return any(isinstance(term, LoadFriction) for term in self.terms.terms)

    def _effort_of_posed(
        self, q: ArrayLike, v: Array, a: Array, *, kind: type[FrictionTerm] = FrictionTerm
    ) -> Array:
        """Return the effort (K, n) of the terms of a kind that depend on the position."""
        out = np.zeros_like(v)
        for term, values in self._posed():
            if isinstance(term, kind):
                position = np.atleast_2d(np.asarray(q, dtype=np.float64))
                motion = Motion(position=position, velocity=v, acceleration=a, robot=self.robot)
                out += term.columns_in(motion, self.terms.joint_names) @ values
        return out

    def _posed(self) -> Iterator[tuple[FrictionTerm, Array]]:
        """Yield the terms that depend on the position, and their values."""
        at = 10 * self.robot.n_links
        for term in self.terms.terms:
            count = len(term.parameters(self.terms.joint_names))
            if term.posed:
                yield term, self.theta[at : at + count]
            at += count

    def _of_coordinates(self, matrices: Array) -> Array:
        """Return matrices (K, nv, nv) in the n coordinates of the robot."""
        E = self.robot.expansion
        return np.asarray(E.T @ matrices @ E)

    def _state(self, q: ArrayLike, **rates: ArrayLike) -> _State:
        configurations = self.robot.configuration(_many(q, "position", None))
        found = [_many(values, name, self.robot.n) for name, values in rates.items()]
        for name, array in zip(rates, found, strict=True):
            if len(array) != len(configurations):
                raise DataError(
                    f"{name}: {len(array)} states, the positions have {len(configurations)}; give "
                    "the same number of both."
                )
        return _State(self._links, self.robot.expansion, configurations, found, _single(q))


@dataclass(frozen=True, eq=False)
class _State:
    """States for Pinocchio, one a row."""

    model: Any
    expansion: Array
    configurations: Array
    rates: list[Array]
    single: bool

    def each(self, algorithm: Callable[..., Array]) -> Array:
        """Return the results of an algorithm of Pinocchio, of which there is one a state."""
        data = self.model.createData()
        expanded = [rate @ self.expansion.T for rate in self.rates]
        rows = zip(self.configurations, *expanded, strict=True)
        # Copied: Pinocchio returns views of its data, which the next state overwrites.
        return np.array([np.array(algorithm(self.model, data, *row)) for row in rows])

    def result(self, values: Array) -> Array:
        """Return the values, of a single state without the first axis."""
        return values[0] if self.single else values


def _single(values: ArrayLike) -> bool:
    """Return whether values are one state, and not many."""
    try:
        return np.ndim(values) == 1
    except ValueError:  # ragged, as `real_array` then says
        return False


def _many(values: ArrayLike, name: str, columns: int | None) -> Array:
    """Return values (columns,) or (K, columns) as (K, columns)."""
    array = real_array(values, name, ndim=1 if _single(values) else 2)
    many = np.atleast_2d(array)
    if columns is not None and many.shape[1] != columns:
        raise DataError(f"{name}: {many.shape[1]} columns, the robot has {columns} joints.")
    return many
