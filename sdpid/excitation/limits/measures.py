"""What is held against limits along a curve: motion, torques, speed of the tool, distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.limits.extremes import Cells
from sdpid.excitation.limits.norms import LinkNorms, effort_norms, link_norms
from sdpid.excitation.limits.torque import TorqueModel
from sdpid.experiment.trajectory.curve import Curve
from sdpid.robot.model.model import RobotModel


@dataclass(frozen=True, eq=False)
class PositionMeasure:
    """Positions with a sign, so that lower limits are upper ones as well: n functions.

    Attributes
    ----------
    sign : float
        1 or −1.
    """

    sign: float

    def nodes(self, curve: Curve, time: Array) -> Array:
        """Return positions, (K, n)."""
        return curve.evaluate(time)

    def values(self, nodes: Array) -> Array:
        """Return them with the sign, (K, n)."""
        return self.sign * nodes

    def bounds(self, cells: Cells) -> Array:
        """Return upper bounds (C, n)."""
        lower, upper = cells.enclose(0)
        return upper if self.sign > 0.0 else -lower


@dataclass(frozen=True, eq=False)
class RateMeasure:
    """Sizes of a derivative of the positions, n functions.

    Attributes
    ----------
    derivative : int
        1 for velocities, 2 for accelerations, 3 for jerks.
    """

    derivative: int

    def nodes(self, curve: Curve, time: Array) -> Array:
        """Return the derivative, (K, n)."""
        return curve.evaluate(time, derivative=self.derivative)

    def values(self, nodes: Array) -> Array:
        """Return its sizes, (K, n)."""
        return np.abs(nodes)

    def bounds(self, cells: Cells) -> Array:
        """Return upper bounds (C, n)."""
        return cells.largest(self.derivative)


def along_cells(cells: Cells, left: Array, right: Array, jets: Array) -> tuple[Array, Array]:
    """Return bounds (C, m) below and above of functions from their values at the ends of cells.

    A function stays within ``w/2·sup|f'|`` of the mean of its values at the ends of a cell of
    width w, and within ``w²/8·sup|f''|`` of its chord; the tighter holds. The same is true above
    of a seminorm of a vector with those of its derivatives.

    Parameters
    ----------
    cells : Cells
        The cells.
    left, right : ndarray, shape (C, m)
        Values at the ends.
    jets : ndarray, shape (3, C, m)
        Bounds on the size of the function and its derivatives over each cell.
    """
    mean, first = 0.5 * (left + right), 0.5 * cells.width * jets[1]
    second = 0.125 * cells.width**2 * jets[2]
    return (
        np.maximum(mean - first, np.minimum(left, right) - second),
        np.minimum(mean + first, np.maximum(left, right) + second),
    )


def robot_norms(robot: RobotModel, cells: Cells) -> LinkNorms:
    """Return the jets of the links' motion over cells."""
    # Mimic joints move with the joint that they follow, and from an offset.
    joints = cells.sizes @ np.abs(robot.expansion).T
    joints[0] += np.abs(robot.offset)
    return link_norms(robot.pin_model, joints)


@dataclass(frozen=True, eq=False)
class TorqueMeasure:
    """Sizes of torques, n functions.

    The links' torque is bounded by `along_cells`, and so are the deviations, a seminorm of the
    regressor's rows; friction and rotors by the ranges of velocity and acceleration.

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
        least, most = along_cells(cells, left[0], right[0], links)
        columns = model.dynamics.terms.enclosed(cells.enclose(1), cells.enclose(2))
        ends = columns[0] * model.coefficients, columns[1] * model.coefficients
        low, high = np.minimum(*ends).sum(axis=2), np.maximum(*ends).sum(axis=2)
        load = model.load * np.maximum(np.abs(least), np.abs(most))
        out = np.maximum(most + high, -(least + low)) + load
        if model.deviations:
            out += along_cells(cells, left[2], right[2], spread)[1]
            widest = np.maximum(*np.abs(columns)) @ model.friction_deviations
            out += model.deviations * widest
        return np.asarray(out)

    def _jets(self, cells: Cells) -> tuple[Array, Array]:
        """Return jets (3, C, n) of the links' torques, and of their deviations."""
        model, robot = self.model, self.model.robot
        norms = robot_norms(robot, cells)
        gravity = float(np.linalg.norm(model.model.gravity.linear))
        bodies, deviations = model.sizes
        E = np.abs(robot.expansion)
        links = np.zeros((3, len(cells.start), robot.n))
        spread = np.zeros_like(links)
        for k in range(robot.n_links):
            links += effort_norms(robot.pin_model, norms, k + 1, bodies[k], gravity) @ E
            if model.deviations:
                own = effort_norms(robot.pin_model, norms, k + 1, deviations[k], gravity) @ E
                spread = np.hypot(spread, own) if model.independent else spread + own
        return links, spread


@dataclass(frozen=True, eq=False)
class ToolMeasure:
    """Speeds of points that are fixed to links, bounded by `along_cells`.

    Attributes
    ----------
    robot : RobotModel
        The robot.
    frames : tuple of int
        Indices of the description's frames at the points.
    """

    robot: RobotModel
    frames: tuple[int, ...]

    def nodes(self, curve: Curve, time: Array) -> Array:
        """Return the speeds, (K, points)."""
        import pinocchio as pin

        robot, model = self.robot, self.robot.pin_model
        data, upright = model.createData(), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        positions = robot.configuration(curve.evaluate(time))
        velocities = curve.evaluate(time, derivative=1) @ robot.expansion.T
        out = np.empty((len(time), len(self.frames)))
        for k, (q, v) in enumerate(zip(positions, velocities, strict=True)):
            pin.forwardKinematics(model, data, q, v)
            for c, frame in enumerate(self.frames):
                out[k, c] = np.linalg.norm(pin.getFrameVelocity(model, data, frame, upright).linear)
        return out

    def values(self, nodes: Array) -> Array:
        """Return the speeds."""
        return nodes

    def bounds(self, cells: Cells) -> Array:
        """Return upper bounds (C, points)."""
        norms = robot_norms(self.robot, cells)
        points = []
        for frame in (self.robot.pin_model.frames[index] for index in self.frames):
            link, length = frame.parentJoint, float(np.linalg.norm(frame.placement.translation))
            points.append(norms.origin[link] + length * norms.turning[link])
        jets = np.stack(points, axis=2)[1:4]
        return along_cells(cells, cells.left, cells.right, jets)[1]


@dataclass(frozen=True, eq=False)
class DistanceMeasure:
    """Distances of pairs with the sign changed, so that a clearance is an upper limit.

    No distance changes faster than ``Σ_j reach_j·|dq_j/dt|``, whatever the configuration.

    Attributes
    ----------
    collision : CollisionModel
        The pairs.
    """

    collision: CollisionModel

    def nodes(self, curve: Curve, time: Array) -> Array:
        """Return the distances, (K, pairs)."""
        return self.collision.distances(curve.evaluate(time))

    def values(self, nodes: Array) -> Array:
        """Return them with the sign changed."""
        return -nodes

    def bounds(self, cells: Cells) -> Array:
        """Return upper bounds (C, pairs)."""
        rate = cells.largest(1) @ self.collision.reach.T
        middle = 0.5 * (cells.left + cells.right)
        return np.asarray(0.5 * cells.width * rate - middle + self.collision.accuracy)
