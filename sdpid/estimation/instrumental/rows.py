"""Rows whose regressor is the part of the measured one that instruments explain."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.estimation.compression.rows import RowSource
from sdpid.experiment.processing.samples import Samples

T = TypeVar("T")


@dataclass(frozen=True)
class InstrumentalRows(RowSource):
    """The second stage of two-stage least squares, as rows of an ordinary problem.

    Let Z be the regressor of the instruments' motion, W that of the measured one, y the efforts,
    ``X = Z·L`` the projection of W on Z, and β the instrumental estimate,
    ``X^T·(y − W·β) = 0``. The rows are ``[X | X·(β − δ) + y − W·β]``. Their least-squares fit is β,
    their residual there is ``y − W·β``, and their scores are those of instruments and residuals:
    whatever computes costs, errors or proofs from rows does so of the instrumental estimate.

    Attributes
    ----------
    samples : Samples
        The measured motion and efforts.
    instruments : Samples
        The other motion, aligned row by row.
    link : ndarray, shape (b, b)
        L.
    fit : ndarray, shape (b,)
        β.
    shift : ndarray, shape (b,)
        δ, which makes β the fit exactly where the equations above hold but nearly; else zero.
    """

    instruments: Samples
    link: Array
    fit: Array
    shift: Array

    def map(
        self, function: Callable[..., T], *arguments: object, sigma: Array | None = None
    ) -> list[T]:
        """Apply a function to the rows of each piece; as `RowSource.map`."""
        samples = self.samples
        pairs = zip(samples.parts, samples.pieces, self.instruments.pieces, strict=True)
        found = []
        for part, piece, instruments in pairs:
            own = () if sigma is None else (sigma if sigma.ndim == 2 else sigma[part],)
            rows = replace(self, samples=piece, instruments=instruments)
            found.append(function(rows, *own, *arguments))
        return found

    @cached_property
    def reached(self) -> Mask:
        """At which columns rows may not be zero: at all, for L mixes them."""
        return np.ones((self.robot.n, self.base.count + 1), dtype=bool)

    def regressor(self, part: slice) -> Array:
        """Return the projected regressor X of some samples, shape (k, n, b)."""
        return np.asarray(self.on(self.instruments).regressor(part) @ self.link)

    def rows(self, part: slice, out: Array | None = None) -> Array:
        """Return X with the efforts of the second stage as last column; as `RowSource.rows`."""
        found = super().rows(part, out)
        residual = found[:, :, -1] - self.measured_regressor(part, found) @ self.fit
        X = self.regressor(part)
        found[:, :, :-1] = X
        found[:, :, -1] = residual + X @ (self.fit - self.shift)
        return found

    def measured_regressor(self, part: slice, rows: Array | None = None) -> Array:
        """Return W of some samples, shape (k, n, b); `rows` are those of `RowSource.rows`."""
        return super().regressor(part) if rows is None else rows[:, :, :-1]

    def chunks(self, size: int = 0) -> Iterator[tuple[slice, Array, Array, Mask]]:
        """Yield (slice, X, efforts of the second stage, mask); as `RowSource.chunks`."""
        for part in self.parts(size):
            found = self.rows(part)
            yield part, found[:, :, :-1], found[:, :, -1], self.mask(part)

    @property
    def hashed(self) -> tuple[Array, ...]:
        """What the rows are made of beside the samples, for their digest."""
        other = self.instruments
        motion = (other.position, other.velocity, other.acceleration)
        return (*motion, self.link, self.fit, self.shift)
