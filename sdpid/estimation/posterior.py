"""How far an estimate is from the truth: the errors of its data and of its prior.

Where no inequality is active, an estimate is the least-squares solution of the data's rows
``A·B·theta = h`` and of the prior's rows ``R·theta = r``. So its error is ``L·(errors of h and r)``
with L the pseudoinverse of both. The errors of h are those that the residuals show, whatever the
weights say (see `sdpid.estimation.noise_spectrum`); those of the prior's rows have a variance of
one, as stated. Where efforts were made of currents, the errors of the gains come on top (see
`gain_errors`), and so do biases by noise in the measured motion and by landings,
where they are known (see `sdpid.estimation.motion_noise`): each as one more error of that size in
its direction, so that intervals hold the truth however large it is. An active inequality can only
bring an estimate nearer to the truth, all in all: it is not counted, which errs on the wide side.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen
from sdpid._common.kept import kept
from sdpid._common.tables import Shown
from sdpid._common.threads import one_thread
from sdpid.errors import SolverError
from sdpid.estimation.cluster_robust import ScoreBlocks
from sdpid.estimation.compression.covariance import PRINTED
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import apply, weights_of
from sdpid.estimation.coordinates import Coordinates
from sdpid.estimation.error_source import ErrorSource
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

# What is independent of each other: Fourier coefficients, blocks of samples, or whole periods.
Groups = Literal["frequencies", "blocks", "periods"]

# Directions of theta that data and prior together see this little are open, but for rounding.
_OPEN = 1e-12

# A function of which more than this share lies in open directions is open: the rest is rounding.
_LOST = 1e-7


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Estimated(Shown):
    """What the errors of an estimate rest on; see `sdpid.estimation.estimate.Estimate`."""

    problem: Problem
    method: str
    base: Array
    theta: Array | None
    curvature: Array | None = field(default=None, repr=False)


@dataclass(frozen=True, eq=False)
class FitErrors:
    """What the residuals show of the errors of the unconstrained fit: it is off by T·x.

    A·T has numbers of order one however little the data show of a direction, T has not.

    Attributes
    ----------
    root : ndarray, shape (b, r)
        T; directions that the data do not determine have no column.
    scores : ndarray, shape (r, r)
        Covariance of x.
    freedom : callable
        Returns the degrees of freedom of the variance of x along each direction (k, r).
    """

    root: Array
    scores: Array
    freedom: Callable[[Array], Array]

    @classmethod
    def of(cls, estimate: Estimated, shown: NoiseSpectrum | ScoreBlocks) -> FitErrors:
        """Take what was shown of the problem's rows under the estimate's cost.

        Where the cost is not of squares, its curvature takes the place of theirs.
        """
        problem, root = estimate.problem, shown.root
        if estimate.curvature is not None:
            T = problem.excitation.root
            pull = (problem.A @ T).T @ (problem.A @ root)
            root = T @ np.linalg.solve(estimate.curvature, pull)
        return cls(root, shown.scores, shown.freedom)


def fit_errors(estimate: Estimated, groups: Groups) -> FitErrors:
    """Return the errors of the unconstrained fit of an estimate's problem.

    Raises
    ------
    DataError
        When the problem has no rows, or too few groups.
    """
    if groups == "frequencies":
        return FitErrors.of(estimate, spectrum_of(estimate))
    return FitErrors.of(estimate, ScoreBlocks.of(estimate.problem, groups))


@kept
def spectrum_of(estimate: Estimated) -> NoiseSpectrum:
    """Return the residuals' spectrum with an estimate's friction; computed once an estimate."""
    return NoiseSpectrum.of(estimate.problem, estimate.theta)


# A pass over all rows.
@kept
def gain_errors(problem: Problem) -> ErrorSource | None:
    """Return the errors of the logarithms of drive gains, None where there are none.

    Efforts that were made of currents are gains times currents, ``y_j = k_j·i_j``: a gain that is
    off by a share e_j moves all efforts of its joint by that share, and the compressed efforts
    ``rhs = Σ_j rhs_j`` by ``Σ_j e_j·rhs_j``, with rhs_j the share of the joint's own rows. The
    errors are the same in every row, so that no residual shows them as noise, and no longer record
    averages them out: they stand beside the errors that residuals show, as a further term of every
    covariance. Weights, the prior and what the data chose stay: it is the first order. An error
    that all gains have in common moves every parameter by the same share.
    """
    rows = problem.rows
    gains = None if rows is None else rows.samples.gains
    if rows is None or gains is None or not gains.covariance.any():
        return None
    exponent = 0.5 * problem.score_exponent
    target = np.sum(rows.map(_targets, exponent, sigma=problem.sigma), axis=0)
    T = problem.excitation.root
    # The normal equations are themselves the compressed rows of a printed weighting.
    turned = problem.A @ T if problem.weighting in PRINTED else T
    moves = frozen(T @ (turned.T @ target))
    return ErrorSource("gains", moves, gains.relative_covariance, gains.freedom, gains)


def _targets(rows: RowSource, sigma: Array, exponent: float) -> Array:
    """Return the products (b, n) of whitened rows and the whitened efforts of each joint alone."""
    n, count = rows.robot.n, rows.base.count
    found = np.zeros((count, n))
    for part in rows.parts():
        own, mask = rows.rows(part), rows.mask(part)
        # The last column of rows may be another: that of a second stage of instruments.
        alone = rows.samples.effort[part][:, :, None] * np.eye(n)
        stacked = np.concatenate([own[:, :, :-1], alone], axis=2)
        weighted = apply(*weights_of(rows, part, sigma, exponent), stacked)
        weighted = np.where(mask[:, :, None], weighted, 0.0).reshape(-1, count + n)
        found += weighted[:, :count].T @ weighted[:, count:]
    return found


def error_sources(problem: Problem) -> tuple[ErrorSource, ...]:
    """Return all that moves the fit of a problem beside noise: its gains, and its biases."""
    gains = gain_errors(problem)
    return problem.errors if gains is None else (gains, *problem.errors)


def rows_covariance(problem: Problem, errors: FitErrors) -> Array:
    """Return the covariance (b, b) of compressed efforts that all errors of the fit are those of.

    Those that residuals show, and those of other sources.
    """
    turned = problem.A @ errors.root
    others = [problem.A @ source.root for source in error_sources(problem)]
    return np.asarray(turned @ errors.scores @ turned.T + sum(each @ each.T for each in others))


class Posterior:
    """The errors of an estimate; without standard parameters it is the fit itself.

    Parameters
    ----------
    estimate : Estimate
        The estimate.
    errors : FitErrors
        Of the unconstrained fit, as residuals show them.

    Raises
    ------
    SolverError
        When the equations among the constraints contradict each other.

    Attributes
    ----------
    errors : FitErrors
        As given.
    sources : tuple of ErrorSource
        What moves the fit beside.
    from_fit : ndarray, shape (p, b)
        How theta moves with the unconstrained fit.
    from_errors : ndarray, shape (p, r)
        The same with the coordinates of its errors.
    from_prior : ndarray, shape (p, rows)
        How theta moves with the prior's rows.
    seen, unseen : ndarray, shape (p, r) and (p, k)
        Directions in which they move it, and in which neither does, scaled.
    """

    def __init__(self, estimate: Estimated, errors: FitErrors) -> None:
        problem = estimate.problem
        # What rounding hides of the data is not seen.
        excitation, B = problem.excitation, problem.base.matrix
        A = problem.A @ excitation.root @ excitation.inverse
        basis = Scaling.of(problem).basis()
        R = prior_rows(estimate)
        if estimate.theta is not None and estimate.method != "wls":
            along = Coordinates.of(problem, basis, np.array(estimate.theta))
            if along is None:
                raise SolverError(
                    "intervals: the equations among the constraints contradict each other.",
                    problem=problem,
                )
            basis = along.directions
        rows = np.vstack([A @ (B @ basis), R @ basis])
        U, singular, V = np.linalg.svd(rows, full_matrices=True)
        rank = int(np.count_nonzero(singular > _OPEN * singular.max(initial=0.0)))
        self.seen, self.unseen = basis @ V[:rank].T, basis @ V[rank:].T
        L = (self.seen / singular[:rank]) @ U[:, :rank].T
        self.errors, self.sources = errors, error_sources(problem)
        self.from_fit, self.from_prior = L[:, : len(A)] @ A, L[:, len(A) :]
        self.from_errors = self.from_fit @ errors.root

    @classmethod
    @one_thread
    def of(cls, estimate: Estimated, groups: Groups = "frequencies") -> Posterior:
        """Gather the errors of an estimate.

        Raises
        ------
        DataError
            When the problem has no rows, or too few groups.
        SolverError
            When the equations among the constraints contradict each other.
        """
        return cls(estimate, fit_errors(estimate, groups))

    def slopes(self, source: ErrorSource, functions: Array) -> Array:
        """Return how functions (m, p) of theta move with each of a source's errors, (m, k)."""
        return np.asarray(functions @ self.from_fit @ source.moves)

    def covariance(self, functions: Array, *, without: Collection[str] = ()) -> Array:
        """Return the covariance (k, k) of functions (k, p) of theta, of what data and prior see.

        Sources of errors are left out by name.
        """
        data, prior = functions @ self.from_errors, functions @ self.from_prior
        found = data @ self.errors.scores @ data.T + prior @ prior.T
        for source in self.sources:
            if source.name not in without:
                moved = self.slopes(source, functions)
                found = found + moved @ source.covariance @ moved.T
        return np.asarray(found)

    def spread(self, functions: Array, data: Array | None = None) -> tuple[Array, Array, Array]:
        """Return what is known of the errors of functions (k, p) of theta.

        Parameters
        ----------
        functions : ndarray, shape (k, p)
            The functions.
        data : ndarray, shape (k, r), optional
            How they move with the coordinates of the fit's errors, where not through theta alone.

        Returns
        -------
        variance : ndarray, shape (k,)
            Infinite where neither data nor prior say anything.
        prior_share : ndarray, shape (k,)
            Share of the prior's rows in it.
        freedom : ndarray, shape (k,)
            Degrees of freedom of the variance, Satterthwaite's: that of the prior's rows is known.
        """
        data = functions @ self.from_errors if data is None else data
        prior = functions @ self.from_prior
        own = np.maximum(np.einsum("ki,ij,kj->k", data, self.errors.scores, data), 0.0)
        moved = [(source, self.slopes(source, functions)) for source in self.sources]
        variances = np.array([own, np.sum(prior**2, axis=1), *(s.variance(m) for s, m in moved)])
        known = np.full(len(own), np.inf)
        degrees = np.array([self.errors.freedom(data), known, *(s.degrees(m) for s, m in moved)])
        total = variances.sum(axis=0)
        # Where there is nothing, all of it is noise.
        shares = np.zeros_like(variances)
        shares[0] = 1.0
        np.divide(variances, total, out=shares, where=total > 0.0)
        freedom = 1.0 / np.maximum(np.sum(shares**2 / degrees, axis=0), np.finfo(float).eps)
        lost = self.lost(functions)
        return np.where(lost, np.inf, total), np.where(lost, 1.0, shares[1]), freedom

    def lost(self, functions: Array) -> Mask:
        """Return of which functions (k, p) of theta neither data nor prior say anything."""
        seen, unseen = (np.linalg.norm(functions @ d, axis=1) for d in (self.seen, self.unseen))
        return np.asarray(unseen > _LOST * np.hypot(seen, unseen))

    def share(self, source: ErrorSource, functions: Array) -> Array:
        """Return the share (k,) of a source of errors in the variances of functions (k, p)."""
        variance, _, _ = self.spread(functions)
        own = source.variance(self.slopes(source, functions))
        return np.divide(own, variance, out=np.zeros_like(own), where=variance > 0.0)


def prior_rows(estimate: Estimated) -> Array:
    """Return the rows R (k, p) of an estimate's prior; none without standard parameters."""
    problem, theta = estimate.problem, estimate.theta
    rows = [np.zeros((0, problem.n_theta))]
    if theta is not None and problem.prior is not None:
        rows += [term.curvature_rows(theta) for term in problem.prior.terms]
    return np.vstack(rows)
