"""Algebra of a rigid body's ten inertial parameters.

A body is the vector ``(m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz)``: mass, first moment
``h = m·r`` and rotational inertia ``I_o`` about the origin of the frame it is given in
(Pinocchio's order). Every function takes arrays of such vectors with any leading shape.

Two matrices are linear in the vector and decide whether a body can exist:

* the 6×6 spatial inertia ``[[I_o, S(h)], [S(h)^T, m·E]]``: positive definite exactly when m > 0
  and the inertia about the center of mass is positive definite [yoshida2000]_;
* the 4×4 pseudo-inertia ``[[½·tr(I_o)·E − I_o, h], [h^T, m]]``: positive definite exactly when
  some mass distribution of positive density has these moments [wensing2018]_.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array

Consistency = Literal["pseudo_inertia", "spatial_inertia", "none"]
CONSISTENCIES: tuple[Consistency, ...] = ("pseudo_inertia", "spatial_inertia", "none")

PARAMETER_NAMES = ("m", "mx", "my", "mz", "xx", "xy", "yy", "xz", "yz", "zz")
PARAMETER_UNITS = ("kg", *("kg.m",) * 3, *("kg.m2",) * 6)

# Order of the six entries of a rotational inertia.
TENSOR_INDEX = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
_ROWS, _COLUMNS = np.array(TENSOR_INDEX).T


def inertia_tensor(theta: ArrayLike) -> Array:
    """Return the rotational inertia about the frame's origin, (..., 10) to (..., 3, 3)."""
    theta = np.asarray(theta, dtype=np.float64)
    tensor = np.empty((*theta.shape[:-1], 3, 3))
    for k, (i, j) in enumerate(TENSOR_INDEX):
        tensor[..., i, j] = tensor[..., j, i] = theta[..., 4 + k]
    return tensor


