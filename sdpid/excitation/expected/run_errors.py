"""The errors of a fit to a run that is repeated, with what earlier runs told."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.estimation.information import information_root, information_rows
from sdpid.estimation.noise_spectrum import NoiseSpectrum


@dataclass(frozen=True, eq=False)
class RunErrors:
    """Sums over the rows of a fit: what its errors are made of.

    Attributes
    ----------
    information : ndarray, shape (c, c)
        ``Σ H_g`` of the base parameters, and of speeds that the data would choose.
    sums : ndarray, shape (c, c)
        ``Σ S_g·H_g``, the covariance of the scores.
    known : ndarray, shape (c,)
        What is known of the parameters beforehand, as the diagonal of an information.
    size : float
        Variance of a weighted row: what is known beforehand is as uncertain as stated.
    base_count : int
        b.
    """

    information: Array
    sums: Array
    known: Array
    size: float
    base_count: int

    @classmethod
    def of(cls, spectrum: NoiseSpectrum) -> RunErrors:
        """Gather the sums over a run's groups of rows."""
        return cls(
            frozen(spectrum.information()),
            frozen(spectrum.information(spectrum.density)),
            spectrum.known,
            spectrum.size,
            spectrum.base_count,
        )

    def plus(self, other: RunErrors, times: float = 1.0) -> RunErrors:
        """Return the sums of this and of `times` another, whose errors are others."""
        return replace(
            self,
            information=frozen(self.information + times * other.information),
            sums=frozen(self.sums + times * other.sums),
        )

    def beyond(self, other: RunErrors) -> RunErrors:
        """Return what this has more than `other`, whose rows it has too; nothing is negative."""
        return replace(
            self,
            information=frozen(_positive(self.information - other.information)),
            sums=frozen(_positive(self.sums - other.sums)),
        )

    def with_earlier(self, information: Array) -> RunErrors:
        """Return the sums with those of earlier runs, from the inverse (b, b) of a covariance."""
        added = np.zeros_like(self.information)
        added[: self.base_count, : self.base_count] = information
        return self.plus(replace(self, information=added, sums=added))

    @property
    def base_information(self) -> Array:
        """Information (b, b) that the fit's weights see, what is known of speeds left out."""
        return self.information[: self.base_count, : self.base_count]

    @property
    def root(self) -> Array:
        """T (b, r) of the fit alone: what rounding of the sums hides has no column."""
        return self.whole_root[: self.base_count]

    @cached_property
    def whole_root(self) -> Array:
        """The same with the logarithms of speeds, (c, r)."""
        return information_root(information_rows(self.information + np.diag(self.known)))

    @cached_property
    def scores(self) -> Array:
        """Covariance of the fit in the coordinates of `root`, (r, r)."""
        sums = self.sums + self.size * np.diag(self.known)
        return np.asarray(self.whole_root.T @ sums @ self.whole_root)

    def freedom(self, directions: Array) -> Array:
        """Return infinite degrees of freedom: the noise is believed, not estimated."""
        return np.full(len(directions), np.inf)


def _positive(matrix: Array) -> Array:
    """Return the nearest positive semidefinite matrix, in units of its diagonal."""
    size = np.sqrt(np.maximum(np.abs(np.diag(matrix)), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    positive = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(positive * np.outer(size, size))
