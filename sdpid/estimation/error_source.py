"""Errors of a fit that are the same in every row, so that no residual shows them as noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.estimation.information import freedom_of
from sdpid.experiment.drive_gains.gains import DriveGains


@dataclass(frozen=True, eq=False)
class ErrorSource:
    """One source of such errors; no longer record averages them out.

    Attributes
    ----------
    name : str
        What it is called among the shares of intervals, such as ``"gains"``, ``"landing"`` or
        ``"motion"`` (noise in the measured one).
    moves : ndarray, shape (b, k)
        How the unconstrained fit moves with each of k errors.
    covariance : ndarray, shape (k, k)
        Of these errors.
    freedom : ndarray, shape (k,)
        Degrees of freedom of their variances.
    gains : DriveGains or None
        Those that are off.
    """

    name: str
    moves: Array
    covariance: Array
    freedom: Array
    gains: DriveGains | None = None

    @classmethod
    def bias(cls, name: str, moved: Array) -> ErrorSource:
        """Return a bias of the fit (b,): an error of that size in its direction."""
        return cls(name, frozen(moved[:, None]), np.eye(1), np.full(1, np.inf))

    def same(self, other: ErrorSource) -> bool:
        """Return whether the errors of another fit are these errors: of the same gains."""
        if self.gains is None or other.gains is None:
            return False
        return self.gains.same_errors(other.gains)

    @property
    def root(self) -> Array:
        """How the fit moves with independent errors of variance one, (b, k)."""
        values, vectors = np.linalg.eigh(self.covariance)
        return np.asarray(self.moves @ (vectors * np.sqrt(np.maximum(values, 0.0))))

    def variance(self, slopes: Array) -> Array:
        """Return the variances (m,) of functions that move by slopes (m, k) with the errors."""
        found = np.einsum("ki,ij,kj->k", slopes, self.covariance, slopes)
        return np.asarray(np.maximum(found, 0.0))

    def degrees(self, slopes: Array) -> Array:
        """Return degrees of freedom of these variances (m,): those of the errors that decide."""
        return freedom_of(slopes**2 * np.diag(self.covariance), self.freedom)
