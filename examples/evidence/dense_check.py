"""Is a motion within its limits? Looked at on a dense grid, independently of `sdpid.excitation`.

Every curve is evaluated at 10 kHz from its coefficients by SciPy and NumPy, efforts come from
Pinocchio's inverse dynamics, speeds from its kinematics, and distances from Coal with the meshes
of the description as they are. A grid proves nothing; it finds what a proof got wrong.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.polynomial import polynomial
from scipy.interpolate import BSpline

import sdpid
from sdpid._common.arrays import Array
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.description.catalog import example_robots

RATE_HZ = 10e3

# Distances are looked at at this rate everywhere, and at the fine one within one coarse step of an
# instant at which a pair is closer than the clearance and this (m).
COARSE_HZ, FINE_HZ, NEAR = 50.0, 1e3, 0.05

# What the least slack is told of.
KINDS = ("position", "velocity", "acceleration", "jerk", "torque", "distance")


class States(NamedTuple):
    """Instants (K,), and the positions and three derivatives at them, (K, n) each."""

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    jerk: Array


@dataclass(frozen=True, kw_only=True)
class Reached:
    """What a motion comes to of one limit.

    `slack` is what is left up to the limit at the worst instant, `time`: negative is broken.
    """

    kind: str
    subject: str
    limit: float
    reached: float
    slack: float
    time: float

    @property
    def held(self) -> bool:
        """Whether the limit holds at all instants looked at."""
        return self.slack >= 0.0

    @property
    def left(self) -> float:
        """What is left of the limit: a share of it, but rad of positions and m of distances."""
        absolute = self.kind in ("position", "distance") or not self.limit
        return self.slack if absolute else self.slack / abs(self.limit)


def left_of(reached: Iterable[Reached]) -> tuple[list[float | None], int, int | None]:
    """Return what is left of each of `KINDS` at least, broken limits, and pairs too close."""
    reached = list(reached)
    least = [min((r.left for r in reached if r.kind == kind), default=None) for kind in KINDS]
    apart = [r.held for r in reached if r.kind == "distance"]
    broken = sum(not r.held for r in reached) - apart.count(False)
    return least, broken, apart.count(False) if apart else None


def curve_states(curve: Any, duration: float, rate_hz: float = RATE_HZ) -> States:
    """Return the states of a curve on a grid over [0, duration], both ends included."""
    count = max(1, round(duration * rate_hz))
    time = duration * np.arange(count + 1) / count
    return States(time, *(_evaluated(curve, time, order) for order in range(4)))


def states_of(trajectory: Trajectory, rate_hz: float = RATE_HZ) -> States:
    """Return the states of a whole trajectory on a grid: connection in, one period, and out."""
    step = 1.0 / rate_hz
    period = trajectory.period
    time, *main = curve_states(trajectory.series, period, rate_hz)
    parts = [(trajectory.rest + trajectory.connection, time, main)]
    start, end = [values[0] for values in main], [values[-1] for values in main]
    length = trajectory.connection
    if length > 0.0:
        s = np.append(np.arange(0.0, length, step), length)
        enter = _quintic(s, length, _at_rest(trajectory.center), start[:3])
        # Coming to rest is starting from it with time reversed.
        last = trajectory.center if hasattr(trajectory.series, "amplitudes") else end[0]
        back = _quintic(length - s, length, _at_rest(last), _mirrored(end[:3]))
        leave = [values * (-1.0) ** order for order, values in enumerate(back)]
        after = trajectory.rest + length + trajectory.periods * period
        parts = [(trajectory.rest, s, enter), *parts, (after, s, leave)]
    stacked = [np.concatenate([values[k] for _, _, values in parts]) for k in range(4)]
    return States(np.concatenate([at + time for at, time, _ in parts]), *stacked)


def _at_rest(position: Array) -> list[Array]:
    return [np.asarray(position), np.zeros_like(position), np.zeros_like(position)]


def _mirrored(state: Sequence[Array]) -> list[Array]:
    return [values * (-1.0) ** order for order, values in enumerate(state)]


def _quintic(time: Array, length: float, start: list[Array], end: Sequence[Array]) -> list[Array]:
    """Return four derivatives of the polynomial of fifth degree between two states."""
    rows = [_monomials(np.array([t]), order)[0] for t in (0.0, length) for order in range(3)]
    coefficients = np.linalg.solve(np.array(rows), np.array([*start, *end]))
    return [_monomials(time, order) @ coefficients for order in range(4)]


def _monomials(time: Array, order: int) -> Array:
    """Return a derivative of 1, t, …, t⁵ at times, (K, 6)."""
    return np.column_stack(
        [polynomial.polyval(time, polynomial.polyder(np.eye(6)[k], order)) for k in range(6)]
    )


def _evaluated(series: Any, time: Array, order: int) -> Array:
    """Return a derivative of a curve from its coefficients."""
    if hasattr(series, "control_points"):
        spline = BSpline(series.knots, series.control_points, series.degree)
        return np.asarray(spline(time, nu=order))
    if not hasattr(series, "amplitudes"):
        return np.asarray(series.evaluate(time, derivative=order))
    rate = 2.0j * np.pi * series.harmonics / series.period
    out = np.tile(series.center if order == 0 else 0.0 * series.center, (len(time), 1))
    for j in range(series.n):
        waves = np.exp(time[:, None] * rate[j] + 1j * series.phases[j]) * rate[j] ** order
        out[:, j] += np.imag(waves) @ series.amplitudes[j]
    return out


def joints_reached(
    names: Sequence[str],
    states: States,
    *,
    lower: Array,
    upper: Array,
    velocity: Array,
    acceleration: Array,
    jerk: Array,
) -> Iterator[Reached]:
    """Yield what each joint reaches of its limits, (n,) each; infinite ones are passed over."""
    for j, name in enumerate(names):
        q = states.position[:, j]
        for limit, slack in ((lower[j], q - lower[j]), (upper[j], upper[j] - q)):
            if np.isfinite(limit):
                k = int(np.argmin(slack))
                yield _reached("position", name, limit, q[k], slack[k], states.time[k])
        for kind, bound, values in (
            ("velocity", velocity, states.velocity),
            ("acceleration", acceleration, states.acceleration),
            ("jerk", jerk, states.jerk),
        ):
            yield from _largest(kind, name, bound[j], values[:, j], states.time)


def efforts_reached(
    names: Sequence[str], time: Array, effort: Array, limit: Array
) -> Iterator[Reached]:
    """Yield what efforts (K, n) reach of their limits (n,)."""
    for j, name in enumerate(names):
        yield from _largest("torque", name, limit[j], effort[:, j], time)


def _largest(kind: str, name: str, limit: float, values: Array, time: Array) -> Iterator[Reached]:
    if np.isfinite(limit):
        k = int(np.argmax(np.abs(values)))
        yield _reached(kind, name, limit, abs(values[k]), limit - abs(values[k]), time[k])


def _reached(kind: str, subject: str, *numbers: float) -> Reached:
    limit, reached, slack, time = map(float, numbers)
    return Reached(kind=kind, subject=subject, limit=limit, reached=reached, slack=slack, time=time)


def efforts(robot: sdpid.RobotModel, states: States, theta: Any = None) -> Array:
    """Return the rigid body's efforts by Pinocchio, one state after the other, (K, n)."""
    model = robot.with_inertias(robot.prior.ravel() if theta is None else theta)
    data = model.createData()
    v, a = (x @ robot.expansion.T for x in (states.velocity, states.acceleration))
    q = robot.configuration(states.position)
    out = np.array([pin.rnea(model, data, *state) for state in zip(q, v, a, strict=True)])
    return np.asarray(out @ robot.expansion)


