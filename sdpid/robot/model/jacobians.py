"""Jacobians of contact points and of links, for many samples at once.

Those of contacts are expressed in the world's axes. Where the base is does not matter, only how it
is turned: a Jacobian is made of differences of places.

Velocities of links are (angular, linear) in the frame of each link, at its origin, so that the
kinetic energy of a link is half ``V^T·I·V`` with the 6×6 spatial inertia of `sdpid.robot.inertia`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Indices, Mask, real_array
from sdpid.errors import DataError
from sdpid.robot.inertia import skew
from sdpid.robot.model.model import RobotModel, each_state
from sdpid.robot.model.regressor_kernel import (
    FLOATING,
    NOTHING,
    PRISMATIC,
    compiled_loop,
    four,
    joints_at,
)

# From Pinocchio's (linear, angular) to (angular, linear).
_ANGULAR_FIRST = np.array([3, 4, 5, 0, 1, 2])
# Bytes from which on Numba is loaded for them: searches ask again and again, and in all take eight
# times as long without it.
_SMALL = 1 << 20


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
    >>> from sdpid.robot.model.jacobians import contact_jacobians
    >>> contact_jacobians(robot, samples.position, ["link_6"]).shape
    (1000, 1, 6, 6)
    """
    q = _configurations(robot, position)
    points = real_array(offset, "offset", ndim=np.ndim(offset) or 1)
    numbers = _frame_numbers(robot, frames)
    if points.shape not in ((3,), (len(numbers), 3)):
        raise DataError(
            f"offset: has shape {points.shape}, expected (3,) or {(len(numbers), 3)}: x, y, z in m."
        )
    points = np.broadcast_to(points, (len(numbers), 3))
    shape = (len(q), len(numbers), 6, robot.n)
    many = 8 * math.prod(shape) >= _SMALL if compiled is None else compiled
    fill = _jacobian_loop() if many else None
    if fill is None:
        return _by_pinocchio(robot, q, numbers, points)
    out, found = np.zeros(shape), [robot.pin_model.frames[number] for number in numbers]
    links = np.array([frame.parentJoint - 1 for frame in found], dtype=np.intp)
    places = np.array([frame.placement.translation for frame in found])
    fill(robot.tree, links, places, *map(np.ascontiguousarray, (points, q)), out)
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
    robot, position, frames, offset, compiled
        As for `contact_jacobians`.
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
    places = _placements(robot, position, [*frames, *others])[..., 3]
    return np.asarray(places[:, : len(frames)] - places[:, len(frames) :])


def frame_places(robot: RobotModel, position: ArrayLike, frames: Sequence[str]) -> Array:
    """Return the origins of frames from that of the robot, world axes, shape (K, c, 3), in m.

    Of a floating base that is the base's origin.
    """
    return _placements(robot, position, frames)[..., 3]


def frame_axes(robot: RobotModel, position: ArrayLike, frames: Sequence[str]) -> Array:
    """Return the axes of frames in the world's, as columns, shape (K, c, 3, 3)."""
    return np.ascontiguousarray(_placements(robot, position, frames)[..., :3])


def link_jacobians(robot: RobotModel, q: ArrayLike) -> Array:
    """Return the velocities of the links per unit of each coordinate's velocity.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    q : array_like, shape (K, n)
        Joint positions; with a floating base those of the joints only, (K, n − 6).

    Returns
    -------
    ndarray, shape (K, links, 6, n)
    """
    import pinocchio as pin

    def jacobians(model: Any, data: Any, q: Array) -> list[Array]:
        pin.computeJointJacobians(model, data, q)
        return [local_jacobian(model, data, i) for i in range(1, model.njoints)]

    shape = robot.n_links, 6, robot.pin_model.nv
    out = each_state(jacobians, robot.pin_model, shape, robot.at_rest(q))
    return np.asarray(out[:, :, _ANGULAR_FIRST] @ robot.expansion)


def joint_rates(robot: RobotModel) -> Array:
    """Return the matrix N (nv, 6·links) that maps link velocities to joint velocities.

    A joint's velocity is the component along its axis of what its link moves relative to the link
    before, ``S^T·(V − X·V_before)``. Turning the joint does not change its axis, in either frame,
    so N does not depend on the position. Coordinates are those of Pinocchio's joints.
    """
    import pinocchio as pin

    model: Any = robot.pin_model
    data = model.createData()
    q = pin.neutral(model)
    pin.computeJointJacobians(model, data, q)
    out = np.zeros((model.nv, 6 * robot.n_links))
    for i in range(1, model.njoints):
        joint = model.joints[i]
        columns = slice(joint.idx_v, joint.idx_v + joint.nv)
        S = local_jacobian(model, data, i)[_ANGULAR_FIRST, columns]
        out[columns, 6 * i - 6 : 6 * i] = S.T
        before = model.parents[i]
        if before > 0:
            # Action on motions from the frame before to this one, angular first.
            X = data.oMi[i].actInv(data.oMi[before]).action
            X = X[np.ix_(_ANGULAR_FIRST, _ANGULAR_FIRST)]
            out[columns, 6 * before - 6 : 6 * before] = -S.T @ X
    return out


