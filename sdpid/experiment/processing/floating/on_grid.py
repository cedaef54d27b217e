"""Channels of a base and its contacts on a uniform grid: read, differentiate, filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array, Mask
from sdpid.experiment.processing.period_mean import Chain
from sdpid.experiment.recording.uniform_grid import Grid


@dataclass(frozen=True, kw_only=True, eq=False)
class OnGrid:
    """What the filter of a chain does with several channels of a record without periods at once.

    Attributes
    ----------
    chain : Chain
        Filter, stencil, window and decimation of the joints' channels.
    """

    chain: Chain

    @property
    def grid(self) -> Grid:
        """The uniform grid of the record."""
        return self.chain.window.grid

    def read(self, table: Array) -> Array:
        """Return channels (N, ...) at all grid points, (M, ...)."""
        flat = np.asarray(table, dtype=np.float64).reshape(len(table), -1)
        columns = [self.grid.read(np.ascontiguousarray(c), 0, self.grid.count) for c in flat.T]
        return np.stack(columns, axis=1).reshape(-1, *table.shape[1:])

    def read_flags(self, flags: Mask) -> Mask:
        """Return flags (N, c) at all grid points: set where that of either neighbor is set."""
        stamps = self.grid.stamps
        if stamps is None:
            return flags[: self.grid.count]
        wanted = self.grid.origin + self.grid.step * np.arange(self.grid.count)
        after = np.clip(np.searchsorted(stamps, wanted), 1, len(stamps) - 1)
        either: Mask = flags[after - 1] | flags[after]
        return either

    def rate(self, values: Array) -> Array:
        """Return the derivative of channels (M, c), their ends continued by point reflection."""
        stencil, step = self.chain.stencil, self.grid.step
        extended = _extended(values, stencil.margin)
        return np.stack([stencil.velocity(c, step) for c in extended.T], axis=1)

    def second(self, values: Array) -> Array:
        """Return the second derivative of channels (M, c), their ends continued likewise."""
        stencil, step = self.chain.stencil, self.grid.step
        extended = _extended(values, stencil.margin)
        return np.stack([stencil.acceleration(c, step) for c in extended.T], axis=1)

    def filtered(self, values: Array) -> Array:
        """Return channels (M, ...) filtered, their ends continued by point reflection."""
        flat = values.reshape(len(values), -1)
        reach = min(self.chain.low_pass.reach, len(flat) - 1)
        passed = self.chain.low_pass.apply(_extended(flat, reach))
        return passed[reach : reach + len(flat)].reshape(values.shape)

    def kept(self, values: NDArray[Any]) -> Any:
        """Return the kept samples of what there is at all grid points."""
        window = self.chain.window
        last = window.first + window.length
        return np.ascontiguousarray(values[window.first : last : self.chain.decimation])


def _extended(values: Array, margin: int) -> Array:
    return np.pad(values, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
