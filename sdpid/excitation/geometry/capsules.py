"""Lower bounds of distances from capsules around the solids, for many positions at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid.excitation.geometry.obstacles import Plane
from sdpid.excitation.geometry.reach import joint_axes
from sdpid.excitation.geometry.solids import Solid
from sdpid.robot.model.model import RobotModel

# Segments whose directions differ by a smaller squared sine count as parallel; what this misses
# of the distance of segments of 1 m is 10 µm.
_PARALLEL = 1e-10
_MISSED = 1e-5


class Capsules:
    """Capsules around solids.

    Parameters
    ----------
    robot : RobotModel
        The robot, on a fixed base.
    solids : sequence of Solid
        Its solids and the obstacles'.
    pairs : ndarray of int, shape (S, 2)
        Indices of two solids; no two planes.
    """

    def __init__(self, robot: RobotModel, solids: Sequence[Solid], pairs: NDArray[np.intp]) -> None:
        self._robot, self._pairs = robot, pairs
        self._joints = np.array([solid.joint for solid in solids], dtype=int)
        fitted = [_capsule(solid) for solid in solids]
        self._ends = np.array([ends for ends, _ in fitted]).reshape(-1, 2, 3)
        self._radii = np.array([radius for _, radius in fitted])
        planes = [solid.shape if isinstance(solid.shape, Plane) else None for solid in solids]
        normals = [plane.normal if plane else (0.0, 0.0, 0.0) for plane in planes]
        self._normals = np.array(normals).reshape(-1, 3)
        self._offsets = np.array(
            [float(np.dot(plane.normal, plane.point)) if plane else 0.0 for plane in planes]
        )
        flat = np.array([plane is not None for plane in planes], dtype=bool)
        self._flat = flat[pairs[:, 1]] if len(pairs) else np.empty(0, dtype=bool)
        model = robot.pin_model
        self._turning, self._sliding = joint_axes(model)
        self._frames = [np.array(M.homogeneous) for M in model.jointPlacements]
        self._parents = [int(parent) for parent in model.parents]
        self._columns = [model.joints[i].idx_v for i in range(model.njoints)]

    def below(self, q: Array) -> Array:
        """Return lower bounds (K, S) of the signed distances at joint positions (K, n)."""
        placements = self._placements(q)[:, self._joints]
        ends = np.einsum("ksij,sej->ksei", placements[..., :3, :3], self._ends)
        ends += placements[..., None, :3, 3]
        out = np.empty((len(q), len(self._pairs)))
        round_, flat = self._pairs[~self._flat].T, self._pairs[self._flat].T
        heights = np.einsum("ksei,si->kse", ends[:, flat[0]], self._normals[flat[1]])
        out[:, self._flat] = heights.min(axis=2) - self._offsets[flat[1]] - self._radii[flat[0]]
        apart = _segments(ends[:, round_[0]], ends[:, round_[1]])
        out[:, ~self._flat] = apart - self._radii[round_].sum(axis=0) - _MISSED
        return out

    def _placements(self, q: Array) -> Array:
        """Return the placements of all joints, the base first, (K, joints, 4, 4)."""
        values = q @ self._robot.expansion.T + self._robot.offset
        out = np.empty((len(q), len(self._frames), 4, 4))
        out[:, 0] = np.eye(4)
        for i in range(1, len(self._frames)):
            own, value = np.tile(np.eye(4), (len(q), 1, 1)), values[:, self._columns[i]]
            x, y, z = self._turning[i]
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            sine, versine = np.sin(value)[:, None, None], 1.0 - np.cos(value)[:, None, None]
            own[:, :3, :3] += sine * cross + versine * (cross @ cross)
            own[:, :3, 3] = value[:, None] * self._sliding[i]
            out[:, i] = out[:, self._parents[i]] @ self._frames[i] @ own
        return out


def _capsule(solid: Solid) -> tuple[Array, float]:
    """Return the ends (2, 3) and the radius of a capsule around a solid, in its joint's frame."""
    points, radius = solid.core
    if not len(points):
        return np.zeros((2, 3)), 0.0
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    axis = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][0]
    along = (points - middle) @ axis
    aside = np.linalg.norm(points - middle - np.outer(along, axis), axis=1)
    # The balls at the ends cover what lies within the radius of them: the ends may move in.
    thick = float(aside.max())
    covered = np.sqrt(np.maximum(thick**2 - aside**2, 0.0))
    lower, upper = (along + covered).min(), (along - covered).max()
    lower, upper = min(lower, upper), max(lower, upper)
    return middle + np.outer([lower, upper], axis), thick + radius


def _segments(first: Array, second: Array) -> Array:
    """Return the distances (…) of segments given by their ends (…, 2, 3) [ericson2005]_."""
    d, e = first[..., 1, :] - first[..., 0, :], second[..., 1, :] - second[..., 0, :]
    r = first[..., 0, :] - second[..., 0, :]
    tiny = np.finfo(np.float64).tiny
    dd, ee = (np.einsum("...i,...i->...", x, x) for x in (d, e))
    de, dr, er = (np.einsum("...i,...i->...", x, y) for x, y in ((d, e), (d, r), (e, r)))
    squared = dd * ee - de**2
    skew = squared > _PARALLEL * dd * ee
    s = np.where(skew, (de * er - dr * ee) / np.where(skew, squared, 1.0), 0.0)
    t = np.clip((de * np.clip(s, 0.0, 1.0) + er) / np.maximum(ee, tiny), 0.0, 1.0)
    s = np.clip((de * t - dr) / np.maximum(dd, tiny), 0.0, 1.0)
    apart = r + s[..., None] * d - t[..., None] * e
    return np.asarray(np.linalg.norm(apart, axis=-1))
