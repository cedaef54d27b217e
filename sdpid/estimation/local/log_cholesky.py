"""The modern local way: smooth coordinates in which every link is consistent."""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.threads import one_thread
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate, Status
from sdpid.estimation.local.physical import physical_slopes, tensor_slopes
from sdpid.estimation.local.run import UNCONSTRAINED, LocalRun
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.robot.consistent import raise_eigenvalues
from sdpid.robot.inertia import central_moments, complement, theta_from_central_moments

# Places of a link's coordinates: half the logarithm of the mass, three logarithms and three
# entries above the diagonal of K, center of mass.
_MASS, _DIAGONAL, _COM = 0, slice(1, 4), slice(7, 10)
_ROWS, _COLUMNS = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])

# A start on or outside the boundary has no coordinates: its moments are raised to this share of
# the mass times the squared length.
_INSIDE = 1e-6

# Least logarithms on the diagonal, stage by stage; the last allows moments of 1e-7 of the mass
# times the squared length. A link that goes to the boundary too early does not come back, as its
# gradient vanishes there, so the way is opened in stages.
_THINNEST = (-2.0, -3.0, -5.0, -8.0)

# A stage but the last ends when a step lowers the cost by less than this share.
_STAGE = 1e-4

# Length of complex steps: of its square there is nothing beside one.
_TINY = 1e-30

# A log-mass with less room than this is fixed, not bounded.
_FIXED = 1e-12

# Curvature of every coordinate, where the squared efforts are one: it keeps directions that the
# effort does not show from drifting with rounding, and adds nothing to the cost.
_STILL = 1e-12

# Conditions that a refusal names.
_NAMED = 4

# The other two tests of convergence: a step or a gradient of rounding.
_ROUNDING = 1e-14


class LogCholesky:
    """The coordinates of a problem and how they become standard parameters [rucker2022]_.

    A link has ten, free of units: a, d (3), k (3) and c (3). With the robot's length l and the
    upper triangular K, its diagonal exp(d) and k above it,

        m = exp(2a),   r = l·c,   N = m·l²·K·K^T + eps·E,

    where N is what must exceed the margin eps: the second moments about the center of mass, or
    for the 6×6 inequality the inertia about it. In the first case

        J − eps·diag(1, 1, 1, 0) = U·U^T,   U = exp(a)·[[l·K, r], [0, 1]],

    which is the parameterisation of [rucker2022]_ with the margin taken off; in the second the
    inertia takes the place of the second moments. The coordinates are one to one with the
    interior of the feasible set, bounds on the mass are bounds on a, and the rest of the
    boundary lies at infinity. Friction parameters are only scaled.

    Attributes
    ----------
    problem : Problem
        The problem.
    length : float
        The robot's length, m.
    friction : ndarray
        Size of each friction parameter.
    """

    def __init__(self, problem: Problem) -> None:
        scaling = Scaling.of(problem)
        self.problem, self.length, self.friction = problem, scaling.length, scaling.friction

    def _split(self, each: Array) -> tuple[Array, Array, Array]:
        """Return masses (…,), l·K (…, 3, 3) and centers of mass (…, 3) of links (…, 10)."""
        K = np.zeros((*each.shape[:-1], 3, 3), dtype=each.dtype)
        K[..., _ROWS, _COLUMNS] = self.length * each[..., 1:7]
        K[..., range(3), range(3)] = self.length * np.exp(each[..., _DIAGONAL])
        return np.exp(2.0 * each[..., _MASS]), K, self.length * each[..., _COM]

    def theta(self, x: Array) -> Array:
        """Return the standard parameters of coordinates (p,)."""
        mass, K, com = self._split(self.problem.feasible.bodies(x))
        margin = self.problem.constraints.margin
        N = mass[:, None, None] * (K @ np.swapaxes(K, 1, 2)) + margin * np.eye(3)
        bodies = theta_from_central_moments(mass, com, N, self.problem.consistency)
        return np.concatenate([bodies.ravel(), x[bodies.size :] * self.friction])

    def from_theta(self, theta: Array) -> Array:
        """Return the coordinates of standard parameters with positive masses.

        Links on the boundary or outside are moved just inside.
        """
        bodies = self.problem.feasible.bodies(theta)
        mass, com, N = central_moments(bodies, self.problem.consistency)
        size = (mass * self.length**2)[:, None, None]
        free = (N - self.problem.constraints.margin * np.eye(3)) / size
        S = raise_eigenvalues(free, np.full(len(free), _INSIDE))
        # The upper factor is the lower one seen from the other corner.
        K = np.linalg.cholesky(S[:, ::-1, ::-1])[:, ::-1, ::-1]
        each = np.empty((len(mass), 10))
        each[:, _MASS] = 0.5 * np.log(mass)
        each[:, 1:7] = K[:, _ROWS, _COLUMNS]
        each[:, _DIAGONAL] = np.log(each[:, _DIAGONAL])
        each[:, _COM] = com / self.length
        return np.concatenate([each.ravel(), theta[bodies.size :] / self.friction])

    def _slopes(self, each: Array, slopes: Array) -> Array:
        """Return slopes in links' parameters (…, 10) as ones in their coordinates (…, 10).

        Coordinates may be complex.
        """
        mass, K, com = self._split(each)
        of_mass, of_com = physical_slopes(mass, com, slopes)
        of_N = tensor_slopes(slopes[..., 4:])
        if self.problem.consistency == "pseudo_inertia":
            of_N = complement(of_N)
        LK = mass[..., None, None] * (of_N @ K)
        out = np.empty((*of_com.shape[:-1], 10), dtype=each.dtype)
        # All but the margin is proportional to the mass.
        out[..., _MASS] = 2.0 * (mass * of_mass + np.sum(LK * K, axis=(-2, -1)))
        out[..., 1:7] = 2.0 * self.length * LK[..., _ROWS, _COLUMNS]
        out[..., _DIAGONAL] *= np.exp(each[..., _DIAGONAL])
        out[..., _COM] = self.length * of_com
        return out

    def link_jacobians(self, x: Array) -> Array:
        """Return the derivative of each link's parameters in its coordinates, (links, 10, 10)."""
        return self._slopes(self.problem.feasible.bodies(x)[:, None], np.eye(10))

    def curvatures(self, x: Array, gradient: Array) -> Array:
        """Return the second derivative of ``gradient·theta`` in each link's coordinates.

        Shape (links, 10, 10). Complex steps differentiate the first one exactly.
        """
        bodies = self.problem.feasible.bodies
        steps = bodies(x)[:, None] + 1j * _TINY * np.eye(10)
        return self._slopes(steps, bodies(gradient)[:, None]).imag / _TINY

    def bounds(self, thinnest: float) -> tuple[Array, Array]:
        """Return bounds on the coordinates: of masses and friction, and how thin a link gets."""
        feasible = self.problem.feasible
        links = 10 * feasible.n_links
        lower, upper = np.full(self.problem.n_theta, -np.inf), np.full(self.problem.n_theta, np.inf)
        lower[:links].reshape(-1, 10)[:, _DIAGONAL] = thinnest
        lower[:links:10] = 0.5 * np.log(self.problem.constraints.mass_min)
        upper[:links:10] = 0.5 * np.log(self.problem.constraints.mass_max)
        lower[links:] = feasible.lower[links:] / self.friction
        upper[links:] = feasible.upper[links:] / self.friction
        return lower, upper


