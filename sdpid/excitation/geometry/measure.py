"""Distances between solids, their witness points and gradients, by Pinocchio and Coal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.errors import SolverError
from sdpid.excitation.geometry.solids import Solid
from sdpid.robot.model.model import RobotModel


# No distance is larger, m: Coal returns the largest number there is where its iteration fails.
_LARGEST = 1e6


class Measure:
    """Signed distances between bodies: negative by the depth where they overlap.

    Parameters
    ----------
    robot : RobotModel
        The robot, on a fixed base.
    solids : sequence of Solid
        Solids of links and obstacles.
    pairs : sequence of (str, str)
        Names of bodies.
    """

    def __init__(
        self, robot: RobotModel, solids: Sequence[Solid], pairs: Sequence[tuple[str, str]]
    ) -> None:
        import pinocchio as pin

        self._robot, self._count = robot, len(pairs)
        self._model, self._data = robot.pin_model, robot.pin_model.createData()
        self._geometry = pin.GeometryModel()
        wanted = {name for pair in pairs for name in pair}
        objects: dict[str, list[int]] = {name: [] for name in wanted}
        for number, solid in enumerate(solids):
            if solid.body in wanted:
                geometry, placement = solid.geometry()
                item = pin.GeometryObject(
                    f"{solid.body} {number}", solid.joint, pin.SE3(placement), geometry
                )
                objects[solid.body].append(self._geometry.addGeometryObject(item))
        joint_of = {solid.body: solid.joint for solid in solids}
        owners = []
        for p, (first, second) in enumerate(pairs):
            for i in objects[first]:
                for j in objects[second]:
                    self._geometry.addCollisionPair(pin.CollisionPair(i, j))
                    owners.append(p)
        # Where the solids of each pair of bodies begin; every body has a solid.
        self._starts: Indices = np.searchsorted(owners, np.arange(self._count)).astype(np.intp)
        self._simple = len(owners) == self._count
        self._found = self._geometry.createData()
        self._results = list(self._found.distanceResults)
        ends = [[joint_of[name] for name in pair] for pair in pairs]
        self._moves = _supports(self._model, ends)

    def distances(self, configurations: Array) -> Array:
        """Return the distances (K, P) at Pinocchio's configurations (K, nq)."""
        import pinocchio as pin

        out = np.empty((len(configurations), len(self._results)))
        if not self._count:
            return out
        for k, q in enumerate(configurations):
            pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._found, q)
            pin.computeDistances(self._geometry, self._found)
            out[k] = [result.min_distance for result in self._results]
        _check(out)
        return out if self._simple else np.minimum.reduceat(out, self._starts, axis=1)

    def gradients(self, configurations: Array) -> tuple[Array, Array]:
        """Return the distances (K, P) and their derivatives (K, P, n)."""
        import pinocchio as pin

        K, P = len(configurations), self._count
        out, normals = np.empty((K, P)), np.empty((K, P, 3))
        points = np.empty((2, K, P, 3))
        jacobians = np.empty((K, 6, self._model.nv))
        if not P:
            return out, np.empty((K, P, self._robot.n))
        for k, q in enumerate(configurations):
            pin.computeJointJacobians(self._model, self._data, q)
            pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._found)
            pin.computeDistances(self._geometry, self._found)
            jacobians[k] = self._data.J
            nearest = self._nearest()
            out[k] = [result.min_distance for result in nearest]
            normals[k] = [result.normal for result in nearest]
            points[0, k] = [result.getNearestPoint1() for result in nearest]
            points[1, k] = [result.getNearestPoint2() for result in nearest]
        _check(out)
        # Meshes that are no hulls have no normal; the way between the nearest points is one.
        unknown = ~np.isfinite(normals).all(axis=2)
        normals[unknown] = (points[1] - points[0])[unknown]
        normals[unknown] /= np.linalg.norm(normals[unknown], axis=1, keepdims=True)
        gradient = np.zeros((K, P, self._model.nv))
        for moves, at, sign in zip(self._moves, points, (-1.0, 1.0), strict=True):
            # The speed of a point along the normal: n·(v + w × x) = n·v + w·(x × n).
            speed = normals @ jacobians[:, :3] + np.cross(at, normals) @ jacobians[:, 3:]
            gradient += sign * speed * moves
        return out, gradient @ self._robot.expansion

    def _nearest(self) -> list[Any]:
        """Return the result of the nearest solids of each pair of bodies."""
        if self._simple:
            return self._results
        found = [result.min_distance for result in self._results]
        ends = [*self._starts[1:], len(found)]
        return [
            self._results[min(range(start, end), key=found.__getitem__)]
            for start, end in zip(self._starts, ends, strict=True)
        ]


def _check(distances: Array) -> None:
    failed = ~(np.abs(distances) < _LARGEST)
    if failed.any():
        raise SolverError(
            f"{np.count_nonzero(failed)} of {distances.size} distances were not found by Coal, the "
            f"first of sample {int(np.argwhere(failed)[0, 0])}; simplify the meshes, or name the "
            "pairs to ignore."
        )


def _supports(model: Any, ends: Sequence[Sequence[int]]) -> Array:
    """Return which joint velocities move only the first or only the second body, (2, P, nv)."""
    out = np.zeros((2, len(ends), model.nv))
    for p, pair in enumerate(ends):
        for side, joint in enumerate(pair):
            while joint:
                out[side, p, model.joints[joint].idx_v] = 1.0
                joint = model.parents[joint]
    return np.asarray(out * (out.sum(axis=0) == 1.0))