def local_jacobian(model: Any, data: Any, joint: int) -> Array:
    """Return the Jacobian (6, nv) of a joint's frame, linear first, of Jacobians in `data`."""
    import pinocchio as pin

    # With a single joint the binding drops the axis of length one.
    found = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL)
    return np.asarray(found).reshape(6, -1)


def _configurations(robot: RobotModel, position: ArrayLike) -> Array:
    """Return Pinocchio's configurations (K, nq), a floating base in the origin."""
    q = robot.configuration(position)
    return np.hstack([np.zeros((len(q), 3)), q[:, 3:]]) if robot.free_flyer else q


def _placements(robot: RobotModel, position: ArrayLike, frames: Sequence[str]) -> Array:
    """Return axes and origins of frames, (K, c, 3, 4), a floating base in the origin."""
    import pinocchio as pin

    numbers = _frame_numbers(robot, frames)

    def placed(model: Any, data: Any, q: Array) -> list[Array]:
        pin.forwardKinematics(model, data, q)
        at = (pin.updateFramePlacement(model, data, number) for number in numbers)
        return [place.homogeneous[:3] for place in at]

    q = _configurations(robot, position)
    return each_state(placed, robot.pin_model, (len(numbers), 3, 4), q)


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
    """Return the same from Pinocchio, sample by sample."""
    import pinocchio as pin

    def jacobians(model: Any, data: Any, q: Array) -> list[Array]:
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        return [pin.getFrameJacobian(model, data, k, pin.LOCAL_WORLD_ALIGNED) for k in numbers]

    shape = len(numbers), 6, robot.pin_model.nv
    out = each_state(jacobians, robot.pin_model, shape, q)
    out[:, :, :3] -= skew(points) @ out[:, :, 3:]
    return np.asarray(out @ robot.expansion)


@functools.cache
def _jacobian_loop() -> Callable[..., None] | None:
    """Return the compiled loop over Jacobians."""
    index, points = np.zeros(0, dtype=np.intp), np.zeros((0, 3))
    return compiled_loop(
        _fill, NOTHING, index, points, points, np.zeros((0, 0)), np.zeros((0, 0, 6, 0))
    )


def _fill(tree: Any, links: Indices, places: Array, offsets: Array, q: Array, out: Array) -> None:
    """Write the Jacobians; `out` holds zeros. Written for a compiler."""
    kind, parent, first_v, axis = tree.kind, tree.parent, tree.first_v, tree.axis
    column, factor, count = tree.column, tree.factor, len(tree.kind)
    # Frames of joints in their parents', and made of them in the world's, a link after another.
    S, R, o = np.zeros((count, 3, 4)), np.zeros((count, 3, 4)), np.zeros((count, 3))
    unit = np.eye(3)
    for k in range(len(q)):
        joints_at(tree, q, k, S, o)
        for i in range(count):
            p, x, y, z = parent[i], o[i, 0], o[i, 1], o[i, 2]
            for a in range(3):
                if p < 0:
                    R[i, a, 0], R[i, a, 1], R[i, a, 2] = S[i, a, 0], S[i, a, 1], S[i, a, 2]
                    continue
                u, v, w = R[p, a, 0], R[p, a, 1], R[p, a, 2]
                R[i, a, 0], R[i, a, 1], R[i, a, 2], _ = four(S[i], 0, u, v, w)
                o[i, a] = o[p, a] + u * x + v * y + w * z
        for f in range(len(links)):
            i = links[f]
            if i < 0:
                continue
            px, py, pz = places[f, 0], places[f, 1], places[f, 2]
            tx = o[i, 0] + R[i, 0, 0] * px + R[i, 0, 1] * py + R[i, 0, 2] * pz + offsets[f, 0]
            ty = o[i, 1] + R[i, 1, 0] * px + R[i, 1, 1] * py + R[i, 1, 2] * pz + offsets[f, 1]
            tz = o[i, 2] + R[i, 2, 0] * px + R[i, 2, 1] * py + R[i, 2, 2] * pz + offsets[f, 2]
            while i >= 0:
                rx, ry, rz = tx - o[i, 0], ty - o[i, 1], tz - o[i, 2]
                floats = kind[i] == FLOATING
                for j in range(6 if floats else 1):
                    s = unit[j % 3] if floats else axis[i]
                    sx, sy, sz = s[0], s[1], s[2]
                    ax = R[i, 0, 0] * sx + R[i, 0, 1] * sy + R[i, 0, 2] * sz
                    ay = R[i, 1, 0] * sx + R[i, 1, 1] * sy + R[i, 1, 2] * sz
                    az = R[i, 2, 0] * sx + R[i, 2, 1] * sy + R[i, 2, 2] * sz
                    slides = kind[i] == PRISMATIC or (floats and j < 3)
                    for w in range(column.shape[1]):
                        c, h = factor[first_v[i] + j, w], column[first_v[i] + j, w]
                        if slides:
                            out[k, f, 0, h] += c * ax
                            out[k, f, 1, h] += c * ay
                            out[k, f, 2, h] += c * az
                        else:
                            out[k, f, 0, h] += c * (ay * rz - az * ry)
                            out[k, f, 1, h] += c * (az * rx - ax * rz)
                            out[k, f, 2, h] += c * (ax * ry - ay * rx)
                            out[k, f, 3, h] += c * ax
                            out[k, f, 4, h] += c * ay
                            out[k, f, 5, h] += c * az
                i = parent[i]
