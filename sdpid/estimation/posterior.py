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


class FitErrors(Protocol):
    """What is known of the errors of the unconstrained fit."""

    @property
    def covariance(self) -> Array:
        """Covariance of the unconstrained fit, (b, b)."""

    def freedom(self, functionals: Array) -> Array:
        """Return the degrees of freedom of the variance of each functional (k, b) of the fit."""


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
    return with_biases(errors, estimate.problem.biases)


def with_biases(errors: FitErrors, biases: Array) -> FitErrors:
    """Return errors of a fit with biases (k, b) beside them; without any, the errors."""
    return _Biased(errors, biases) if len(biases) else errors


@dataclass(frozen=True, eq=False)
class _Biased:
    """Errors of a fit, with biases (k, b) beside them."""

    errors: FitErrors
    biases: Array

    @property
    def covariance(self) -> Array:
        """Mean squared errors of the unconstrained fit, (b, b)."""
        return np.asarray(self.errors.covariance + self.biases.T @ self.biases)

    def freedom(self, functionals: Array) -> Array:
        """Return the degrees of freedom of what each functional (k, b) is off by."""
        own = np.einsum("ki,ij,kj->k", functionals, self.errors.covariance, functionals)
        squared = np.sum((functionals @ self.biases.T) ** 2, axis=1)
        share = _share(own, own + squared, 1.0)
        freedom = self.errors.freedom(functionals)
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
        A, B = problem.A, problem.base.matrix
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
        return cls(errors, of_data @ A, of_prior, of_data @ gains.rows, gains, seen, unseen)

    def covariance(self, functions: Array, *, gains: bool = True) -> Array:
        """Return the covariance (k, k) of functions (k, p) of theta, of what data and prior see.

        The errors of gains are left out on request.
        """
        data, prior = functions @ self.from_fit, functions @ self.from_prior
        found = data @ self.errors.covariance @ data.T + prior @ prior.T
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
        data, prior = functions @ self.from_fit, functions @ self.from_prior
        own = np.maximum(np.einsum("ki,ij,kj->k", data, self.errors.covariance, data), 0.0)
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

    def bias_share(self, functions: Array, bias: Array) -> Array:
        """Return the share (k,) of one of the fit's biases (b,) in the variances of functions."""
        variance, _, _ = self.spread(functions)
        own = ((functions @ self.from_fit) @ bias) ** 2
        return np.asarray(np.where(np.isfinite(variance), _share(own, variance, 0.0), 0.0))

    def gains_share(self, functions: Array) -> Array:
        """Return the share (k,) of the gains' errors in the variances of functions (k, p)."""
        variance, _, _ = self.spread(functions)
        of_gains = self.gains.variance(functions @ self.from_gains)
        return np.asarray(np.where(np.isfinite(variance), _share(of_gains, variance, 0.0), 0.0))


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


def constrained_covariance(estimate: Estimated) -> Array:
    """Return the covariance (b, b) of an estimate's base parameters, its prior's share included.

    Inequalities are not counted, equations among the constraints are.

    Raises
    ------
    DataError
        When the problem has no rows.
    """
    return Posterior.of(estimate).covariance(estimate.problem.base.matrix)