class Geometry:
    """The collision shapes of a URDF as they are, meshes included, and boxes and planes around.

    Parameters
    ----------
    robot : RobotModel
        A robot that was loaded from a URDF.
    package_dirs : iterable of paths, optional
        Folders in which ``package://`` names are looked up.
    """

    def __init__(self, robot: sdpid.RobotModel, package_dirs: Iterable[Any] = ()) -> None:
        if robot.urdf is None:
            raise sdpid.errors.ModelError(f"'{robot.name}' was not loaded from a URDF.")
        share = {
            os.fspath(folder)
            for path in example_robots().values()
            for inner in path.parents
            if inner.name == "example-robot-data"
            for folder in (inner.parent, inner / "robots")
        }
        folders = [*map(os.fspath, package_dirs), *sorted(share)]
        self.robot = robot
        self.shapes = pin.buildGeomFromUrdfString(
            robot.pin_model, robot.urdf, pin.GeometryType.COLLISION, package_dirs=folders
        )
        self.obstacles: list[str] = []
        bodies = [f for f in robot.pin_model.frames if f.type == pin.FrameType.BODY]
        self.base = next((f.name for f in bodies if f.parentJoint == 0), "base")

    def add(self, name: str, shape: Any, placement: Any) -> None:
        """Add an obstacle that stands still: a Coal shape and a `pin.SE3`."""
        self.shapes.addGeometryObject(pin.GeometryObject(name, 0, 0, placement, shape))
        self.obstacles.append(name)

    def link_of(self, index: int) -> str:
        """Return the moving link that a shape belongs to, its own name for an obstacle."""
        shape = self.shapes.geometryObjects[index]
        if shape.name in self.obstacles:
            return str(shape.name)
        return self.robot.link_names[shape.parentJoint - 1] if shape.parentJoint else self.base

    def pairs(self, wanted: Iterable[tuple[str, str]]) -> list[tuple[int, int]]:
        """Return the pairs of shapes of pairs of links."""
        asked = {frozenset(pair) for pair in wanted}
        count = len(self.shapes.geometryObjects)
        links = [self.link_of(i) for i in range(count)]
        return [
            (i, j)
            for i in range(count)
            for j in range(i)
            if links[i] != links[j] and frozenset((links[i], links[j])) in asked
        ]

    def distances(self, position: Array, pairs: Sequence[tuple[int, int]]) -> Array:
        """Return the distances (K, P) of pairs of shapes, m; negative where they penetrate."""
        self.shapes.removeAllCollisionPairs()
        for pair in pairs:
            self.shapes.addCollisionPair(pin.CollisionPair(*pair))
        model, data = self.robot.pin_model, self.robot.pin_model.createData()
        found = self.shapes.createData()
        out = np.empty((len(position), len(pairs)))
        for k, q in enumerate(self.robot.configuration(position)):
            pin.computeDistances(model, data, self.shapes, found, q)
            out[k] = [result.min_distance for result in found.distanceResults]
        return out


