"""Bodies in robot files: ten parameters, or mass, center of mass and inertia about it, exactly.

A body is (m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) about a joint's frame. A file has the mass,
the center of mass and the inertia about it, each number the double nearest to what the parameters
give in exact arithmetic. On the edge of consistency, where rounding could make a body that readers
refuse, moments about the center of mass are raised first (`inside`).
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

from ..bodies import has_margin, link_matrix
from ..exact import positive_semidefinite
from .placements import Placement, matmul

# Readers reject a body that rounding has put on the edge (MuJoCo: principal moments below 1e-14
# kg·m², or a triangle inequality missed by one bit). Written bodies are this far inside, kg·m²,
# and by this share of their largest moment; it changes efforts by some 1e-13 N·m.
_INSIDE, _SHARE = Fraction(1e-13), Fraction(1e-14)

# Parameters may be outside by a solver's rounding, which so many doublings outgrow.
_DOUBLINGS = 20

# Names of the six moments, and their places in the tensor.
MOMENTS = {"ixx": (0, 0), "ixy": (0, 1), "iyy": (1, 1), "ixz": (0, 2), "iyz": (1, 2), "izz": (2, 2)}

Body = Sequence[Fraction]


class Inertial(NamedTuple):
    """Mass in kg, center of mass in m, inertia about it in kg·m², along the frame's axes."""

    mass: float
    com: tuple[float, ...]
    moments: tuple[float, ...]

    def named(self) -> dict[str, float]:
        """Return every number by name."""
        names = ("mass", "x", "y", "z", *MOMENTS)
        return dict(zip(names, (self.mass, *self.com, *self.moments), strict=True))


NOTHING = Inertial(0.0, (0.0,) * 3, (0.0,) * 6)


def tensor(moments: Sequence[Fraction]) -> list[list[Fraction]]:
    """Return the rows of the tensor with six moments."""
    xx, xy, yy, xz, yz, zz = moments
    return [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]


def central(body: Sequence[float | Fraction]) -> tuple[Fraction, list[Fraction], list[Fraction]]:
    """Return mass, center of mass and moments about it, exactly; the mass must not be zero."""
    mass, *others = (Fraction(x) for x in body)
    com = [h / mass for h in others[:3]]
    return mass, com, _shifted(others[3:], -mass, com)


def about_origin(
    mass: float | Fraction, com: Sequence[Fraction], moments: Sequence[Fraction]
) -> list[Fraction]:
    """Return the ten parameters of a mass, a center of mass and moments about it, exactly."""
    mass = Fraction(mass)
    return [mass, *(mass * c for c in com), *_shifted(moments, mass, com)]


def _shifted(
    moments: Sequence[Fraction], mass: Fraction, com: Sequence[Fraction]
) -> list[Fraction]:
    """Return moments plus those of a mass at a point."""
    square = sum(c * c for c in com)
    return [
        value + mass * ((square if i == j else 0) - com[i] * com[j])
        for value, (i, j) in zip(moments, MOMENTS.values(), strict=True)
    ]


def body_of(inertial: Inertial, axes: Placement | None = None) -> list[Fraction]:
    """Return the ten parameters of an inertial, whose moments may be along other axes."""
    moments = [Fraction(x) for x in inertial.moments]
    if axes is not None:
        R = axes.rotation
        turned = matmul(matmul(R, tensor(moments)), [list(row) for row in zip(*R, strict=True)])
        moments = [turned[i][j] for i, j in MOMENTS.values()]
    return about_origin(inertial.mass, [Fraction(x) for x in inertial.com], moments)


def moved(body: Body, placement: Placement) -> list[Fraction]:
    """Return a body, given in a frame, in the frame that this one is placed in.

    The pseudo-inertia J becomes T·J·T^T, T being the placement's 4×4 matrix.
    """
    T = [[*row, t] for row, t in zip(*placement, strict=True)]
    T.append([Fraction(0)] * 3 + [Fraction(1)])
    J = matmul(
        matmul(T, link_matrix(body, "pseudo_inertia")), [list(c) for c in zip(*T, strict=True)]
    )
    trace = J[0][0] + J[1][1] + J[2][2]
    moments = [(trace if i == j else 0) - J[i][j] for i, j in MOMENTS.values()]
    return [J[3][3], J[0][3], J[1][3], J[2][3], *moments]


def less(body: Body, others: Sequence[Body]) -> list[Fraction]:
    """Return a body without others that are part of it."""
    return [x - sum(parts) for x, *parts in zip(body, *others, strict=True)]


def inside(body: Body, consistency: str) -> list[Fraction] | None:
    """Return the body with its moments raised where it lies on the edge; None where it is none."""
    least = _INSIDE + _SHARE * max(map(abs, body[4:]))
    for step in (0, *(2**k for k in range(_DOUBLINGS))):
        trial = list(body)
        # Second moments of t in all directions are a rotational inertia of 2·t.
        for k in (4, 6, 9):
            trial[k] += step * least * (2 if consistency == "pseudo_inertia" else 1)
        if trial[0] > 0 and has_margin(trial, least, consistency):
            return trial
    return None


def rounded(body: Body) -> Inertial:
    """Return the doubles nearest to mass, center of mass and moments about it."""
    if not any(body):
        return NOTHING
    mass, com, moments = central(body)
    return Inertial(float(mass), tuple(map(float, com)), tuple(map(float, moments)))


def exists(mass: float, moments: Sequence[float], consistency: str) -> bool:
    """Return whether a mass with moments about its center is consistent, exactly."""
    rows = tensor([Fraction(x) for x in moments])
    if consistency == "pseudo_inertia":
        half = (rows[0][0] + rows[1][1] + rows[2][2]) / 2
        rows = [[(half if i == j else 0) - rows[i][j] for j in range(3)] for i in range(3)]
    return mass > 0 and positive_semidefinite(rows)
