"""Bodies in robot files: ten parameters, or mass, center of mass and inertia about it, exactly.

A body is (m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) about a joint's frame. A file has the mass,
the center of mass and the inertia about it, each number the double nearest to what the parameters
give in exact arithmetic. On the edge of consistency, where rounding could make a body that readers
refuse, moments about the center of mass are raised first (`inside`).
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple, TypeVar

from sdpid.robot.inertia import TENSOR_INDEX
from sdpid.verifier.bodies import has_margin
from sdpid.verifier.exact import positive_semidefinite

# Readers reject a body that rounding has put on the edge (MuJoCo: principal moments below 1e-14
# kg·m², or a triangle inequality missed by one bit). Written bodies are this far inside, kg·m²,
# and by this share of their largest moment; it changes efforts by some 1e-13 N·m.
_INSIDE, _SHARE = Fraction(1e-13), Fraction(1e-14)

# Parameters may be outside by a solver's rounding, which so many doublings outgrow.
_DOUBLINGS = 20

# Names of the six moments, in the order of their places `TENSOR_INDEX`.
TENSOR_NAMES = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")

Body = Sequence[Fraction]
Number = TypeVar("Number", float, Fraction)


class Inertial(NamedTuple):
    """Mass in kg, center of mass in m, inertia about it in kg·m², along the frame's axes."""

    mass: float
    com: tuple[float, ...]
    moments: tuple[float, ...]

    def named(self) -> dict[str, float]:
        """Return every number by name."""
        names = ("mass", "x", "y", "z", *TENSOR_NAMES)
        return dict(zip(names, (self.mass, *self.com, *self.moments), strict=True))


NOTHING = Inertial(0.0, (0.0,) * 3, (0.0,) * 6)


def tensor(moments: Sequence[Number]) -> list[list[Number]]:
    """Return the rows of the tensor with six moments."""
    xx, xy, yy, xz, yz, zz = moments
    return [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]


def second_moment(moments: Sequence[Fraction]) -> list[list[Fraction]]:
    """Return the rows of ``½·tr(I)·E − I`` exactly."""
    rows = tensor(moments)
    half = (rows[0][0] + rows[1][1] + rows[2][2]) / 2
    return [[half * (i == j) - rows[i][j] for j in range(3)] for i in range(3)]


def central(body: Sequence[float | Fraction]) -> tuple[Fraction, list[Fraction], list[Fraction]]:
    """Return mass, center of mass and moments about it, exactly; the mass must not be zero."""
    mass, *others = (Fraction(x) for x in body)
    com = [h / mass for h in others[:3]]
    square = sum(c * c for c in com)
    moments = [
        value - mass * ((square if i == j else 0) - com[i] * com[j])
        for value, (i, j) in zip(others[3:], TENSOR_INDEX, strict=True)
    ]
    return mass, com, moments


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


def exists(mass: float, moments: Sequence[float | Fraction], consistency: str) -> bool:
    """Return whether a mass with moments about its center is consistent, exactly."""
    exact = [Fraction(x) for x in moments]
    rows = second_moment(exact) if consistency == "pseudo_inertia" else tensor(exact)
    return mass > 0 and positive_semidefinite(rows)