@one_thread
def solve_log_cholesky(
    problem: Problem,
    *,
    start: Array | None = None,
    seed: int | np.random.Generator = 0,
    max_iterations: int = 600,
    tolerance: float = 1e-8,
) -> Estimate:
    """Minimize the cost locally in log-Cholesky coordinates [rucker2022]_.

    Every point in these coordinates satisfies the links' inequality with its margin, 4×4 or 6×6,
    so nonlinear least squares (SciPy's ``least_squares``, analytic derivatives) needs no
    constraints but bounds on masses and friction.

    The boundary of what is consistent lies at infinity: where links end on it the result stays
    above the optimum. See docs/guides/estimation.md.

    Parameters
    ----------
    problem : Problem
        The problem, with a consistency.
    start : ndarray, shape (p,), optional
        Standard parameters to start from, masses positive. Links on the boundary or outside are
        first moved inside.
    seed : int or numpy.random.Generator, optional
        Seed of the random start that is used without `start`.
    max_iterations : int, optional
        Limit on evaluations of the residual, refused steps included.
    tolerance : float, optional
        A step that lowers the cost by less than this share of it is the last.

    Returns
    -------
    Estimate
        With status ``"optimal"`` when the point is feasible and its cost at most 1e-4 above what is
        proven of all feasible parameters; otherwise ``"iteration limit"``, ``"stalled"``, or
        ``"infeasible"`` where a parameter exceeds ``theta_max``, which the coordinates cannot
        express. How far from the global optimum a result is, `certify` tells.

    Raises
    ------
    DataError
        When the start has another size or masses that are not positive, or the problem has no
        consistency to obey, further conditions (`Constraints.others`) or a log-det prior.
    InfeasibleError
        When no parameters satisfy the constraints.

    Examples
    --------
    >>> local = sdpid.solve_log_cholesky(problem, seed=0)
    >>> local.method, local.feasible
    ('log_cholesky', True)
    >>> bool(local.cost >= sdpid.certify(estimate).lower_bound)
    True
    """
    reason = unsupported(problem)
    if reason is not None:
        raise DataError(f"solve_log_cholesky: {reason}")
    problem.feasible.require_feasible()
    run = _LogCholeskyRun(problem, start, seed)
    result = run.minimized(max_iterations, tolerance)
    # SciPy's status 0 is the limit on evaluations.
    stopped: Status = "iteration limit" if int(result.status) == 0 else "stalled"
    theta = run.theta(result.x)
    return run.estimate("log_cholesky", theta, stopped=stopped, message=str(result.message))


