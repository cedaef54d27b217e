"""Jacobians of contact points, for many samples at once.

Everything is expressed in the world's axes. Where the base is does not matter, only how it is
turned: a Jacobian is made of differences of places.
"""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Mask, real_array, rotation_matrices
from sdpid.errors import DataError
from sdpid.robot.model.contacts import kernel
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.regressor_kernel import FLOATING, PRISMATIC, REVOLUTE, Tree


def contact_jacobians(
    robot: RobotModel,
    position: ArrayLike,
    frames: Sequence[str],
    offset: ArrayLike = (0, 0, 0),
    *,
    compiled: bool | None = None,
) -> Array:
    """Return the velocities of contact points per unit of each coordinate's velocity.

    Their transposes map forces and moments on the robot at these points to efforts:
    ``Y @ theta = effort + Σ_i J_i^T·f_i``.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    position : array_like, shape (K, n) or (K, nq)
        Joint positions; configurations with a floating base, whose velocity is in its own frame.
    frames : sequence of str
        Names of frames of the robot, c in all.
    offset : (3,) or (c, 3) array_like, optional
        Contact points relative to the frames' origins in the world's axes, m.
    compiled : bool, optional
        Whether to use the compiled loop: of a log's blocks all or none. By default the size
        decides.

    Returns
    -------
    ndarray, shape (K, c, 6, n)
        Linear velocity of the point first, then angular velocity, in the world's axes.

    Raises
    ------
    DataError
        When a frame is not one of the robot's, or a shape does not fit.

    Examples
    --------
    >>> from sdpid.robot.model.contacts.jacobians import contact_jacobians
    >>> contact_jacobians(robot, samples.position, ["link_6"]).shape
    (1000, 1, 6, 6)
    """
    q = robot.configuration(position)
    points = real_array(offset, "offset", ndim=np.ndim(offset) or 1)
    numbers = _frame_numbers(robot, frames)
    if points.shape not in ((3,), (len(numbers), 3)):
        raise DataError(
            f"offset: has shape {points.shape}, expected (3,) or {(len(numbers), 3)}: x, y, z in m."
        )
    points = np.broadcast_to(points, (len(numbers), 3))
    tree = robot.tree
    if tree is None:
        return _by_pinocchio(robot, q, numbers, points)
    found = [robot.pin_model.frames[number] for number in numbers]
    at = np.array([frame.parentJoint - 1 for frame in found], dtype=np.intp)
    places = np.array([frame.placement.translation for frame in found])
    quick = kernel.jacobians(tree, at, places, np.ascontiguousarray(points), q, compiled)
    if quick is not None:
        return quick
    out = np.zeros((len(q), len(numbers), 6, robot.n))
    links = _Links(tree, q)
    for i, (number, point) in enumerate(zip(numbers, points, strict=True)):
        _fill(out[:, i], tree, links, robot.pin_model.frames[number], point)
    return out


def relative_jacobians(
    robot: RobotModel,
    position: ArrayLike,
    frames: Sequence[str],
    against: Sequence[str | None],
    offset: ArrayLike = (0, 0, 0),
    *,
    compiled: bool | None = None,
) -> Array:
    """Return `contact_jacobians` of frames less those of the frames that they touch.

    Of two links that touch, coordinates that carry both move neither against the other, and are
    zero: also where the two places are a little apart, as a filter of positions leaves them.

    Parameters
    ----------
    against : sequence of (str or None)
        The robot's other frame at each contact; None for the surroundings.
    """
    J = contact_jacobians(robot, position, frames, offset, compiled=compiled)
    pairs = [(i, other) for i, other in enumerate(against) if other is not None]
    if pairs:
        which, others = zip(*pairs, strict=True)
        at = np.broadcast_to(np.asarray(offset, dtype=np.float64), (len(frames), 3))[list(which)]
        J[:, which] -= contact_jacobians(robot, position, others, at, compiled=compiled)
        for i, other in pairs:
            J[:, i][..., carrying_both(robot, frames[i], other)] = 0.0
    return J


