"""A robot whose parameters are known: its inverse and forward dynamics, friction included."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, real_array
from sdpid._common.tables import Table, facts_html
from sdpid.errors import DataError, ModelError
from sdpid.robot.friction.model import FrictionModel, JointCurve, default_velocities, joint_number
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.position import AtJoints, OneJoint
from sdpid.robot.friction.term import FrictionTerm, SampledMotion
from sdpid.robot.model.model import RobotModel, each_state

# Forward dynamics with friction of the load: friction a tenth of the load shrinks the error tenfold
# a round, three quarters of it by a quarter. Settled is a state whose efforts are met to this share
# of the largest of them; gears that lose all of their load do not settle, and do not move either.
_SETTLED = 1e-12
_ROUNDS = 100

# Half a step of positions, rad or m, over which springs are straight lines.
_NUDGE = 1e-6

# A quaternion, or a cosine and a sine, this far from length one is no configuration.
_UNIT = 1e-6


class States(NamedTuple):
    """States for Pinocchio, one a row."""

    model: Any
    expansion: Array
    configurations: Array
    rates: list[Array]
    single: bool

    def each(self, algorithm: Callable[..., Array], axes: int = 1) -> Array:
        """Return an algorithm's results in the robot's coordinates, (K, n) or (K, n, n)."""
        E, shape = self.expansion, (self.model.nv,) * axes
        expanded = [rate @ E.T for rate in self.rates]
        found = each_state(algorithm, self.model, shape, self.configurations, *expanded) @ E
        return np.asarray(found if axes == 1 else E.T @ found)

    def result(self, values: Array) -> Array:
        """Return the values, of a single state without the first axis."""
        return values[0] if self.single else values


def spring_efforts(robot: RobotModel, position: Array) -> Array:
    """Return the efforts (K, n) of the springs in a description of a robot on a fixed base."""
    rest = np.zeros_like(position)
    motion = SampledMotion(position=position, velocity=rest, acceleration=rest, robot=robot)
    terms = FrictionModel.from_terms(robot.springs, robot.joint_names)
    values = [0.0 if each.value is None else each.value for each in terms.parameters]
    return np.asarray(terms.columns_in(motion) @ np.array(values))


def is_single(values: ArrayLike) -> bool:
    """Return whether values are one state, and not many."""
    try:
        return np.ndim(values) == 1
    except ValueError:  # ragged, as `real_array` then says
        return False


def many(values: ArrayLike, name: str, columns: int | None) -> Array:
    """Return values (columns,) or (K, columns) as (K, columns)."""
    array = real_array(values, name, ndim=1 if is_single(values) else 2)
    rows = np.atleast_2d(array)
    if columns is not None and rows.shape[1] != columns:
        raise DataError(f"{name}: {rows.shape[1]} columns, the robot has {columns} joints.")
    return rows


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RobotDynamics:
    """The equations of motion of a robot with known parameters, to compute with.

    ``effort = mass_matrix(q) @ a + coriolis(q, v) @ v + gravity(q) + friction(v)``, and friction
    that grows with load where the model has it, which depends on all three, and springs and other
    terms of the position.

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

    Examples
    --------
    >>> model = estimate.model()
    >>> q, v = np.zeros(6), np.full(6, 0.1)
    >>> effort = model.inverse_dynamics(q, v, np.zeros(6))
    >>> bool(np.allclose(effort, model.coriolis(q, v) @ v + model.gravity(q) + model.friction(v)))
    True
    >>> bool(np.allclose(model.forward_dynamics(q, v, effort), 0.0, atol=1e-8))
    True
    """

    robot: RobotModel
    terms: FrictionModel
    theta: Array

    def __repr__(self) -> str:
        what = f"{self.robot.name!r:.60}, {self.robot.n} coordinates"
        return f"RobotDynamics({what}, terms: {self._kinds:.80})"

    def _repr_html_(self) -> str:
        """Return the links' masses and centers, and the parameters of the terms, for a notebook."""
        robot, parameters = self.robot, self.terms.parameters
        bodies = self.theta[: 10 * robot.n_links].reshape(-1, 10)
        links = [
            (name, body[0], *(body[1:4] / body[0] if body[0] > 0.0 else [None] * 3))
            for name, body in zip(robot.link_names, bodies, strict=True)
        ]
        terms = {
            "parameter": [each.name for each in parameters],
            "unit": [each.unit for each in parameters],
            "value": self.theta[10 * robot.n_links :].tolist(),
        }
        facts = {
            "joints": len(self.terms.joint_names),
            "terms": self._kinds,
            "links": "one choice: efforts tell only combinations of their parameters",
        }
        return facts_html(
            f"Dynamics of {robot.name}",
            facts,
            Table(("link", "mass, kg", "x, m", "y, m", "z, m"), tuple(links)),
            Table.of_columns(terms),
        )

    @property
    def _kinds(self) -> str:
        return ", ".join(type(term).__name__ for term in self.terms.terms) or "none"

    def to_pinocchio(self) -> Any:
        """Return a new Pinocchio model with these links and, as its armature, rotor inertias.

        Pinocchio's algorithms know neither friction nor couplings between joints: its ``damping``
        and ``friction`` are zero, and the effort of `friction` is to be added. Gravity is tilted
        where the model says so. Joints that mimic others are joints of their own there.
        """
        model = self._links.copy()
        model.gravity.linear = self.tilted_gravity
        for column, joint, factor in self.robot.seated_joints():
            model.armature[joint.idx_v] = self.drive_inertia[column, column] / factor**2
        return model

    @cached_property
    def tilted_gravity(self) -> Array:
        """Gravity in the base link, tilted where the model says so, m/s²."""
        gravity = self.robot.gravity
        return gravity + sum(
            (values @ term.change(gravity) for term, values in self._posed() if type(term) is Tilt),
            np.zeros(3),
        )

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

        def whole(*state: Any) -> Array:
            upper = np.triu(pin.crba(*state))
            return np.asarray(upper + np.triu(upper, 1).T)

        state = self._state(q)
        return state.result(state.each(whole, 2) + self.drive_inertia)

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
        return state.result(state.each(pin.computeCoriolisMatrix, 2))

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
        upright = state.each(pin.computeGeneralizedGravity)
        rest = np.zeros_like(upright)
        return state.result(upright + self._effort_of_posed(q, rest, rest, kind=Tilt))

    def friction(self, v: ArrayLike) -> Array:
        """Return the effort of joint friction and offsets: the curve itself, not filtered.

        Friction that grows with load is not in it: its load depends on the whole motion. Nor are
        springs and other terms of the position.

        Parameters
        ----------
        v : array_like, shape (n,) or (K, n)
            Joint velocities, rad/s or m/s.

        Returns
        -------
        ndarray, shape (n,) or (K, n)
        """
        velocity = many(v, "velocity", self.robot.n)
        rest = np.zeros_like(velocity)
        found = self._effort_of_terms(velocity, rest)
        return found[0] if is_single(v) else found

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
        terms = self._effort_of_terms(*state.rates) + self._effort_of_posed(q, *state.rates)
        return state.result(state.each(pin.rnea) + terms)

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
            When a mass matrix is singular, or friction that grows with load is so strong that no
            acceleration is found.
        """
        state = self._state(q, velocity=v, tau=tau)
        positions, (velocity, effort) = np.atleast_2d(np.asarray(q)), state.rates
        masses = self.mass_matrix(positions)
        resting = self.inverse_dynamics(positions, velocity, np.zeros_like(velocity))
        found = self._accelerations(masses, effort - resting)
        if any(isinstance(term, LoadFriction) for term in self.terms.terms):
            # Their friction depends on the acceleration.
            self._settle(positions, velocity, effort, found, masses=masses, resting=resting)
        return state.result(found)

    def friction_curve(self, joint: str | int, velocity: ArrayLike | None = None) -> JointCurve:
        """Return the friction of one joint over its velocity, all other joints at rest.

        Offsets are in it; friction that grows with load is not.

        Parameters
        ----------
        joint : str or int
            Name of the joint, or its place among the joints that have friction.
        velocity : array_like, shape (s,), optional
            Velocities, rad/s or m/s; by default both ways up to the limit in the description, or
            to 1 rad/s (m/s) where it has none, closer together near standstill.

        Returns
        -------
        JointCurve
            Without a band: an `Identification` gives it with one (`friction_curve` there).

        Raises
        ------
        DataError
            When there is no such joint, or a velocity is not finite.
        """
        j = joint_number(self.terms.joint_names, joint)
        column = self.terms.first + j
        if velocity is None:
            velocity = default_velocities(float(self.robot.velocity_limits[column]))
        speeds = frozen(real_array(velocity, "velocity", ndim=1))
        states = np.zeros((len(speeds), self.robot.n))
        states[:, column] = speeds
        return JointCurve(
            joint=self.terms.joint_names[j],
            velocity=speeds,
            effort=frozen(self.friction(states)[:, column]),
            unit="N" if self.robot.slides[column] else "N·m",
        )

    def _settle(
        self, q: Array, v: Array, tau: Array, a: Array, *, masses: Array, resting: Array
    ) -> None:
        """Repeat accelerations (K, n), in place, until friction of the load is that of them."""
        scale = np.abs([tau, resting]).max(axis=(0, 2), initial=0.0)
        moving = np.arange(len(a))
        for _ in range(_ROUNDS):
            left = tau[moving] - self.inverse_dynamics(q[moving], v[moving], a[moving])
            errors = np.abs(left).max(axis=1)
            unsettled = errors > _SETTLED * scale[moving]
            hopeless = np.any(errors > scale[moving] / _SETTLED)
            moving, left = moving[unsettled], left[unsettled]
            if hopeless or not moving.size:
                break
            a[moving] += self._accelerations(masses[moving], left)
        if moving.size:
            raise ModelError(
                f"'{self.robot.name}': no acceleration found for {moving.size} of {len(a)} states "
                f"in {_ROUNDS} rounds: their friction grows with the load as fast as the load "
                "does; see the parameters Fl, which must stay below 1."
            )

    def _accelerations(self, masses: Array, effort: Array) -> Array:
        """Return what efforts (K, n) accelerate masses (K, n, n) by."""
        try:
            return np.asarray(np.linalg.solve(masses, effort[..., None])[..., 0])
        except np.linalg.LinAlgError:
            raise ModelError(
                f"'{self.robot.name}': a mass matrix is singular, so that no acceleration follows "
                "from the effort; identify with a consistency, which makes every link a body."
            ) from None

    @cached_property
    def _links(self) -> Any:
        """Pinocchio's model with these links, without armature and friction."""
        model = self.robot.with_inertias(self.theta)
        model.damping = model.friction = np.zeros(model.nv)
        return model

    @cached_property
    def drive_inertia(self) -> Array:
        """Effort of the terms per unit acceleration, (n, n): rotor inertias and couplings."""
        unit, rest = np.eye(self.robot.n), np.zeros((self.robot.n, self.robot.n))
        return (self._effort_of_terms(rest, unit) - self._effort_of_terms(rest, rest)).T

    def stiffness(self, q: Array) -> Array:
        """Return how efforts of terms of one joint's position change with it, (K, n, n)."""
        n = self.robot.n
        out, rest = np.zeros((len(q), n, n)), np.zeros_like(q)
        if any(isinstance(term, OneJoint) for term in self.terms.terms):
            for j, step in enumerate(_NUDGE * np.eye(n)):
                ahead, back = (
                    self._effort_of_posed(q + side * step, rest, rest, kind=OneJoint)
                    for side in (1.0, -1.0)
                )
                out[:, :, j] = (ahead - back) / (2.0 * _NUDGE)
        return out

    def _effort_of_terms(self, v: Array, a: Array) -> Array:
        """Return the effort (K, n) of terms at any position, on joints behind motors too."""
        found = self.terms.columns(v, a) @ self.theta[10 * self.robot.n_links :]
        return np.asarray(found + self._effort_of_posed(np.zeros_like(v), v, a, kind=AtJoints))

    def _effort_of_posed(
        self, q: ArrayLike, v: Array, a: Array, *, kind: type[Any] = FrictionTerm
    ) -> Array:
        """Return the effort (K, n) of terms of a kind; by default all that depend on positions."""
        position = np.atleast_2d(np.asarray(q, dtype=np.float64))
        first, out = self.terms.first, np.zeros_like(v)
        motion = SampledMotion(
            position=position, velocity=v[:, first:], acceleration=a[:, first:], robot=self.robot
        )
        for term, values in self._posed():
            if isinstance(term, kind) and isinstance(term, AtJoints) == (kind is AtJoints):
                out[:, first:] += term.columns_in(motion, self.terms.joint_names) @ values
        return out

    def _posed(self) -> Iterator[tuple[FrictionTerm, Array]]:
        """Yield the terms that depend on the position, and their values."""
        for term, own in self.terms.placed:
            if term.posed:
                yield term, self.theta[10 * self.robot.n_links :][own]

    def _state(self, q: ArrayLike, **rates: ArrayLike) -> States:
        configurations = self.robot.configuration(many(q, "position", None))
        found = [many(values, name, self.robot.n) for name, values in rates.items()]
        for name, array in zip(rates, found, strict=True):
            if len(array) != len(configurations):
                raise DataError(
                    f"{name}: {len(array)} states, the positions have {len(configurations)}; give "
                    "the same number of both."
                )
        self._require_unit(configurations)
        return States(self._links, self.robot.expansion, configurations, found, is_single(q))

    def _require_unit(self, configurations: Array) -> None:
        """Refuse given configurations (K, nq) whose quaternions are none: angles need no check."""
        import pinocchio as pin

        model = self.robot.pin_model
        for k, each in enumerate(configurations if self.robot.free_flyer else ()):
            if not pin.isNormalized(model, each, _UNIT):
                raise DataError(
                    f"position: state {k} has a quaternion (entries 3 to 6: x, y, z, w), or a "
                    "cosine and sine of a continuous joint, that is not of length 1; divide it by "
                    "its length."
                )
