"""Distances between solids, their witness points and gradients, by Pinocchio and Coal."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.errors import SolverError
from sdpid.excitation.geometry.capsules import Capsules
from sdpid.excitation.geometry.solids import Solid
from sdpid.robot.model.model import RobotModel

# No distance is larger, m: Coal returns the largest number there is where its iteration fails.
_LARGEST = 1e6


# Signed distance, normal from the first to the second, nearest points of both.
Witness = tuple[float, Array, Array, Array]


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

        self.robot, self._count = robot, len(pairs)
        self._model, self._data = robot.pin_model, robot.pin_model.createData()
        self._geometry = pin.GeometryModel()
        objects: dict[str, list[int]] = {name: [] for pair in pairs for name in pair}
        chosen = [solid for solid in solids if solid.body in objects]
        for number, solid in enumerate(chosen):
            geometry, placement = solid.geometry
            item = pin.GeometryObject(f"{number}", solid.joint, pin.SE3(placement), geometry)
            objects[solid.body].append(self._geometry.addGeometryObject(item))
        parts = [
            (p, i, j)
            for p, (first, second) in enumerate(pairs)
            for i in objects[first]
            for j in objects[second]
        ]
        for _, i, j in parts:
            self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        self.solids = tuple(chosen)
        self.owners: Indices = np.array([p for p, _, _ in parts], dtype=np.intp)
        self.parts: Indices = np.array([part[1:] for part in parts], dtype=np.intp).reshape(-1, 2)
        # Where the solids of each pair of bodies begin; every body has a solid.
        self._starts = np.searchsorted(self.owners, np.arange(self._count))
        self._found = self._geometry.createData()
        self._results = list(self._found.distanceResults)
        joint_of = {solid.body: solid.joint for solid in chosen}
        self._moves = _supports(self._model, [[joint_of[name] for name in pair] for pair in pairs])

    @cached_property
    def capsules(self) -> Capsules:
        """Capsules around the solids, for bounds on the distances of `parts`."""
        return Capsules(self.robot, self.solids, self.parts)

    def distances(self, q: Array) -> Array:
        """Return the distances (K, P) at joint positions (K, n)."""
        import pinocchio as pin

        found = np.empty((len(q), len(self._results)))
        if not self._count:
            return found
        for k, configuration in enumerate(self.robot.configuration(q)):
            pin.updateGeometryPlacements(
                self._model, self._data, self._geometry, self._found, configuration
            )
            pin.computeDistances(self._geometry, self._found)
            found[k] = [result.min_distance for result in self._results]
        _check(found)
        return np.minimum.reduceat(found, self._starts, axis=1)

    def place(self, configuration: Array) -> Array:
        """Put everything in its place at a configuration (nq,); return the Jacobian (6, nv)."""
        import pinocchio as pin

        pin.computeJointJacobians(self._model, self._data, configuration)
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._found)
        return np.reshape(self._data.J, (6, -1))

    def part(self, part: int) -> Any:
        """Return Coal's result of one of the pairs of solids (`parts`) where they are placed."""
        import pinocchio as pin

        return pin.computeDistance(self._geometry, self._found, part)

    def derivatives(
        self, found: Sequence[Witness], jacobians: Array, samples: Indices, pairs: Indices
    ) -> tuple[Array, Array]:
        """Return distances (N,) and their derivatives (N, n) of what was found.

        Parameters
        ----------
        found : sequence of Witness
            N of them.
        jacobians : ndarray, shape (K, 6, nv)
            What `place` returned for each sample.
        samples, pairs : ndarray of int, shape (N,)
            Sample and pair of bodies of each.
        """
        distances = np.array([witness[0] for witness in found])
        _check(distances)
        normals, *points = (np.array([witness[i] for witness in found]) for i in (1, 2, 3))
        # Meshes that are no hulls have no normal; the way between the nearest points is one.
        unknown = ~np.isfinite(normals).all(axis=1)
        normals[unknown] = (points[1] - points[0])[unknown]
        normals[unknown] /= np.linalg.norm(normals[unknown], axis=1, keepdims=True)
        gradient = np.zeros((len(found), self._model.nv))
        for moves, at, sign in zip(self._moves, points, (-1.0, 1.0), strict=True):
            # The speed of a point along the normal: n·(v + w × x) = n·v + w·(x × n).
            wrench = np.concatenate([normals, np.cross(at, normals)], axis=1)
            speed = np.einsum("ni,nij->nj", wrench, jacobians[samples])
            gradient += sign * speed * moves[pairs]
        return distances, gradient @ self.robot.expansion


def copied(result: Any) -> Witness:
    """Return a result of Coal, whose memory is used again."""
    return (
        result.min_distance,
        np.array(result.normal),
        result.getNearestPoint1(),
        result.getNearestPoint2(),
    )


def _check(distances: Array) -> None:
    failed = ~(np.abs(distances) < _LARGEST)
    if failed.any():
        raise SolverError(
            f"{np.count_nonzero(failed)} of {distances.size} distances were not found by Coal, the "
            f"first of sample {int(np.argwhere(failed)[0, 0])}; simplify the meshes."
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
