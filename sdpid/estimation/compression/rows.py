"""The stacked rows of a problem, in chunks.

Rows are never held all at once: chunks are whitened (`sdpid.estimation.compression.whitening`) and
folded into a small triangular factor (`sdpid.estimation.compression.triangle`).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask, frozen
from sdpid.errors import DataError
from sdpid.estimation.compression.contact_rows import ContactRows
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import OfMotion, SampledMotion
from sdpid.robot.model import regressor_kernel as kernels
from sdpid.robot.model.base_parameters import BaseParameters
from sdpid.robot.model.model import RobotModel

T = TypeVar("T")

# Bytes of the rows of a chunk. From samples to the triangle a six-axis arm takes 3.3 µs a sample in
# chunks of 1 MiB, 2.8 in chunks of 4: what is done once for a chunk then no longer counts, and the
# rows are still in a cache, if not the fastest, when they are whitened and folded.
CHUNK_BYTES = 1 << 22

# Samples handled at a time by what does not look at the rows.
CHUNK = 4096


@runtime_checkable
class SamplesElsewhere(Protocol):
    """Samples that stay where they are, and have functions applied to their rows there."""

    @property
    def samples(self) -> Samples:
        """An evenly thinned selection."""

    @property
    def n_samples(self) -> int:
        """Number of all samples."""

    def map(
        self,
        rows: RowSource,
        function: Callable[..., T],
        arguments: tuple[object, ...],
        sigma: Array | None,
    ) -> list[T]:
        """Apply a function to each piece, with robot, friction and base of rows: `RowSource.map`.

        What is added up over the pieces is the same wherever they are, to the last bit.
        """


@dataclass(frozen=True)
class RowSource:
    """The base regressor and the efforts of a sample set.

    Attributes
    ----------
    robot, friction, base, samples
        What the rows are made of.
    force_scale : float
        What covariances of measured contact forces are multiplied by.
    elsewhere : SamplesElsewhere or None
        Where the samples are of which `samples` is a selection; None where these are all.
    """

    robot: RobotModel
    friction: FrictionModel
    base: BaseParameters
    samples: Samples
    force_scale: float = field(default=1.0, kw_only=True)
    elsewhere: SamplesElsewhere | None = field(default=None, kw_only=True)

    @property
    def n_samples(self) -> int:
        """Number of samples that the rows are made of."""
        return (self.elsewhere or self.samples).n_samples

    def map(
        self, function: Callable[..., T], *arguments: object, sigma: Array | None = None
    ) -> list[T]:
        """Apply a function to the rows of each piece and return the results in their order.

        Parameters
        ----------
        function : callable
            Of the rows of a piece, of its part of `sigma` if there is one, and of the arguments.
        *arguments
            The same for all pieces.
        sigma : ndarray, shape (n, n) or (K, n, n), optional
            A covariance, for all samples or one a sample.
        """
        if self.elsewhere is not None:
            return self.elsewhere.map(self, function, arguments, sigma)
        found = []
        for part, rows in zip(self.samples.parts, self.pieces(), strict=True):
            own = () if sigma is None else (sigma if sigma.ndim == 2 else sigma[part],)
            found.append(function(rows, *own, *arguments))
        return found

    def pieces(self) -> Iterator[RowSource]:
        """Yield the rows of each piece of the samples."""
        return map(self.on, self.samples.pieces)

    def on(self, samples: Samples) -> RowSource:
        """Return the ordinary rows of other samples, of whatever kind these rows are."""
        return RowSource(
            self.robot, self.friction, self.base, samples, force_scale=self.force_scale
        )

    def with_force_scale(self, scale: float) -> RowSource:
        """Return the same rows with other covariances of measured contact forces.

        Raises
        ------
        DataError
            Where such forces are elsewhere.
        """
        contacts = self.samples.contacts
        if self.elsewhere is not None and contacts is not None and contacts.measured:
            raise DataError(
                "samples: measured contact forces cannot be weighted by residuals on a cluster; "
                "give the flags alone, or use the samples here."
            )
        return replace(self, force_scale=scale)

    @property
    def hashed(self) -> tuple[Array, ...]:
        """What the rows are made of beside the samples, for their digest."""
        return () if self.force_scale == 1.0 else (np.array([self.force_scale]),)

    @cached_property
    def chunk_size(self) -> int:
        """Samples of a chunk: those whose rows have `CHUNK_BYTES`, at least one."""
        return max(1, CHUNK_BYTES // self._sample_bytes)

    @property
    def many(self) -> bool:
        """Whether compiled loops are worth it, where there are any."""
        # As for the whole log, so that its last few samples are computed like the others.
        return self._sample_bytes * self.samples.n_samples >= kernels.WORTH

    @property
    def _sample_bytes(self) -> int:
        return 8 * self.robot.n * (self.base.count + 1)

    @cached_property
    def _places(self) -> Indices:
        """The base parameter that the column of each standard one leads, -1 for none."""
        places = np.full(len(self.base.theta_names), -1, dtype=np.intp)
        places[self.base.kept] = np.arange(self.base.count)
        return places

    def with_every_column(self) -> RowSource:
        """Return the rows with a column for each friction parameter, dependent ones too.

        They come last. The links' columns are those that the scan for base parameters kept, in
        which friction has no part.
        """
        base, first, more = self.base, 10 * self.robot.n_links, self.friction.parameters
        links = np.flatnonzero(base.kept < first)
        matrix = np.zeros((len(links) + len(more), first + len(more)))
        matrix[: len(links), :first] = base.matrix[links, :first]
        matrix[len(links) :, first:] = np.eye(len(more))
        names, units = tuple(p.name for p in more), tuple(p.unit for p in more)
        every = replace(
            base,
            names=(*(base.names[i] for i in links), *names),
            units=(*(base.units[i] for i in links), *units),
            matrix=frozen(matrix),
            kept=np.concatenate([base.kept[links], first + np.arange(len(more))]),
            theta_names=(*base.theta_names[:first], *names),
            theta_units=(*base.theta_units[:first], *units),
        )
        return replace(self, base=every)

    def regressor(self, part: slice) -> Array:
        """Return the base regressor of some samples, shape (k, n, b)."""
        return self.rows(part)[:, :, :-1]

    def rows(self, part: slice) -> Array:
        """Return the base regressor of some samples with the efforts as last column.

        Parameters
        ----------
        part : slice
            The samples.

        Returns
        -------
        ndarray, shape (k, n, b + 1)
        """
        s, n, effort = self.samples, self.robot.n, self.effort(part)
        of_links, to = np.split(self._places, [10 * self.robot.n_links])
        out = np.empty((len(effort), n, self.base.count + 1))
        self.robot.regressor_columns(
            s.position[part], s.velocity[part], s.acceleration[part],
            places=of_links, out=out, compiled=self.many,
            entries=(effort, np.arange(n), np.full(n, self.base.count)),
        )  # fmt: skip
        out[:, :, to[to >= 0]] = self.friction.columns_in(self.motion(part))[:, :, to >= 0]
        return out

    def contacts(self, part: slice) -> ContactRows | None:
        """Return what contacts do to the rows of some samples, None where there are none."""
        return ContactRows.of(
            self.robot, self.samples, part, scale=self.force_scale, compiled=self.many
        )

    def effort(self, part: slice) -> Array:
        """Return the efforts of some samples (k, n), those of measured contact forces added."""
        effort, contacts = self.samples.effort[part], self.samples.contacts
        touching = self.contacts(part) if contacts is not None and contacts.measured else None
        return effort if touching is None else effort + touching.effort

    def mask(self, part: slice) -> Mask:
        """Return which rows of some samples are used, shape (k, n)."""
        if self.samples.mask is None:
            return np.ones(self.samples.effort[part].shape, dtype=bool)
        return self.samples.mask[part]

    def chunks(self, size: int = 0) -> Iterator[tuple[slice, Array, Array, Mask]]:
        """Yield (slice, base regressor, effort, mask) by `size` samples, else `chunk_size`."""
        for part in self.parts(size):
            found = self.rows(part)
            yield part, found[:, :, :-1], found[:, :, -1], self.mask(part)

    def parts(self, size: int = 0, within: slice = slice(None)) -> Iterator[slice]:
        """Yield the slices of chunks of `size` samples, else of `chunk_size`, of some neighbors."""
        first, stop, _ = within.indices(len(self.samples.effort))
        size = size or self.chunk_size
        for start in range(first, stop, size):
            yield slice(start, min(start + size, stop))

    def motion(self, part: slice) -> SampledMotion:
        """Return the motion of some samples, at which friction columns are evaluated."""
        return motion_of(self.robot, self.samples, part, first=self.friction.first)


def motion_of(robot: RobotModel, samples: Samples, part: slice, *, first: int = 0) -> SampledMotion:
    """Return the motion of some samples, of the joints from `first` on that have friction."""

    def through_filter(function: OfMotion, key: Hashable | None = None) -> Array:
        # The coordinates of a floating base come first, and have no friction.
        return samples.through_filter(lambda v, a: function(v[:, first:], a[:, first:]), part, key)

    def through_path(function: Callable[[Array], Array]) -> Array:
        return np.concatenate([function(samples.position[each]) for each in samples.parts])[part]

    return SampledMotion(
        position=samples.position[part],
        velocity=samples.velocity[part][:, first:],
        acceleration=samples.acceleration[part][:, first:],
        robot=robot,
        through_filter=None if samples.wide is None else through_filter,
        through_path=through_path,
    )
