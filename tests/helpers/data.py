"""Samples made from known parameters, and brute-force sums over their rows."""

from collections.abc import Iterable
from typing import Any

import numpy as np

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import Problem
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import point_masses
from sdpid.robot.model.base_parameters import BaseParameters, structural_base
from tests.helpers.strategies import random_states

FRICTION: tuple[str | FrictionTerm, ...] = ("coulomb", "viscous")


def random_links(rng: np.random.Generator, count: int, *, points: int = 8) -> Array:
    """Return consistent links (count, 10), each made of random point masses."""
    masses = rng.uniform(0.05, 0.5, (count, points))
    centers = rng.uniform(-0.2, 0.2, (count, 1, 3))
    positions = centers + rng.uniform(-0.15, 0.15, (count, points, 3))
    return point_masses(masses, positions)


def friction_model(
    robot: sdpid.RobotModel, friction: Iterable[str | FrictionTerm] = FRICTION
) -> FrictionModel:
    """Return the friction model of a robot."""
    return FrictionModel.from_terms(friction, robot.joint_names, first=robot.n_base)


def random_bodies(robot: sdpid.RobotModel, seed: int) -> tuple[tuple[float, ...], ...]:
    """Return bodies of a robot as terms of friction take them."""
    links = random_links(np.random.default_rng(seed), robot.n_links)
    return tuple(map(tuple, links.tolist()))


def base_of(robot: sdpid.RobotModel, *friction: str | FrictionTerm) -> BaseParameters:
    """Return the base parameters of a robot with these terms of friction."""
    return structural_base(robot, friction_model(robot, friction))


def random_theta(
    robot: sdpid.RobotModel,
    rng: np.random.Generator,
    friction: Iterable[str | FrictionTerm] = FRICTION,
) -> Array:
    """Return consistent standard parameters (p,) with positive friction."""
    terms = friction_model(robot, friction).parameters
    links = random_links(rng, robot.n_links)
    return np.concatenate([links.ravel(), rng.uniform(0.1, 2.0, len(terms))])


def flat_links(rng: np.random.Generator, count: int) -> Array:
    """Return links (count, 10) of a single point mass each: on the boundary of what exists."""
    return random_links(rng, count, points=1)


def full_regressor(
    robot: sdpid.RobotModel,
    states: tuple[Array, Array, Array],
    friction: Iterable[str | FrictionTerm] = FRICTION,
) -> Array:
    """Return the regressor of all standard parameters, (K, n, p)."""
    q, v, a = states
    return np.dstack([robot.regressor(q, v, a), friction_model(robot, friction).columns(v, a)])


def row_source(
    robot: sdpid.RobotModel,
    samples: sdpid.Samples,
    friction: Iterable[str | FrictionTerm] = FRICTION,
) -> RowSource:
    """Return the rows of samples, by the robot's structural base parameters."""
    model = friction_model(robot, friction)
    return RowSource(robot, model, structural_base(robot, model), samples)


def make_samples(
    robot: sdpid.RobotModel,
    theta: Array,
    rng: np.random.Generator,
    *,
    count: int = 60,
    noise: float | Array = 0.0,
    friction: Iterable[str | FrictionTerm] = FRICTION,
    states: tuple[Array, Array, Array] | None = None,
    **fields: Any,
) -> sdpid.Samples:
    """Return samples at states, by default generic ones, that count.

    Efforts are exact but for noise (a deviation, or an array).
    """
    q, v, a = states or random_states(rng, robot.n, count)
    effort = full_regressor(robot, (q, v, a), friction) @ theta
    error = noise * rng.standard_normal(effort.shape) if np.ndim(noise) == 0 else noise
    return sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort + error, **fields)


def random_covariance(rng: np.random.Generator, n: int, count: int | None = None) -> Array:
    """Return covariances (n, n) or (count, n, n), well conditioned and correlated."""
    shape = (n, n) if count is None else (count, n, n)
    root = rng.standard_normal(shape)
    return np.asarray(0.2 * root @ np.swapaxes(root, -1, -2) + 0.5 * np.eye(n))


def raw_rows(problem: Problem | RowSource) -> tuple[Array, Array, np.ndarray]:
    """Return the base regressor (K, n, b), efforts (K, n) and mask, from the standard columns."""
    s = problem.samples
    rigid = problem.robot.regressor(s.position, s.velocity, s.acceleration)
    full = np.dstack([rigid, problem.friction.columns(s.velocity, s.acceleration)])
    mask = np.ones(s.effort.shape, dtype=bool) if s.mask is None else np.asarray(s.mask)
    return full[:, :, problem.base.kept], s.effort, mask


def whitened(W: Array, effort: Array, mask: np.ndarray, sigma: Array) -> tuple[Array, Array]:
    """Return rows (K, n, b) and efforts (K, n) whitened sample by sample, masked ones zero."""
    rows, efforts = np.zeros_like(W), np.zeros_like(effort)
    for k in range(len(W)):
        used = np.flatnonzero(mask[k])
        if used.size:
            own = sigma if sigma.ndim == 2 else sigma[k]
            root = matrix_power(own[np.ix_(used, used)], -0.5)
            rows[k, used], efforts[k, used] = root @ W[k, used], root @ effort[k, used]
    return rows, efforts


def matrix_power(matrix: Array, exponent: float) -> Array:
    """Return a symmetric power, one matrix at a time."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors @ np.diag(values**exponent) @ vectors.T)


def brute_force_cost(problem: Problem, base: Array, sigma: Array) -> float:
    """Return the weighted cost, summed sample by sample over the rows that are not masked.

    Parameters
    ----------
    problem : Problem
        Its weighting says which sum.
    base : ndarray, shape (b,)
        Base parameters.
    sigma : ndarray, shape (n, n) or (K, n, n)
        The covariance that the weighting is meant to use.
    """
    W, effort, mask = raw_rows(problem)
    normal = np.zeros(problem.base.count)
    total = 0.0
    for k in range(len(W)):
        used = np.flatnonzero(mask[k])
        if not used.size:
            continue
        covariance = (sigma if sigma.ndim == 2 else sigma[k])[np.ix_(used, used)]
        residual = (effort[k] - W[k] @ base)[used]
        if problem.weighting == "eq9":
            normal += W[k][used].T @ matrix_power(covariance, -0.5) @ residual
        else:
            weighted = np.linalg.solve(covariance, residual)
            normal += W[k][used].T @ weighted
            total += float(residual @ weighted)
    return float(normal @ normal) if problem.weighting in ("eq9", "eq18") else total


def relative_error(base: Array, truth: Array, units: tuple[str, ...]) -> float:
    """Return the largest error, relative to the largest true value of the same unit."""
    kinds = np.array(units)
    sizes = np.array([np.abs(truth[kinds == unit]).max() for unit in units])
    return float(np.max(np.abs(base - truth) / sizes))
