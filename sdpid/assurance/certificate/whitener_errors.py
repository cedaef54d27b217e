"""How near computed powers of covariances are to exact ones.

A sample's weight is Sigma^(2e), e being -1/2 or -1/4. What computers have is V with
``V^T·V ≈ Sigma^(2e)``. How near is found for each V from ``V·Sigma·V^T − E``, not taken from the
way in which V was made. That difference is small beside its terms, so that they are added up in
pairs of doubles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.certificate.outward import (
    SLACK,
    UNDERFLOW,
    UNIT,
    below_one,
    gamma,
    quotient,
    usable,
)

# A double times this, less what it is too large by, has half the digits [ogita2005]_.
_SPLIT = 2.0**27 + 1.0

# Errors of a product of pairs, in squares of the error of a plain one. Of a product of doubles
# there is one for the sum of the roundings; others come from the two small parts, from their
# product, which is left out, and from what five factors bring along.
_PAIRED = 32.0

# A number and what is missing in it.
Pair = tuple[Array, Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class WhitenerErrors:
    """Errors of m powers V of covariances: ``Sigma^(2e) = V^T·(E + J)·V``.

    Attributes
    ----------
    weight : ndarray, shape (m,)
        Bounds of ‖J‖; infinite where none is found.
    nearly : ndarray, shape (m, n, n)
        What J nearly is, symmetric.
    rest : ndarray, shape (m,)
        Bounds of ‖J − nearly‖.
    rounding : ndarray, shape (m,)
        ``V·rows`` as computed is off by at most this share of its norm.
    """

    weight: Array
    nearly: Array
    rest: Array
    rounding: Array

    @classmethod
    def of(cls, powers: Array, sigma: Array, used: Mask, exponent: float) -> WhitenerErrors:
        """Compare powers with their covariances.

        With ``V·Sigma·V^T = E + H`` and ‖H‖ ≤ d < 1, ``Sigma^-1 = V^T·(E + H)^-1·V``, so that
        ‖J‖ ≤ d/(1 − d), and ``J = −H`` up to d²/(1 − d). For e = -1/4 the first bound follows from
        ``T·Sigma·T = E + H``, ``T = V^T·V``: with S the root of Sigma, the eigenvalues of T·S are
        those of the positive definite ``N = V·S·V^T`` and lie between the singular values of T·S,
        which are the roots of the eigenvalues of E + H; and ``S^-1 = V^T·N^-1·V``. There J is
        nearly a first-order solution K, and the same bound for ``C^T·V`` in place of V, with
        ``C·C^T = E + K``, gives ``‖J − K‖ ≤ (1 + ‖K‖)·d'/(1 − d')``.

        Rounding in ``V·rows`` is at most a multiple of ``|V|·|rows| ≤ |V|·|V^-1|·|V·rows|``.

        Parameters
        ----------
        powers : ndarray, shape (m, n, n)
            V, zero in rows and columns that are not used.
        sigma : ndarray, shape (n, n) or (m, n, n)
            Covariances, of which the lower triangles count.
        used : ndarray of bool, shape (m, n)
            Rows that are used.
        exponent : float
            e.
        """
        n = used.shape[1]
        both = used[:, :, None] & used[:, None, :]
        lower = np.tril(sigma)
        S: Array = np.where(both, lower + np.swapaxes(np.tril(sigma, -1), -1, -2), 0.0)
        filled = powers + np.eye(n) * ~used[:, None, :]
        try:
            inverse = np.asarray(np.linalg.inv(filled), dtype=np.float64)
        except np.linalg.LinAlgError:
            inverse = np.full(filled.shape, np.inf)
        if not usable(S, powers, inverse):
            nothing = np.full(len(used), np.inf)
            return cls(weight=nothing, nearly=np.zeros_like(powers), rest=nothing, rounding=nothing)
        H, error = _defect(powers, S, used, exponent, np.zeros_like(powers))
        off = _norms(np.abs(H) + error)
        weight = quotient(off, below_one(off))
        if exponent == -0.5:
            nearly = -0.5 * (H + _turned(H))
            rest = _norms(error + np.abs(H + nearly)) + off * weight
        else:
            nearly = _first_order(filled, H)
            left = _norms(np.add(*map(np.abs, _defect(powers, S, used, exponent, nearly))))
            # Less than 1/2, K leaves E + K positive definite.
            size = quotient(1.0 + _norms(nearly), below_one(_norms(nearly)) > 0.0)
            rest = size * quotient(left, below_one(left))
        enlarged = np.abs(filled) @ np.abs(inverse)
        wrong = _norms(np.abs(np.eye(n) - filled @ inverse) + gamma(n + 1) * enlarged)
        moved = gamma(n + 1) * quotient(_norms(enlarged), below_one(wrong))
        return cls(
            weight=weight,
            nearly=nearly,
            rest=SLACK * rest,
            rounding=quotient(moved, below_one(moved)),
        )


def _first_order(V: Array, H: Array) -> Array:
    """Return K with ``V^T·(E + K)·V·Sigma·V^T·(E + K)·V ≈ E``, H being what is left without K.

    To first order ``V·K·V^-1 + V^-1·K·V = −H``, as V is symmetric but for rounding.
    """
    values, vectors = np.linalg.eigh(V)
    ratio = values[:, :, None] / values[:, None, :]
    turned = _turned(vectors) @ H @ vectors
    K = -vectors @ (turned / (ratio + _turned(ratio))) @ _turned(vectors)
    return np.asarray(0.5 * (K + _turned(K)))


def _defect(V: Array, S: Array, used: Mask, exponent: float, K: Array) -> Pair:
    """Return ``T·S·T^T − E``, T being V or V^T·(E + K)·V, and a bound of each entry's error."""
    zero = np.zeros_like(V)
    T, size = (V, zero), np.abs(V)
    if exponent != -0.5:
        one = np.eye(V.shape[1])
        between = one + K
        middle = between, K - (between - one)
        T = _product((_turned(V), zero), _product(middle, (V, zero)))
        size = _turned(size) @ (np.abs(one) + np.abs(K)) @ size
    high, low = _product(T, _product((S, np.zeros_like(S)), (_turned(T[0]), _turned(T[1]))))
    # The products are near one or zero: nothing is lost.
    above = high - np.eye(V.shape[1]) * used[:, None, :]
    paired = _PAIRED * gamma(4 * V.shape[1] + 4) ** 2
    error = 2.0 * UNIT * (np.abs(above) + np.abs(low)) + paired * (size @ np.abs(S) @ _turned(size))
    return above + low, SLACK * error + UNDERFLOW