def skew(vector: ArrayLike) -> Array:
    """Return the matrix S(v) with S(v)·w = v × w, (..., 3) to (..., 3, 3)."""
    v = np.asarray(vector, dtype=np.float64)
    matrix = np.zeros((*v.shape[:-1], 3, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -v[..., 2], v[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = v[..., 2], -v[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -v[..., 1], v[..., 0]
    return matrix


def least_turn(one: ArrayLike, other: ArrayLike) -> Array:
    """Return the least rotation (3, 3) that turns one vector into the direction of another."""
    start, end = (np.asarray(each) / np.linalg.norm(each) for each in (one, other))
    K = skew(np.cross(start, end))
    # Rodrigues' formula.
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + start @ end))


def _trace(matrix: Array) -> Any:
    return np.trace(matrix, axis1=-2, axis2=-1)


def complement(matrix: Array) -> Array:
    """Return tr(A)·E − A, which turns second moments into a rotational inertia."""
    return np.asarray(_trace(matrix)[..., None, None] * np.eye(3) - matrix)


def second_moment_from_inertia(tensor: Array) -> Array:
    """Return the second-moment matrix ∫ x·x^T dm = ½·tr(I)·E − I of a rotational inertia."""
    return np.asarray(0.5 * _trace(tensor)[..., None, None] * np.eye(3) - tensor)


def pseudo_inertia(theta: ArrayLike) -> Array:
    """Return the 4×4 pseudo-inertia, (..., 10) to (..., 4, 4) [wensing2018]_."""
    theta = np.asarray(theta, dtype=np.float64)
    matrix = np.empty((*theta.shape[:-1], 4, 4))
    matrix[..., :3, :3] = second_moment_from_inertia(inertia_tensor(theta))
    matrix[..., :3, 3] = matrix[..., 3, :3] = theta[..., 1:4]
    matrix[..., 3, 3] = theta[..., 0]
    return matrix


def from_pseudo_inertia(matrix: ArrayLike) -> Array:
    """Return the parameter vector of a pseudo-inertia, (..., 4, 4) to (..., 10)."""
    matrix = np.asarray(matrix, dtype=np.float64)
    theta = np.empty((*matrix.shape[:-2], 10))
    theta[..., 0] = matrix[..., 3, 3]
    theta[..., 1:4] = matrix[..., :3, 3]
    theta[..., 4:] = tensor_entries(complement(matrix[..., :3, :3]))
    return theta


def spatial_inertia(theta: ArrayLike) -> Array:
    """Return the 6×6 spatial inertia, (..., 10) to (..., 6, 6) [yoshida2000]_."""
    theta = np.asarray(theta, dtype=np.float64)
    matrix = np.zeros((*theta.shape[:-1], 6, 6))
    matrix[..., :3, :3] = inertia_tensor(theta)
    matrix[..., :3, 3:] = skew(theta[..., 1:4])
    matrix[..., 3:, :3] = -matrix[..., :3, 3:]
    matrix[..., 3:, 3:] = theta[..., 0, None, None] * np.eye(3)
    return matrix


def tensor_entries(tensor: Array) -> Array:
    """Return the entries of symmetric matrices in theta's order, (..., 3, 3) to (..., 6)."""
    return tensor[..., _ROWS, _COLUMNS]


def physical_parameters(theta: ArrayLike) -> tuple[Array, Array, Array]:
    """Return mass (...,), center of mass (..., 3) and inertia about it (..., 3, 3).

    Only defined where the mass is not zero; elsewhere the entries are not finite.
    """
    theta = np.asarray(theta, dtype=np.float64)
    mass = theta[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        com = theta[..., 1:4] / mass[..., None]
        shift = mass[..., None, None] * complement(com[..., :, None] * com[..., None, :])
    return mass.copy(), com, inertia_tensor(theta) - shift


def theta_from_physical(mass: ArrayLike, com: ArrayLike, inertia: ArrayLike) -> Array:
    """Return the parameter vector from mass, center of mass and the inertia about it.

    Parameters
    ----------
    mass : array_like, shape (...,)
        Mass in kg.
    com : array_like, shape (..., 3)
        Center of mass in m.
    inertia : array_like, shape (..., 3, 3)
        Rotational inertia about the center of mass in kg·m², along the axes of the frame.

    Returns
    -------
    ndarray, shape (..., 10)
    """
    mass = np.asarray(mass, dtype=np.float64)
    com = np.asarray(com, dtype=np.float64)
    outer = com[..., :, None] * com[..., None, :]
    about_origin = np.asarray(inertia, dtype=np.float64) + (
        mass[..., None, None] * complement(outer)
    )
    theta = np.empty((*mass.shape, 10))
    theta[..., 0] = mass
    theta[..., 1:4] = mass[..., None] * com
    theta[..., 4:] = tensor_entries(about_origin)
    return theta


def central_moments(theta: ArrayLike, consistency: Consistency) -> tuple[Array, Array, Array]:
    """Return mass (...,), center of mass (..., 3) and the matrix N (..., 3, 3) about it.

    N is what must be positive definite beside the mass: the second moments for
    ``"pseudo_inertia"``, the rotational inertia for the others. Its entries are not finite where
    the mass is zero.
    """
    mass, com, inertia = physical_parameters(theta)
    if consistency == "pseudo_inertia":
        inertia = second_moment_from_inertia(inertia)
    return mass, com, inertia


def theta_from_central_moments(
    mass: ArrayLike, com: ArrayLike, moments: Array, consistency: Consistency
) -> Array:
    """Return the parameter vector (..., 10) of what `central_moments` returns."""
    inertia = complement(moments) if consistency == "pseudo_inertia" else moments
    return theta_from_physical(mass, com, inertia)


def matrix_of(theta: ArrayLike, consistency: Consistency) -> Array:
    """Return the matrix whose positive definiteness is the given consistency."""
    return pseudo_inertia(theta) if consistency == "pseudo_inertia" else spatial_inertia(theta)


def matrix_basis(consistency: Consistency) -> Array:
    """Return E_k, shape (10, s, s), with ``matrix_of(theta) = Σ theta_k·E_k``."""
    return matrix_of(np.eye(10), consistency)


def margin_shift(consistency: Consistency) -> Array:
    """Return the matrix D such that margin t means ``matrix_of(theta) − t·D`` ⪰ 0."""
    if consistency == "pseudo_inertia":
        return np.diag([1.0, 1.0, 1.0, 0.0])
    return np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])


def margin(theta: ArrayLike, consistency: Consistency) -> Array:
    """Return how far inside the consistent set each body is, in kg·m².

    The margin is the largest t for which the inequality holds with t·E taken off the inertia
    about the center of mass (``"spatial_inertia"``) or off the second moments about it
    (``"pseudo_inertia"``); by the Schur complement it is the smallest eigenvalue of that matrix.
    A margin t of the second moments implies a margin of 2·t of the inertia.

    Parameters
    ----------
    theta : array_like, shape (..., 10)
        The bodies.
    consistency : {"pseudo_inertia", "spatial_inertia", "none"}
        Which set; for ``"none"`` the margin of ``"spatial_inertia"`` is given.

    Returns
    -------
    ndarray, shape (...,)
        NaN where the mass is not positive: no margin exists there. (Arrays inside the library
        use NaN for it; results shown to users say None.)
    """
    mass, _, moments = central_moments(theta, consistency)
    positive = mass > 0.0
    moments = np.where(positive[..., None, None], moments, np.eye(3))
    smallest = np.linalg.eigvalsh(moments)[..., 0]
    return np.where(positive, smallest, np.nan)


def transform(theta: ArrayLike, rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Return the same body expressed in another frame.

    Parameters
    ----------
    theta : array_like, shape (..., 10)
        The body in frame b.
    rotation, translation : array_like, shapes (3, 3) and (3,)
        Placement of frame b in frame a: ``x_a = R·x_b + t``.

    Returns
    -------
    ndarray, shape (..., 10)
        The body in frame a.
    """
    placement = np.eye(4)
    placement[:3, :3] = rotation
    placement[:3, 3] = translation
    return from_pseudo_inertia(placement @ pseudo_inertia(theta) @ placement.T)


def point_masses(masses: ArrayLike, positions: ArrayLike) -> Array:
    """Return the body made of point masses (..., N) at positions (..., N, 3)."""
    masses = np.asarray(masses, dtype=np.float64)
    points = np.asarray(positions, dtype=np.float64)
    homogeneous = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)
    return from_pseudo_inertia(
        np.einsum("...k,...ki,...kj->...ij", masses, homogeneous, homogeneous)
    )
