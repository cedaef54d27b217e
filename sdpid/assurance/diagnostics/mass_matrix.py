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
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen
from sdpid._common.seeds import generator
from sdpid._common.tables import Shown, plain
from sdpid.errors import DataError
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
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
    problem = estimate.problem
    robot = problem.robot
    box, rng = _box(robot, bounds), generator(seed)
    links = 10 * robot.n_links
    theta = estimate.some_theta
    # A prior-free estimate's mass matrix is that of its base parameters.
    inertias = spatial_inertia(np.array(theta[:links]).reshape(-1, 10))
    value, q, positions = _search(robot, inertias, box, rng)
    lower, reason = _proof(problem, np.array(theta))
    return SmallestMassEigenvalue(
        value=value,
        q=frozen(q),
        lower_bound=lower,
        reason=reason,
        positions=positions,
        bounds=frozen(box),
    )


def _box(robot: RobotModel, bounds: ArrayLike | None) -> Array:
    """Return the box of the joints, beside a floating base."""
    limits = robot.position_limits[robot.n_base :]
    if bounds is None:
        return _default_box(robot, limits)
    box = np.array(bounds, dtype=np.float64)
    if box.shape != limits.shape or not np.all(np.isfinite(box)) or np.any(box[:, 0] > box[:, 1]):
        raise DataError(
            f"smallest_mass_eigenvalue: bounds have shape {box.shape}, expected {limits.shape} "
            "finite numbers, lower before upper."
        )
    return box


def _default_box(robot: RobotModel, limits: Array) -> Array:
    """Return the description's limits: one turn at most, and ends for joints that have none."""
    model, box = robot.pin_model, limits.copy()
    names = robot.joint_names[robot.n_base :]
    kinds = [model.joints[model.getJointId(name)].shortname() for name in names]
    # Where one position drives several joints with ratios, a turn need not bring all of them back.
    periodic = len(robot.expansion) == robot.n
    for j, kind in enumerate(kinds):
        slide = kind.startswith("JointModelP")
        if not np.isfinite(box[j]).all():
            box[j] = (-_SLIDE, _SLIDE) if slide else (-0.5 * _TURN, 0.5 * _TURN)
        elif periodic and not slide:
            box[j, 1] = min(box[j, 1], box[j, 0] + _TURN)
    return np.asarray(box)


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

    if not len(box):
        here = np.zeros((1, 0))
        return float(_eigenvalues(robot, inertias, here)[0]), here[0], 1
    q = rng.uniform(box[:, 0], box[:, 1], (_POSITIONS, len(box)))
    values = _eigenvalues(robot, inertias, q)

    def descend(x: Array) -> tuple[float, Array]:
        steps = np.vstack([x, x + _STEP * np.eye(len(x)), x - _STEP * np.eye(len(x))])
        each = _eigenvalues(robot, inertias, steps)
        slope = (each[1 : len(x) + 1] - each[len(x) + 1 :]) / (2.0 * _STEP)
        return float(each[0]), slope

    first = int(np.argmin(values))
    best = float(values[first]), q[first]
    for start in np.argsort(values)[:_REFINED]:
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
    bodies = np.asarray(theta, dtype=np.float64)[: 10 * robot.n_links].reshape(-1, 10)
    inertias = spatial_inertia(bodies)
    N = joint_rates(robot)
    diagonal = np.diagonal(inertias, axis1=1, axis2=2)
    if not np.all(diagonal >= np.finfo(float).tiny):
        return None
    # Scaled, so that units of length and mass do not decide what is definite.
    d = np.sqrt(diagonal)
    try:
        roots = np.linalg.cholesky(inertias / (d[:, :, None] * d[:, None, :]))
    except np.linalg.LinAlgError:
        return None
    rates = N.reshape(len(N), robot.n_links, 6) / d
    halves = np.linalg.solve(roots, np.moveaxis(rates, 0, 2))
    stacked = np.moveaxis(halves, 2, 0).reshape(len(N), -1)
    # v^T·M·v ≥ v^T·E^T·(stacked·stacked^T)^(-1)·E·v, E the expansion of coordinates to joints.
    triangle = np.asarray(np.linalg.qr(stacked.T, mode="r"))
    if not float(np.abs(np.diagonal(triangle)).min(initial=np.inf)) > 0.0:
        return None
    shown = np.linalg.solve(triangle.T, robot.expansion)
    value = float(np.linalg.svd(shown, compute_uv=False)[-1] ** 2)
    # Rounding of all of this is far below the share of a millionth.
    return value * (1.0 - 1e-6) if value > 0.0 else None