def distances_reached(
    geometry: Geometry, states: States, wanted: Mapping[tuple[str, str], float]
) -> list[Reached]:
    """Return the least distance of pairs of links on a fine grid, against what each must keep."""
    asked = {frozenset(pair): clearance for pair, clearance in wanted.items()}
    pairs = geometry.pairs(wanted)
    rate = 1.0 / np.median(np.diff(states.time))
    every, fine = (max(1, round(rate / hz)) for hz in (COARSE_HZ, FINE_HZ))
    coarse = np.arange(0, len(states.time), every)
    first = geometry.distances(states.position[coarse], pairs)
    least: dict[frozenset[str], tuple[float, float]] = {}
    for p, pair in enumerate(pairs):
        key = frozenset(map(geometry.link_of, pair))
        index, values = coarse, first[:, p]
        near = coarse[first[:, p] < asked[key] + NEAR]
        if near.size:
            around = near[:, None] + np.arange(-every, every + 1, fine)
            index = np.unique(np.clip(around, 0, len(states.time) - 1))
            values = geometry.distances(states.position[index], [pair])[:, 0]
        k = int(np.argmin(values))
        found = float(values[k]), float(states.time[index[k]])
        least[key] = min(found, least.get(key, found))
    return [
        least_reached(pair, clearance, *np.array([least[key]]).T)
        for pair, clearance in wanted.items()
        if (key := frozenset(pair)) in least
    ]


def least_reached(pair: tuple[str, str], clearance: float, values: Array, time: Array) -> Reached:
    """Return the least of distances (K,) of a pair at some times, against what it must keep."""
    k = int(np.argmin(values))
    name = " – ".join(pair)
    return _reached("distance", name, clearance, values[k], values[k] - clearance, time[k])