def carrying_both(robot: RobotModel, frame: str, other: str) -> Mask:
    """Return which coordinates move the links of two frames by the same joints only, (n,)."""
    model: Any = robot.pin_model
    links = [model.frames[number].parentJoint for number in _frame_numbers(robot, (frame, other))]
    apart = set(model.supports[links[0]]) ^ set(model.supports[links[1]])
    moving = np.zeros(robot.n, dtype=np.bool_)
    for joint in apart:
        first = model.joints[joint].idx_v
        moving |= np.any(robot.expansion[first : first + model.joints[joint].nv] != 0.0, axis=0)
    return ~moving


def frame_gaps(
    robot: RobotModel, position: ArrayLike, frames: Sequence[str], others: Sequence[str]
) -> Array:
    """Return how far the origins of frames are from those of other ones, shape (K, c), in m."""
    return np.asarray(np.linalg.norm(frame_offsets(robot, position, frames, others), axis=2))


def frame_offsets(
    robot: RobotModel, position: ArrayLike, frames: Sequence[str], others: Sequence[str]
) -> Array:
    """Return origins of frames less those of other ones, shape (K, c, 3), in m and world axes."""
    q = robot.configuration(position)
    numbers = [_frame_numbers(robot, names) for names in (frames, others)]
    tree = robot.tree
    if tree is None:
        import pinocchio as pin

        model: Any = robot.pin_model
        data = model.createData()
        out = np.empty((len(q), len(frames), 3))
        for k, configuration in enumerate(q):
            pin.framesForwardKinematics(model, data, configuration)
            places = [np.array([data.oMf[i].translation for i in own]) for own in numbers]
            out[k] = places[0] - places[1]
        return out
    links = _Links(tree, q)
    own, other = (
        np.stack([_place(links, robot.pin_model.frames[i]) for i in each], axis=1)
        for each in numbers
    )
    return np.asarray(own - other)


def frame_places(robot: RobotModel, position: ArrayLike, frames: Sequence[str]) -> Array:
    """Return the origins of frames from that of the robot, world axes, shape (K, c, 3), in m.

    Of a floating base that is the base's origin.
    """
    q = robot.configuration(position)
    numbers = _frame_numbers(robot, frames)
    tree = robot.tree
    if tree is None:
        import pinocchio as pin

        model: Any = robot.pin_model
        data = model.createData()
        out = np.empty((len(q), len(numbers), 3))
        for k, configuration in enumerate(q):
            pin.framesForwardKinematics(model, data, configuration)
            out[k] = [data.oMf[number].translation for number in numbers]
        return out - q[:, None, :3] if robot.free_flyer else out
    links = _Links(tree, q)
    return np.stack([_place(links, robot.pin_model.frames[i]) for i in numbers], axis=1)


def frame_axes(robot: RobotModel, position: ArrayLike, frames: Sequence[str]) -> Array:
    """Return the axes of frames in the world's, as columns, shape (K, c, 3, 3)."""
    q = robot.configuration(position)
    numbers = _frame_numbers(robot, frames)
    out = np.empty((len(q), len(numbers), 3, 3))
    tree = robot.tree
    if tree is None:
        import pinocchio as pin

        model: Any = robot.pin_model
        data = model.createData()
        for k, configuration in enumerate(q):
            pin.framesForwardKinematics(model, data, configuration)
            out[k] = [data.oMf[number].rotation for number in numbers]
        return out
    links = _Links(tree, q)
    for i, number in enumerate(numbers):
        frame = robot.pin_model.frames[number]
        R = links.turned(frame.parentJoint - 1)
        out[:, i] = R @ np.array(frame.placement.rotation)
    return out


class _Links:
    """How links are turned and where they are relative to the base, as far as it is asked for."""

    def __init__(self, tree: Tree, q: Array) -> None:
        self._tree, self._q = tree, q
        self._found: dict[int, tuple[Array, Array]] = {}

    def turned(self, link: int) -> Array:
        """Return the rotation of a link (K, 3, 3); the world for -1."""
        return self._at(link)[0]

    def place(self, link: int) -> Array:
        """Return the origin of a link, (K, 3)."""
        return self._at(link)[1]

    def _at(self, link: int) -> tuple[Array, Array]:
        if link not in self._found:
            self._found[link] = self._moved(link)
        return self._found[link]

    def _moved(self, link: int) -> tuple[Array, Array]:
        tree, q = self._tree, self._q
        if link < 0:
            return np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
        at = tree.first_q[link]
        own, way = tree.turn[link], tree.place[link]
        if tree.kind[link] == FLOATING:
            return own[2] @ rotation_matrices(q[:, at + 3 : at + 7]), np.zeros((len(q), 3))
        before, origin = self._at(int(tree.parent[link]))
        if tree.kind[link] == PRISMATIC:
            return before @ own[2], origin + (
                before @ (way[0] + way[1] * q[:, at, None])[:, :, None]
            )[:, :, 0]
        unbounded = tree.unbounded[link]
        x = q[:, at] if unbounded else np.cos(q[:, at])
        y = q[:, at + 1] if unbounded else np.sin(q[:, at])
        turn = own[0] * x[:, None, None] + own[1] * y[:, None, None] + own[2]
        return before @ turn, origin + before @ way[0]


