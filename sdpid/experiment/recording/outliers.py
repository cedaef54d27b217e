"""Refuse positions with single samples that no robot can reach."""

from __future__ import annotations

import math

import numpy as np

from sdpid.errors import DataError
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.stored import blocks, extremes

_TURN = 2.0 * math.pi
# No joint turns by two turns (or slides by 12 m) from one sample to the next. Wrapped angles jump
# by whole turns, a counter that is reset by at most a hundred.
_LARGEST_STEP = 2.0 * _TURN
_MOST_TURNS = 100.0
_OFF_WHOLE_TURNS = 1.0
# Where more than this share of all steps is too large, positions are in another unit.
_FEW = 0.01


def require_no_outliers(log: Recording) -> None:
    """Raise when a position jumps by more than any joint turns in one step.

    Raises
    ------
    DataError
        Naming the joint, the row and the jump, and how many there are.
    """
    low, high = extremes(log.position)
    for j in np.flatnonzero(high - low > _LARGEST_STEP).tolist():
        count, first, last = 0, None, None
        for begin, values in blocks(log.position[:, j]):
            steps = np.diff(values) if last is None else np.diff(values, prepend=last)
            row = begin + (1 if last is None else 0)
            last = values[-1]
            turns = np.rint(steps / _TURN)
            wraps = np.abs(steps - _TURN * turns) <= _OFF_WHOLE_TURNS
            wraps &= np.abs(turns) <= _MOST_TURNS
            wrong = np.flatnonzero((np.abs(steps) > _LARGEST_STEP) & ~wraps)
            count += wrong.size
            if first is None and wrong.size:
                first = row + int(wrong[0]), float(steps[wrong[0]])
        if first is not None and count <= max(_FEW * log.n_samples, 2.0):
            row, jump = first
            raise DataError(
                f"position: that of joint {log.names[j]} jumps by {jump:.4g} rad at sample "
                f"{row + 1} of {log.n_samples} ({count} such {'jump' if count == 1 else 'jumps'}), "
                f"more than the {_LARGEST_STEP:.4g} rad that any joint turns in one step: an "
                "outlier. Remove that sample (a gap of a few samples is interpolated), or cut "
                "the recording there."
            )
