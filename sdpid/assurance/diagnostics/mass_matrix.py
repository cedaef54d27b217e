"""Smallest eigenvalue of the mass matrix over joint positions, and a bound that needs no search.

**Search.** The smallest eigenvalue of ``M(q) = Σ J_i(q)^T·I_i·J_i(q)`` over a box, at many
quasi-random positions at once, then by local descent from the lowest. It finds an upper bound on
the minimum: a negative value disproves an estimate, a positive one proves nothing.

**Bound.** With N from `sdpid.robot.model.jacobians.joint_rates`, the joints' velocities are ``N·V``
of the links' velocities V, and N does not depend on q. So, whenever ``diag(I_1, …) ⪰ c·N^T·N``,

    v^T·M(q)·v = V^T·diag(I_1, …)·V ≥ c·‖N·V‖² = c·‖v‖²   at every q,

and c bounds the smallest eigenvalue from below. For consistent links the largest such c is
``1/λ_max(N·diag(I_i^(-1))·N^T)``: in a chain of revolute joints it only asks for the inertias about
the centers of mass. As M depends on the base parameters alone, any standard parameters that have
them may stand for the links: those are taken that prove most, one semidefinite program.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, generator
from sdpid._common.tables import Shown, plain
from sdpid.errors import DataError
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling, congruent
from sdpid.robot.inertia import spatial_inertia
from sdpid.robot.model.jacobians import joint_rates, link_jacobians
from sdpid.robot.model.model import RobotModel

# Positions of the global search, and how many of the lowest are refined.
_POSITIONS = 2048
_REFINED = 8
_BATCH = 512

# Differences for the descent's gradient: the cube root of rounding, positions being of order one.
_STEP = 6e-6

# Where a joint has no limits: one turn, or 1 m either way if it slides.
_TURN, _SLIDE = 2.0 * np.pi, 1.0

# The program's point is repaired by giving away this share of the bound at a time.
_GIVE = (0.0, 1e-6, 1e-4, 1e-2, 0.1, 0.5)

# Null directions of the scaled base matrix: its singular values are of order one or rounding.
_NULL = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SmallestMassEigenvalue(Shown):
    """The smallest eigenvalue of the mass matrix over a box of joint positions.

    Attributes
    ----------
    value : float
        The smallest eigenvalue found, in SI units (kg·m², kg of sliding joints).
    q : ndarray, shape (n,)
        Where, rad or m; with a floating base the joints only.
    lower_bound : float or None
        No position, inside or outside of the box, has a smaller eigenvalue; in floating point.
        None where there is no such proof.
    reason : str
        What proves it, or why nothing does.
    positions : int
        Positions of the global search.
    bounds : ndarray, shape (n, 2)
        The box.

    Examples
    --------
    >>> least = sdpid.smallest_mass_eigenvalue(estimate)
    >>> least.positive_definite, bool(0.0 < least.lower_bound <= least.value)
    (True, True)
    >>> least.q.shape, least.bounds.shape
    ((6,), (6, 2))
    """

    value: float
    q: Array
    lower_bound: float | None
    reason: str
    positions: int
    bounds: Array

    _facts = ("value", "q", "lower_bound", "reason")

    @property
    def positive_definite(self) -> bool:
        """Whether the mass matrix is proven positive definite at every position."""
        return self.lower_bound is not None and self.lower_bound > 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return dict(plain(self))


def smallest_mass_eigenvalue(
    estimate: Estimate, *, bounds: ArrayLike | None = None, seed: int | np.random.Generator = 0
) -> SmallestMassEigenvalue:
    """Find the smallest eigenvalue of the links' mass matrix over a box.

    Inertia of rotors that friction terms add to the diagonal is left out.

    Parameters
    ----------
    estimate : Estimate
        With or without standard parameters.
    bounds : array_like, shape (n, 2), optional
        The box, rad or m; by default the description's limits, of a joint that turns no more than
        one turn. Where it has none, from −π to π, or 1 m either way for a joint that slides. With a
        floating base the joints only: where the base is does not matter.
    seed : int or numpy.random.Generator, optional
        Of the search.

    Returns
    -------
    SmallestMassEigenvalue

    Raises
    ------
    DataError
        When the box does not fit the robot, or the seed is no whole number from 0 on.

    Examples
    --------
    >>> least = sdpid.smallest_mass_eigenvalue(estimate)
    >>> least.positive_definite
    True
    >>> round(least.value, 3), least.q.shape
    (0.034, (6,))
    """
    problem, theta = estimate.problem, np.array(estimate.some_theta)
    robot, rng = problem.robot, generator(seed)
    box = _box(robot, bounds)
    # A prior-free estimate's mass matrix is that of its base parameters.
    bodies = theta[: 10 * robot.n_links].reshape(-1, 10)
    value, q, positions = _search(robot, spatial_inertia(bodies), box, rng)
    lower, reason = proven_bound(robot, bodies), "the estimate's own links"
    for others in _strongest(problem, bodies):
        found = proven_bound(robot, others)
        if found is not None and (lower is None or found > lower):
            lower, reason = found, "links with the same base parameters that prove most"
    if lower is None:
        reason = (
            "no links with positive definite inertias were found that have these base parameters, "
            "so consistency proves nothing"
        )
    return SmallestMassEigenvalue(
        value=value,
        q=frozen(q),
        lower_bound=lower,
        reason=reason,
        positions=positions,
        bounds=frozen(box),
    )


def _box(robot: RobotModel, bounds: ArrayLike | None) -> Array:
    """Return the box of the joints, beside a floating base: by default the description's limits.

    A joint turns once at most, and has ends where the description gives none.
    """
    limits, slides = robot.position_limits[robot.n_base :], robot.slides[robot.n_base :]
    if bounds is None:
        ends = np.where(slides, _SLIDE, 0.5 * _TURN)[:, None] * [-1.0, 1.0]
        box = np.where(np.all(np.isfinite(limits), axis=1, keepdims=True), limits, ends)
        # Where one position drives several joints with ratios, a turn need not bring all of them
        # back.
        if len(robot.expansion) == robot.n:
            box[~slides, 1] = np.minimum(box[~slides, 1], box[~slides, 0] + _TURN)
        return box
    box = np.array(bounds, dtype=np.float64)
    if box.shape != limits.shape or not np.all(np.isfinite(box)) or np.any(box[:, 0] > box[:, 1]):
        raise DataError(
            f"smallest_mass_eigenvalue: bounds have shape {box.shape}, expected {limits.shape} "
            "finite numbers, lower before upper."
        )
    return box


def _eigenvalues(robot: RobotModel, inertias: Array, q: Array) -> Array:
    """Return the smallest eigenvalue at each of many positions."""
    out = []
    for start in range(0, len(q), _BATCH):
        J = link_jacobians(robot, q[start : start + _BATCH])
        M = np.einsum("klai,lab,klbj->kij", J, inertias, J, optimize=True)
        out.append(np.linalg.eigvalsh(0.5 * (M + np.swapaxes(M, 1, 2)))[:, 0])
    return np.concatenate(out)


def _search(
    robot: RobotModel, inertias: Array, box: Array, rng: np.random.Generator
) -> tuple[float, Array, int]:
    """Return the smallest value found, where, and how many positions were tried at first."""
    from scipy.optimize import minimize

    # A floating base alone has one position.
    q = rng.uniform(box[:, 0], box[:, 1], (_POSITIONS if len(box) else 1, len(box)))
    values = _eigenvalues(robot, inertias, q)
    order = np.argsort(values)
    best = float(values[order[0]]), q[order[0]]

    def descend(x: Array) -> tuple[float, Array]:
        steps = np.vstack([x, x + _STEP * np.eye(len(x)), x - _STEP * np.eye(len(x))])
        each = _eigenvalues(robot, inertias, steps)
        slope = (each[1 : len(x) + 1] - each[len(x) + 1 :]) / (2.0 * _STEP)
        return float(each[0]), slope

    for start in order[: _REFINED if len(box) else 0]:
        found = minimize(descend, q[start], jac=True, method="L-BFGS-B", bounds=box)
        if found.fun < best[0]:
            best = float(found.fun), np.clip(found.x, box[:, 0], box[:, 1])
    return *best, len(q)


def proven_bound(robot: RobotModel, theta: ArrayLike) -> float | None:
    """Return a positive number below every eigenvalue of the mass matrix at every position.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    theta : array_like
        Standard parameters; what follows the links' is ignored.

    Returns
    -------
    float or None
        None where a link's spatial inertia is not positive definite.
    """
    bodies = np.asarray(theta, dtype=np.float64).ravel()[: 10 * robot.n_links].reshape(-1, 10)
    inertias = spatial_inertia(bodies)
    diagonal = np.diagonal(inertias, axis1=1, axis2=2)
    if not np.all(diagonal >= np.finfo(float).tiny):
        return None
    # Scaled, so that units of length and mass do not decide what is definite.
    d = np.sqrt(diagonal)
    try:
        roots = np.linalg.cholesky(inertias / (d[:, :, None] * d[:, None, :]))
    except np.linalg.LinAlgError:
        return None
    rates = joint_rates(robot).reshape(-1, robot.n_links, 6) / d
    halves = np.linalg.solve(roots, np.moveaxis(rates, 0, 2))
    # v^T·M·v ≥ v^T·E^T·(halves^T·halves)^(-1)·E·v, E the expansion of coordinates to joints.
    triangle = np.asarray(np.linalg.qr(halves.reshape(-1, len(rates)), mode="r"))
    if not float(np.abs(np.diagonal(triangle)).min(initial=np.inf)) > 0.0:
        return None
    shown = np.linalg.solve(triangle.T, robot.expansion)
    value = float(np.linalg.svd(shown, compute_uv=False)[-1] ** 2)
    # Rounding of all of this is far below the share of a millionth.
    return value * (1.0 - 1e-6) if value > 0.0 else None


def _strongest(problem: Problem, bodies: Array) -> list[Array]:
    """Return candidate links with the same base parameters, for which the bound is largest.

    What friction terms have of the base parameters stays theirs: rotors are no links.
    """
    from scipy.linalg import null_space

    robot, scaling = problem.robot, Scaling.of(problem)
    basis = scaling.basis()[: bodies.size, : bodies.size]
    null = basis @ null_space(problem.base.matrix[:, : bodies.size] @ basis, rcond=_NULL)
    count = null.shape[1]
    # Of a joint between two links, |a − b|² ≤ 2·|a|² + 2·|b|²: this leaves one small matrix
    # inequality a link instead of a large one, and its optimum is within a factor of two.
    rates = joint_rates(robot).reshape(-1, robot.n_links, 6)
    shared = np.where(np.count_nonzero(np.any(rates != 0.0, axis=2), axis=1) > 1, 2.0, 1.0)
    inverses = np.asarray(np.linalg.inv(scaling.roots(6)))
    needs = congruent(inverses, np.einsum("j,jla,jlb->lab", shared, rates, rates))
    needs = needs / np.abs(needs).max()
    # Inertias of the links as functions of the step along the null directions, and of the bound.
    moves = spatial_inertia(np.moveaxis(null.reshape(*bodies.shape, count), 2, 1))
    linear = np.concatenate([congruent(inverses[:, None], moves), -needs[:, None]], axis=1)
    constants, every = congruent(inverses, spatial_inertia(bodies)), np.arange(count + 1)
    # What limits a body's parameters limits these too, or they would run away.
    bound = min(problem.constraints.theta_max, 1e6)
    scale = scaling.theta[: bodies.size]
    solution = solve_conic(
        ConicProgram(
            M=np.zeros((0, count + 1)),
            m=np.zeros(0),
            cost=-np.eye(count + 1)[-1],
            C=np.column_stack([null / scale[:, None], np.zeros(bodies.size)]),
            lower=(-bound - bodies.ravel()) / scale,
            upper=(bound - bodies.ravel()) / scale,
            blocks=tuple(map(Matrix, repeat(every), linear, constants)),
        )
    )
    if solution.x is None:
        return []
    moved = null @ solution.x[:-1]
    # The solver may end outside by rounding; on the way back everything stays on the face.
    return [bodies.ravel() + (1.0 - give) * moved for give in _GIVE]
