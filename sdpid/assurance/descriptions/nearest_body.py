"""The nearest body that can exist, in closed form, with a proof that checks exactly.

A tensor I about the center of mass belongs to some body exactly when its second moments
``P = ½·tr(I)·E − I`` are positive semidefinite (with a positive mass); this is the triangle
inequality of the principal moments together with their sign. The distance is the Frobenius norm
‖X − P‖ of second moments, which does not depend on the axes.

*Theorem (projection onto a shifted cone).* Let ``P = Q·Λ·Q^T`` and ``K = {X : X ⪰ φ·E}``. Then
``X* = Q·max(Λ, φ)·Q^T`` is the one nearest point of K. Proof: ``N = X* − P = Q·max(φ − Λ, 0)·Q^T``
is positive semidefinite, and ``N·(X* − φ·E) = 0`` because for every eigenvalue one factor is zero.
For any X in K therefore ``⟨X − X*, X* − P⟩ = ⟨X − φ·E, N⟩ − ⟨X* − φ·E, N⟩ = ⟨X − φ·E, N⟩ ≥ 0``,
the inner product of two positive semidefinite matrices, and hence
``‖X − P‖² ≥ ‖X* − P‖² + ‖X − X*‖²``.

That is a proof about real numbers; what is written has been rounded. Any N ⪰ 0, right or not,
gives a bound: ``‖X − P‖·‖N‖ ≥ ⟨X − P, N⟩ = ⟨X − φ·E, N⟩ + φ·tr N − ⟨P, N⟩ ≥ φ·tr N − ⟨P, N⟩`` for
all X in K. `prove_nearest` evaluates it in rational arithmetic, for an N that is a sum of squares
and so positive semidefinite beyond doubt, and compares with the exact distance of what was
written.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import CertificateError
from sdpid.verifier.exact import inner, positive_semidefinite

# Second moments of a repaired body are at least this share of the largest eigenvalue, in
# magnitude, of the given ones. Older releases of MuJoCo find principal moments to some 1e-7 only
# and then ask for A + B ≥ C.
RELATIVE_FLOOR = 1e-6
# They are at least those of a ball of this radius (m), so that a point gets an extent.
RADIUS_FLOOR = 1e-4
# And at least this, kg·m²: MuJoCo refuses principal moments below 1e-14.
ABSOLUTE_FLOOR = 1e-12
# The projection aims so much (relative) above the floor that rounding does not go below it.
_ABOVE = 1e-7
# What is written may be farther than the nearest by this share: rounding, and the above.
NEAREST = 1e-6


@dataclass(frozen=True, kw_only=True)
class NearestProof:
    """Exact evidence that a body is the nearest.

    Attributes
    ----------
    distance : float
        ‖X − P‖ of what was written, kg·m².
    lower_bound : float
        No second moments with the floor are nearer than this, kg·m².
    floor : float
        Least eigenvalue that was asked for, kg·m².
    """

    distance: float
    lower_bound: float
    floor: float


def moment_floor(second_moment: Array, mass: float) -> float:
    """Return the least second moment that a repaired body gets, kg·m²."""
    largest = float(np.abs(np.linalg.eigvalsh(second_moment)).max())
    return max(RELATIVE_FLOOR * largest, mass * RADIUS_FLOOR**2, ABSOLUTE_FLOOR)


def aim(floor: float) -> float:
    """Return the floor to project onto, so that what is written stays above `floor`."""
    return floor * (1.0 + _ABOVE)


def prove_nearest(
    given: list[list[Fraction]], written: list[list[Fraction]], floor: Fraction
) -> NearestProof:
    """Prove that `written` is the nearest to `given` among matrices ⪰ `floor`, but for rounding.

    Parameters
    ----------
    given, written : list of list of Fraction
        Second moments (3, 3), exactly.
    floor : Fraction
        The least eigenvalue.

    Returns
    -------
    NearestProof

    Raises
    ------
    CertificateError
        When `written` is below the floor, or something else may be nearer by more than 1e-6 of
        the distance.
    """
    shifted = [[written[i][j] - floor * (i == j) for j in range(3)] for i in range(3)]
    if not positive_semidefinite(shifted):
        raise CertificateError(
            f"nearest body: what was written has second moments below {float(floor):.3g} kg·m²."
        )
    P = np.array([[float(x) for x in row] for row in given])
    values, vectors = np.linalg.eigh(P)
    N = [[Fraction(0)] * 3 for _ in range(3)]
    for value, vector in zip(values, vectors.T, strict=True):
        weight = max(floor - Fraction(float(value)), Fraction(0))
        q = [Fraction(float(x)) for x in vector]
        N = [[N[i][j] + weight * q[i] * q[j] for j in range(3)] for i in range(3)]
    gain = floor * sum(N[i][i] for i in range(3)) - inner(given, N)
    difference = [[written[i][j] - given[i][j] for j in range(3)] for i in range(3)]
    distance2, size2 = inner(difference, difference), inner(N, N)
    # Squared, so that no root has to be taken: bound² = gain²/‖N‖².
    bound2 = gain * gain / size2 if gain > 0 and size2 > 0 else Fraction(0)
    allowed = (1 + Fraction(NEAREST)) ** 2
    if distance2 > allowed * bound2:
        raise CertificateError(
            f"nearest body: the distance is {float(distance2) ** 0.5:.9g} kg·m², proven is only "
            f"that none is below {float(bound2) ** 0.5:.9g}."
        )
    return NearestProof(
        distance=float(distance2) ** 0.5, lower_bound=float(bound2) ** 0.5, floor=float(floor)
    )
