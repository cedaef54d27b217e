"""A trajectory as polynomials of fifth degree, one after the other: what controllers evaluate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.trajectory.trajectory import Trajectory

# Largest distance between curve and polynomials, rad: below the resolution of any encoder. Curves
# that are polynomials of fifth degree themselves are met exactly.
TOLERANCE = 1e-7

# Points within a piece at which that distance is measured, as shares of its length.
_BETWEEN = np.linspace(0.0, 1.0, 9)[1:-1]

# Halvings after which a piece is taken as it is: by then it is a thousandth of what it was.
_HALVINGS = 10

# Rows: coefficients of s^0 to s^5 of the polynomials with, at s = 0 and s = 1, one of position,
# velocity, acceleration equal to one and the others zero.
_HERMITE = np.array(
    [
        [1.0, 0.0, 0.0, -10.0, 15.0, -6.0],
        [0.0, 1.0, 0.0, -6.0, 8.0, -3.0],
        [0.0, 0.0, 0.5, -1.5, 1.5, -0.5],
        [0.0, 0.0, 0.0, 10.0, -15.0, 6.0],
        [0.0, 0.0, 0.0, -4.0, 7.0, -3.0],
        [0.0, 0.0, 0.0, 0.5, -1.0, 0.5],
    ]
)


@dataclass(frozen=True)
class Piece:
    """A polynomial of fifth degree in s, which runs from 0 to 1.

    Attributes
    ----------
    begin, end : float
        Time in the trajectory, s.
    coefficients : ndarray, shape (6, n)
        Of s^0 to s^5, rad.
    """

    begin: float
    end: float
    coefficients: Array


def pieces(trajectory: Trajectory) -> tuple[Piece, ...]:
    """Return polynomials that follow a trajectory from the end of its first rest to the last.

    Each has position, velocity and acceleration of the trajectory at both ends.

    Parameters
    ----------
    trajectory : Trajectory
        All its periods are among the pieces.

    Returns
    -------
    tuple of Piece
        One begins where the one before it ends.
    """
    made: list[Piece] = []
    parts = trajectory.curves()
    for start, curve in parts:
        own = [
            piece
            for a, b in zip(curve.breaks, curve.breaks[1:], strict=False)
            for piece in _split(curve, float(a), float(b), _HALVINGS)
        ]
        # Only the periodic part is there several times, and what follows it comes later.
        turns = trajectory.periods if curve is trajectory.series else 1
        for turn in range(turns):
            shift = start + turn * curve.duration
            made += [Piece(p.begin + shift, p.end + shift, p.coefficients) for p in own]
    return tuple(made)


def _split(curve: Any, begin: float, end: float, halvings: int) -> Iterator[Piece]:
    """Yield pieces of a curve between two times, halved until they follow it."""
    width = end - begin
    ends = np.array([begin, end])
    scaled = np.stack([curve.evaluate(ends, derivative=d) * width**d for d in range(3)])
    coefficients = _HERMITE.T @ scaled.transpose(1, 0, 2).reshape(6, -1)
    inside = curve.evaluate(begin + width * _BETWEEN)
    error = np.abs(np.vander(_BETWEEN, 6, increasing=True) @ coefficients - inside).max()
    if error <= TOLERANCE or halvings == 0:
        yield Piece(begin, end, coefficients)
        return
    middle = 0.5 * (begin + end)
    yield from _split(curve, begin, middle, halvings - 1)
    yield from _split(curve, middle, end, halvings - 1)
