"""Matrices of a link's ten parameters, and what it takes to be a body."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from .exact import inner, positive_semidefinite

# The matrix that a consistency asks to be positive semidefinite, in words.
MATRICES = {"pseudo_inertia": "4x4 pseudo-inertia", "spatial_inertia": "6x6 spatial inertia"}
CONSISTENCIES = (*MATRICES, "none")


def link_matrix(body: Any, consistency: str) -> list[list[Fraction]]:
    """Return M of (m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz), about the joint frame's origin.

    4×4 pseudo-inertia ``[[½·tr(I)·E − I, h], [h^T, m]]`` with h = (mx, my, mz): ⪰ 0 where some
    distribution of mass has these moments. 6×6 spatial inertia ``[[I, S(h)], [S(h)^T, m·E]]``.
    """
    m, x, y, z, xx, xy, yy, xz, yz, zz = map(Fraction, body)
    o = Fraction(0)
    if consistency == "spatial_inertia":
        return [
            [xx, xy, xz, o, -z, y],
            [xy, yy, yz, z, o, -x],
            [xz, yz, zz, -y, x, o],
            [o, z, -y, m, o, o],
            [-z, o, x, o, m, o],
            [y, -x, o, o, o, m],
        ]
    return [
        [(yy + zz - xx) / 2, -xy, -xz, x],
        [-xy, (xx + zz - yy) / 2, -yz, y],
        [-xz, -yz, (xx + yy - zz) / 2, z],
        [x, y, z, m],
    ]


def adjoint(Z: Any, consistency: str) -> list[Fraction]:
    """Return ⟨Z, M(e_k)⟩ for the ten unit bodies e_k."""
    units = ([int(i == k) for i in range(10)] for k in range(10))
    return [inner(Z, link_matrix(unit, consistency)) for unit in units]


def has_margin(body: Any, margin: float | Fraction, consistency: str) -> bool:
    """Return whether ``M(body) − margin·D ⪰ 0``, exactly."""
    matrix = link_matrix(body, consistency)
    for i in range(3):
        matrix[i][i] -= Fraction(margin)
    return positive_semidefinite(matrix)
