"""The compressed cost against the cost of the rows, for every theta: an enclosure that is proven.

Compressing turns millions of weighted rows into A, rhs and floor, in floating point. How far the
two costs are from each other is bounded here over the whole box of parameters, with every rounding
counted. The proof is in docs/theory ("Compression holds for every theta").
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.threads import one_thread
from sdpid.assurance.certificate.outward import (
    SLACK,
    UNDERFLOW,
    UNIT,
    below_one,
    gamma,
    lengths,
    norm,
    usable,
)
from sdpid.assurance.certificate.row_sums import RowSums
from sdpid.assurance.certificate.whitener_errors import paired
from sdpid.errors import DataError
from sdpid.estimation.compression.covariance import Weighting
from sdpid.estimation.compression.rows import Rows
from sdpid.estimation.problem import Problem

# Costs next to zero are compared with this share of that of the efforts alone, as gaps are.
TINY_COST = 1e-6


# Products of a factor and a matrix that makes its columns orthonormal are of size one: where they
# are added up of numbers this large, rounding counts. Few columns are, and pairs take much longer.
_CANCELING = 1e5


@dataclass(frozen=True)
class Compression:
    """How far the compressed cost is from the cost of the rows, at every theta of a box.

    With f_c the compressed cost and f_rows that of the rows, both of the data alone,
    ``(1 − relative)·f_c − absolute ≤ f_rows ≤ (1 + relative)·f_c + absolute``.

    Attributes
    ----------
    relative, absolute : float
        Infinite where nothing is proven, as when A, rhs and floor are not of these rows.
    """

    relative: float
    absolute: float

    @property
    def proven(self) -> bool:
        """Whether it says anything: from below, costs have to stay above zero."""
        return self.relative < 1.0 and self.absolute < math.inf


UNPROVEN = Compression(math.inf, math.inf)


def prove_compression(problem: Problem) -> Compression | None:
    """Enclose the cost of a problem's rows by its compressed cost, for every theta of its box.

    Of a robust problem the rows are the weighted ones, and its `constant` is added to their cost.
    None where the rows were not kept, and where nothing is proven (see `Compression.proven`).
    """
    if problem.rows is None:
        return None
    limit = base_limit(problem.base.matrix, problem.feasible.lower, problem.feasible.upper)
    floor = max(problem.floor - problem.constant, 0.0)
    rounded = abs(Fraction(problem.floor) - Fraction(problem.constant) - Fraction(floor))
    try:
        found = enclose_compression(
            problem.rows,
            problem.sigma,
            problem.weighting,
            A=problem.A,
            rhs=problem.rhs,
            floor=floor,
            base_limit=limit,
        )
    except DataError:
        # Weights of a robust loss can be too far from each other for a covariance of samples.
        return None
    absolute = SLACK * (found.absolute + float(rounded))
    return Compression(found.relative, absolute) if found.proven else None


def base_limit(matrix: Array, lower: Array, upper: Array) -> Array:
    """Return how large base parameters B·theta (b,) can be within bounds on theta, rounded up."""
    largest = np.maximum(np.abs(lower), np.abs(upper))
    return np.asarray(SLACK * (np.abs(matrix) @ largest))


@one_thread
def enclose_compression(
    rows: Rows,
    sigma: Array,
    weighting: Weighting,
    *,
    A: Array,
    rhs: Array,
    floor: float,
    base_limit: Array,
) -> Compression:
    """Enclose the cost of rows by a compressed one, ``‖A @ base − rhs‖² + floor``.

    Parameters
    ----------
    rows : Rows
        Any rows, here or on a cluster: not only those that A, rhs and floor were made of.
    sigma : ndarray, shape (n, n) or (K, n, n)
        Their covariance, symmetric: of each the lower triangle counts.
    weighting : {"gls", "gls_per_sample", "eq9", "eq18", "residual"}
        What the cost of the rows is (see `sdpid.build_problem`).
    A : ndarray, shape (b, b)
    rhs : ndarray, shape (b,)
    floor : float
        The compressed cost.
    base_limit : ndarray, shape (b,)
        The largest size of each base parameter for which it has to hold.

    Returns
    -------
    Compression
    """
    normal = weighting in ("eq9", "eq18")
    # The cost of normal equations has no floor; a compressed one that has is off by it.
    compressed = _Compressed.of(A, rhs, 0.0 if normal else floor, base_limit)
    if compressed is None or floor < 0.0:
        return UNPROVEN
    M = compressed.M
    if normal:
        sums = RowSums.of(rows, sigma, -0.25 if weighting == "eq9" else -0.5)
        share = _of_normal_equations(sums, compressed) if sums.usable else math.inf
        weight, constant = 0.0, abs(floor)
    else:
        sums = RowSums.of(rows, sigma, -0.5, M)
        share = _of_squares(sums, compressed) if sums.usable else math.inf
        weight, constant = sums.weight, 0.0
    if not share + weight < 1.0:
        return UNPROVEN
    relative = SLACK * (share + weight + share * weight)
    absolute = SLACK * (1.0 + weight) * share * compressed.slack + constant
    return Compression(relative, SLACK * absolute)


@dataclass(frozen=True, eq=False)
class _Compressed:
    """A compressed cost ``‖R·z‖²``, z = (base, −1), and coordinates in which it is nearly ‖w‖².

    Attributes
    ----------
    R : ndarray, shape (b + 1, b + 1)
        ``[A rhs; 0 √floor]``, the root rounded.
    M : ndarray, shape (b + 1, b + 1)
        z = M·w.
    off : float
        ``‖M^T·(R^T·R + D²)·M − E‖`` is at most this, below 1/2.
    slack : float
        ``‖D·z‖²`` is at most this in the box.
    """

    R: Array
    M: Array
    off: float
    slack: float

    @classmethod
    def of(cls, A: Array, rhs: Array, floor: float, base_limit: Array) -> _Compressed | None:
        """Choose D and M; None where no M is good enough."""
        count = len(rhs) + 1
        R = np.zeros((count, count))
        R[:-1, :-1], R[:-1, -1] = A, rhs
        R[-1, -1] = math.sqrt(max(floor, 0.0))
        if not (floor >= 0.0 and usable(R)):
            return None
        limit = np.append(base_limit, 1.0)
        D = _small(R, limit)
        both = np.vstack([R, np.diag(D)])
        M = _inverse(both)
        if M is None or not usable(both, M):
            return None
        gram, error = _gram(both, M)
        # The root's square is off by three roundings of the floor.
        off = norm(gram - np.eye(count)) + error + _root_error(R, M)
        # Without a limit there is no D, and 0·∞ is zero.
        slack = SLACK * norm(np.multiply(D, limit, where=D > 0.0, out=np.zeros(count))) ** 2
        return cls(R, M, off, slack) if below_one(off) else None

    @property
    def least(self) -> float:
        """``‖R·z‖² + ‖D·z‖²`` is at least this times ‖w‖²."""
        return float(below_one(self.off))


def _small(R: Array, limit: Array) -> Array:
    """Return columns' weights D so small that ``‖D·z‖²`` is no more than the least cost.

    They make directions definite that no data show. None is above the size of its own column, or
    above 1 where the column is zero: a base parameter may be zero in the whole box.
    """
    efforts = float(np.sum(np.square(R[:, -1])))
    own = np.sqrt(np.einsum("ij,ij->j", R, R))
    most = own + (own == 0.0)
    # Beside columns that depend on each other, what no parameter explains is not in the floor
    # alone.
    columns, left = R[:, :-1] / most[:-1], R[:, -1]
    left = left - columns @ np.linalg.lstsq(columns, left)[0]
    scale = max(float(np.sum(np.square(left))), TINY_COST * efforts) or 1.0
    share = math.sqrt(scale / len(limit))
    return np.asarray(share / np.maximum(limit, share / most))


def _inverse(factor: Array) -> Array | None:
    """Return M with factor·M nearly orthonormal; any M will do for the proof, but not all as well.

    As in `Triangle`: with columns of unit norm first, so that rounding in X·M is of their size.
    """
    sizes = np.sqrt(np.einsum("ij,ij->j", factor, factor))
    if not np.all(sizes > 0.0):
        return None
    try:
        _, s, Vt = np.linalg.svd(factor / sizes, full_matrices=False)
    except np.linalg.LinAlgError:
        return None
    return np.asarray((Vt.T / np.maximum(s, UNIT * s[0])) / sizes[:, None])


def _gram(factor: Array, M: Array) -> tuple[Array, float]:
    """Return (factor·M)^T·(factor·M) and a bound of the norm of its error.

    Columns of products that cancel are added up in pairs of doubles.
    """
    count = len(factor)
    product = factor @ M
    sizes = lengths(factor) @ np.abs(M)
    moved = gamma(count) * sizes
    some = np.flatnonzero(sizes > _CANCELING)
    if len(some):
        (high, low), left = paired(factor[None], M[None][:, :, some])
        product[:, some] = high[0] + low[0]
        # The sum is rounded once.
        moved[some] = lengths(left[0] + 2.0 * UNIT * np.abs(product[:, some]))
    shift = norm(moved)
    gram = product.T @ product
    rounding = gamma(count) * norm(product) ** 2
    error = (2.0 * _root(gram, rounding) + shift) * shift + rounding
    return gram, SLACK * error + UNDERFLOW


def _root(gram: Array, error: float) -> float:
    """Bound the spectral norm of the matrix with this Gram matrix, known to an error."""
    return SLACK * math.sqrt(float(np.abs(gram).sum(axis=0).max()) + error)


def _root_error(R: Array, M: Array) -> float:
    """Return how far the rounding of √floor moves M^T·R^T·R·M at most."""
    return 4.0 * UNIT * (abs(float(R[-1, -1])) * norm(M[-1])) ** 2


def _of_squares(sums: RowSums, compressed: _Compressed) -> float:
    """Bound |‖X·z‖² − ‖R·z‖²| by a share of ‖R·z‖² + ‖D·z‖².

    It is ``w^T·(M^T·X^T·X·M − M^T·R^T·R·M)·w``, and ‖w‖² is bounded by ‖R·z‖² + ‖D·z‖².
    """
    R, M = compressed.R, compressed.M
    gram, error = _gram(R, M)
    # ‖fl(X·M) − X·M‖, from the rounding of the rows and from that of the product.
    moved = sums.moved + gamma(len(R)) * sums.lengths
    shift = SLACK * norm(moved @ np.abs(M))
    summed = sums.rounding * sums.squares
    total = norm(sums.gram - gram) + error + summed
    total += (2.0 * _root(sums.gram, summed) + shift) * shift
    total += _root_error(R, M) + UNDERFLOW
    return SLACK * total / compressed.least


def _of_normal_equations(sums: RowSums, compressed: _Compressed) -> float:
    """Bound |‖G·z‖² − ‖R·z‖²| by a share of ‖R·z‖² + ‖D·z‖², G being the rows' W^T·Omega·(W, Y).

    With ‖(G − R)·M‖ ≤ h, ‖G·z‖ is within h·‖w‖ of ‖R·z‖.
    """
    R, M = compressed.R[:-1], compressed.M
    left, larger = sums.gram[:-1] - R, 1.0 + sums.weight
    off = norm(left @ M) + gamma(len(M) + 1) * norm(np.abs(left) @ np.abs(M)) + UNDERFLOW
    for share, sizes in ((larger * sums.rounding, sums.lengths), (1.0, sums.off_lengths)):
        off += SLACK * share * norm(sizes[:-1]) * norm(sizes @ np.abs(M))
    h = SLACK * off / math.sqrt(compressed.least)
    return SLACK * (2.0 + h) * h
