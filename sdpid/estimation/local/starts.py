"""Where local solvers start."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid.errors import DataError
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.robot.inertia import theta_from_physical


def random_start(problem: Problem, rng: np.random.Generator) -> Array:
    """Return random standard parameters that satisfy margins, bounds on masses, and signs.

    Each link is a random ellipsoid: masses log-uniform within the bounds around the problem's
    own scale, radii and centers of mass of the size of the robot. Further conditions are left to
    the solver.

    Parameters
    ----------
    problem : Problem
        The problem.
    rng : numpy.random.Generator
        Source of randomness.
    """
    scaling = Scaling.of(problem)
    bounds = problem.constraints
    links = problem.robot.n_links
    low = max(bounds.mass_min * 1.01, 0.05 * scaling.mass)
    high = max(min(bounds.mass_max * 0.99, 3.0 * scaling.mass), low)
    mass = np.exp(rng.uniform(np.log(low), np.log(high), links))
    com = rng.normal(0.0, 0.5 * scaling.length, (links, 3))
    frames = np.linalg.qr(rng.standard_normal((links, 3, 3)))[0]
    moments = mass[:, None] * (scaling.length * rng.uniform(0.1, 0.8, (links, 3))) ** 2
    moments = moments + 1.1 * bounds.margin
    second = np.einsum("lik,lk,ljk->lij", frames, moments, frames)
    trace = moments.sum(axis=1)[:, None, None] * np.eye(3)
    friction = scaling.theta[10 * links :] * rng.uniform(0.05, 1.0, problem.n_theta - 10 * links)
    bodies = theta_from_physical(mass, com, trace - second)
    return np.concatenate([bodies.ravel(), friction])


def checked_start(
    problem: Problem, start: ArrayLike | None, seed: int | np.random.Generator
) -> Array:
    """Return a given start, or a random one where there is none.

    Parameters
    ----------
    problem : Problem
        The problem.
    start : array_like, shape (p,), or None
        Standard parameters.
    seed : int or numpy.random.Generator
        Of the random start.

    Returns
    -------
    ndarray, shape (p,)

    Raises
    ------
    DataError
        When the start has another size or masses that are not positive.
    """
    if start is None:
        return random_start(problem, np.random.default_rng(seed))
    values = real_array(start, "start", ndim=1)
    if values.shape != (problem.n_theta,):
        raise DataError(f"start: shape {values.shape}, expected ({problem.n_theta},).")
    masses = problem.feasible.bodies(values)[:, 0]
    if np.any(masses <= 0.0):
        worst = int(np.argmin(masses))
        raise DataError(
            f"start: link {worst + 1} has mass {masses[worst]} kg; a local solver needs positive "
            "masses to start from."
        )
    return values