def unsupported(problem: Problem) -> str | None:
    """Return why a problem cannot be solved in these coordinates, None where it can."""
    feasible = problem.feasible
    if problem.consistency == "none":
        return UNCONSTRAINED
    # Facets of a hull are many; a few names tell.
    names = [*feasible.row_names, *feasible.block_names[feasible.n_own :]]
    if names:
        listed = ", ".join(names[:_NAMED]) + (", …" if len(names) > _NAMED else "")
        return (
            f"its coordinates cannot express further conditions ({listed}), only margins, masses "
            "and signs; use solve_sdp or solve_slsqp."
        )
    if len(problem.log_det.links):
        return (
            "a log-det prior (kind 'entropic') is no sum of squares; use solve_sdp or "
            "solve_slsqp, or a prior of kind 'pullback'."
        )
    return None


class _LogCholeskyRun(LocalRun):
    """The residual of the free coordinates with its derivative, and the stages of the solver."""

    def __init__(self, problem: Problem, *start: Any) -> None:
        super().__init__(problem, *start)
        self.coordinates = LogCholesky(problem)
        # Constant rows: the floor, so that tolerances are shares of the cost, and one for each
        # row of curvature.
        self.constant = np.zeros(1 + problem.n_theta)
        self.constant[0] = self.scale * np.sqrt(problem.floor)
        lower, upper = self.coordinates.bounds(_THINNEST[-1])
        self.free = upper - lower > _FIXED
        self.fixed = np.where(self.free, 0.0, lower)

    def expand(self, x: Array) -> Array:
        """Return all coordinates of the free ones."""
        full = self.fixed.copy()
        full[self.free] = x
        return full

    def theta(self, x: Array) -> Array:
        """Return the standard parameters, masses that rounding took over their bounds put back."""
        theta, feasible = self.coordinates.theta(self.expand(x)), self.problem.feasible
        clipped = np.clip(theta, feasible.lower, feasible.upper)
        return np.where(feasible.bounded, clipped, theta)

    def residual(self, x: Array) -> Array:
        values = self.G @ self.coordinates.theta(self.expand(x)) - self.rhs
        return np.concatenate([values, self.constant])

    def jacobian(self, x: Array) -> Array:
        """Return the derivative of the residual, and rows that add curvature to its square.

        The residual of those rows is zero, so they do not change the gradient.
        """
        full = self.expand(x)
        gradient = (self.G @ self.coordinates.theta(full) - self.rhs) @ self.G
        values, vectors = np.linalg.eigh(self.coordinates.curvatures(full, gradient))
        roots = np.sqrt(np.maximum(values, 0.0) + _STILL)[:, :, None] * np.swapaxes(vectors, 1, 2)
        jacobians = self.coordinates.link_jacobians(full)
        of_theta, bent = np.zeros_like(self.G), np.sqrt(_STILL) * np.eye(len(full))
        for link, (own_jacobian, root) in enumerate(zip(jacobians, roots, strict=True)):
            own = slice(10 * link, 10 * link + 10)
            of_theta[:, own], bent[own, own] = self.G[:, own] @ own_jacobian, root
        of_theta[:, 10 * len(roots) :] = self.G[:, 10 * len(roots) :] * self.coordinates.friction
        return np.vstack([of_theta, np.zeros((1, len(full))), bent])[:, self.free]

    def minimized(self, max_iterations: int, tolerance: float) -> Any:
        """Return SciPy's result of the last stage."""
        from scipy.optimize import least_squares

        last: Array | None = None

        def jacobian(x: Array) -> Array:
            # Called at every accepted step, and where a stage starts: where the one before ended.
            nonlocal last
            if last is None or not np.array_equal(x, last):
                self.record(x)
            last = x.copy()
            return self.jacobian(x)

        x = self.coordinates.from_theta(self.start)[self.free]
        left = max_iterations
        # A trial step that overflows has an infinite cost, and the next one is shorter.
        with np.errstate(over="ignore", invalid="ignore"):
            for stage, thinnest in enumerate(_THINNEST):
                stages = len(_THINNEST) - stage
                lower, upper = (side[self.free] for side in self.coordinates.bounds(thinnest))
                result = least_squares(
                    self.residual,
                    np.clip(x, lower, upper),
                    jac=jacobian,
                    bounds=(lower, upper),
                    method="trf",
                    x_scale=1.0,
                    ftol=tolerance if stages == 1 else max(tolerance, _STAGE),
                    xtol=_ROUNDING,
                    gtol=_ROUNDING,
                    max_nfev=max(left // stages, 1),
                )
                x, left = result.x, left - int(result.nfev)
                if left <= 0:
                    break
        return result
