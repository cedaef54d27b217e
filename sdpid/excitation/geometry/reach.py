"""How far a joint's motion can carry a body: bounds that hold at every position.

A ball holds all places that a body can take as seen from a joint's frame. It goes from joint to
joint along the way between two bodies: turning about an axis turns the ball into a wider one that
is centered on the axis, sliding stretches it. The farthest that the ball reaches from the next
joint's axis is the largest speed that any point of the body gets per unit of that joint's speed.

With A and B the bodies, the signed distance between convex sets is the largest
``−h_A(u) − h_B(−u)`` over unit vectors u, h their support functions; moving no point of B farther
than s changes it by at most s. So its rate is at most the sum over the joints between A and B of
reach times speed, where it is the same to move B with A at rest and A with B at rest: the shorter
of both reaches holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.geometry.solids import Solid
from sdpid.robot.model.jacobians import local_jacobian
from sdpid.robot.model.model import RobotModel

Ball = tuple[Array, float]
Core = tuple[Array, float]


def joint_axes(robot_model: Any) -> tuple[Array, Array]:
    """Return the directions of turning and of sliding in the joints' own frames, (joints, 3)."""
    import pinocchio as pin

    data = robot_model.createData()
    pin.computeJointJacobians(robot_model, data, pin.neutral(robot_model))
    turning, sliding = np.zeros((2, robot_model.njoints, 3))
    for i in range(1, robot_model.njoints):
        column = local_jacobian(robot_model, data, i)[:, robot_model.joints[i].idx_v]
        sliding[i], turning[i] = column[:3], column[3:]
    return turning, sliding


def way(robot_model: Any, first: int, second: int) -> tuple[list[int], list[int]]:
    """Return the joints from one body up to the common ancestor, and from there to the other."""
    up, down = (list(robot_model.supports[joint])[:0:-1] for joint in (first, second))
    common = set(up) & set(down)
    return [j for j in up if j not in common], [j for j in reversed(down) if j not in common]


class _Reaches:
    """Bounds on the speed of distances per unit of each joint's speed."""

    def __init__(self, robot: RobotModel, bounds: Array) -> None:
        self._model, expansion = robot.pin_model, robot.expansion
        self._placements = [np.array(M.homogeneous) for M in self._model.jointPlacements]
        self._turning, self._sliding = joint_axes(self._model)
        # Limits of Pinocchio's joints from those of the coordinates; those of sliding ones count.
        self._range = np.tile(robot.offset, (2, 1))
        for column in range(robot.n):
            rows = np.flatnonzero(expansion[:, column])
            ends = np.multiply.outer(bounds[:, column], expansion[rows, column])
            self._range[:, rows] += np.sort(ends, axis=0)

    def between(self, first: int, cores: list[Core], second: int, others: list[Core]) -> Array:
        """Return the bounds (nv,) for two bodies, given by joints and cores (`Solid.core`)."""
        up, down = way(self._model, first, second)
        out = np.zeros(self._model.nv)
        there = self._along(up, down, cores)
        back = self._along(down[::-1], up[::-1], others)
        for joint in (*up, *down):
            out[self._model.joints[joint].idx_v] = min(there[joint], back[joint])
        return out

    def _along(self, up: list[int], down: list[int], cores: list[Core]) -> dict[int, float]:
        """Return for each joint on the way how far the body's points can be from its axis."""
        out = dict.fromkeys((*up, *down), 0.0)
        for points, radius in cores:
            if not len(points):
                return dict.fromkeys(out, np.inf)
            ball = _ball(points, radius)
            for k, joint in enumerate(up):
                exact = (points, radius) if k == 0 else None
                out[joint] = max(out[joint], self._distance(joint, ball, exact))
                ball = _placed(self._placements[joint], self._swept(joint, ball, 1.0))
            for joint in down:
                ball = _placed(np.linalg.inv(self._placements[joint]), ball)
                out[joint] = max(out[joint], self._distance(joint, ball, None))
                ball = self._swept(joint, ball, -1.0)
        return out

    def _distance(self, joint: int, ball: Ball, exact: Core | None) -> float:
        """Return the farthest from an axis, or one for a sliding joint."""
        axis = self._turning[joint]
        if not axis.any():
            return 1.0
        points, radius = (ball[0][None], ball[1]) if exact is None else exact
        return float(np.linalg.norm(np.cross(points, axis), axis=1).max()) + radius

    def _swept(self, joint: int, ball: Ball, sign: float) -> Ball:
        """Return a ball about all places of a ball that moves with a joint."""
        center, radius = ball
        axis = self._turning[joint]
        if axis.any():
            on_axis = (center @ axis) * axis
            return on_axis, radius + float(np.linalg.norm(center - on_axis))
        lower, upper = self._range[:, self._model.joints[joint].idx_v]
        if not np.isfinite([lower, upper]).all():
            return center, np.inf
        return (
            center + sign * 0.5 * (lower + upper) * self._sliding[joint],
            radius + 0.5 * (upper - lower),
        )


def pair_reaches(
    robot: RobotModel, solids: Sequence[Solid], pairs: Sequence[tuple[str, str]], bounds: Array
) -> Array:
    """Return the bounds (P, n) for pairs of bodies, given limits (2, n) of the coordinates."""
    reaches = _Reaches(robot, bounds)
    cores: dict[str, list[Core]] = {}
    for solid in solids:
        cores.setdefault(solid.body, []).append(solid.core)
    joint = {solid.body: solid.joint for solid in solids}
    out = np.zeros((len(pairs), robot.pin_model.nv))
    for p, (first, second) in enumerate(pairs):
        out[p] = reaches.between(joint[first], cores[first], joint[second], cores[second])
    return np.asarray(out @ np.abs(robot.expansion))


def _ball(points: Array, radius: float) -> Ball:
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return center, float(np.linalg.norm(points - center, axis=1).max()) + radius


def _placed(placement: Array, ball: Ball) -> Ball:
    return placement[:3, :3] @ ball[0] + placement[:3, 3], ball[1]
