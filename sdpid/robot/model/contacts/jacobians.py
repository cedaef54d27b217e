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

from sdpid._common.arrays import Array, Mask, real_array
from sdpid.errors import DataError
from sdpid.robot.inertia import skew
from sdpid.robot.model.contacts import kernel
from sdpid.robot.model.model import RobotModel


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
    q = _configurations(robot, position)
    points = real_array(offset, "offset", ndim=np.ndim(offset) or 1)
    numbers = _frame_numbers(robot, frames)
    if points.shape not in ((3,), (len(numbers), 3)):
        raise DataError(
            f"offset: has shape {points.shape}, expected (3,) or {(len(numbers), 3)}: x, y, z in m."
        )
    points = np.broadcast_to(points, (len(numbers), 3))
    found = [robot.pin_model.frames[number] for number in numbers]
    at = np.array([frame.parentJoint - 1 for frame in found], dtype=np.intp)
    places = np.array([frame.placement.translation for frame in found])
    quick = kernel.jacobians(robot.tree, at, places, np.ascontiguousarray(points), q, compiled)
    return quick if quick is not None else _by_pinocchio(robot, q, numbers, points)


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


def _configurations(robot: RobotModel, position: ArrayLike) -> Array:
    """Return Pinocchio's configurations (K, nq), a floating base in the origin."""
    q = robot.configuration(position)
    return np.hstack([np.zeros((len(q), 3)), q[:, 3:]]) if robot.free_flyer else q


def _placements(robot: RobotModel, position: ArrayLike, frames: Sequence[str]) -> Array:
    """Return axes and origins of frames, (K, c, 3, 4), a floating base in the origin."""
    import pinocchio as pin

    q = _configurations(robot, position)
    model, numbers = robot.pin_model, _frame_numbers(robot, frames)
    data = model.createData()
    out = np.empty((len(q), len(numbers), 3, 4))
    for k, configuration in enumerate(q):
        pin.forwardKinematics(model, data, configuration)
        for i, number in enumerate(numbers):
            out[k, i] = pin.updateFramePlacement(model, data, number).homogeneous[:3]
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
    """Return the same from Pinocchio, sample by sample."""
    import pinocchio as pin

    model: Any = robot.pin_model
    data, axes = model.createData(), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    out = np.empty((len(q), len(numbers), 6, model.nv))
    for k, configuration in enumerate(q):
        pin.computeJointJacobians(model, data, configuration)
        for i, number in enumerate(numbers):
            pin.updateFramePlacement(model, data, number)
            # With a single joint the binding drops the axis of length one.
            out[k, i] = pin.getFrameJacobian(model, data, number, axes).reshape(6, -1)
    out[:, :, :3] -= skew(points) @ out[:, :, 3:]
    return np.asarray(out @ robot.expansion)
