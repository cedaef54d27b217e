"""What else may stand between two encoders: an encoder's line, hysteresis, the position."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.robot.friction.position import play

# Cycles a turn of a line that an encoder draws: fewer are positions, more lie between samples.
_FEWEST, _MOST = 50.0, 5000.0
# Bins a cycle of the fastest line.
_BINS = 4
# All of them, at most.
_MOST_BINS = 1 << 20
# Elements that slip at these shares of the largest torque.
_SLIPS = (0.1, 0.3)
# Powers of the position in its range.
_POWERS = (1, 2, 3)


@dataclass(frozen=True, kw_only=True, eq=False)
class DeflectionTerm:
    """A further part of one joint's deflection, linear in its weights.

    Attributes
    ----------
    kind : str
        ``"line"`` (a periodic error of the link's encoder), ``"hysteresis"`` or ``"position"``.
    numbers : tuple of float
        Cycles a turn of the line; torques (N·m) at which elements slip; ends of the range of
        positions that it was fitted to, outside of which it stays as at the nearer end.
    weights : ndarray, shape (k,)
        Of cosine and sine, rad; of the elements, rad/(N·m); of powers of the position, rad.
    """

    kind: str
    numbers: tuple[float, ...]
    weights: Array

    def columns(self, link: Array, torque: Array) -> Array:
        """Return what the weights are multiplied by, (N, k), along one stretch."""
        if self.kind == "line":
            angle = self.numbers[0] * link
            return np.stack([np.cos(angle), np.sin(angle)], axis=1)
        if self.kind == "hysteresis":
            return np.stack([play(torque, slip) - torque for slip in self.numbers], axis=1)
        low, high = self.numbers
        part = (2.0 * np.clip(link, low, high) - low - high) / (high - low)
        return np.stack([part**power for power in _POWERS], axis=1)

    def within(self, links: list[Array]) -> DeflectionTerm:
        """Return the term; polynomials of the position are on the range of these positions."""
        return replace(self, numbers=_ends(links)) if self.kind == "position" else self

    @property
    def size(self) -> int:
        """Number of weights."""
        return {"line": 2, "hysteresis": len(_SLIPS), "position": len(_POWERS)}[self.kind]

    @property
    def least(self) -> float:
        """The least value of a weight: elements take energy up, and give none."""
        return 0.0 if self.kind == "hysteresis" else -np.inf


def candidates(links: list[Array], torques: list[Array], left: list[Array]) -> list[DeflectionTerm]:
    """Return terms that could be there, without weights.

    Parameters
    ----------
    links, torques, left : list of ndarray, shape (N,)
        Of each recording the link's positions and torques, and what delay and compliance leave.
    """
    largest = max(float(np.abs(each - each.mean()).max()) for each in torques)
    none = np.zeros(0)
    found = [
        ("line", (_cycles(links, left),)),
        ("hysteresis", tuple(share * largest for share in _SLIPS)),
        ("position", _ends(links)),
    ]
    return [DeflectionTerm(kind=kind, numbers=numbers, weights=none) for kind, numbers in found]


def _ends(links: list[Array]) -> tuple[float, float]:
    """Return the range of the link's positions in all recordings."""
    return min(float(each.min()) for each in links), max(float(each.max()) for each in links)


def _cycles(links: list[Array], left: list[Array]) -> float:
    """Return the cycles a turn of the line that is strongest in all recordings together."""
    from scipy.optimize import minimize_scalar

    origin = min(float(each.min()) for each in links)
    # Joints that turn on and on have wider bins, and lines of fewer cycles a turn.
    span = max(float(each.max()) for each in links) - origin
    width = max(2.0 * np.pi / (_BINS * _MOST), span / _MOST_BINS)
    most = 2.0 * np.pi / (_BINS * width)
    bins = np.concatenate([((each - origin) / width).astype(np.intp) for each in links])
    sums = np.bincount(bins, weights=np.concatenate(left))
    # Twice as long, so that no line falls between two frequencies.
    size = 1 << (2 * len(sums)).bit_length()
    power = np.abs(np.fft.rfft(sums, size)) ** 2
    each = 2.0 * np.pi / (size * width)
    inside = np.flatnonzero(
        (each * np.arange(len(power)) >= _FEWEST) & (each * np.arange(len(power)) <= most)
    )
    if not inside.size:
        return _FEWEST
    first = each * float(inside[np.argmax(power[inside])])
    q, signal = np.concatenate(links), np.concatenate(left)

    def missed(cycles: float) -> float:
        return -float(np.abs(signal @ np.exp(-1j * cycles * q)) ** 2)

    return float(minimize_scalar(missed, bounds=(first - each, first + each), method="bounded").x)
