"""`SimulatedArm`: a robot with known parameters as plain arrays, and its motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid.errors import DataError, ModelError
from sdpid.experiment.simulation.kernels.linked import entries
from sdpid.experiment.simulation.kernels.links import (
    KINDS,
    LOADING,
    POINT,
    POWERS,
    TILTED,
    Robot,
    memory_for,
)
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import LoadFriction, PosedTerm, PositionFriction, Tilt
from sdpid.robot.friction.position import way_of
from sdpid.robot.friction.term import EffortCurve, simulated_curves
from sdpid.robot.model.arms import require_fixed_robot, require_open_chain
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel

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
        coefficients = model.theta[10 * robot.n_links :]
        require_fixed_robot(robot, "simulation")
        require_open_chain(robot, "simulation")
        tree, own_v = robot.tree, robot.tree.first_v
        bodies = np.array(model.theta[: 10 * robot.n_links]).reshape(-1, 10)
        # Bodies and their gravity: the robot's, those of a tilt, and those that carry load.
        packs = [bodies, np.zeros_like(bodies), np.zeros_like(bodies)]
        gravity = np.stack([robot.gravity, np.zeros(3), robot.gravity])
        for term, own in terms.placed:
            if isinstance(term, PosedTerm):
                at = TILTED if isinstance(term, Tilt) else LOADING
                packs[at] = np.array(robot.prior if term.bodies is None else term.bodies)
            if isinstance(term, Tilt):
                gravity[TILTED] = coefficients[own] @ term.change(robot.gravity)
        friction = _friction(robot, terms, coefficients)
        column = np.where(tree.factor[own_v] != 0.0, tree.column[own_v], -1)
        arrays = Robot(
            tree=_packed(np.column_stack([tree.kind, tree.parent, column])),
            angles=_packed(np.column_stack([np.asarray(robot.offset)[own_v], tree.factor[own_v]])),
            turn=_packed(tree.turn),
            place=_packed(np.concatenate([tree.place, tree.axis[:, None]], axis=1)),
            bodies=_packed(packs),
            gravity=_packed(gravity),
            matrices=_packed([model.drive_inertia, friction.pop("viscous")]),
            tilted=bool(packs[TILTED].any()),
            loaded=bool(packs[LOADING].any()),
            bent=any(isinstance(term, PositionFriction) for term in terms.terms),
            **{name: _packed(values) for name, values in friction.items()},
        )
        return cls(model=model, arrays=arrays)

    def __repr__(self) -> str:
        return f"SimulatedArm({self.model.robot.name!r:.60}, {self.n} joints)"

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.model.robot.n

    def dynamics(self, q: Array, v: Array, effort: Array) -> tuple[Array, Array, Array]:
        """Return mass matrices (S, n, n), biases (S, n) and accelerations (S, n) under efforts.

        Biases are Coriolis, gravity and offsets. Joints at rest stay while friction holds them.

        Parameters
        ----------
        q, v, effort : ndarray, shape (S, n)
            States and efforts.
        """
        states = [
            self._taken(name, values, len(q))
            for name, values in (("position", q), ("velocity", v), ("effort", effort))
        ]
        M, (h, a) = np.empty((len(q), self.n, self.n)), np.empty((2, len(q), self.n))
        entries().dynamics(self.arrays, memory_for(self.arrays), *states, M, h, a)
        return M, h, a

    def run(
        self, states: ArrayLike, effort: Array, dt: float, *, free: ArrayLike | None = None
    ) -> Array:
        """Return positions and velocities (2, S, T + 1, n) of S segments under given efforts.

        They are those at the ends of the steps, NaN after a segment diverged: a speed is not finite
        or beyond 1000 rad/s (m/s).

        Parameters
        ----------
        states : array_like, shape (2, S, 1, n)
            Positions and velocities where the segments start; with `free` (2, S, T + 1, n): those
            that the other joints follow.
        effort : ndarray, shape (S, T, n)
            Mean efforts over each of T steps.
        dt : float
            Length of a step, s.
        free : array_like of bool, shape (n,) or (S, n), optional
            Joints that move by the equations of motion, by default all.
        """
        S, T = effort.shape[:2]
        effort = self._taken("effort", effort, S, T)
        states = self._taken("states", states, 2, S, 1 if free is None else T + 1)
        fixed = np.zeros((S, self.n), dtype=np.bool_) | (free is not None and ~np.asarray(free))
        out = np.full((2, S, T + 1, self.n), np.nan)
        memory = memory_for(self.arrays)
        entries().open_loop(self.arrays, memory, states, effort, float(dt), fixed, out)
        return out

    def _taken(self, name: str, values: Any, *shape: int) -> Array:
        """Return numbers of every joint as the compiled loops take them."""
        array = real_array(values, name, ndim=len(shape) + 1)
        if array.shape != (*shape, self.n):
            raise DataError(
                f"{name}: shape {array.shape}, expected {(*shape, self.n)}: one row a state, one "
                "column a joint."
            )
        return np.require(array, np.float64, _COMPILED_FOR)


def _friction(robot: RobotModel, terms: FrictionModel, coefficients: Array) -> dict[str, Array]:
    """Return what terms say of their simulation, gathered in the arrays of a `Robot`.

    The fourth column of jumps says where friction of the load adds to them.
    """
    n, names = len(terms.joint_names), terms.joint_names
    viscous, constant, load = np.zeros((n, n)), np.zeros(n), np.zeros((n, 4))
    parabolas = np.zeros((n, 5))
    if {LoadFriction, PositionFriction} <= {type(term) for term in terms.terms}:
        raise ModelError(
            "simulation: friction of the load and over position together are not simulated; "
            "identify with one of them."
        )
    curves: list[tuple[tuple[int, int], Array, tuple[float, ...]]] = []
    jumps: dict[tuple[float, ...], Array] = {}
    by_position: list[tuple[EffortCurve, Array, tuple[float, ...]]] = []
    for term, own in terms.placed:
        parts = [
            (part, *way_of(type(term).__name__, places[part.joint], robot, names))
            for acting, places, values in term.acting(coefficients[own], names)
            for part in simulated_curves(acting, values, [str(place) for place in places])
        ]
        for part, way, offset in parts:
            i = part.joint
            if not way.any():
                continue
            if part.kind == "slope":
                viscous += part.size * np.outer(way, way)
            elif part.kind == "constant":
                constant += part.size * way
            elif part.kind == "load":
                load[i] = (part.size, *part.numbers)
            elif part.kind == "position":
                # As friction of a load that is the parabola's value.
                load[i], parabolas[i] = (1.0, 0.0, 1.0, part.size), part.numbers
            elif part.kind == "jump":
                ends = np.array([part.numbers[1], part.size])
                key = (part.numbers[0], *way.tolist())
                jumps[key] = jumps.get(key, 0.0) + ends
            elif (kind := KINDS.index(part.kind)) >= POWERS:
                low, *others = part.numbers
                by_position.append((part, way, (offset - low, part.size, *others)))
            else:
                curves.append(((kind, part.side), way, (part.size, *part.numbers)))
    exact = (load[:, 0] != 0.0) & (load[:, 3] == 0.0)
    speeds = np.array([key[0] for key in jumps])
    ways = [np.array(key[1:]) for key in jumps]
    rubs = [
        bool(speed == 0.0 and np.count_nonzero(way) == 1 and exact @ (way == 1.0))
        for speed, way in zip(speeds, ways, strict=True)
    ]
    ends = np.reshape(list(jumps.values()), (-1, 2))
    begin, points = len(curves) + len(by_position), list[tuple[float, float]]()
    for part, way, numbers in by_position:
        curves.append(((KINDS.index(part.kind), begin + len(points)), way, numbers))
        points += part.points
    curves += [((POINT, 0), np.zeros(n), (*point, 0.0, 0.0)) for point in points]
    moved = [*(way for _, way, _ in curves), *ways]
    width = max([2, *(int(np.count_nonzero(way)) for way in moved)])
    which, factors = _sparse([way for _, way, _ in curves], width)
    contacts, shares = _sparse(ways, width)
    kinds = np.reshape(np.array([kind for kind, _, _ in curves], dtype=np.int64), (-1, 2))
    return {
        "viscous": viscous,
        "constant": constant,
        "load": load,
        "parabolas": parabolas,
        "which": np.hstack([kinds, which]),
        "curves": np.hstack([np.reshape([each for _, _, each in curves], (-1, 4)), factors]),
        "contacts": contacts,
        "jumps": np.column_stack([speeds, ends, np.array(rubs, dtype=np.float64), shares]),
    }


def _sparse(ways: list[Array], width: int) -> tuple[Any, Array]:
    """Return coordinates, -1 for none, and factors of directions, (m, width) each."""
    columns, factors = -np.ones((len(ways), width), dtype=np.int64), np.zeros((len(ways), width))
    for k, way in enumerate(ways):
        moved = np.flatnonzero(way)
        columns[k, : len(moved)], factors[k, : len(moved)] = moved, way[moved]
    return columns, factors


def _packed(values: Any) -> Any:
    """Return a writable copy in the one layout that is compiled for."""
    array = np.asarray(values)
    return np.array(array, dtype=np.int64 if array.dtype.kind == "i" else np.float64, order="C")
