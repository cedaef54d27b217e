"""What is held against limits: functions of a state for a search, and bounds along a curve.

Functions of a state are at least zero where a limit is held, in shares of it, and smooth enough to
be differentiated. What happens between the instants at which a search looks is left to
`sdpid.excitation.limits.check`.

Along a curve time is cut into cells. Over each cell a `CurveMeasure` bounds its functions; cells on
which a bound does not decide are cut in half, until every function is known to hold its limit or to
break it at an instant that was evaluated.

Efforts and the motion of links are bounded at every configuration. Every vector of the recursive
Newton-Euler algorithm is a sum of products of vectors that turn with a link: lengths, axes, first
moments, inertias. A *jet* bounds such a vector over a cell of time: row k is at least the norm of
its k-th derivative at every instant. Sums and products of vectors obey
``|(x + y)^(k)| ≤ |x^(k)| + |y^(k)|`` and, by Leibniz, ``|(x·y)^(k)| ≤ Σ C(k, m)·|x^(m)|·
|y^(k−m)|``, cross products, scalar products and products with matrices alike. So the recursion,
carried out on jets, bounds efforts and their first two derivatives whatever the configuration; only
the sizes of the joints' speeds and their derivatives enter, over the same cell.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Indices
from sdpid.errors import ModelError
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.limits.torque import TorqueModel
from sdpid.experiment.trajectory.curve import Curve
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.regressor_kernel import PRISMATIC, Tree


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueWithin:
    """Torques stay within their limits: one function a limited joint, 1 − (torque/limit)².

    The added deviations and the steps of Coulomb friction are counted as constants at a state.

    Attributes
    ----------
    model : TorqueModel
        The torques.
    limits : JointLimits
        Their limits, less the model's reserve.
    """

    model: TorqueModel
    limits: JointLimits
    name: str = field(default="torque", init=False)

    @cached_property
    def _limited(self) -> Indices:
        return np.flatnonzero(np.isfinite(self.limits.torque))

    @cached_property
    def _allowed(self) -> Array:
        return self.model.allowed(self.limits.torque)[self._limited]

    def evaluate(self, q: Array, v: Array, a: Array) -> Array:
        """Return the slacks (K, m) at states (K, n), in shares of the limits squared."""
        size = np.abs(self.model.torque(q, v, a)) + self.model.spread(q, v, a)
        return np.asarray(1.0 - (size[:, self._limited] / self._allowed) ** 2)

    def derivatives(self, q: Array, v: Array, a: Array) -> tuple[Array | None, ...]:
        """Return derivatives (K, m, n) by position, velocity and acceleration."""
        torque, *slopes = self.model.torque_and_derivatives(q, v, a)
        size = np.abs(torque) + self.model.spread(q, v, a)
        scale = -2.0 * (np.sign(torque) * size)[:, self._limited] / self._allowed**2
        return tuple(scale[:, :, None] * slope[:, self._limited] for slope in slopes)


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolSpeedWithin:
    """The speed of the tool stays within its limit: one function a frame, 1 − (speed/limit)².

    Attributes
    ----------
    robot : RobotModel
        The robot.
    speed : float
        The limit, m/s.
    frames : tuple of int
        Indices of the frames whose speed it is, see `tool_frames`.
    """

    robot: RobotModel
    speed: float
    frames: tuple[int, ...]
    name: str = field(default="tool speed", init=False)

    @classmethod
    def of(cls, robot: RobotModel, limits: JointLimits) -> ToolSpeedWithin | None:
        """Build from the limits of a robot; None where the speed is not limited."""
        if limits.tool_speed is None:
            return None
        frames = tool_frames(robot, limits.tool)
        return cls(robot=robot, speed=limits.tool_speed, frames=frames)

    def speeds(self, q: Array, v: Array) -> Array:
        """Return the speeds (K, frames) at states (K, n), m/s."""
        return self._velocities(q, v)[0]

    def evaluate(self, q: Array, v: Array, a: Array) -> Array:
        """Return the slacks (K, frames) at states (K, n), in shares of the limit squared."""
        return np.asarray(1.0 - self.speeds(q, v) ** 2 / self.speed**2)

    def derivatives(self, q: Array, v: Array, a: Array) -> tuple[Array | None, ...]:
        """Return derivatives (K, frames, n) by position and velocity."""
        _, by_position, by_velocity = self._velocities(q, v, derivatives=True)
        scale = -2.0 / self.speed**2
        return scale * by_position, scale * by_velocity, None

    def _velocities(
        self, q: Array, v: Array, *, derivatives: bool = False
    ) -> tuple[Array, Array, Array]:
        """Return speeds (K, frames), and half the derivatives of their squares (K, frames, n)."""
        import pinocchio as pin

        robot, model = self.robot, self.robot.pin_model
        data, E = model.createData(), robot.expansion
        own = pin.ReferenceFrame.LOCAL
        speeds = np.empty((len(q), len(self.frames)))
        slopes = np.zeros((2, len(q), len(self.frames), robot.n))
        zero = np.zeros(model.nv)
        for k, state in enumerate(zip(robot.configuration(q), v @ E.T, strict=True)):
            if derivatives:
                pin.computeForwardKinematicsDerivatives(model, data, *state, zero)
            else:
                pin.forwardKinematics(model, data, *state)
            for c, frame in enumerate(self.frames):
                pin.updateFramePlacement(model, data, frame)
                velocity = pin.getFrameVelocity(model, data, frame, own).linear
                speeds[k, c] = np.linalg.norm(velocity)
                if derivatives:
                    by = pin.getFrameVelocityDerivatives(model, data, frame, own)
                    # With a single joint the binding drops the axis of length one.
                    slopes[:, k, c] = [velocity @ part.reshape(6, -1)[:3] @ E for part in by]
        return speeds, slopes[0], slopes[1]


def tool_frames(robot: RobotModel, tool: str | None = None) -> tuple[int, ...]:
    """Return the indices of the frames whose speed is limited as the tool's.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    tool : str, optional
        One frame of the description; by default, of every last link, the frame that is farthest
        from its joint.

    Raises
    ------
    ModelError
        When the robot has no such frame.
    """
    model, numbers = robot.pin_model, robot.frame_numbers
    if tool is not None:
        if tool not in numbers:
            names = ", ".join(dict.fromkeys(str(frame.name) for frame in model.frames))
            raise ModelError(f"'{robot.name}' has no frame '{tool}' for the tool; it has {names}.")
        return (numbers[tool],)
    lengths = [float(np.linalg.norm(frame.placement.translation)) for frame in model.frames]
    owners = np.array([frame.parentJoint for frame in model.frames])
    last = set(range(1, model.njoints)) - {model.parents[i] for i in range(1, model.njoints)}
    own = (np.flatnonzero(owners == link).tolist() for link in sorted(last))
    return tuple(max(each, key=lambda index: lengths[index]) for each in own)


# Derivatives of the joints' positions that enter: the second derivative of an effort has the
# fourth, snap.
_ORDERS = 4

# Cells are at most this long at first, s: motions of arms change over tenths of a second.
_FIRST = 0.1
# Cells shorter than this (s) are not cut: what is undecided then is within a hair of its limit.
_FINEST = 1e-7
# At most this many cells are looked at, a few seconds' work.
_MOST = 400_000
# Plans may touch their limits, and bounds are widened by rounding: so much is let pass, as a share
# of the limit, and of this number where the limit is smaller.
_TOUCHING, _SMALL = 1e-9, 1e-3

# Of m functions: upper bounds that hold at every instant, the largest values that were evaluated,
# and where, s; each of shape (m,).
Extremes = tuple[Array, Array, Array]


@dataclass(frozen=True, eq=False)
class Cells:
    """C cells of time along a curve, with what was evaluated at their ends.

    Attributes
    ----------
    curve : Curve
        The motion.
    start, stop : ndarray, shape (C,)
        Ends in s, increasing; cells do not overlap.
    left, right : ndarray, shape (C, d)
        Values of the measure's nodes at both ends, as seen from inside.
    """

    curve: Curve
    start: Array
    stop: Array
    left: Array
    right: Array

    @property
    def width(self) -> Array:
        """Lengths (C, 1) in s."""
        return (self.stop - self.start)[:, None]

    def enclose(self, derivative: int) -> tuple[Array, Array]:
        """Return bounds (C, n) of a derivative of the positions, below and above."""
        edges = np.union1d(self.start, self.stop)
        place = np.searchsorted(edges, self.start)
        lower, upper = self.curve.enclose(edges, derivative=derivative)
        return lower[place], upper[place]

    def largest(self, derivative: int) -> Array:
        """Return bounds (C, n) on the size of a derivative of the positions."""
        return np.asarray(np.maximum(*np.abs(self.enclose(derivative))))

    @cached_property
    def sizes(self) -> Array:
        """Bounds (5, C, n) on the sizes of the positions and their four derivatives."""
        return np.stack([self.largest(order) for order in range(5)])


class CurveMeasure(ABC):
    """m functions along a curve that must not grow too large."""

    @abstractmethod
    def nodes(self, curve: Curve, time: Array) -> Array:
        """Return what bounds need of an instant, (K,) to (K, d)."""

    def values(self, nodes: Array) -> Array:
        """Return the functions at instants, (K, d) to (K, m): by default the nodes."""
        return nodes

    @abstractmethod
    def bounds(self, cells: Cells) -> Array:
        """Return upper bounds (C, m) of the functions over cells."""


def extremes(curve: Curve, measure: CurveMeasure, limits: Array, resolution: Array) -> Extremes:
    """Return the largest values of functions along a curve.

    Parameters
    ----------
    curve : Curve
        The motion.
    measure : CurveMeasure
        The functions.
    limits : ndarray, shape (m,)
        Values that they must not exceed.
    resolution : ndarray, shape (m,)
        Bounds are refined until they are this close to a value that was evaluated, and further
        while a limit lies between the two.
    """
    start, stop = _first_cells(curve)
    # Just before the ends: a derivative that jumps is seen from the left there.
    left, right = measure.nodes(curve, start), measure.nodes(curve, np.nextafter(stop, -np.inf))
    known = np.concatenate([measure.values(left), measure.values(right)])
    reached, when = _top(known, np.concatenate([start, stop]))
    worst = reached
    allowed = with_tolerance(limits)
    seen = len(start)
    while True:
        ends = np.maximum(measure.values(left), measure.values(right))
        bounds = np.maximum(measure.bounds(Cells(curve, start, stop, left, right)), ends)
        # A bound may be far from what is reached, or from deciding.
        wide = (bounds > allowed) & (reached <= allowed) | (bounds > reached + resolution)
        cut = wide.any(axis=1) & (stop - start > _FINEST) & (seen <= _MOST)
        worst = np.maximum(worst, bounds[~cut].max(axis=0, initial=-np.inf))
        if not cut.any():
            return np.maximum(worst, reached), reached, when
        start, stop, left, right = start[cut], stop[cut], left[cut], right[cut]
        middle = 0.5 * (start + stop)
        nodes = measure.nodes(curve, middle)
        top, place = _top(measure.values(nodes), middle)
        when = np.where(top > reached, place, when)
        reached = np.maximum(reached, top)
        seen += 2 * len(middle)
        start, stop, left, right = (
            np.stack(pair, axis=1).reshape(2 * len(middle), *pair[0].shape[1:])
            for pair in ((start, middle), (middle, stop), (left, nodes), (nodes, right))
        )


def with_tolerance(limits: ArrayLike) -> Array:
    """Return upper limits with what is let pass for rounding."""
    values = np.asarray(limits, dtype=np.float64)
    return np.asarray(values + _TOUCHING * np.maximum(np.abs(values), _SMALL))


def _top(values: Array, time: Array) -> tuple[Array, Array]:
    """Return the largest of values (K, m) of functions, and when."""
    best = np.argmax(values, axis=0)
    return values[best, np.arange(values.shape[1])], time[best]


def _first_cells(curve: Curve) -> tuple[Array, Array]:
    """Return the ends of cells between the breaks of a curve."""
    breaks = np.asarray(curve.breaks)
    count = np.maximum(1, np.ceil(np.diff(breaks) / _FIRST)).astype(int)
    parts = [
        low + (high - low) * np.arange(k) / k
        for low, high, k in zip(breaks[:-1], breaks[1:], count, strict=True)
    ]
    edges = np.append(np.concatenate(parts), breaks[-1])
    return edges[:-1], edges[1:]


@dataclass(frozen=True, eq=False)
class MotionMeasure(CurveMeasure):
    """A derivative of the positions, n functions.

    Attributes
    ----------
    derivative : int
        0 for positions, 1 for velocities, 2 for accelerations, 3 for jerks.
    signs : tuple of float
        Of what is limited: 1 for the derivative itself, −1 for it with the sign changed, so that
        lower limits are upper ones as well; by default both, its size.
    """

    derivative: int
    signs: tuple[float, ...] = (1.0, -1.0)

    def nodes(self, curve: Curve, time: Array) -> Array:
        """Return the derivative, (K, n)."""
        return curve.evaluate(time, derivative=self.derivative)

    def values(self, nodes: Array) -> Array:
        """Return it with the sign, or its size, (K, n)."""
        return np.asarray(np.max([sign * nodes for sign in self.signs], axis=0))

    def bounds(self, cells: Cells) -> Array:
        """Return upper bounds (C, n)."""
        lower, upper = cells.enclose(self.derivative)
        sides = [upper if sign > 0.0 else -lower for sign in self.signs]
        return np.asarray(np.max(sides, axis=0))


class LinkNorms(NamedTuple):
    """Jets of the links' motion over C cells; link 0 is the base.

    Attributes
    ----------
    turning : list of ndarray (5, C)
        Of a unit vector fixed to the link.
    spin : list of ndarray (4, C)
        Of the angular velocity.
    offset : list of ndarray (5, C)
        Of the vector from the parent's origin to the link's.
    origin : list of ndarray (5, C)
        Of the link's origin.
    """

    turning: list[Array]
    spin: list[Array]
    offset: list[Array]
    origin: list[Array]


def product(x: Array, y: Array, count: int) -> Array:
    """Return the jet (count, …) of a product, from jets of at least that many rows."""
    return np.stack([sum(comb(k, m) * x[m] * y[k - m] for m in range(k + 1)) for k in range(count)])


def _turning(spin: Array) -> Array:
    """Return the jet (5, C) of a unit vector fixed to a link, from that of its spin (4, C)."""
    rows = [np.ones_like(spin[0])]
    for k in range(_ORDERS):
        rows.append(sum(comb(k, m) * spin[k - m] * rows[m] for m in range(k + 1)))
    return np.stack(rows)


def link_norms(tree: Tree, joints: Array) -> LinkNorms:
    """Return the jets of the motion of a tree's links.

    Parameters
    ----------
    tree : Tree
        Of turning and sliding joints on a fixed base.
    joints : ndarray, shape (5, C, nv)
        Bounds on the sizes of the positions (of sliding joints) and their four derivatives.
    """
    zero = np.zeros(joints.shape[:2])
    norms = LinkNorms([_turning(zero[1:])], [zero[1:]], [zero], [zero])
    lengths = np.linalg.norm(tree.place[:, 0], axis=1)
    for kind, before, first, length in zip(
        tree.kind, tree.parent + 1, tree.first_v, lengths, strict=True
    ):
        own, turning = joints[:, :, first], norms.turning[before]
        step, spin = length * turning, norms.spin[before]
        if kind == PRISMATIC:
            step = step + product(turning, own, _ORDERS + 1)
        else:
            spin = spin + product(turning, own[1:], _ORDERS)
        norms.spin.append(spin)
        norms.turning.append(_turning(spin))
        norms.offset.append(step)
        norms.origin.append(norms.origin[before] + step)
    return norms


def effort_norms(
    tree: Tree, norms: LinkNorms, link: int, sizes: Sequence[float], gravity: float
) -> Array:
    """Return the jets (3, C, nv) of what one body adds to the efforts.

    Parameters
    ----------
    tree : Tree
        The kinematics.
    norms : LinkNorms
        The motion of its links.
    link : int
        The body's link, from 1.
    sizes : sequence of 3 floats
        Its mass, and the norms of its first moment and rotational inertia about the link's origin.
    gravity : float
        Size of gravity, m/s².
    """
    mass, moment, inertia = sizes
    turning = norms.turning[link]
    acceleration = norms.origin[link][2:].copy()
    acceleration[0] += gravity
    force = mass * acceleration + moment * turning[2:]
    spinning = product(product(turning, turning, _ORDERS), norms.spin[link], _ORDERS)
    torque = inertia * spinning[1:] + moment * product(turning, acceleration, 3)
    arm = np.zeros_like(torque)
    found = np.zeros((*torque.shape, len(tree.shared)))
    while link > 0:
        kind, before, first = (x[link - 1] for x in (tree.kind, tree.parent + 1, tree.first_v))
        whole = force if kind == PRISMATIC else torque + product(arm, force, 3)
        found[:, :, first] = product(norms.turning[before], whole, 3)
        arm = arm + norms.offset[link][:3]
        link = before
    return found


def _robot_norms(robot: RobotModel, cells: Cells) -> LinkNorms:
    """Return the jets of the links' motion over cells."""
    # Mimic joints move with the joint that they follow, and from an offset.
    joints = cells.sizes @ np.abs(robot.expansion).T
    joints[0] += np.abs(robot.offset)
    return link_norms(robot.tree, joints)


