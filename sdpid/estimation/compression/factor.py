"""From rows to the few numbers of a cost: weights, and one compression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.compression.covariance import (
    JointRows,
    Weighting,
    pooled,
    residual_covariance,
)
from sdpid.estimation.compression.rows import Rows, RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import compress, whitened_chunks


@dataclass(frozen=True, eq=False)
class Factor:
    """The cost ``‖A @ base − rhs‖² + floor`` of weighted rows.

    Attributes
    ----------
    sigma : ndarray, shape (n, n) or (K, n, n)
        The covariance that was used.
    A : ndarray, shape (b, b)
    rhs : ndarray, shape (b,)
    floor : float
    used : int
        Rows that are not masked.
    """

    sigma: Array
    A: Array
    rhs: Array
    floor: float
    used: int

    @classmethod
    def of(cls, rows: Rows, weighting: Weighting) -> Factor:
        """Weight and compress rows, piece by piece; the order of the pieces decides rounding."""
        if weighting == "residual":
            return cls.of_joints(rows, JointRows.merged(rows.map(JointRows.of)))
        sigma = covariance(rows, weighting)
        if weighting in ("eq9", "eq18"):
            # W^T·Sigma^e·W, as a product of equal factors.
            pairs = rows.map(_normal_equations, -0.25 if weighting == "eq9" else -0.5, sigma=sigma)
            H = np.sum([found for found, _ in pairs], axis=0)
            return cls(sigma, H[:, :-1], H[:, -1], 0.0, sum(used for _, used in pairs))
        triangle, used = Triangle(rows.base.count + 1), 0
        for piece, count in rows.map(compress, sigma=sigma):
            triangle.merge(piece)
            used += count
        return cls(sigma, *triangle.split(), used)

    @classmethod
    def of_joints(cls, rows: Rows, joints: JointRows) -> Factor:
        """Weight rows that are compressed already with one variance a joint, from residuals."""
        sigma = residual_covariance(rows, joints)
        triangle = Triangle(rows.base.count + 1)
        triangle.add(joints.joined(np.diagonal(sigma)))
        return cls(sigma, *triangle.split(), int(joints.used.sum()))


def covariance(rows: Rows, weighting: Weighting) -> Array:
    """Return the covariance that a weighting uses, (n, n) or (K, n, n)."""
    if weighting == "residual":
        return residual_covariance(rows)
    given = rows.samples.covariance
    if given is None:
        return np.eye(rows.robot.n)
    return pooled(given) if weighting == "gls" else np.asarray(given)


def _normal_equations(rows: RowSource, sigma: Array, exponent: float) -> tuple[Array, int]:
    """Return ``W^T·Sigma^(2·exponent)·(W, Y)``, (b, b + 1), and the number of rows."""
    count, used = rows.base.count, 0
    H = np.zeros((count, count + 1))
    for _, weighted, mask in whitened_chunks(rows, sigma, exponent):
        flat = weighted.reshape(-1, count + 1)
        H += flat[:, :-1].T @ flat
        used += int(mask.sum())
    return H, used
