"""How near computed weights of samples in contact are to exact ones.

With the covariance C of a sample's rows and the efforts A (n, r) of forces that nobody measured,
its weight is ``Omega = N·(N^T·C·N)^-1·N^T``, the columns of N spanning what is orthogonal to A
(`sdpid.estimation.compression.contact_rows`). What computers have is V of as many rows, with
``V·A ≈ 0`` and ``V·C·V^T ≈ E``. Both are found from V itself, not taken from the way it was made.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.assurance.certificate.outward import (
    SLACK,
    UNDERFLOW,
    UNIT,
    below_one,
    gamma,
    quotient,
    usable,
)
from sdpid.assurance.certificate.whitener_errors import paired
from sdpid.estimation.compression.contact_rows import RANK, ContactRows
from sdpid.estimation.compression.whitening import weights

# Below this share of the largest entry of a triangle's diagonal, columns may repeat each other.
_SUSPICIOUS = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactWhiteners:
    """Weights of g samples that lose as many directions, and their errors.

    There is a T near V with ``Omega = T^T·(E + J)·T``.

    Attributes
    ----------
    some : ndarray of int, shape (g,)
        Which samples.
    V, rest : ndarray, shape (g, s, n)
        Whiteners, zero in columns of rows that are not used, are the sums of these. Of directions
        that are all but dependent, doubles alone would leave too much.
    weight : ndarray, shape (g,)
        Bounds of ‖J‖; infinite where none is found.
    shift : ndarray, shape (g,)
        ``V·w`` is off from ``T·w`` by at most this times ‖G·w‖, for any column w.
    G : ndarray, shape (g, r, n)
        Nearly what the forces that explain a residual w best are of it, but for their sign.
    grown, lean : ndarray, shape (g,)
        They are at most ``grown·‖G·w‖ + lean·‖w‖`` in size, ‖w‖² being ``w^T·C^-1·w``.
    force : ndarray, shape (g,)
        And at most ``force·‖w‖``.
    """

    some: Indices
    V: Array
    rest: Array
    weight: Array
    shift: Array
    G: Array
    grown: Array
    lean: Array
    force: Array

    @property
    def rank(self) -> int:
        """How many directions of forces each sample loses."""
        return int(self.G.shape[1])

    def times(self, W: Array) -> Array:
        """Return whitened columns (g, s, c) of columns (g, n, c)."""
        return np.asarray(self.V @ W + self.rest @ W)

    def moved(self, W: Array) -> Array:
        """Return what `times` is off from T times columns (g, n, c) at most, (g, c)."""
        sizes, rounding = np.abs(W), gamma(W.shape[1] + 1)
        of_product = rounding * _lengths((np.abs(self.V) + np.abs(self.rest)) @ sizes)
        forces = np.abs(self.G @ W) + rounding * (np.abs(self.G) @ sizes)
        return np.asarray(SLACK * (of_product + self.shift[:, None] * _lengths(forces)))


def contact_whiteners(
    touching: ContactRows, sigma: Array, mask: Mask
) -> Iterator[ContactWhiteners]:
    """Yield weights of some samples, and how near they are.

    Let G be any matrix with ``G·A = E + F``, ‖F‖ < 1: then A has full rank, and
    ``T = V − D·G'`` with ``D = V·A`` and ``G' = (E + F)^-1·G`` has ``T·A = 0``. With ``H = T·C·T^T
    − E``, ‖H‖ ≤ d < 1, its rows span what is orthogonal to A, so that ``Omega = T^T·(E + H)^-1·T``
    and ‖J‖ ≤ d/(1 − d).

    Where contacts repeat each other, A are as many of their directions as are independent.

    Parameters
    ----------
    touching : ContactRows
        Contacts of k samples.
    sigma : ndarray, shape (n, n) or (k, n, n)
        Covariances of efforts, of which the lower triangles count.
    mask : ndarray of bool, shape (k, n)
        Rows that are used.
    """
    own = sigma if touching.covariance is None else sigma + touching.covariance
    powers, index = touching.roots(*weights(sigma, mask))
    for some, A, P, used in _groups(touching, powers[index], mask):
        each = own[some] if own.ndim == 3 else own[None]
        lower = np.tril(each)
        both = used[:, :, None] & used[:, None, :]
        C = np.where(both, lower + np.swapaxes(np.tril(each, -1), -1, -2), 0.0)
        yield _of(some, A, P, used, C)


def _groups(
    touching: ContactRows, P: Array, mask: Mask
) -> Iterator[tuple[Indices, Array, Array, Mask]]:
    """Yield samples that lose as much, their independent directions, roots and rows in use."""
    n = mask.shape[1]
    masked, active = n - np.count_nonzero(mask, axis=1), np.count_nonzero(touching.active, axis=1)
    # The columns that are active come first, in their order.
    order = np.argsort(~touching.active, axis=1, kind="stable")
    for left_out, m in np.unique(np.column_stack([masked, active]), axis=0).tolist():
        some = np.flatnonzero((masked == left_out) & (active == m))
        own = mask[some]
        A = np.take_along_axis(touching.directions[some], order[some, None, :m], axis=2)
        A = np.where(own[:, :, None], A, 0.0)
        B = P[some] @ A
        sure = _clear(B)
        if sure.any():
            yield some[sure], A[sure], P[some[sure]], own[sure]
        kept = [_independent(each) for each in B[~sure]]
        ranks = np.array([len(each) for each in kept], dtype=np.intp)
        for rank in np.unique(ranks).tolist():
            few = np.flatnonzero(ranks == rank)
            chosen = np.array([kept[i] for i in few], dtype=np.intp).reshape(len(few), 1, rank)
            at = np.flatnonzero(~sure)[few]
            yield some[at], np.take_along_axis(A[at], chosen, axis=2), P[some[at]], own[at]


def _clear(B: Array) -> Mask:
    """Return whether columns (g, n, m) are clearly independent."""
    _, n, m = B.shape
    if m > n:
        return np.zeros(len(B), dtype=np.bool_)
    if not m:
        return np.ones(len(B), dtype=np.bool_)
    length = np.sqrt(np.einsum("gnm,gnm->gm", B, B))
    R = np.linalg.qr(B / np.where(length > 0.0, length, 1.0)[:, None, :], mode="r")
    least: Array = np.abs(np.diagonal(R, axis1=1, axis2=2)).min(axis=1)
    return np.asarray(least >= _SUSPICIOUS, dtype=np.bool_)


def _independent(B: Array) -> Indices:
    """Return which columns of a matrix (n, m) are independent, in their order."""
    from scipy.linalg import qr

    length = np.sqrt(np.einsum("nm,nm->m", B, B))
    scaled = B / np.where(length > 0.0, length, 1.0)
    # As many as the rows themselves lose: the cost of another rank is another one.
    size = np.linalg.svd(scaled, compute_uv=False)
    rank = int(np.count_nonzero(size > RANK * size[:1]))
    _, order = qr(scaled, mode="r", pivoting=True)
    return np.asarray(np.sort(order[:rank]), dtype=np.intp)


def _of(some: Indices, A: Array, P: Array, used: Mask, C: Array) -> ContactWhiteners:
    """Return weights of samples with independent directions A (g, n, r)."""
    V, G = _made(A, P, used)
    if not usable(V, G, C, A):
        weight = np.full(len(some), np.inf)
        return ContactWhiteners(
            some=some,
            V=np.zeros_like(V),
            rest=np.zeros_like(V),
            weight=weight,
            shift=np.zeros(len(some)),
            G=np.zeros_like(G),
            grown=weight,
            lean=weight,
            force=weight,
        )
    n, one = A.shape[1], np.eye(A.shape[2])
    absA, absG, absC = (np.abs(each) for each in (A, G, C))
    F = _norms(np.abs(G @ A - one) + gamma(n + 1) * (absG @ absA + one))
    rest, left_over = _refined(V, A, G)
    D = _norms(left_over)
    # Bounds ‖D·(E + F)^-1‖.
    d = quotient(D + UNDERFLOW, below_one(F + UNDERFLOW))
    # The sum is rounded once.
    both = V + rest
    absV = np.abs(both)
    sizes = absV @ absC
    left = both @ C @ _turned(both) - np.eye(V.shape[1])
    chi = _norms(np.abs(left) + gamma(2 * n + 4) * (sizes @ _turned(absV) + np.eye(V.shape[1])))
    spread = _norms(absG @ absC @ _turned(absG))
    # As G finds the forces that leave least, G·C·V^T is next to nothing.
    apart = np.abs(G @ C @ _turned(both)) + gamma(2 * n + 2) * _turned(sizes @ _turned(absG))
    moved = 2.0 * d * _norms(apart) + d**2 * spread
    off = np.where(np.isfinite(d), chi + np.where(np.isfinite(moved), moved, np.inf), np.inf)
    off = SLACK * off + UNDERFLOW
    d = np.where(np.isfinite(d), d, 0.0)
    grown = quotient(1.0, below_one(F + UNDERFLOW))
    # Of all left inverses the one that finds the best forces has the least G·C·G^T, and no part in
    # T: with G' as above it is ``G' − G'·C·T^T·(E + H)^-1·T``.
    lean = SLACK * (_norms(apart) + d * spread) * np.where(np.isfinite(grown), grown, 0.0)
    return ContactWhiteners(
        some=some,
        V=V,
        rest=rest,
        weight=quotient(off, below_one(off)),
        shift=SLACK * d,
        G=G,
        grown=grown,
        lean=np.where(np.isfinite(grown), quotient(lean, below_one(off)), np.inf),
        force=quotient(SLACK * np.sqrt(spread), below_one(F + UNDERFLOW)),
    )


def _refined(V: Array, A: Array, G: Array) -> tuple[Array, Array]:
    """Return what to add to V, for V·A to vanish, and bounds of what is then left of it."""
    (high, low), error = paired(V, A)
    rest = -(high + low) @ G
    taken = rest @ A
    size = np.abs(rest) @ np.abs(A)
    left = np.abs(high + taken + low)
    rounding = gamma(A.shape[1] + 3) * (size + np.abs(low)) + 4.0 * UNIT * np.abs(high)
    return rest, SLACK * (left + rounding + error)


def _made(A: Array, P: Array, used: Mask) -> tuple[Array, Array]:
    """Return V (g, s, n) and a left inverse G (g, r, n) of A: any will do, but not as well."""
    g, n, r = A.shape
    count = n - int(np.count_nonzero(used[0]))
    # A row that is not used is a direction, too.
    left_out = np.argsort(used, axis=1, kind="stable")[:, :count]
    units = np.swapaxes(np.eye(n)[left_out], 1, 2)
    B = P @ A
    length = np.sqrt(np.einsum("gnr,gnr->gr", B, B))
    length = np.where(length > 0.0, length, 1.0)
    both = np.concatenate([units, B / length[:, None, :]], axis=2)
    if not np.isfinite(both).all():
        return np.full((g, n - count - r, n), np.inf), np.zeros((g, r, n))
    Q, R = np.linalg.qr(both, mode="complete")
    kept = slice(count, count + r)
    try:
        inverse = np.linalg.solve(R[:, kept, kept], np.swapaxes(Q[:, :, kept], 1, 2))
    except np.linalg.LinAlgError:
        inverse = np.zeros((g, r, n))
    G = (inverse @ P) / length[:, :, None]
    V = np.swapaxes(Q[:, :, count + r :], 1, 2) @ P
    return V * used[:, None, :], G * used[:, None, :]


def _lengths(columns: Array) -> Array:
    """Return the norms of some columns (g, s, c), rounded up."""
    return np.asarray(SLACK * np.sqrt(np.einsum("gsc,gsc->gc", columns, columns)))


def _turned(matrices: Array) -> Array:
    """Return transposed matrices."""
    return np.swapaxes(matrices, -1, -2)


def _norms(matrices: Array) -> Array:
    """Return the Frobenius norms of some matrices, rounded up."""
    return np.asarray(SLACK * np.sqrt(np.sum(np.square(matrices), axis=(1, 2))))
