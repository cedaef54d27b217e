"""Hit-and-run: draws from a density inside of walls, without a step size [smith1984]_.

Many chains at once. In every step each chain draws a point on a line through the present one, as
the density says along the line. Where the line meets a matrix inequality is a generalized
eigenvalue, so the part of it that is inside is known. The lines of a sweep are conjugate in the
covariance of the directions: where that is the density's own and the density is Gaussian, a sweep
ends at a point that is independent of the one it began with.
"""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.sampling.density import Density

# Trials on a line, each of which leaves less of it; beyond, a chain stays where it is.
_TRIALS = 60

# In place of nothing, as a divisor.
_TINY = 1e-300

# A level is met but for rounding.
_ROUNDING = 1e-9


def hit_and_run(
    density: Density,
    x: Array,
    *,
    covariance: Array,
    rng: np.random.Generator,
    count: int,
    sweeps: int = 1,
) -> Array:
    """Return the points (count, C, n) of chains, one after every so many sweeps.

    Parameters
    ----------
    density : Density
        The density.
    x : ndarray, shape (C, n)
        Where the chains begin: points inside.
    covariance : ndarray, shape (n, n)
        Of the directions. Any leaves the density as it is; with one near its own chains move
        furthest.
    rng : numpy.random.Generator
        Of directions and points.
    count, sweeps : int
        Points of each chain, and sweeps from one to the next.
    """
    root = np.linalg.cholesky(covariance)
    found = np.empty((count, *x.shape))
    for i in range(count):
        for _ in range(sweeps):
            turned, _ = np.linalg.qr(rng.standard_normal(root.shape))
            x = _swept(density, x, turned @ root.T, rng)
        found[i] = x
    return found


def _swept(density: Density, x: Array, directions: Array, rng: np.random.Generator) -> Array:
    """Return where chains (C, n) are after a step along each of some directions (k, n)."""
    # From the points themselves in every sweep, so that roundings do not add up.
    matrices = [each for each in density.matrices if len(each)]
    here, pulls = [each.at(x) for each in matrices], directions @ density.precision
    roots, steps = _roots(here), [each.along(directions) for each in matrices]
    strength = density.strength if len(density.bodies) else 0.0
    for k, v in enumerate(directions):
        # The line is inside at t where 1 + t·rate is positive for all of these.
        rates = [
            relative_eigenvalues(L, D[k]).reshape(len(x), -1)
            for L, D in zip(roots, steps, strict=True)
        ]
        bodies = rates[-1] if strength else np.zeros((len(x), 0))
        slope = (x - density.mean) @ pulls[k] + density.slope @ v
        t = drawn_on_lines(slope, float(pulls[k] @ v), strength, bodies, np.hstack(rates), rng)
        moved = [F + t[:, None, None, None] * D[k] for F, D in zip(here, steps, strict=True)]
        for i in _outside(moved):
            # Rounding would take the chain through a wall: it stays where it is.
            t[i] = 0.0
            for F, own in zip(moved, here, strict=True):
                F[i] = own[i]
        here, roots = moved, _roots(moved)
        x = x + t[:, None] * v
    return x


def drawn_on_lines(
    slope: Array,
    curvature: float,
    strength: float,
    bodies: Array,
    rates: Array,
    rng: np.random.Generator,
) -> Array:
    """Draw a point t (C,) on each line, from t = 0, as the density along it says.

    It is ``exp(−slope·t − ½·curvature·t²)·Π (1 + t·bodies)^strength`` where all ``1 + t·rates`` are
    positive. The point is drawn from where that is above a random level [neal2003]_, an interval,
    for the logarithm is concave. It lies in that of the Gaussian with the same slope at t = 0.
    """
    fall = rng.exponential(size=len(slope))
    tangent = slope - strength * bodies.sum(axis=1)
    high = np.minimum(_reach(tangent, curvature, fall), 1.0 / np.maximum(-rates.min(1), _TINY))
    low = -np.minimum(_reach(-tangent, curvature, fall), 1.0 / np.maximum(rates.max(1), _TINY))
    t, going = np.zeros(len(slope)), np.ones(len(slope), dtype=bool)
    for _ in range(_TRIALS):
        t[going] = rng.uniform(low[going], high[going])
        logs = np.log(np.maximum(1.0 + t[:, None] * bodies, _TINY)).sum(axis=1)
        going &= slope * t + 0.5 * curvature * t**2 - strength * logs > fall * (1.0 + _ROUNDING)
        if not going.any():
            return t
        # What is not above the level is an end of what may be.
        low, high = np.where(going & (t < 0.0), t, low), np.where(going & (t > 0.0), t, high)
    t[going] = 0.0
    return t


def _reach(slope: Array, curvature: float, fall: Array) -> Array:
    """Return the positive t at which ``slope·t + ½·curvature·t²`` is the fall."""
    root = np.sqrt(slope**2 + 2.0 * curvature * fall)
    uphill = (root - slope) / curvature if curvature > 0.0 else np.full(len(fall), np.inf)
    downhill = np.divide(
        2.0 * fall, slope + root, out=np.full(len(fall), np.inf), where=slope > 0.0
    )
    return np.where(slope > 0.0, downhill, uphill)


def relative_eigenvalues(L: Array, D: Array) -> Array:
    """Return the eigenvalues (..., s), rising, of ``L^(-1)·D·L^(-T)``.

    With ``F = L·L^T`` the matrix ``F + t·D`` is positive definite as long as ``1 + t·value`` is
    positive for all of them.
    """
    if L.shape[-1] == 1:
        return np.asarray(D / L**2)
    half = _lower_solve(L, D)
    return np.asarray(np.linalg.eigvalsh(_lower_solve(L, np.swapaxes(half, -1, -2))))


def _lower_solve(L: Array, right: Array) -> Array:
    """Return ``L^(-1)·right``, row by row: for thousands of small matrices that is fastest."""
    out = np.empty(L.shape)
    for i in range(L.shape[-1]):
        known = np.einsum("...k,...kj->...j", L[..., i, :i], out[..., :i, :])
        out[..., i, :] = (right[..., i, :] - known) / L[..., i, i, None]
    return out


def _roots(matrices: list[Array]) -> list[Array]:
    """Return L with ``F = L·L^T`` of matrices F (C, N, s, s)."""
    found = []
    for F in matrices:
        if F.shape[-1] == 1 and not F.min(initial=1.0) > 0.0:
            raise np.linalg.LinAlgError
        # Of numbers the square root is much faster.
        root = np.sqrt(F) if F.shape[-1] == 1 else np.linalg.cholesky(F)
        found.append(np.asarray(root, dtype=np.float64))
    return found


def _outside(matrices: list[Array]) -> list[int]:
    """Return the chains of which a matrix (C, N, s, s) is not positive definite."""
    try:
        _roots(matrices)
    except np.linalg.LinAlgError:
        if len(matrices[0]) == 1:
            return [0]
        return [i for i in range(len(matrices[0])) if _outside([F[i : i + 1] for F in matrices])]
    return []