def _proof(problem: Problem, theta: Array) -> tuple[float | None, str]:
    """Return the largest proven bound, and the reason for it."""
    robot = problem.robot
    best, reason = proven_bound(robot, theta), "the estimate's own links"
    for bodies in _strongest(problem, theta):
        value = proven_bound(robot, bodies)
        if value is not None and (best is None or value > best):
            best, reason = value, "links with the same base parameters that prove most"
    if best is None:
        return None, (
            "no links with positive definite inertias were found that have these base parameters, "
            "so consistency proves nothing"
        )
    return best, reason


def _strongest(problem: Problem, theta: Array) -> list[Array]:
    """Return candidate links with theta's base parameters, for which the bound is largest."""
    robot, feasible = problem.robot, problem.feasible
    links = 10 * robot.n_links
    scaling = Scaling.of(problem)
    basis = scaling.basis()
    _, singular, rows = np.linalg.svd(problem.base.matrix @ basis)
    rank = int(np.count_nonzero(singular > _NULL * singular[0]))
    null = (basis @ rows[rank:].T)[:links]
    null = null[:, np.linalg.norm(null, axis=0) > 0.0]
    units = spatial_inertia(np.eye(10))
    inverses = np.linalg.inv(np.linalg.cholesky(spatial_inertia(scaling.bodies)))
    bodies = theta[:links].reshape(-1, 10)
    # Of a joint between two links, |a − b|² ≤ 2·|a|² + 2·|b|²: this leaves one small matrix
    # inequality a link instead of a large one, and its optimum is within a factor of two.
    rates = joint_rates(robot).reshape(-1, robot.n_links, 6)
    shared = np.where(np.count_nonzero(np.any(rates != 0.0, axis=2), axis=1) > 1, 2.0, 1.0)
    needs = np.einsum("j,jla,jlb->lab", shared, rates, rates)
    needs = inverses @ needs @ np.swapaxes(inverses, 1, 2)
    unit = float(np.abs(needs).max())
    count = null.shape[1] + 1
    blocks = []
    for i, (inverse, need) in enumerate(zip(inverses, needs, strict=True)):
        own = null[10 * i : 10 * i + 10]
        index = np.flatnonzero(np.any(own != 0.0, axis=0))
        scaled = inverse @ units @ inverse.T
        linear = np.einsum("ka,kij->aij", own[:, index], scaled)
        blocks.append(
            Matrix(
                np.append(index, count - 1),
                np.concatenate([linear, -need[None] / unit]),
                np.einsum("k,kij->ij", bodies[i], scaled),
            )
        )
    slope = np.zeros(count)
    slope[-1] = -1.0
    # What limits a body's parameters limits these too, or they would run away.
    bound = np.minimum(feasible.constraints.theta_max, 1e6)
    scale = scaling.theta[:links]
    C = np.column_stack([null / scale[:, None], np.zeros(links)])
    program = ConicProgram(
        M=np.zeros((0, count)),
        m=np.zeros(0),
        cost=slope,
        C=C,
        lower=(-bound - theta[:links]) / scale,
        upper=(bound - theta[:links]) / scale,
        blocks=tuple(blocks),
    )
    solution = solve_conic(program)
    if solution.x is None:
        return []
    moved = null @ solution.x[:-1]
    # The solver may end outside by rounding; on the way back everything stays on the face.
    return [theta[:links] + (1.0 - give) * moved for give in _GIVE]
