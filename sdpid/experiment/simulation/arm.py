"""`SimulatedArm`: a robot with known parameters as plain arrays, and its motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid.errors import DataError
from sdpid.experiment.simulation.kernels.friction_arrays import FrictionArrays
from sdpid.experiment.simulation.kernels.layout import Robot, memory_for
from sdpid.experiment.simulation.kernels.linked import entries
from sdpid.robot.friction.posed import LoadFriction, PosedTerm, Tilt
from sdpid.robot.model.contacts.open_chain import require_fixed_robot, require_open_chain
from sdpid.robot.model.dynamics import RobotDynamics

# Numba compiles for writable C-contiguous arrays of doubles.
_COMPILED_FOR: tuple[Literal["C", "A", "W"], ...] = ("C", "A", "W")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SimulatedArm:
    """The equations of motion of a robot on a fixed base, compiled where Numba is installed.

    States are rows of arrays (S, n). Friction is that of the model, and at rest it sticks: where
    friction jumps, the joint stays as long as the jump can hold it.

    Attributes
    ----------
    model : RobotDynamics
        The robot and its parameters.
    arrays : Robot
        What the compiled loops take.
    """

    model: RobotDynamics
    arrays: Robot

    @classmethod
    def of(cls, model: RobotDynamics) -> SimulatedArm:
        """Pack a robot with known parameters.

        Parameters
        ----------
        model : RobotDynamics
            What ``estimate.model()`` returns.

        Raises
        ------
        ModelError
            When the base floats, loops close, a joint has no motor, or a friction term is not one
            of `sdpid.friction`.
        """
        robot, terms = model.robot, model.terms
        require_fixed_robot(robot, "simulation")
        require_open_chain(robot, "simulation")
        tree = robot.tree
        bodies = np.array(model.theta[: 10 * robot.n_links]).reshape(-1, 10)
        friction, coefficients = FrictionArrays(robot.n), model.theta[10 * robot.n_links :]
        gravity, none = np.array(robot.gravity), np.zeros((0, 10))
        tilted, tilt, loaded = none, np.zeros(3), none
        for term, own_values in terms.placed:
            values = coefficients[own_values]
            friction.add(term, values, terms.joint_names)
            if isinstance(term, PosedTerm):
                own = robot.prior if term.bodies is None else np.array(term.bodies)
                if isinstance(term, Tilt):
                    tilted, tilt = np.array(own), values @ term.change(robot.gravity)
                elif isinstance(term, LoadFriction):
                    loaded = np.array(own)
        if len(tilted) and np.array_equal(tilted, bodies):
            gravity, tilted = gravity + tilt, none
        which, curves, contacts, jumps = friction.arrays()
        own_v = tree.first_v
        offset = np.asarray(robot.offset, dtype=np.float64)[own_v]
        nothing = np.zeros_like(bodies)
        arrays = Robot(
            tree=_packed([tree.kind, tree.parent, tree.column[own_v]]),
            angles=_packed([tree.factor[own_v], offset]),
            turn=_packed(tree.turn),
            place=_packed(np.concatenate([tree.place, tree.axis[:, None]], axis=1)),
            bodies=_packed([bodies, *(x if len(x) else nothing for x in (tilted, loaded))]),
            gravity=_packed([gravity, tilt, robot.gravity]),
            matrices=_packed([model.drive_inertia, friction.viscous]),
            constant=_packed(friction.constant),
            load=_packed(friction.load),
            which=_packed(which),
            curves=_packed(curves),
            contacts=_packed(contacts),
            jumps=_packed(jumps),
            tilted=len(tilted) > 0,
            loaded=len(loaded) > 0,
        )
        return cls(model=model, arrays=arrays)

    def __repr__(self) -> str:
        return f"SimulatedArm({self.model.robot.name!r:.60}, {self.n} joints)"

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.model.robot.n

    def mass_and_bias(self, q: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
        """Return mass matrices (S, n, n) and biases (S, n): Coriolis, gravity, offsets.

        Parameters
        ----------
        q, v : array_like, shape (S, n)
            Positions and velocities.
        """
        q, v = self._states(q, v)
        M, h = np.empty((len(q), self.n, self.n)), np.empty((len(q), self.n))
        entries().many_dynamics(self.arrays, memory_for(self.arrays), q, v, M, h)
        return M, h

    def acceleration(self, q: ArrayLike, v: ArrayLike, effort: ArrayLike) -> Array:
        """Return accelerations (S, n) under efforts; joints at rest stay while friction holds them.

        Parameters
        ----------
        q, v, effort : array_like, shape (S, n)
            States and efforts.
        """
        q, v, effort = self._states(q, v, effort)
        out = np.empty_like(q)
        none = np.zeros(self.n, dtype=np.bool_)
        memory = memory_for(self.arrays)
        entries().many_accelerations(self.arrays, memory, q, v, effort, none, out)
        return out

    def run(
        self,
        q: ArrayLike,
        v: ArrayLike,
        effort: ArrayLike,
        dt: float,
        *,
        free: ArrayLike | None = None,
        record: tuple[Array, Array] | None = None,
    ) -> tuple[Array, Array, Any]:
        """Return the motion of S segments under given efforts.

        Parameters
        ----------
        q, v : array_like, shape (S, n)
            Where the segments start.
        effort : array_like, shape (S, T, n)
            Mean efforts over each of T steps.
        dt : float
            Length of a step, s.
        free : array_like of bool, shape (n,) or (S, n), optional
            Joints that move by the equations of motion, by default all.
        record : tuple of 2 ndarrays, shape (S, T + 1, n), optional
            Positions and velocities that the other joints follow.

        Returns
        -------
        position, velocity : ndarray, shape (S, T + 1, n)
            States at the ends of the steps; NaN after a segment diverged.
        count : ndarray of int, shape (S,)
            States of each segment before it diverged: T + 1 where it did not. A segment has
            diverged when a speed is not finite or beyond 1000 rad/s (m/s).
        """
        q, v = self._states(q, v)
        efforts = np.require(real_array(effort, "effort", ndim=3), np.float64, _COMPILED_FOR)
        S, T = efforts.shape[:2]
        if efforts.shape != (len(q), T, self.n):
            raise DataError(
                f"effort: shape {efforts.shape}, expected ({len(q)}, steps, {self.n}): one row a "
                "step of each segment."
            )
        fixed = np.zeros((S, self.n), dtype=np.bool_)
        given = np.zeros((2, 0, 0, self.n))
        if free is not None:
            fixed = fixed | ~np.asarray(free, dtype=np.bool_)
            if record is None or np.asarray(record).shape != (2, S, T + 1, self.n):
                raise DataError(
                    f"record: shape {np.asarray(record).shape}, expected {(2, S, T + 1, self.n)}: "
                    "positions and velocities that the joints follow which are not free."
                )
            given = np.require(record, np.float64, _COMPILED_FOR)
        out, count = np.full((2, S, T + 1, self.n), np.nan), np.zeros(S, dtype=np.int64)
        memory = memory_for(self.arrays)
        entries().open_loop(self.arrays, memory, q, v, efforts, float(dt), fixed, given, out, count)
        return out[0], out[1], count

    def _states(self, *arrays: ArrayLike) -> list[Array]:
        """Return arrays (S, n) as the compiled loops take them."""
        names = ("position", "velocity", "effort")
        found: list[Array] = []
        for values, name in zip(arrays, names, strict=False):
            array = real_array(values, name, ndim=2)
            if array.shape[1] != self.n or (found and len(array) != len(found[0])):
                raise DataError(
                    f"{name}: shape {array.shape}, expected one row a state and {self.n} columns."
                )
            found.append(np.require(array, np.float64, _COMPILED_FOR))
        return found


def _packed(values: Any) -> Any:
    """Return a writable copy in the one layout that is compiled for."""
    array = np.asarray(values)
    return np.array(array, dtype=np.int64 if array.dtype.kind == "i" else np.float64, order="C")
