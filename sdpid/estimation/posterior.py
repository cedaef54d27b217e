"""How far an estimate is from the truth: the errors of its data and of its prior.

Where no inequality is active, an estimate is the least-squares solution of the data's rows
``A·B·theta = h`` and of the prior's rows ``R·theta = r``. So its error is ``L·(errors of h and r)``
with L the pseudoinverse of both. The errors of h are those that the residuals show, whatever the
weights say (see `sdpid.estimation.noise_spectrum`); those of the prior's rows have a variance of
one, as stated. Where efforts were made of currents, the errors of the gains come on top (see
`sdpid.estimation.gain_errors`), and so do biases by noise in the measured motion and by landings,
where they are known (see `sdpid.estimation.motion_noise`): each as one more error of that size in
its direction, so that intervals hold the truth however large it is. An active inequality can only
bring an estimate nearer to the truth, all in all: it is not counted, which errs on the wide side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import SolverError
from sdpid.estimation.cluster_robust import ScoreBlocks
from sdpid.estimation.coordinates import Coordinates
from sdpid.estimation.error_source import ErrorSource
from sdpid.estimation.gain_errors import GainErrors
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

# What is independent of each other: Fourier coefficients, blocks of samples, or whole periods.
Groups = Literal["frequencies", "blocks", "periods"]

# Directions of theta that data and prior together see this little are open, but for rounding.
_OPEN = 1e-12

# Share of errors beside a bias below which they no longer count.
_LEAST_SHARE = 1e-3

# A function of which more than this share lies in open directions is open: the rest is rounding.
_LOST = 1e-7


class Estimated(Protocol):
    """What an estimate says of itself."""

    @property
    def problem(self) -> Problem:
        """What was solved."""

    @property
    def method(self) -> str:
        """How, such as ``"wls"``."""

    @property
    def base(self) -> Array:
        """Base parameters, (b,)."""

    @property
    def theta(self) -> Array | None:
        """Standard parameters (p,), None where the method has none."""

    @property
    def curvature(self) -> Array | None:
        """That of the data's cost where it is not that of squares, (r, r) (see `Estimate`)."""


class FitErrors(Protocol):
    """What is known of the errors of the unconstrained fit: it is off by T·x, where it is seen.

    A·T has numbers of order one however little the data show of a direction, T has not.
    """

    @property
    def root(self) -> Array:
        """T (b, r); directions that the data do not determine have no column."""

    @property
    def scores(self) -> Array:
        """Covariance of x, (r, r)."""

    def freedom(self, directions: Array) -> Array:
        """Return the degrees of freedom of the variance of x along each direction (k, r)."""


def fit_errors(estimate: Estimated, groups: Groups) -> FitErrors:
    """Return the errors of the unconstrained fit of an estimate's problem.

    Raises
    ------
    DataError
        When the problem has no rows, or too few groups.
    """
    errors: FitErrors = (
        NoiseSpectrum.of(estimate.problem, estimate.theta)
        if groups == "frequencies"
        else ScoreBlocks.of(estimate.problem, groups)
    )
    return beside(errors, estimate)


def rows_covariance(problem: Problem, errors: FitErrors) -> Array:
    """Return the covariance (b, b) of the compressed efforts that the fit's errors are those of."""
    turned = problem.A @ errors.root
    return np.asarray(turned @ errors.scores @ turned.T)


def beside(errors: FitErrors, estimate: Estimated) -> FitErrors:
    """Return errors of a fit under the estimate's cost, and with its biases beside them.

    Where the cost is not of squares, its curvature takes the place of theirs.
    """
    problem, root = estimate.problem, errors.root
    if estimate.curvature is not None:
        T = problem.excitation.root
        pull = (problem.A @ T).T @ (problem.A @ root)
        root = T @ np.linalg.solve(estimate.curvature, pull)
    elif not problem.errors:
        return errors
    return _Beside(errors, np.hstack([root, *(source.moves for source in problem.errors)]))


@dataclass(frozen=True, eq=False)
class _Beside:
    """Errors of a fit, and k biases beside them: each as one more error of size one."""

    errors: FitErrors
    root: Array

    @property
    def scores(self) -> Array:
        """Mean squares, (r + k, r + k)."""
        own = self.errors.scores
        found = np.eye(self.root.shape[1])
        found[: len(own), : len(own)] = own
        return found

    def freedom(self, directions: Array) -> Array:
        """Return the degrees of freedom of mean squares along directions (k, r + k)."""
        parts = np.split(directions, [len(self.errors.scores)], axis=1)
        own = np.einsum("ki,ij,kj->k", parts[0], self.errors.scores, parts[0])
        share = _share(own, own + np.sum(parts[1] ** 2, axis=1), 1.0)
        freedom = self.errors.freedom(parts[0])
        return np.asarray(freedom / np.maximum(share, _LEAST_SHARE) ** 2)


