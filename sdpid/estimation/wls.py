"""Weighted least squares in closed form: what the data say without physics."""

from __future__ import annotations

import time

import numpy as np

from sdpid._arrays import frozen
from sdpid._threads import one_thread
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem


@one_thread
def solve_wls(problem: Problem) -> Estimate:
    """Minimise the cost without constraints.

    Parameters
    ----------
    problem : Problem
        The problem; its constraints are not used.

    Returns
    -------
    Estimate
        With `theta` None: base parameters alone say nothing about single links. With a prior
        (ridge regression) all standard parameters are determined and returned.
    """
    start = time.perf_counter()
    if problem.prior is not None:
        G, h = problem.design
        scale = np.linalg.norm(G, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        theta = np.linalg.lstsq(G / scale, h, rcond=None)[0] / scale
        return Estimate.of_theta(
            problem,
            theta,
            method="wls",
            status="optimal",
            message="closed form, with the prior",
            iterations=1,
            solve_time=time.perf_counter() - start,
        )
    # Columns scaled to unit length: their units differ, and so do their sizes by orders.
    scale = np.linalg.norm(problem.A, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    scaled = np.linalg.lstsq(problem.A / scale, problem.rhs, rcond=None)[0]
    return Estimate(
        problem=problem,
        method="wls",
        base=frozen(scaled / scale),
        theta=None,
        status="optimal",
        message="closed form",
        iterations=1,
        solve_time=time.perf_counter() - start,
    )