def _fill(out: Array, tree: Tree, links: _Links, frame: Any, offset: Array) -> None:
    """Write the Jacobian (K, 6, n) of a point; the columns that do not move it stay as they are."""
    link = frame.parentJoint - 1
    point = _place(links, frame) + offset
    while link >= 0:
        R, arm = links.turned(link), point - links.place(link)
        first = int(tree.first_v[link])
        if tree.kind[link] == FLOATING:
            columns = tree.column[first : first + 6]
            out[:, :3, columns[:3]] = R
            out[:, 3:, columns[3:]] = R
            for j in range(3):
                out[:, :3, columns[3 + j]] = _cross(R[:, :, j], arm)
        else:
            axis = R @ tree.axis[link]
            column, factor = tree.column[first], tree.factor[first]
            if tree.kind[link] == REVOLUTE:
                out[:, :3, column] += factor * _cross(axis, arm)
                out[:, 3:, column] += factor * axis
            else:
                out[:, :3, column] += factor * axis
        link = int(tree.parent[link])


def _place(links: _Links, frame: Any) -> Array:
    """Return the origin of a frame, (K, 3)."""
    link = frame.parentJoint - 1
    turned = links.turned(link) @ np.array(frame.placement.translation)
    return np.asarray(turned + links.place(link))


def _cross(a: Array, b: Array) -> Array:
    """Return cross products (K, 3), several times as fast as NumPy's."""
    out = np.empty_like(a)
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    out[:, 0] = ay * bz - az * by
    out[:, 1] = az * bx - ax * bz
    out[:, 2] = ax * by - ay * bx
    return out


def _frame_numbers(robot: RobotModel, frames: Sequence[str]) -> list[int]:
    """Return the numbers of frames in Pinocchio's model.

    Raises
    ------
    DataError
        When one is not the robot's.
    """
    known = robot.frame_numbers
    for name in frames:
        if name not in known:
            near = get_close_matches(name, known)
            raise DataError(
                f"contacts: '{name}' is no frame of the robot '{robot.name}'; "
                + (f"near to it are {', '.join(near)}." if near else f"it has {', '.join(known)}.")
            )
    return [known[name] for name in frames]


def _by_pinocchio(robot: RobotModel, q: Array, numbers: Sequence[int], points: Array) -> Array:
    """Return the same from Pinocchio, sample by sample, for joints that are not covered above."""
    import pinocchio as pin

    model: Any = robot.pin_model
    data = model.createData()
    out = np.empty((len(q), len(numbers), 6, model.nv))
    for k, configuration in enumerate(q):
        pin.computeJointJacobians(model, data, configuration)
        pin.updateFramePlacements(model, data)
        for i, number in enumerate(numbers):
            out[k, i] = pin.getFrameJacobian(
                model, data, number, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )
    out[:, :, :3] -= np.einsum("cij,kcjn->kcin", _skew(points), out[:, :, 3:])
    return np.asarray(out @ robot.expansion)


def _skew(vectors: Array) -> Array:
    """Return the matrices of cross products, (c, 3, 3)."""
    out = np.zeros((len(vectors), 3, 3))
    out[:, 0, 1], out[:, 1, 0] = -vectors[:, 2], vectors[:, 2]
    out[:, 2, 0], out[:, 0, 2] = -vectors[:, 1], vectors[:, 1]
    out[:, 1, 2], out[:, 2, 1] = -vectors[:, 0], vectors[:, 0]
    return out
