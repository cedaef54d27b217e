"""Choose the strength of a prior by the evidence, the marginal likelihood of the data."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array

# Strengths that are tried, nats: beyond these the data or the prior have nothing left to say.
WEAKEST, STRONGEST = 1e-2, 1e2

# Strengths per decade of the first search; the evidence is smooth on that scale.
_PER_DECADE = 6

# Directions that neither data nor prior know are left out: singular values of the stacked rows,
# columns scaled to unit length, are of order one or rounding there.
_UNKNOWN = 1e-10


def negative_log_evidence(
    data: tuple[Array, Array],
    links: tuple[Array, Array],
    others: tuple[Array, Array],
    strengths: Array,
) -> Array:
    """Return −log of the marginal likelihood for each strength, up to a constant.

    With normal noise and a normal prior it has a closed form:
    ``½·min_theta (‖G·theta − h‖² + λ‖R·theta − r‖² + ‖F·theta − f‖²) + ½·log det(G^T·G + λ·R^T·R
    + F^T·F) − ½·rank(R)·log λ``; the determinant is that on the directions that rows determine.

    Parameters
    ----------
    data : tuple of ndarray
        G (rows, p) and h, whitened.
    links : tuple of ndarray
        R (k, p), of full row rank, and r, at strength one.
    others : tuple of ndarray
        F and f: rows whose strength is not in question.
    strengths : ndarray, shape (m,)
        Values of λ.

    Returns
    -------
    ndarray, shape (m,)
    """
    (G, h), (R, r), (F, f) = data, links, others
    stacked = np.vstack([G, F, R])
    scale = np.linalg.norm(stacked, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    _, singular, rows = np.linalg.svd(stacked / scale, full_matrices=False)
    known = rows[singular > _UNKNOWN * singular[0]].T / scale[:, None]
    fixed = np.column_stack([np.vstack([G, F]) @ known, np.concatenate([h, f])])
    # Once: the rows that do not change with the strength, as a small triangle.
    fixed = np.asarray(np.linalg.qr(fixed, mode="r"))
    scaled = np.column_stack([R @ known, r])
    out = np.empty(len(strengths))
    count = known.shape[1]
    for k, strength in enumerate(strengths):
        stack = np.vstack([fixed, np.sqrt(strength) * scaled])
        triangle = np.asarray(np.linalg.qr(stack, mode="r"))
        diagonal = np.abs(np.diagonal(triangle))
        rest = float(np.sum(triangle[count:, count] ** 2))
        out[k] = 0.5 * rest + float(np.log(diagonal[:count]).sum())
        out[k] -= 0.5 * len(R) * np.log(strength)
    return out


def strength_by_evidence(
    data: tuple[Array, Array], links: tuple[Array, Array], others: tuple[Array, Array]
) -> float:
    """Return the strength between 0.01 and 100 nats of the largest marginal likelihood.

    Of the problem without constraints, and of the rows that are given alone: no validation data
    are looked at. A grid comes first, since there may be several maxima, then a line search.

    Parameters
    ----------
    data, links, others : tuple of ndarray
        See `negative_log_evidence`.
    """
    from scipy.optimize import minimize_scalar

    low, high = np.log(WEAKEST), np.log(STRONGEST)
    count = round(_PER_DECADE * (high - low) / np.log(10.0)) + 1
    grid = np.linspace(low, high, count)
    best = int(np.argmin(negative_log_evidence(data, links, others, np.exp(grid))))
    found = minimize_scalar(
        lambda x: float(negative_log_evidence(data, links, others, np.exp([x]))[0]),
        bounds=(grid[max(best - 1, 0)], grid[min(best + 1, count - 1)]),
        method="bounded",
        options={"xatol": 1e-3},
    )
    return float(np.exp(found.x))
