"""Rows of samples in contact: forces that nobody measured are eliminated, measured ones added.

The equations of a sample are ``Y @ theta = effort + J^T·f`` with errors of the covariance S in the
efforts and R in the forces of closed contacts, so that the covariance of ``effort + J^T·f`` is
``C = S + J^T·R·J``. A force that was not measured has an infinite R: its directions carry no
information, and what is left is, the columns of A being those of J^T,
``Omega = C^-1 − C^-1·A·(A^T·C^-1·A)^-1·A^T·C^-1``. With a root P of C^-1 and an orthonormal basis N
of what the columns of P·A leave it is ``T^T·T`` with ``T = N·N^T·P``, of which the n − rank(A) rows
N^T·P are independent. A row that is masked is a direction of infinite variance, too: zero in P.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.jacobians import frame_axes, relative_jacobians
from sdpid.robot.model.model import RobotModel

# A direction of the forces below this share of the strongest one, all columns scaled to unit
# length, is another one's repetition: rounding leaves 1e-16, and two points of a foot that are a
# millimeter apart some 1e-3.
RANK = 1e-8

# A force that moves joints less than this share of the strongest one of a sample is none: it acts
# across a linkage in a plane, and only rounding moves joints, of angles in the description too
# (pi to seven digits). Without a loop every force moves the base or a joint by its lever.
_NOTHING = 1e-6

# The last of a triangle's diagonal is no bound of the least singular value, but not far off either:
# below this one looks closer.
_SUSPICIOUS = 1e-4


@dataclass(frozen=True, eq=False)
class ContactRows:
    """What contacts do to the rows of some samples.

    Attributes
    ----------
    directions : ndarray, shape (k, n, m)
        Efforts of every force or moment that nobody measured, A.
    active : ndarray of bool, shape (k, m)
        Whether there may be one.
    effort : ndarray, shape (k, n)
        Efforts of measured forces.
    spread : ndarray, shape (k, n, s)
        Efforts of independent errors of measured forces, each of one standard deviation: L, so that
        their covariance is L·L^T. Without measured forces there are none, and s is zero.
    """

    directions: Array
    active: Mask
    effort: Array
    spread: Array

    @property
    def covariance(self) -> Array:
        """The covariance of the efforts of measured forces, (k, n, n)."""
        return np.asarray(self.spread @ np.swapaxes(self.spread, 1, 2))

    @classmethod
    def of(
        cls,
        robot: RobotModel,
        samples: Samples,
        part: slice,
        *,
        scale: float = 1.0,
        compiled: bool = False,
    ) -> ContactRows | None:
        """Return the contacts of some samples, None where samples have none.

        The covariance of measured forces is multiplied by `scale`; compiled loops are used or not.
        """
        contacts = samples.contacts
        if contacts is None:
            return None
        q = samples.position[part]
        J = relative_jacobians(
            robot, q, contacts.frames, contacts.against, contacts.offset, compiled=compiled
        )
        down = contacts.down[part]
        known = contacts.force_covariance
        infinite = np.ones((contacts.n, 6), dtype=bool)
        if known is not None:
            infinite = np.isinf(np.diagonal(known, axis1=1, axis2=2))
        found: list[Array] = []
        axes = None
        for i, kind in enumerate(contacts.kind):
            moments, transmitted = J[:, i, 3:], infinite[i, 3:]
            if kind == "line" and transmitted.all():
                # An edge transmits no moment about itself, the frame's y axis.
                if axes is None:
                    axes = frame_axes(robot, q, contacts.frames)
                moments = np.swapaxes(axes[:, i][:, :, [0, 2]], 1, 2) @ moments
            else:
                moments = moments[:, transmitted & (kind != "point")]
            found.append(np.concatenate([J[:, i, :3][:, infinite[i, :3]], moments], axis=1))
        directions = np.swapaxes(np.concatenate(found, axis=1), 1, 2)
        active = np.repeat(down, [each.shape[1] for each in found], axis=1)
        if any(contacts.against):
            size = np.einsum("knm,knm->km", directions, directions)
            active &= size > _NOTHING**2 * size.max(axis=1, keepdims=True, initial=0.0)
        if known is None or contacts.forces is None:
            return cls(
                directions, active, np.zeros(q.shape[:1] + J.shape[3:]), directions[:, :, :0]
            )
        values, vectors = np.linalg.eigh(scale * np.where(np.isinf(known), 0.0, known))
        root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        f = np.where(infinite, 0.0, contacts.forces[part])
        # A foot in the air has no force, and no error of one, whatever its sensor shows.
        J = np.where(down[:, :, None, None], J, 0.0)
        return cls(
            directions,
            active,
            np.einsum("kcin,kci->kn", J, f),
            np.einsum("kcin,cij->kncj", J, root)[:, :, root.any(axis=1)],
        )

    def _left(self, powers: Array, index: Indices) -> Iterator[tuple[Indices, Array, Array]]:
        """Yield samples, bases N (s, n, r) of what forces leave of whitened rows, and N^T·P."""
        for some, own in alike(self.active):
            P = powers[index[some]]
            for few, N in complements(P @ self.directions[some][:, :, own]):
                yield some[few], N, np.swapaxes(N, 1, 2) @ P[few]

    def unforced(self, mask: Mask) -> Iterator[tuple[Indices, Array]]:
        """Yield samples, and bases N (s, n, r) of what forces leave of the rows in use (k, n).

        They are the same for all weights: a covariance C of the rows makes
        ``Omega = N·(N^T·C·N)^-1·N^T``. Samples without a row in use have none.
        """
        for some, pattern in alike(np.hstack([self.active, mask])):
            own, rows = np.split(pattern, [self.active.shape[1]])
            if rows.any():
                for few, kept in complements(self.directions[some][:, rows][:, :, own]):
                    N = np.zeros((len(few), len(rows), kept.shape[2]))
                    N[:, rows] = kept
                    yield some[few], N

    def roots(self, powers: Array, index: Indices) -> tuple[Array, Indices]:
        """Return roots and which each sample has, errors of measured forces added to efforts'."""
        if not self.spread.shape[2]:
            return powers, index
        return with_spread(powers[index], self.spread), np.arange(len(index))

    def eliminated(self, powers: Array, index: Indices, mask: Mask) -> tuple[Array, Array]:
        """Return weights T (k, n, n) from roots P, and how much of each row is left, (k, n).

        What is left of the rows in use, `mask`, adds up to the independent ones.
        """
        found = np.empty((len(index), *powers.shape[1:]))
        shares = mask.astype(np.float64)
        for some, N, left in self._left(powers, index):
            found[some] = N @ left
            shares[some] *= np.einsum("knr,knr->kn", N, N)
        return found, shares

    def independent(self, powers: Array, index: Indices, rows: Array) -> tuple[Array, int]:
        """Return the independent whitened rows (r, c) of rows (k, n, c), and lost directions.

        They have the same products as T·rows, sample by sample.
        """
        found, lost = [], 0
        for some, _, left in self._left(powers, index):
            found.append((left @ rows[some]).reshape(-1, rows.shape[2]))
            lost += (left.shape[2] - left.shape[1]) * len(some)
        return np.concatenate(found), lost

    def errors(self, powers: Array, index: Indices, residual: Array) -> Array:
        """Return errors of the efforts (k, n, c) from residuals: less what forces explain best.

        The forces, within their covariance where they were measured, are those that leave the
        least weighted residual of the rows in use. Masked rows get what these forces leave of them.
        """
        out: Array = residual.copy()
        weighted = np.zeros_like(residual)
        for some, own in alike(self.active):
            P, r = powers[index[some]], residual[some]
            A = self.directions[some][:, :, own]
            # Least squares by the pseudo-inverse: a repeated direction has no force of its own.
            left = r - A @ (np.linalg.pinv(P @ A, rcond=RANK) @ (P @ r))
            out[some] = left
            weighted[some] = np.swapaxes(P, 1, 2) @ (P @ left)
        return out - self.spread @ (np.swapaxes(self.spread, 1, 2) @ weighted)


