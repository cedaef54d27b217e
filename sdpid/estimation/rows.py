"""The stacked rows of a problem, in chunks, and their compression.

Rows are never held all at once: chunks are whitened and folded into a small triangular factor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from sdpid._arrays import Array, Mask
from sdpid.experiment.samples import Samples
from sdpid.robot.base import BaseParameters
from sdpid.robot.friction import FrictionModel
from sdpid.robot.model import RobotModel

T = TypeVar("T")

# Samples handled at a time: some 10 MB of rows for a six-axis arm.
CHUNK = 4096


@dataclass(frozen=True)
class RowSource:
    """The base regressor and the efforts of a sample set.

    Attributes
    ----------
    robot, friction, base, samples
        What the rows are made of.
    """

    robot: RobotModel
    friction: FrictionModel
    base: BaseParameters
    samples: Samples

    def map(
        self, function: Callable[..., T], *arguments: object, sigma: Array | None = None
    ) -> list[T]:
        """Return what a function says of the rows of every piece, in order.

        What is added up over the pieces is the same wherever they are, to the last bit.

        Parameters
        ----------
        function : callable
            Of the rows of a piece, of its part of `sigma` if there is one, and of the arguments.
        *arguments
            The same for all pieces.
        sigma : ndarray, shape (n, n) or (K, n, n), optional
            A covariance, for all samples or one a sample.
        """
        samples = self.samples
        found = []
        for part, piece in zip(samples.parts, samples.pieces, strict=True):
            own = () if sigma is None else (sigma if sigma.ndim == 2 else sigma[part],)
            found.append(function(replace(self, samples=piece), *own, *arguments))
        return found

    def regressor(self, part: slice) -> Array:
        """Return the base regressor of some samples, shape (k, n, b)."""
        s = self.samples
        q, v, a = s.position[part], s.velocity[part], s.acceleration[part]
        links = 10 * self.robot.n_links
        kept = self.base.kept
        out = np.empty((len(q), self.robot.n, self.base.count))
        inertial = kept < links
        out[:, :, inertial] = self.robot.regressor(q, v, a)[:, :, kept[inertial]]
        out[:, :, ~inertial] = self.friction.columns(v, a)[:, :, kept[~inertial] - links]
        return out

    def chunks(self, size: int = CHUNK) -> Iterator[tuple[slice, Array, Array, Mask]]:
        """Yield (slice, base regressor, effort, mask) chunk by chunk."""
        count = len(self.samples.effort)
        for start in range(0, count, size):
            part = slice(start, min(start + size, count))
            mask = (
                np.ones((part.stop - part.start, self.robot.n), dtype=bool)
                if self.samples.mask is None
                else self.samples.mask[part]
            )
            yield part, self.regressor(part), self.samples.effort[part], mask


class Triangle:
    """A growing upper triangle R with R^T·R = Σ rows^T·rows, by orthogonal transformations."""

    def __init__(self, columns: int) -> None:
        self.R: Array = np.zeros((0, columns))

    def add(self, rows: Array) -> None:
        """Fold further rows in."""
        self.R = np.asarray(np.linalg.qr(np.vstack([self.R, rows]), mode="r"))

    def split(self) -> tuple[Array, Array, float]:
        """Return A (b, b), rhs (b,) and floor, the last column being the right-hand side."""
        columns = self.R.shape[1]
        R = np.zeros((columns, columns))
        R[: len(self.R)] = self.R[:columns]
        b = columns - 1
        return R[:b, :b].copy(), R[:b, b].copy(), float(R[b, b] ** 2)