def _along(cells: Cells, left: Array, right: Array, jets: Array) -> tuple[Array, Array]:
    """Return bounds (C, m) below and above of functions from their values at the ends of cells.

    With jets (3, C, m) a function stays within ``w/2·sup|f'|`` of the mean of its values at the
    ends of a cell of width w, and within ``w²/8·sup|f''|`` of its chord; the tighter holds. The
    same is true above of a seminorm of a vector with those of its derivatives.
    """
    mean, first = 0.5 * (left + right), 0.5 * cells.width * jets[1]
    second = 0.125 * cells.width**2 * jets[2]
    return (
        np.maximum(mean - first, np.minimum(left, right) - second),
        np.minimum(mean + first, np.maximum(left, right) + second),
    )


@dataclass(frozen=True, eq=False)
class TorqueMeasure(CurveMeasure):
    """Sizes of torques, n functions.

    The links' torque is bounded from its values at the ends of cells, and so are the deviations, a
    seminorm of the regressor's rows; friction and rotors by the ranges of velocity and
    acceleration.

    Attributes
    ----------
    model : TorqueModel
        The torques.
    """

    model: TorqueModel

    def nodes(self, curve: Curve, time: Array) -> Array:
        """Return torques of links and of friction, and deviations of both, (K, 4n)."""
        model = self.model
        q, v, a = (curve.evaluate(time, derivative=order) for order in range(3))
        links = model.links(q, v, a)
        friction = model.friction(v, a) + np.abs(links) * model.load * np.sign(v)
        return np.hstack([links, friction, model.link_spread(q, v, a), model.friction_spread(v, a)])

    def values(self, nodes: Array) -> Array:
        """Return the sizes (K, n) with their deviations."""
        links, friction, *spread = np.split(nodes, 4, axis=1)
        return np.abs(links + friction) + spread[0] + spread[1]

    def bounds(self, cells: Cells) -> Array:
        """Return upper bounds (C, n)."""
        model = self.model
        links, spread = self._jets(cells)
        left, right = (np.split(nodes, 4, axis=1) for nodes in (cells.left, cells.right))
        least, most = _along(cells, left[0], right[0], links)
        columns = model.dynamics.terms.enclosed(cells.enclose(1), cells.enclose(2))
        ends = columns[0] * model.coefficients, columns[1] * model.coefficients
        low, high = np.minimum(*ends).sum(axis=2), np.maximum(*ends).sum(axis=2)
        load = model.load * np.maximum(np.abs(least), np.abs(most))
        out = np.maximum(most + high, -(least + low)) + load
        if model.deviations:
            out += _along(cells, left[2], right[2], spread)[1]
            widest = np.maximum(*np.abs(columns)) @ model.friction_deviations
            out += model.deviations * widest
        return np.asarray(out)

    def _jets(self, cells: Cells) -> tuple[Array, Array]:
        """Return jets (3, C, n) of the links' torques, and of their deviations."""
        model, robot = self.model, self.model.robot
        norms = _robot_norms(robot, cells)
        gravity = float(np.linalg.norm(model.model.gravity.linear))
        E = np.abs(robot.expansion)
        links = np.zeros((3, len(cells.start), robot.n))
        spread = np.zeros_like(links)
        for k, (body, deviation) in enumerate(zip(*model.sizes, strict=True), 1):
            links += effort_norms(robot.tree, norms, k, body, gravity) @ E
            if model.deviations:
                own = effort_norms(robot.tree, norms, k, deviation, gravity) @ E
                spread = np.hypot(spread, own) if model.independent else spread + own
        return links, spread


