"""From rows to the few numbers of a cost: weights, and one compression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.compression.contact_noise import contact_noise
from sdpid.estimation.compression.covariance import (
    PRINTED,
    JointRows,
    Weighting,
    pooled,
    residual_noise,
)
from sdpid.estimation.compression.rows import RowSource
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
        Independent rows that are not masked.
    force_scale : float
        What covariances of measured contact forces were multiplied by: samples that make one
        independent one, as of `sigma`, and a factor above 1 where residuals ask for it.
    time : float
        Samples that make one independent one, where weights are from residuals.
    """

    sigma: Array
    A: Array
    rhs: Array
    floor: float
    used: int
    force_scale: float = 1.0
    time: float = 1.0

    @classmethod
    def of(cls, rows: RowSource, weighting: Weighting) -> Factor:
        """Weight and compress rows, piece by piece; the order of the pieces decides rounding."""
        if weighting == "residual":
            if rows.samples.contacts is None:
                return cls.of_joints(rows, JointRows.merged(rows.map(JointRows.of)))
            variance, time, force = contact_noise(rows)
            # Residuals only raise errors of forces: a fit follows forces that are all wrong alike,
            # as by their scale, and hardly shows it.
            sigma, scale = np.diag(variance * time), time * max(force, 1.0)
            triangle, used = compressed(rows.with_force_scale(scale), sigma)
            return cls(sigma, *triangle.split(), used, scale, time)
        given = rows.samples.covariance
        sigma = np.eye(rows.robot.n) if given is None else np.asarray(given)
        if weighting == "gls":
            sigma = pooled(sigma)
        if weighting in PRINTED:
            # W^T·Sigma^e·W, as a product of equal factors.
            pairs = rows.map(_normal_equations, -0.25 if weighting == "eq9" else -0.5, sigma=sigma)
            H = np.sum([found for found, _ in pairs], axis=0)
            return cls(sigma, H[:, :-1], H[:, -1], 0.0, sum(used for _, used in pairs))
        triangle, used = compressed(rows, sigma)
        return cls(sigma, *triangle.split(), used)

    @classmethod
    def of_joints(cls, rows: RowSource, joints: JointRows) -> Factor:
        """Weight rows that are compressed already with one variance a joint, from residuals."""
        variance, time = residual_noise(rows, joints)
        used = int(joints.used.sum())
        split = joints.joined(variance * time).split()
        return cls(np.diag(variance * time), *split, used, time=time)


def compressed(rows: RowSource, sigma: Array) -> tuple[Triangle, int]:
    """Return the triangle of all whitened rows, and how many independent ones there are."""
    triangle, used = Triangle(rows.base.count + 1), 0
    for piece, count in rows.map(compress, sigma=sigma):
        triangle.merge(piece)
        used += count
    return triangle, used


def _normal_equations(rows: RowSource, sigma: Array, exponent: float) -> tuple[Array, int]:
    """Return ``W^T·Sigma^(2·exponent)·(W, Y)``, (b, b + 1), and the number of rows."""
    count, used = rows.base.count, 0
    H = np.zeros((count, count + 1))
    for _, weighted, mask in whitened_chunks(rows, sigma, exponent):
        flat = weighted.reshape(-1, count + 1)
        H += flat[:, :-1].T @ flat
        used += int(mask.sum())
    return H, used
