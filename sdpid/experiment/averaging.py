"""Period by period: filter a channel, fold it into the mean, and measure the spread."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._arrays import Array
from sdpid.experiment.filters import Stencil, ZeroPhaseFilter
from sdpid.experiment.window import Window

__all__ = ["Chain", "near_standstill", "period_covariance"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """The filter, the window it is run over, and what is kept of its output.

    Attributes
    ----------
    window : Window
        The part of the record to be filtered.
    low_pass : ZeroPhaseFilter
        The filter; a pass is forward and backward.
    stencil : Stencil
        Central differences.
    decimation : int
        Every so many samples are kept.
    passes : int
        Zero-phase passes over a signal that is to be differentiated, 1 or 2. What is kept as it
        is (position, torque, a measured velocity) always gets 1.
    margin : int
        Samples on either side that differences and mask need.
    """

    window: Window
    low_pass: ZeroPhaseFilter
    stencil: Stencil
    decimation: int
    passes: int
    margin: int

    def kept(self, signal: NDArray[Any]) -> Any:
        """Return the kept samples of a period that still has (what is left of) its margins."""
        margin = (signal.size - self.window.length) // 2
        return signal[margin : margin + self.window.length : self.decimation]

    def parts(self, size: int) -> Iterator[Chain]:
        """Yield the chain over pieces of about `size` samples, which together are the window.

        The periods of a periodic window are averaged, so it is not taken apart.
        """
        window = self.window
        if window.circular:
            yield self
            return
        size = max(1, size // self.decimation) * self.decimation
        for first in range(0, window.length, size):
            length = min(size, window.length - first)
            yield replace(self, window=replace(window, first=window.first + first, length=length))

    def filtered(self, column: Array, *, scale: float = 1.0) -> Iterator[Array]:
        """Yield each period, with its margins, filtered once."""
        for stages in self._filtered(column, 1, scale):
            yield stages[0]

    def mean(self, column: Array) -> tuple[Array, Array, float]:
        """Return the averages after one and after `passes` passes, and the periods' spread.

        The averages still have their margins; with one pass they are the same array. The spread
        is the rms deviation of the kept samples from their mean over the periods, after the last
        pass.
        """
        window = self.window
        size = window.length + 2 * self.margin
        once = np.zeros(size)
        last = once if self.passes == 1 else np.zeros(size)
        kept = np.empty((window.periods, len(range(0, window.length, self.decimation))))
        for p, stages in enumerate(self._filtered(column, self.passes, 1.0)):
            once += stages[0]
            if self.passes > 1:
                last += stages[-1]
            kept[p] = self.kept(stages[-1])
        once /= window.periods
        if self.passes > 1:
            last /= window.periods
        kept -= kept.mean(axis=0)
        return once, last, float(np.sqrt(np.mean(kept**2)))

    def _filtered(self, column: Array, passes: int, scale: float) -> Iterator[list[Array]]:
        """Yield each period, with its margins, after 1, ..., `passes` zero-phase passes."""
        pad = self.low_pass.reach
        for p in range(self.window.periods):
            signal = self.window.read(column, p, pad + self.margin)
            if scale != 1.0:
                signal = signal * scale
            keep = slice(pad, signal.size - pad)
            stages = []
            for _ in range(passes):
                signal = self.low_pass.apply(signal)
                stages.append(signal[keep])
            yield stages


def near_standstill(
    velocity: Array, speed: float, reach: int, *, circular: bool
) -> NDArray[np.bool_]:
    """Tell which samples are near a reversal or a standstill.

    Parameters
    ----------
    velocity : (N,) ndarray
        Velocity of one joint.
    speed : float
        Below this speed a sample is slow.
    reach : int
        Samples within so many samples of a slow one are near it.
    circular : bool
        The last sample is followed by the first.

    Returns
    -------
    (N,) ndarray of bool
    """
    slow = np.abs(velocity) < speed
    # A fast reversal may pass the slow band between two samples: both are then slow.
    negative = np.signbit(velocity)
    turns = negative[1:] != negative[:-1]
    slow[1:] |= turns
    slow[:-1] |= turns
    if circular and negative[0] != negative[-1]:
        slow[0] = slow[-1] = True
    reach = min(reach, velocity.size)
    around = np.pad(slow, reach, mode="wrap") if circular else np.pad(slow, reach)
    counts = np.concatenate(([0], np.cumsum(around)))
    near: NDArray[np.bool_] = counts[2 * reach + 1 :] != counts[: -2 * reach - 1]
    return near


def period_covariance(torque: Array, mean: Array) -> Array:
    """Return Sigma_k of the paper's (11) [denso]_.

    Parameters
    ----------
    torque : (P, K, n) ndarray
        Torque of each period, in N·m.
    mean : (K, n) ndarray
        Its mean over the periods.

    Returns
    -------
    (K, n, n) ndarray
        In (N·m)², of a rank of at most P - 1.
    """
    P, K, n = torque.shape
    covariance = np.empty((K, n, n))
    for i in range(n):
        left = torque[:, :, i] - mean[:, i]
        for j in range(i, n):
            right = left if i == j else torque[:, :, j] - mean[:, j]
            covariance[:, i, j] = np.einsum("pk,pk->k", left, right) / (P - 1)
            covariance[:, j, i] = covariance[:, i, j]
    return covariance