@dataclass(frozen=True, eq=False)
class ToolMeasure(CurveMeasure):
    """Speeds of points that are fixed to links, bounded from those at the ends of cells.

    Attributes
    ----------
    tool : ToolSpeedWithin
        The points.
    """

    tool: ToolSpeedWithin

    def nodes(self, curve: Curve, time: Array) -> Array:
        """Return the speeds, (K, points)."""
        return self.tool.speeds(curve.evaluate(time), curve.evaluate(time, derivative=1))

    def bounds(self, cells: Cells) -> Array:
        """Return upper bounds (C, points)."""
        robot = self.tool.robot
        norms = _robot_norms(robot, cells)
        points = []
        for frame in (robot.pin_model.frames[index] for index in self.tool.frames):
            link, length = frame.parentJoint, float(np.linalg.norm(frame.placement.translation))
            points.append(norms.origin[link] + length * norms.turning[link])
        jets = np.stack(points, axis=2)[1:4]
        return _along(cells, cells.left, cells.right, jets)[1]


@dataclass(frozen=True, eq=False)
class DistanceMeasure(CurveMeasure):
    """Distances of pairs with the sign changed, so that a clearance is an upper limit.

    No distance changes faster than ``Σ_j reach_j·|dq_j/dt|``, whatever the configuration.

    Attributes
    ----------
    collision : CollisionModel
        The pairs.
    """

    collision: CollisionModel

    def nodes(self, curve: Curve, time: Array) -> Array:
        """Return the distances with the sign changed, (K, pairs)."""
        return -self.collision.distances(curve.evaluate(time))

    def bounds(self, cells: Cells) -> Array:
        """Return upper bounds (C, pairs)."""
        rate = cells.largest(1) @ self.collision.reach.T
        middle = 0.5 * (cells.left + cells.right)
        return np.asarray(0.5 * cells.width * rate + middle + self.collision.accuracy)
