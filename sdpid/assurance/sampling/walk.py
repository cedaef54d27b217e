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

# A chain that would leave less than this share of its room to a wall stays where it is: rounding
# could take it through.
_LEAST_ROOM = 1e-9


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
    matrices = density.walls, density.bodies
    here, steps = [each.at(x) for each in matrices], [each.along(directions) for each in matrices]
    room, pushes = density.room(x), directions @ density.limits.T
    pulls = directions @ density.precision
    for k, v in enumerate(directions):
        # The line is inside at t where 1 + t·rate is positive for all of these.
        rates = [relative_eigenvalues(F, D[k]) for F, D in zip(here, steps, strict=True)]
        slope = (x - density.mean) @ pulls[k] + density.slope @ v
        every = np.hstack([*rates, pushes[k] / room])
        t = drawn_on_lines(slope, float(pulls[k] @ v), density.strength, rates[-1], every, rng)
        t[np.any(1.0 + t[:, None] * every < _LEAST_ROOM, axis=1)] = 0.0
        here = [F + t[:, None, None, None] * D[k] for F, D in zip(here, steps, strict=True)]
        room = room + t[:, None] * pushes[k]
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


def relative_eigenvalues(F: Array, D: Array) -> Array:
    """Return the eigenvalues (C, N·s) of ``L^(-1)·D·L^(-T)`` of matrices ``F = L·L^T``.

    These are (C, N, s, s), and D one matrix each (N, s, s). The matrix ``F + t·D`` is positive
    definite as long as ``1 + t·value`` is positive for all of them.
    """
    root = np.linalg.inv(np.linalg.cholesky(F))
    return np.asarray(np.linalg.eigvalsh(root @ D @ np.swapaxes(root, -1, -2)).reshape(len(F), -1))
