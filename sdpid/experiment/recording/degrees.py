"""Recognize positions in degrees by ranges that no joint has."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.stored import extremes

# Joints of arms are limited to about one turn either way, and no such joint passes two turns.
_LIMIT_OF_ARMS = 2.0 * math.pi * (1.0 + 1e-6)
_TWO_TURNS = 4.0 * math.pi
# In degrees no joint of an arm passes this; wheels in radians do.
_ARMS_IN_DEGREES = 720.0
# A log may pass the limits of a URDF that are a little too tight, but not by half their span.
_SPAN_FACTOR = 1.5
# The same slack once the positions are read as degrees: they must then fit the limits.
_FIT_FACTOR = 1.25


def suspect_units(
    recording: Recording,
    position_limits: Any = None,
    position_range: tuple[Array, Array] | None = None,
) -> tuple[str, ...]:
    """Name the joints whose positions look like degrees.

    A joint with finite limits is named when its positions are far beyond them (more than two
    turns where the limits are within one turn, or twice the limits with a span of more than 1.5
    times theirs) and would fit if they were degrees. A joint without limits may turn many times,
    so it is named only together with one that has limits. Where no joint is known to have limits,
    those beyond two turns, and not beyond 720, are named when they are more than half of at least
    two.

    Parameters
    ----------
    recording : Recording
        The log to look at.
    position_limits : (n, 2) array_like, optional
        Lower and upper limits in rad, infinite where there are none.
    position_range : pair of (n,) ndarray, optional
        Least and largest positions, where they are known.

    Returns
    -------
    tuple of str
        Joint names (numbers from 1 where the recording has no names); empty when all is well.

    Raises
    ------
    DataError
        When the limits are of another shape.
    """
    if position_range is None:
        position_range = extremes(recording.position)
    low, high = position_range
    peak = np.maximum(np.abs(low), np.abs(high))
    beyond = peak > _TWO_TURNS
    limits = None
    if position_limits is not None:
        limits = _checked_limits(position_limits, recording.n)
    if limits is None or not np.isfinite(limits).all(axis=1).any():
        beyond &= peak <= _ARMS_IN_DEGREES
        named = beyond & (recording.n > 1) & (2 * np.count_nonzero(beyond) > recording.n)
    else:
        named = _suspect_limited(low, high, peak, limits)
        if named.any():
            named = named | (beyond & ~np.isfinite(limits).all(axis=1))
    return tuple(name for name, bad in zip(recording.names, named, strict=True) if bad)


def require_plausible_units(recording: Recording, position_limits: Any = None) -> None:
    """Raise when positions look like degrees.

    Parameters
    ----------
    recording : Recording
        The log to look at.
    position_limits : (n, 2) array_like, optional
        Lower and upper limits in rad, infinite where there are none.

    Raises
    ------
    DataError
        Naming the joints with their ranges, as decided by `suspect_units`.
    """
    suspects = suspect_units(recording, position_limits)
    if not suspects:
        return
    ranges = []
    for name in suspects:
        j = recording.names.index(name)
        column = recording.position[:, j]
        text = f"{name} from {column.min():.4g} to {column.max():.4g}"
        if position_limits is not None:
            limits = np.asarray(position_limits, dtype=np.float64)[j]
            text += f" (limits {limits[0]:.4g} to {limits[1]:.4g} rad)"
        ranges.append(text)
    raise DataError(
        f"position: looks like degrees, not radians: {'; '.join(ranges)}. Convert it, or read "
        "the file with units={'position': 'deg'}; angles in radians of joints that do turn that "
        "far may be wrapped to ±pi."
    )


def _checked_limits(position_limits: Any, n: int) -> Array:
    """Return limits as an (n, 2) array of floats that may be infinite."""
    limits = np.asarray(position_limits, dtype=np.float64)
    if limits.shape != (n, 2) or np.isnan(limits).any():
        raise DataError(
            f"position_limits: has shape {limits.shape}, expected {(n, 2)}: a lower and an upper "
            "limit for each joint, infinite where there is none."
        )
    return limits


def _suspect_limited(low: Array, high: Array, peak: Array, limits: Array) -> Any:
    """Return which joints with finite limits move as if in degrees, (n,)."""
    finite = np.asarray(np.isfinite(limits).all(axis=1))
    limits = np.where(finite[:, None], limits, 0.0)
    reach = np.abs(limits).max(axis=1)
    turns = (reach <= _LIMIT_OF_ARMS) & (peak > _TWO_TURNS)
    # A narrow range may honestly be overstepped, but not to twice its farthest end.
    wide = (high - low) > _SPAN_FACTOR * (limits[:, 1] - limits[:, 0])
    wide &= peak > 2.0 * reach
    fits = np.radians(peak) <= _FIT_FACTOR * reach
    return finite & fits & (turns | wide)
