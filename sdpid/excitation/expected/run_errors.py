"""The errors of a fit to a run that is repeated, with what earlier runs told."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.estimation.information import information_root
from sdpid.estimation.noise_spectrum import NoiseSpectrum


@dataclass(frozen=True, eq=False)
class RunErrors:
    """Sums over the rows of a fit: what its errors are made of.

    Attributes
    ----------
    information : ndarray, shape (c, c)
        ``Σ H_g`` of the base parameters, and of speeds that the data would choose.
    scores : ndarray, shape (c, c)
        ``Σ S_g·H_g``, the covariance of the scores.
    known : ndarray, shape (c,)
        What is known of the parameters beforehand, as the diagonal of an information.
    base_count : int
        b.
    """

    information: Array
    scores: Array
    known: Array
    base_count: int

    @classmethod
    def of(cls, spectrum: NoiseSpectrum) -> RunErrors:
        """Gather the sums over a run's groups of rows."""
        return cls(
            frozen(spectrum.information.sum(axis=0)),
            frozen(np.einsum("g,gij->ij", spectrum.density, spectrum.information)),
            spectrum.known,
            spectrum.base_count,
        )

    def plus(self, other: RunErrors, times: float = 1.0) -> RunErrors:
        """Return the sums of this and of `times` another, whose errors are others."""
        return replace(
            self,
            information=frozen(self.information + times * other.information),
            scores=frozen(self.scores + times * other.scores),
        )

    def beyond(self, other: RunErrors) -> RunErrors:
        """Return what this has more than `other`, whose rows it has too; nothing is negative."""
        return replace(
            self,
            information=frozen(_positive(self.information - other.information)),
            scores=frozen(_positive(self.scores - other.scores)),
        )

    def with_earlier(self, information: Array) -> RunErrors:
        """Return the sums with those of earlier runs, from the inverse (b, b) of a covariance."""
        added = np.zeros_like(self.information)
        added[: self.base_count, : self.base_count] = information
        return self.plus(replace(self, information=added, scores=added))

    @property
    def base_information(self) -> Array:
        """Information (b, b) that the fit's weights see, what is known of speeds left out."""
        return self.information[: self.base_count, : self.base_count]

    @property
    def covariance(self) -> Array:
        """Covariance of the unconstrained fit, (b, b)."""
        return self.whole_covariance[: self.base_count, : self.base_count]

    @cached_property
    def whole_covariance(self) -> Array:
        """Covariance (c, c) of the fit and of the logarithms of speeds that the data choose."""
        root = information_root(self.information + np.diag(self.known))
        return np.asarray(root @ (root.T @ (self.scores + np.diag(self.known)) @ root) @ root.T)

    def freedom(self, functionals: Array) -> Array:
        """Return infinite degrees of freedom: the noise is believed, not estimated."""
        return np.full(len(functionals), np.inf)


def _positive(matrix: Array) -> Array:
    """Return the nearest positive semidefinite matrix, in units of its diagonal."""
    size = np.sqrt(np.maximum(np.abs(np.diag(matrix)), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    positive = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(positive * np.outer(size, size))
