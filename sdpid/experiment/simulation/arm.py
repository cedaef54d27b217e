"""`SimulatedArm`: a robot with known parameters as plain arrays, and its motion under efforts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Indices, Mask, real_array
from sdpid.errors import DataError, ModelError
from sdpid.experiment.processing.samples import Samples
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


# Longest step, s. Linearly implicit in friction, halving it moves no median by more than
# docs/evidence/rollouts.md says.
STEP = 0.005

# Bytes of efforts and states of stretches that are simulated together.
_BYTES = 1 << 26

# A joint this many times faster than any joint of the recording has run away: on the way there it
# has left the recorded motion by turns.
_RUNAWAY = 20.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """A processed recording on the grid of the simulation.

    Attributes
    ----------
    step : float
        Of the grid, s.
    time : ndarray, shape (T,)
        s; pieces of the recording stand one after the other.
    position, velocity : ndarray, shape (T, n)
        Measured states.
    effort : ndarray, shape (T, n)
        Measured efforts halfway to the next instant.
    piece : ndarray of int, shape (T,)
        Number of the piece that each instant belongs to.
    """

    step: float
    time: Array
    position: Array
    velocity: Array
    effort: Array
    piece: Indices

    @classmethod
    def of(cls, samples: Samples, *, step: float = STEP) -> Track:
        """Interpolate samples by cubic splines; `step` is the longest that the grid may have."""
        from scipy.interpolate import CubicSpline

        assert samples.time is not None
        spacing = float(np.median(np.diff(samples.time)))
        # Whole numbers of steps between samples, so that samples stay what they are.
        h = spacing / math.ceil(spacing / step - 1e-9)
        parts: list[tuple[Array, ...]] = []
        for number, part in enumerate(samples.parts):
            own = samples.time[part]
            if len(own) < 2:
                continue
            count = math.floor((own[-1] - own[0]) / h + 1e-6)
            time = own[0] + h * np.arange(count + 1)
            states = [CubicSpline(own, x[part])(time) for x in (samples.position, samples.velocity)]
            effort = CubicSpline(own, samples.effort[part])(time + 0.5 * h)
            parts.append((time, *states, effort, np.full(len(time), number)))
        names = ("time", "position", "velocity", "effort", "piece")
        joined = map(np.concatenate, zip(*parts, strict=True))
        return cls(step=h, **dict(zip(names, joined, strict=True)))

    def starts(self, length: float, every: float) -> Indices:
        """Return instants `every` s apart that have `length` s of their piece before them."""
        steps, stride = self.steps(length), max(1, round(every / self.step))
        found = []
        for number in np.unique(self.piece):
            own = np.flatnonzero(self.piece == number)
            found.append(own[: max(0, len(own) - steps) : stride])
        return np.concatenate(found)

    def steps(self, seconds: float) -> int:
        """Return how many steps there are in a time."""
        return max(1, round(seconds / self.step))


def simulate_stretches(
    arm: SimulatedArm, track: Track, first: Indices, free: Mask, after: Sequence[int] | Indices
) -> Array:
    """Simulate stretches of a track under its efforts, many in one call.

    Each starts in the measured state. Joints that are not free follow the recording: their
    accelerations are prescribed, and the free ones are solved for.

    Parameters
    ----------
    arm : SimulatedArm
        What moves.
    track : Track
        Efforts, states to start from, and the motion of joints that are not free.
    first : ndarray of int, shape (S,)
        Instants at which stretches start.
    free : ndarray of bool, shape (S, n)
        Joints that are free; the others follow the track.
    after : sequence of int
        Steps after which positions are kept, rising.

    Returns
    -------
    ndarray, shape (S, L, n)
        Simulated positions. Divergence is no error: what ran away is NaN from then on.
    """
    wanted = np.asarray(after, dtype=np.intp)
    steps, n = int(wanted[-1]), track.position.shape[1]
    limit = _RUNAWAY * float(np.abs(track.velocity).max())
    out = np.empty((len(first), len(wanted), n))
    size = max(1, _BYTES // (40 * n * steps))
    for begin in range(0, len(first), size):
        own = slice(begin, begin + size)
        rows = first[own, None] + np.arange(steps + 1)
        loose = None if free[own].all() else free[own]
        states = np.stack([track.position[rows], track.velocity[rows]])
        states = states[:, :, :1] if loose is None else states
        position, velocity = arm.run(states, track.effort[rows[:, :-1]], track.step, free=loose)
        with np.errstate(invalid="ignore"):
            # Not a number is not below the limit either.
            lost = ~(np.abs(velocity).max(axis=2) < limit)
        lost = np.logical_or.accumulate(lost, axis=1)
        out[own] = np.where(lost[:, :, None], np.nan, position)[:, wanted]
    return out


def tip_positions(robot: RobotModel, q: Array) -> Array:
    """Return where the tip is (K, 3), m, at positions (K, n); not a number where they are not.

    The last joint has the most joints before it; of the frames that it carries the farthest is
    the tip, or else its own origin.
    """
    import pinocchio as pin

    model, data = robot.pin_model, robot.pin_model.createData()
    last = max(range(model.njoints), key=lambda i: len(model.supports[i]))
    places = [np.array(f.placement.translation) for f in model.frames if f.parentJoint == last]
    place = max([np.zeros(3), *places], key=lambda each: float(np.linalg.norm(each)))
    sound = np.asarray(np.isfinite(q).all(axis=1))
    out = np.full((len(q), 3), np.nan)
    configurations = robot.configuration(np.where(sound[:, None], q, 0.0))
    for k in np.flatnonzero(sound):
        pin.forwardKinematics(model, data, configurations[k])
        out[k] = data.oMi[last].act(place)
    return out
