"""A record as what it can be processed in: split at gaps, with angles that do not wrap."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sdpid._arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.recording import Recording
from sdpid.experiment.timing import MAX_GAP_STEPS

__all__ = ["continuous", "split_at_gaps", "unwrapped"]

_TURN = 2.0 * math.pi
# No joint turns further from one sample to the next (rad). A jump this close to whole turns is
# then a wrapped angle, as long as no jump lies between: those would be another unit, or outliers.
_LARGEST_STEP = 1.0
# After a gap in which samples were lost, stamps go on late by its length. Where the stamps after
# it catch up by more than this part of it, the samples came late: none was lost.
_CAUGHT_UP = 0.5
# Stamps on either side that tell the two apart.
_NEIGHBOURS = 50
# Samples looked at together: what stays in the cache.
_BLOCK = 1 << 14
# So many steps before a gap tell the rate there.
_BEFORE = 400


def continuous(log: Recording) -> tuple[tuple[Recording, ...], list[str]]:
    """Return the pieces of a record that can be filtered, and what was done to get them.

    Parameters
    ----------
    log : Recording
        As it was measured.

    Returns
    -------
    pieces : tuple of Recording
        From `split_at_gaps`, each `unwrapped`; ``(log,)`` itself where nothing had to be done.
    notes : list of str
        In words, with sizes and rows.

    Raises
    ------
    DataError
        As `split_at_gaps`.
    """
    pieces = split_at_gaps(log)
    notes = []
    if pieces != (log,):
        steps = np.diff(log.time)
        own = sum(piece.duration for piece in pieces)
        single = log.n_samples - sum(piece.n_samples for piece in pieces)
        count = np.count_nonzero(steps > MAX_GAP_STEPS * log.step)
        lone = f", {single} of the samples alone between gaps left out" if single else ""
        notes.append(
            f"split at {count} {'gap' if count == 1 else 'gaps'} of more than {MAX_GAP_STEPS:g} "
            f"steps of {log.step:.6g} s, the largest {log.stamps.most:.6g} s before row "
            f"{log.stamps.row}: "
            f"{log.duration - own:.6g} s of {log.duration:.6g} s were not measured{lone}"
        )
    turned = [unwrapped(piece) for piece in pieces]
    jumps = sum((jumps for _, jumps in turned), np.zeros(log.n, dtype=np.intp))
    if jumps.any():
        listed = ", ".join(
            f"{name} {count}" for name, count in zip(log.names, jumps, strict=True) if count
        )
        notes.append(f"angles that wrap continued by whole turns; jumps of joint {listed}")
    return tuple(piece for piece, _ in turned), notes


def split_at_gaps(log: Recording) -> tuple[Recording, ...]:
    """Split a record where so many samples are missing that nobody knows the motion between.

    Parameters
    ----------
    log : Recording
        A record without periods. One with periods is returned as it is: a period with a gap
        cannot be averaged with the others, and `sdpid.experiment.timing.make_grid` says so.

    Returns
    -------
    tuple of Recording
        What lies between steps of more than five nominal ones, without single samples;
        ``(log,)`` itself without such a gap.

    Raises
    ------
    DataError
        When the samples after a gap come in a burst that makes up for it: then they are late,
        not lost, and their stamps do not say when they were taken.
    """
    if log.period is not None:
        return (log,)
    # The same arithmetic as in `make_grid`, which refuses what is left.
    if not log.stamps.most - log.step > (MAX_GAP_STEPS - 1.0) * log.step:
        return (log,)
    steps = np.diff(log.time) - log.step
    rows = np.flatnonzero(steps > (MAX_GAP_STEPS - 1.0) * log.step) + 1
    for row in rows:
        _require_lost(log, int(row))
    # Half of all steps are no longer than their median, so some samples do lie together.
    bounds = [0, *rows.tolist(), log.n_samples]
    pieces: list[Recording] = []
    for first, stop in pairwise(bounds):
        if stop - first > 1:
            # Its own nominal step may be shorter, and a step that was just no gap then is one.
            pieces += split_at_gaps(_rows(log, slice(first, stop)))
    return tuple(pieces)


def unwrapped(log: Recording) -> tuple[Recording, NDArray[np.intp]]:
    """Continue angles by whole turns where they jump by about as much.

    Parameters
    ----------
    log : Recording
        Without gaps.

    Returns
    -------
    log : Recording
        In which no such jumps are left; the same one where there were none.
    jumps : (n,) ndarray of int
        How many each joint had. A joint that also jumps by something between 1 rad and a turn
        less 1 rad is left alone: it is in another unit, or has outliers.
    """
    jumps = np.zeros(log.n, dtype=np.intp)
    position: Array | None = None
    for j in _may_wrap(log):
        steps = np.diff(log.position[:, j])
        turns = np.rint(steps / _TURN)
        if not turns.any() or np.abs(steps - _TURN * turns).max() > _LARGEST_STEP:
            continue
        jumps[j] = np.count_nonzero(turns)
        if position is None:
            position = np.array(log.position)
        position[1:, j] -= _TURN * np.cumsum(turns)
    return (log if position is None else replace(log, position=position)), jumps


def _may_wrap(log: Recording) -> list[int]:
    """Return the joints that are worth a closer look, by passes that cost long records little."""
    position, least = log.position, _TURN - _LARGEST_STEP
    if float(position.max()) - float(position.min()) < least:
        return []
    if log.stored:
        # Their file knows the ranges; steps would have to be decoded.
        return np.flatnonzero(position.max(axis=0) - position.min(axis=0) >= least).tolist()
    for first in range(0, log.n_samples - 1, _BLOCK):
        part = position[first : first + _BLOCK + 1]
        steps = part[1:] - part[:-1]
        if steps.max() >= least or steps.min() <= -least:
            return list(range(log.n))
    return []


def _rows(log: Recording, rows: slice) -> Recording:
    """Return some samples of a record without periods."""
    return replace(
        log,
        time=log.time[rows],
        position=log.position[rows],
        effort=log.effort[rows],
        velocity=None if log.velocity is None else log.velocity[rows],
    )


def _step_before(log: Recording, row: int) -> float:
    """Return the mean step before the gap that ends at a row: the rate of a log may change."""
    steps = np.diff(log.time[max(0, row - _BEFORE) : row])
    steps = steps[steps <= MAX_GAP_STEPS * log.step]
    return float(steps.mean()) if steps.size >= _NEIGHBOURS else log.step


def _require_lost(log: Recording, row: int) -> None:
    """Raise when the stamps after the gap that ends at a row make up for it."""
    time, step = log.time, _step_before(log, row)
    gap = float(time[row] - time[row - 1]) - step
    after = time[row : row + _NEIGHBOURS]
    # How far ahead of a regular clock that starts after the gap its neighbours come.
    early = float(np.max(step * np.arange(after.size) - (after - after[0])))
    if early > _CAUGHT_UP * gap:
        raise DataError(
            f"time: after a gap of {gap + step:.6g} s before row {row} the stamps catch up by "
            f"{early:.6g} s within {after.size} samples, more than {100 * _CAUGHT_UP:g} % of it: "
            "samples came late, none was lost. Use the time at which they were taken, or leave "
            "the stamps out and give rate_hz."
        )
