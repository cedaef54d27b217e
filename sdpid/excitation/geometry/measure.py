"""Distances between solids and their gradients by Pinocchio and Coal, and bounds on them.

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
from functools import cached_property
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.errors import SolverError
from sdpid.excitation.geometry.obstacles import Plane
from sdpid.excitation.geometry.solids import Solid
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.regressor_kernel import PRISMATIC

Ball = tuple[Array, float]
Core = tuple[Array, float]


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
        # Axes by Pinocchio's number of the joint; the base has none.
        self._axes = np.vstack([np.zeros(3), robot.tree.axis])
        self._slides = np.append(False, robot.tree.kind == PRISMATIC)
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
        if self._slides[joint]:
            return 1.0
        points, radius = (ball[0][None], ball[1]) if exact is None else exact
        return float(np.linalg.norm(np.cross(points, self._axes[joint]), axis=1).max()) + radius

    def _swept(self, joint: int, ball: Ball, sign: float) -> Ball:
        """Return a ball about all places of a ball that moves with a joint."""
        center, radius = ball
        axis = self._axes[joint]
        if not self._slides[joint]:
            on_axis = (center @ axis) * axis
            return on_axis, radius + float(np.linalg.norm(center - on_axis))
        lower, upper = self._range[:, self._model.joints[joint].idx_v]
        if not np.isfinite([lower, upper]).all():
            return center, np.inf
        return center + sign * 0.5 * (lower + upper) * axis, radius + 0.5 * (upper - lower)


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


# No distance is larger, m: Coal returns the largest number there is where its iteration fails.
_LARGEST = 1e6

# Pairs whose share of a soft minimum is below exp(-this) are left out of it: at 300 per meter each
# changes it by 0.4 µm at most, less than a distance is accurate.
_NEGLIGIBLE = 9.0

# Segments whose directions differ by a smaller squared sine count as parallel; what this misses
# of the distance of segments of 1 m is 10 µm.
_PARALLEL = 1e-10
_MISSED = 1e-5

# Normal and point of what is no plane.
_NO_PLANE = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


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
        # Which joint velocities move only the first or only the second body.
        self._moves = np.zeros((2, self._count, self._model.nv))
        for p, (first, second) in enumerate(pairs):
            ways = way(self._model, joint_of[first], joint_of[second])
            for moves, joints in zip(self._moves, ways, strict=True):
                moves[p, [self._model.joints[joint].idx_v for joint in joints]] = 1.0
        self._last: tuple[Array, Array] | None = None

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

    def soft_minimum(
        self, q: Array, sharpness: float, clearances: Array, reach: Array, horizon: float
    ) -> tuple[Array, Array]:
        """Return soft minima of slacks (K,) over all pairs of solids, and derivatives (K, n).

        ``-log(exp(-s*horizon) + sum of exp(-s*slack))/s`` with s the sharpness.

        Parameters
        ----------
        q : ndarray, shape (K, n)
            Joint positions.
        sharpness : float
            1/m.
        clearances : ndarray, shape (P,)
            What is taken off the distances of each pair of bodies, m.
        reach : ndarray, shape (P, n)
            Bounds on the rates of the distances of pairs of bodies, m/rad (m/m).
        horizon : float
            Slack beyond which it makes no difference how far away everything is, m.
        """
        gaps = clearances[self.owners]
        # What is found nearer replaces the bounds until the next call.
        bounds = self._bounds(q, reach)
        below = bounds - gaps
        margin = _NEGLIGIBLE / sharpness
        found: list[tuple[Any, ...]] = []
        jacobians = np.zeros((len(q), 6, self._model.nv))
        configurations = self.robot.configuration(q)
        for k in np.flatnonzero((below < horizon + margin).any(axis=1)):
            jacobians[k] = self.place(configurations[k])
            least, results = horizon, []
            for part in np.argsort(below[k], kind="stable").tolist():
                if below[k, part] >= least + margin:
                    break
                result = self.part(part)
                bounds[k, part] = result.min_distance
                least = min(least, result.min_distance - gaps[part])
                results.append((part, result))
            for part, result in results:
                if result.min_distance - gaps[part] < least + margin:
                    # Coal uses the memory of its results again.
                    ends = result.getNearestPoint1(), result.getNearestPoint2()
                    found.append((k, part, result.min_distance, np.array(result.normal), *ends))
        if not found:
            return np.full(len(q), horizon), np.zeros_like(q)
        at, which, distances, normals, *points = map(np.array, zip(*found, strict=True))
        _check(distances)
        gradients = self._gradients(normals, points, jacobians[at], self.owners[which])
        slack = distances - gaps[which]
        lowest = np.full(len(q), horizon)
        np.minimum.at(lowest, at, slack)
        weights = np.exp(-sharpness * (slack - lowest[at]))
        total = np.exp(-sharpness * (horizon - lowest))
        np.add.at(total, at, weights)
        out = np.zeros_like(q)
        np.add.at(out, at, (weights / total[at])[:, None] * gradients)
        return lowest - np.log(total) / sharpness, out

    def _bounds(self, q: Array, reach: Array) -> Array:
        """Return lower bounds (K, S) of distances: of capsules, or the last ones less the way."""
        bounds = self.capsules.below(q)
        if self._last is not None and len(self._last[0]) == len(q):
            moved = np.abs(q - self._last[0]) @ reach.T
            bounds = np.maximum(bounds, self._last[1] - moved[:, self.owners])
        self._last = q.copy(), bounds
        return bounds

    def _gradients(
        self, normals: Array, ends: list[Array], jacobians: Array, pairs: Indices
    ) -> Array:
        """Return the derivatives (N, n) of distances of pairs, from their nearest points."""
        # Meshes that are no hulls have no normal; the way between the nearest points is one.
        unknown = ~np.isfinite(normals).all(axis=1)
        normals[unknown] = (ends[1] - ends[0])[unknown]
        normals[unknown] /= np.linalg.norm(normals[unknown], axis=1, keepdims=True)
        gradient = np.zeros((len(pairs), self._model.nv))
        for moves, at, sign in zip(self._moves, ends, (-1.0, 1.0), strict=True):
            # The speed of a point along the normal: n·(v + w × x) = n·v + w·(x × n).
            wrench = np.concatenate([normals, np.cross(at, normals)], axis=1)
            speed = np.einsum("ni,nij->nj", wrench, jacobians)
            gradient += sign * speed * moves[pairs]
        return np.asarray(gradient @ self.robot.expansion)


def _check(distances: Array) -> None:
    failed = ~(np.abs(distances) < _LARGEST)
    if failed.any():
        raise SolverError(
            f"{np.count_nonzero(failed)} of {distances.size} distances were not found by Coal, the "
            f"first of sample {int(np.argwhere(failed)[0, 0])}; simplify the meshes."
        )


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

    def __init__(self, robot: RobotModel, solids: Sequence[Solid], pairs: Indices) -> None:
        self._robot, self._pairs = robot, pairs
        self._joints = np.array([solid.joint for solid in solids], dtype=int)
        fitted = [_capsule(solid) for solid in solids]
        self._ends = np.array([ends for ends, _ in fitted]).reshape(-1, 2, 3)
        self._radii = np.array([radius for _, radius in fitted])
        planes = [
            (solid.shape.normal, solid.shape.point) if isinstance(solid.shape, Plane) else _NO_PLANE
            for solid in solids
        ]
        self._normals, points = np.array(planes).reshape(-1, 2, 3).swapaxes(0, 1)
        self._offsets = np.einsum("si,si->s", self._normals, points)
        self._flat = (self._normals != 0.0).any(axis=1)[pairs[:, 1]]

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
        tree, robot = self._robot.tree, self._robot
        values = (q @ robot.expansion.T + robot.offset)[:, tree.first_v, None, None]
        own = np.tile(np.eye(4), (len(q), len(tree.parent), 1, 1))
        own[..., :3, :3] = np.cos(values) * tree.turn[:, 0] + np.sin(values) * tree.turn[:, 1]
        own[..., :3, :3] += tree.turn[:, 2]
        own[..., :3, 3] = tree.place[:, 0] + values[..., 0] * tree.place[:, 1]
        out = [np.broadcast_to(np.eye(4), (len(q), 4, 4))]
        for i, parent in enumerate(tree.parent):
            out.append(out[parent + 1] @ own[:, i])
        return np.stack(out, axis=1)


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