def alike(flags: Mask) -> Iterator[tuple[Indices, Mask]]:
    """Yield samples with the same flags (m,), of (k, m), and these flags."""
    patterns, index = np.unique(flags, axis=0, return_inverse=True)
    for i, pattern in enumerate(patterns):
        yield np.flatnonzero(index.reshape(-1) == i), pattern


def with_spread(P: Array, L: Array) -> Array:
    """Return roots of ``(C + L·L^T)^-1`` from roots P (k, m, n) of C^-1 and L (k, n, s).

    P·L is large where forces are hardly known and small where they are known well: from its
    singular values, and no square of them, roots are exact from one limit to the other.
    """
    if not L.shape[2]:
        return P
    U, s, _ = np.linalg.svd(P @ L, full_matrices=False)
    lost = 1.0 - 1.0 / np.sqrt(1.0 + s**2)
    return np.asarray(P - (U * lost[:, None, :]) @ (np.swapaxes(U, 1, 2) @ P))


def complements(A: Array) -> Iterator[tuple[Indices, Array]]:
    """Yield samples, and bases N (s, n, n − rank) of what columns (s, n, m) leave."""
    n, m = A.shape[1:]
    if not m:
        yield np.arange(len(A)), np.broadcast_to(np.eye(n), (len(A), n, n))
        return
    length = np.sqrt(np.einsum("snm,snm->sm", A, A))
    A = A / np.where(length > 0.0, length, 1.0)[:, None, :]
    doubtful = np.ones(len(A), dtype=bool)
    if m <= n:
        Q, R = np.linalg.qr(A, mode="complete")
        doubtful = np.abs(np.diagonal(R, axis1=1, axis2=2)).min(axis=1) < _SUSPICIOUS
        if not doubtful.all():
            yield np.flatnonzero(~doubtful), Q[~doubtful][:, :, m:]
    if not doubtful.any():
        return
    U, s, _ = np.linalg.svd(A[doubtful], full_matrices=True)
    ranks = np.count_nonzero(s > RANK * s[:, :1], axis=1)
    for rank in np.unique(ranks).tolist():
        some = ranks == rank
        yield np.flatnonzero(doubtful)[some], U[some][:, :, rank:n]