@dataclass(frozen=True, eq=False)
class Posterior:
    """The errors of an estimate.

    Attributes
    ----------
    errors : FitErrors
        Of the unconstrained fit.
    from_fit : ndarray, shape (p, b)
        How theta moves with the unconstrained fit.
    from_errors : ndarray, shape (p, r)
        The same with the coordinates of its errors.
    from_prior : ndarray, shape (p, rows)
        How theta moves with the prior's rows.
    from_gains : ndarray, shape (p, n)
        How theta moves with the logarithms of the gains that made the efforts of currents.
    gains : GainErrors
        Their errors.
    seen, unseen : ndarray, shape (p, r) and (p, k)
        Directions in which they move it, and in which neither does, scaled.
    """

    errors: FitErrors
    from_fit: Array
    from_errors: Array
    from_prior: Array
    from_gains: Array
    gains: GainErrors
    seen: Array
    unseen: Array

    @classmethod
    def of(cls, estimate: Estimated, groups: Groups = "frequencies") -> Posterior:
        """Gather the errors of an estimate; without standard parameters it is the fit itself.

        Raises
        ------
        DataError
            When the problem has no rows, or too few groups.
        SolverError
            When the equations among the constraints contradict each other.
        """
        return cls.about(estimate, fit_errors(estimate, groups))

    @classmethod
    def about(cls, estimate: Estimated, errors: FitErrors) -> Posterior:
        """Build from the errors of the unconstrained fit; as `of`."""
        problem = estimate.problem
        # What rounding hides of the data is not seen.
        excitation, B = problem.excitation, problem.base.matrix
        A = problem.A @ excitation.root @ excitation.inverse
        basis = Scaling.of(problem).basis()
        R = prior_rows(estimate)
        if estimate.theta is not None and estimate.method != "wls":
            basis = _along_equations(problem, basis, np.array(estimate.theta))
        rows = np.vstack([A @ (B @ basis), R @ basis])
        U, singular, V = np.linalg.svd(rows, full_matrices=True)
        rank = int(np.count_nonzero(singular > _OPEN * singular.max(initial=0.0)))
        seen, unseen = basis @ V[:rank].T, basis @ V[rank:].T
        L = (seen / singular[:rank]) @ U[:, :rank].T
        gains = GainErrors.of(problem)
        of_data, of_prior = L[:, : len(A)], L[:, len(A) :]
        from_errors = of_data @ (A @ errors.root)
        of_gains = of_data @ gains.rows
        return cls(errors, of_data @ A, from_errors, of_prior, of_gains, gains, seen, unseen)

    def covariance(self, functions: Array, *, gains: bool = True) -> Array:
        """Return the covariance (k, k) of functions (k, p) of theta, of what data and prior see.

        The errors of gains are left out on request.
        """
        data, prior = functions @ self.from_errors, functions @ self.from_prior
        found = data @ self.errors.scores @ data.T + prior @ prior.T
        if gains and self.gains.any:
            moved = functions @ self.from_gains
            found = found + moved @ self.gains.covariance @ moved.T
        return np.asarray(found)

    def spread(self, functions: Array) -> tuple[Array, Array, Array]:
        """Return what is known of the errors of functions (k, p) of theta.

        Returns
        -------
        variance : ndarray, shape (k,)
            Infinite where neither data nor prior say anything.
        prior_share : ndarray, shape (k,)
            Share of the prior's rows in it.
        freedom : ndarray, shape (k,)
            Degrees of freedom of the variance: that of the prior's rows is known.
        """
        data, prior = functions @ self.from_errors, functions @ self.from_prior
        own = np.maximum(np.einsum("ki,ij,kj->k", data, self.errors.scores, data), 0.0)
        slopes = functions @ self.from_gains
        of_gains, believed = self.gains.variance(slopes), np.sum(prior**2, axis=1)
        total = own + of_gains + believed
        share = _share(believed, total, 0.0)
        uncertain = _share(own, total, 1.0) ** 2 / self.errors.freedom(data)
        uncertain += _share(of_gains, total, 0.0) ** 2 / self.gains.degrees(slopes)
        freedom = 1.0 / np.maximum(uncertain, np.finfo(float).eps)
        lost = self.lost(functions)
        return np.where(lost, np.inf, total), np.where(lost, 1.0, share), freedom

    def lost(self, functions: Array) -> Mask:
        """Return of which functions (k, p) of theta neither data nor prior say anything."""
        seen, unseen = (np.linalg.norm(functions @ d, axis=1) for d in (self.seen, self.unseen))
        return np.asarray(unseen > _LOST * np.hypot(seen, unseen))

    def share_of(self, source: ErrorSource, functions: Array) -> Array:
        """Return the share (k,) of a source of errors in the variances of functions (k, p)."""
        return self._share(functions, source.variance(functions @ self.from_fit @ source.moves))

    def gains_share(self, functions: Array) -> Array:
        """Return the share (k,) of the gains' errors in the variances of functions (k, p)."""
        return self._share(functions, self.gains.variance(functions @ self.from_gains))

    def _share(self, functions: Array, own: Array) -> Array:
        variance, _, _ = self.spread(functions)
        return np.asarray(np.where(np.isfinite(variance), _share(own, variance, 0.0), 0.0))


def _share(part: Array, total: Array, otherwise: float) -> Array:
    """Return the share of a part; of nothing it is stated."""
    out = np.full_like(part, otherwise)
    return np.asarray(np.divide(part, total, out=out, where=total > 0.0))


def prior_rows(estimate: Estimated) -> Array:
    """Return the rows R (k, p) of an estimate's prior; none without standard parameters."""
    problem, theta = estimate.problem, estimate.theta
    rows = [np.zeros((0, problem.n_theta))]
    if theta is not None and problem.prior is not None:
        rows += [term.curvature_rows(theta) for term in problem.prior.terms]
    return np.vstack(rows)


def _along_equations(problem: Problem, basis: Array, theta: Array) -> Array:
    """Return the directions (p, k) of theta that equations among the constraints leave free."""
    found = Coordinates.of(problem, basis, theta)
    if found is None:
        raise SolverError(
            "intervals: the equations among the constraints contradict each other.",
            problem=problem,
        )
    return found.directions
