"""The velocity at a wider band than the efforts', and their filter, for friction columns."""

from __future__ import annotations

from collections import OrderedDict, defaultdict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen_view
from sdpid.experiment.processing.efforts import in_threads
from sdpid.experiment.processing.filters import BAND_OVER_RATE, ZeroPhaseFilter, low_pass
from sdpid.experiment.processing.period_mean import Chain
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording

# Samples before the first kept one and behind the last, in time constants of the filter: exp(-20)
# is 2e-9 of what the guess at the ends would be off.
LEAD = 20.0

# The band of the velocity, in cut-offs of the efforts' filter, and the least rate at which it is
# sampled: 20 samples a period of its own cut-off. Four times the band leaves a reversal at its time
# and an encoder's noise out.
_BAND = 4.0
_RATE_OVER_CUTOFF = 80.0

# Results that are kept: those of the terms of a model, with room for those tried beside them.
_KEPT = 12


@dataclass(frozen=True, kw_only=True, eq=False)
class WideVelocity:
    """Velocities of one piece of a recording, at more samples and of wider band than those kept.

    Friction is steep in the velocity, and its effort has passed a filter. What stands in the
    filtered efforts is the filtered friction, not friction at the filtered velocity.

    Attributes
    ----------
    velocity : (M, n) ndarray
        In rad/s, with neighbors on either side of the kept samples.
    step : float
        Distance of two samples, in s.
    low_pass : ZeroPhaseFilter
        The filter of the efforts, for this step.
    first, stride, count : int
        The kept samples are ``first + stride·k`` for k below count.
    """

    velocity: Array
    step: float
    low_pass: ZeroPhaseFilter
    first: int
    stride: int
    count: int
    _found: OrderedDict[Hashable, Array] = field(
        default_factory=OrderedDict, repr=False, init=False
    )

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields without the results kept."""
        return {**self.__dict__, "_found": OrderedDict()}

    def part(self, start: int, stop: int) -> WideVelocity:
        """Return that of neighboring kept samples, from `start` up to `stop`."""
        lead = lead_samples(self.low_pass)
        low = max(0, self.first + self.stride * start - lead)
        high = self.first + self.stride * (stop - 1) + lead + 1
        return replace(
            self,
            velocity=self.velocity[low:high],
            first=self.first + self.stride * start - low,
            count=stop - start,
        )


def filtered(
    wides: Sequence[WideVelocity],
    function: Callable[[Array, Array], Array],
    key: Hashable | None = None,
) -> list[Array]:
    """Return values (count, ...) of a function of each piece's velocity, filtered.

    Parameters
    ----------
    wides : sequence of WideVelocity
        The pieces; those of one filter and length pass it side by side.
    function : callable
        Of velocities and accelerations (M, n), to values (M, ...).
    key : hashable, optional
        Identifies the function: its results are kept for the next call.
    """
    alike = defaultdict(list)
    for wide in wides:
        if key not in wide._found:
            alike[wide.low_pass, len(wide.velocity)].append(wide)
    for (passed, length), own in alike.items():
        rates = (np.gradient(wide.velocity, wide.step, axis=0) for wide in own)
        values = [function(wide.velocity, rate) for wide, rate in zip(own, rates, strict=True)]
        flat = passed.apply(np.concatenate([x.reshape(length, -1) for x in values], axis=1))
        for wide, part in zip(own, np.split(flat, len(own), axis=1), strict=True):
            kept = np.ascontiguousarray(part[wide.first :: wide.stride][: wide.count])
            wide._found[key] = frozen_view(kept.reshape(wide.count, *values[0].shape[1:]))
    found = [wide._found[key] for wide in wides]
    for wide in wides:
        wide._found.pop(None, None)
        while len(wide._found) > _KEPT:
            wide._found.popitem(last=False)
    return found


def wide_velocity(
    log: Recording, chain: Chain, processing: Processing, resting: Mask, *, chunk: int
) -> WideVelocity:
    """Return the wide velocity of a record without gaps.

    Parameters
    ----------
    log : Recording
        The record.
    chain : Chain
        Window, filter and decimation of its samples.
    processing : Processing
        Cut-off, filter, and where velocities are from.
    resting : (n,) ndarray of bool
        Joints that do not move: the sign of their noise is nothing.
    chunk : int
        Pieces in which a record without periods is filtered, in samples.
    """
    window, grid = chain.window, chain.window.grid
    rate = 1.0 / grid.step
    cutoff = min(_BAND * processing.cutoff_hz, max(BAND_OVER_RATE * rate, processing.cutoff_hz))
    step = _fine_step(chain.decimation, rate / (_RATE_OVER_CUTOFF * processing.cutoff_hz))
    filter_of_efforts = processing.low_pass(rate / step)
    lead = lead_samples(filter_of_efforts)
    more = 0 if window.circular else lead * step
    wide = replace(
        chain,
        window=replace(window, first=window.first - more, length=window.length + 2 * more),
        low_pass=low_pass(processing.filter, cutoff, processing.order, rate),
        decimation=step,
        passes=1,
        margin=chain.stencil.margin,
    )
    velocity = np.empty((len(range(0, wide.window.length, step)), log.n))
    measured = log.velocity if processing.velocity == "measured" else None

    def one(j: int) -> None:
        first = 0
        for part in wide.parts(chunk):
            if measured is None:
                signal, _, _ = part.mean(log.position[:, j])
                fine = chain.stencil.velocity(signal, grid.step)
            else:
                signal, _, _ = part.mean(measured[:, j])
                fine = chain.stencil.inner(signal)
            kept = part.kept(fine)
            velocity[first : first + kept.size, j] = kept
            first += kept.size

    in_threads(one, range(log.n))
    velocity[:, resting] = 0.0
    if window.circular:
        velocity = np.pad(velocity, ((lead, lead), (0, 0)), mode="wrap")
    return WideVelocity(
        velocity=frozen_view(velocity),
        step=grid.step * step,
        low_pass=filter_of_efforts,
        first=lead,
        stride=chain.decimation // step,
        count=len(range(0, window.length, chain.decimation)),
    )


def _fine_step(decimation: int, most: float) -> int:
    """Return the largest divisor of the decimation that is at most `most`, at least 1."""
    return max(d for d in range(1, decimation + 1) if decimation % d == 0 and d <= max(most, 1.0))


def lead_samples(low_pass: ZeroPhaseFilter) -> int:
    """Return how many samples on either side of the kept ones the filter needs."""
    return min(int(np.ceil(LEAD * low_pass.time_constant)), low_pass.reach)