def paired(V: Array, A: Array) -> tuple[Pair, Array]:
    """Return the products of matrices (m, s, n) and (m, n, r) in pairs, and bounds of errors."""
    found = _product((V, np.zeros_like(V)), (A, np.zeros_like(A)))
    share = _PAIRED * gamma(4 * V.shape[2] + 4) ** 2
    return found, SLACK * share * (np.abs(V) @ np.abs(A)) + UNDERFLOW


def _product(A: Pair, B: Pair) -> Pair:
    """Return the product of matrices in pairs: sums with their errors [ogita2005]_."""
    low = A[0] @ B[1] + A[1] @ B[0]
    high = np.zeros_like(low)
    for k in range(A[0].shape[-1]):
        term, missing = _times(A[0][:, :, k, None], B[0][:, k, None, :])
        new = high + term
        seen = new - high
        low += ((high - (new - seen)) + (term - seen)) + missing
        high = new
    return high, low


def _times(a: Array, b: Array) -> Pair:
    """Return products and what they are rounded by."""
    product = a * b
    (a_high, a_low), (b_high, b_low) = _halves(a), _halves(b)
    missing = a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)
    return product, missing


def _halves(a: Array) -> Pair:
    """Return doubles as sums of two with half the digits."""
    scaled = _SPLIT * a
    high = scaled - (scaled - a)
    return high, a - high


def _turned(matrices: Array) -> Array:
    """Return transposed matrices."""
    return np.swapaxes(matrices, -1, -2)


def _norms(matrices: Array) -> Array:
    """Return the Frobenius norms of some matrices, rounded up."""
    return np.asarray(SLACK * np.sqrt(np.sum(np.square(matrices), axis=(1, 2))))
