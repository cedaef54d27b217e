"""Joints of a tree: what is constant of each, and its rotation, enclosed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.outward import SLACK as UP
from sdpid.assurance.certificate.outward import UNIT as U
from sdpid.assurance.log_proof.elementary import sine_cosine
from sdpid.assurance.log_proof.enclosure import TINY, Enclosed, root
from sdpid.robot.model.regressor_kernel import FLOATING, PRISMATIC, REVOLUTE, Tree

# Rounding of an entry of a quaternion's matrix, four operations on numbers whose absolute sum is at
# most 1 + 4|q|², and three entries a row: 4·3 + 1.
_QUATERNION = 13.0 * U

# Products with these are exact.
_PLAIN = (-1.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Axis:
    """A constant axis of a joint, in its own frame.

    Attributes
    ----------
    vector : Enclosed
        The axis.
    plain : bool
        Whether products with it are exact.
    turns : bool
        Whether it is one of rotation.
    coordinate : int
        The robot's coordinate that moves it.
    factor : float
        How fast.
    first_v : int
        Pinocchio's coordinate.
    """

    vector: Enclosed
    plain: bool
    turns: bool
    coordinate: int
    factor: float
    first_v: int

    def times(self, rate: Enclosed) -> Enclosed:
        """Return a rate (K,) along the axis."""
        found = rate.times(self.vector)
        return Enclosed(found.mid, rate.rad * self.vector.size, found.size) if self.plain else found


@dataclass(frozen=True, eq=False)
class Joint:
    """What is constant of a joint.

    Attributes
    ----------
    kind, parent : int
        As in `Tree`.
    axes : tuple of Axis
        One, or six of a floating base.
    place, slide : Enclosed
        Origin of the joint's frame in its parent's, and what a meter of a prismatic joint adds.
    turn : ndarray, shape (3, 3, 3)
        Rotation of the joint's frame in its parent's: ``turn[0] cos + turn[1] sin + turn[2]``.
    rounding : float
        Bound of the rounding of that sum, for sine and cosine up to one.
    norms : tuple of 3 floats
        Frobenius norms of the three matrices.
    orthogonal : float
        Bound of the sum's spectral norm where cosine and sine are on the circle.
    """

    kind: int
    parent: int
    axes: tuple[Axis, ...]
    place: Enclosed
    slide: Enclosed
    turn: Array
    rounding: float
    norms: tuple[float, float, float]
    orthogonal: float

    @classmethod
    def of(cls, tree: Tree, i: int) -> Joint:
        """Return a joint of a tree."""
        kind, to, turn = int(tree.kind[i]), int(tree.first_v[i]), tree.turn[i]
        if kind == FLOATING:
            vectors = [(np.eye(3)[k % 3], k >= 3) for k in range(6)]
        else:
            vectors = [(tree.axis[i], kind == REVOLUTE)]
        axes = tuple(
            Axis(
                constant_vector(values),
                bool(np.isin(values, _PLAIN).all()),
                turns,
                int(tree.column[to + k]),
                float(tree.factor[to + k]),
                to + k,
            )
            for k, (values, turns) in enumerate(vectors)
        )
        # Each product rounds once, and each sum of two terms that are there.
        products = sum(np.where(np.isin(x, _PLAIN), 0.0, np.abs(x)) for x in turn[:2])
        sums = np.maximum(np.count_nonzero(turn, axis=0) - 1, 0) * np.abs(turn).sum(axis=0)
        first, second, rest = (_frobenius(x) for x in turn)
        return cls(
            kind=kind,
            parent=int(tree.parent[i]),
            axes=axes,
            place=constant_vector(tree.place[i, 0]),
            slide=constant_vector(tree.place[i, 1]),
            turn=turn,
            rounding=U * _frobenius(products + sums) * UP,
            norms=(first, second, rest),
            orthogonal=_orthogonality(*turn),
        )

    def rotation(self, q: Enclosed) -> Enclosed:
        """Return the rotation of the joint's frame in its parent's."""
        first, second, rest = (x[..., None] for x in self.turn)
        if self.kind == PRISMATIC:
            return _constant_matrix(self.turn[2])
        if self.kind == FLOATING:
            return _constant_matrix(self.turn[2]).compose(_quaternion(q.at(slice(3, 7))))
        stored = len(q.mid) == 2
        sine, cosine = (q.at(1), q.at(0)) if stored else sine_cosine(q.at(0))
        mid = first * cosine.mid + second * sine.mid + rest
        sizes = float(cosine.size), float(sine.size)
        rad = self.rounding * max(*sizes, 1.0)
        rad += self.norms[0] * float(cosine.rad) + self.norms[1] * float(sine.rad)
        size = self.orthogonal + rad
        if stored:
            # It need not lie on the circle.
            size = self.norms[0] * sizes[0] + self.norms[1] * sizes[1] + self.norms[2]
        return Enclosed(mid, np.asarray(rad * UP + TINY), np.asarray(size * UP))

    def origin(self, q: Enclosed) -> Enclosed:
        """Return the origin of the joint's frame in its parent's."""
        if self.kind == PRISMATIC:
            return self.place + q.at(0).times(self.slide)
        return self.place


def _orthogonality(first: Array, second: Array, rest: Array) -> float:
    """Return a bound of the norm of ``A c + B s + D`` for c² + s² = 1.

    Its square is at most the norm of ``E + c²(A^T A − P) + s²(B^T B − P) + c s(A^T B + B^T A) +
    c(A^T D + D^T A) + s(B^T D + D^T B)`` with P = E − D^T D.
    """
    P = np.eye(3) - rest.T @ rest
    defects = [x.T @ x - P for x in (first, second)]
    pairs = ((first, second), (first, rest), (second, rest))
    defects += [x.T @ y + y.T @ x for x, y in pairs]
    # Eight operations on numbers of the matrices' size make each entry; nine entries.
    rounding = 72.0 * U * sum(_frobenius(x) for x in (first, second, rest, np.eye(3))) ** 2
    return float(root(1.0 + sum(map(_frobenius, defects)) + 5.0 * rounding))


def _quaternion(q: Enclosed) -> Enclosed:
    """Return the matrix ``E + 2w[x]ₓ + 2[x]ₓ²`` of quaternions (4, K), x y z w, as stored.

    It is normal, with the eigenvalues 1 and ``1 − 2s ± 2w√s i``, s = |x|², whose squared size is
    ``1 − 4s(1 − s − w²)``.
    """
    x, y, z, w = q.mid
    mid = np.empty((3, 3, len(x)))
    mid[0, 0], mid[1, 1] = 1.0 - 2.0 * (y * y + z * z), 1.0 - 2.0 * (x * x + z * z)
    mid[2, 2] = 1.0 - 2.0 * (x * x + y * y)
    mid[0, 1], mid[1, 0] = 2.0 * (x * y - z * w), 2.0 * (x * y + z * w)
    mid[0, 2], mid[2, 0] = 2.0 * (x * z + y * w), 2.0 * (x * z - y * w)
    mid[1, 2], mid[2, 1] = 2.0 * (y * z - x * w), 2.0 * (y * z + x * w)
    s = x * x + y * y + z * z
    square = float(np.sum(q.size**2)) * UP
    rad = _QUATERNION * (1.0 + 4.0 * square)
    # Ten operations on numbers up to 4(1 + |q|²)².
    most = float(np.max(1.0 - 4.0 * s * (1.0 - s - w * w), initial=1.0))
    most += 40.0 * U * (1.0 + square) ** 2
    return Enclosed(mid, np.asarray(rad * UP), np.asarray((root(most) + rad) * UP))


def _frobenius(matrix: Array) -> float:
    """Return an upper bound of the norm of a vector or the Frobenius norm of a 3×3 matrix."""
    return float(root(np.sum(matrix * matrix)))


def constant_vector(values: Array) -> Enclosed:
    """Return a constant vector (3, 1)."""
    return Enclosed(values[:, None], np.zeros(()), np.asarray(_frobenius(values)))


def _constant_matrix(values: Array) -> Enclosed:
    """Return a constant matrix (3, 3, 1) with a bound of its spectral norm."""
    # The norm of M^T M is at most its largest absolute row sum; six operations make each entry.
    square = float(np.abs(values.T @ values).sum(axis=1).max()) + 18.0 * U * _frobenius(values) ** 2
    return Enclosed(values[..., None], np.zeros(()), np.asarray(root(square)))
