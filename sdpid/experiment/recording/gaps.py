"""A record as what it can be processed in: split at gaps, with angles that do not wrap."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid.experiment.recording.recording import Recording, rows_of
from sdpid.experiment.recording.stored import extremes
from sdpid.experiment.recording.uniform_grid import MAX_GAP_STEPS, longest_gap

_TURN = 2.0 * math.pi
# No joint turns further from one sample to the next (rad). A jump this close to whole turns is
# then a wrapped angle, as long as no jump lies between: those would be another unit, or outliers.
_LARGEST_STEP = 1.0
# After a gap in which samples were lost, stamps go on late by its length. Where the stamps after
# it catch up by more than this part of it, the samples came late: none was lost.
_CAUGHT_UP = 0.5
# Stamps on either side that tell the two apart.
_NEIGHBORS = 50
# So many steps before a gap tell the rate there.
_BEFORE = 400


def continuous(log: Recording) -> tuple[tuple[Recording, ...], list[str]]:
    """Return the pieces of a recording that can be filtered, and notes on what was done.

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
    """
    log, notes = in_time(log)
    pieces = split_at_gaps(log)
    if pieces != (log,):
        longest = longest_gap(log.step)
        measured = sum(piece.duration for piece in pieces)
        single = log.n_samples - sum(piece.n_samples for piece in pieces)
        count = np.count_nonzero(np.diff(log.time) > longest)
        lone = f", {single} of the samples alone between gaps left out" if single else ""
        notes.append(
            f"split at {count} {'gap' if count == 1 else 'gaps'} of more than "
            f"{longest / log.step:.3g} steps of {log.step:.6g} s, the largest "
            f"{log.stamps.most:.6g} s before row {log.stamps.row + 1}: "
            f"{log.duration - measured:.6g} s of {log.duration:.6g} s were not measured{lone}"
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
    """Split a recording where samples are missing for too long to interpolate.

    Parameters
    ----------
    log : Recording
        A record without periods. One with periods is returned as it is: a period with a gap
        cannot be averaged with the others, and `sdpid.experiment.recording.uniform_grid.make_grid`
        says so.

    Returns
    -------
    tuple of Recording
        What lies between steps of more than five nominal ones and 10 ms, without single samples;
        ``(log,)`` itself without such a gap.
    """
    if log.period is not None:
        return (log,)
    # The same arithmetic as in `make_grid`, which refuses what is left.
    longest = longest_gap(log.step) - log.step
    if not log.stamps.most - log.step > longest:
        return (log,)
    rows = np.flatnonzero(np.diff(log.time) - log.step > longest) + 1
    # Half of all steps are no longer than their median, so some samples do lie together.
    bounds = [0, *rows.tolist(), log.n_samples]
    pieces: list[Recording] = []
    for first, stop in pairwise(bounds):
        if stop - first > 1:
            # A piece may have a shorter nominal step, so that another of its steps is a gap.
            pieces += split_at_gaps(rows_of(log, slice(first, stop)))
    return tuple(pieces)


def unwrapped(log: Recording) -> tuple[Recording, NDArray[np.intp]]:
    """Continue angles that wrap: add whole turns after jumps of about whole turns.

    Parameters
    ----------
    log : Recording
        Without gaps.

    Returns
    -------
    log : Recording
        Without such jumps, the reference whole turns from where it was; the same object where
        there were none.
    jumps : (n,) ndarray of int
        Jumps of each joint. A joint that also jumps by something between 1 rad and a turn
        less 1 rad is left alone: it is in another unit, or has outliers.
    """
    jumps = np.zeros(log.n, dtype=np.intp)
    position: Array | None = None
    low, high = extremes(log.position)
    for j in np.flatnonzero(high - low >= _TURN - _LARGEST_STEP).tolist():
        steps = np.diff(log.position[:, j])
        turns = np.rint(steps / _TURN)
        if not turns.any() or np.abs(steps - _TURN * turns).max() > _LARGEST_STEP:
            continue
        jumps[j] = np.count_nonzero(turns)
        if position is None:
            position = np.array(log.position)
        position[1:, j] -= _TURN * np.cumsum(turns)
    if position is not None:
        log = replace(log, position=position)
    return _near_positions(log), jumps


def _near_positions(log: Recording) -> Recording:
    """Return a recording whose references are moved by whole turns, to where positions are."""
    if log.reference is None:
        return log
    reference: Array | None = None
    for j in range(log.n):
        column = np.asarray(log.reference[:, j])
        turns = np.rint((column - log.position[:, j]) / _TURN)
        if not turns.any():
            continue
        moved = column - _TURN * turns
        # A reference in another unit, or of another joint, jumps where it leaves the position.
        if np.abs(np.diff(moved)).max() <= _LARGEST_STEP:
            reference = np.array(log.reference) if reference is None else reference
            reference[:, j] = moved
    return log if reference is None else replace(log, reference=reference)


def in_time(log: Recording) -> tuple[Recording, list[str]]:
    """Correct the time stamps of samples that came late, in a burst after a gap.

    Samples that a busy logger stamps late follow each other faster until the stamps are back on
    the regular clock. Where none is missing, they get regular stamps. Where some were lost as
    well, it is not known which, and the burst is left out.

    Parameters
    ----------
    log : Recording
        As it was measured.

    Returns
    -------
    log : Recording
        The same one where no sample came late.
    notes : list of str
        How many samples, and before which row.
    """
    limit = MAX_GAP_STEPS * log.step
    if not log.stamps.most > limit:
        return log, []
    time = np.array(log.time)
    keep = np.ones(time.size, dtype=np.bool_)
    notes = []
    for row in (np.flatnonzero(np.diff(time) > limit) + 1).tolist():
        step = _step_before(log, row)
        gap = float(time[row] - time[row - 1]) - step
        after = time[row : row + 2 * math.ceil(gap / step) + _NEIGHBORS]
        # How late each sample is by a regular clock that starts before the gap.
        late = after - time[row - 1] - step * np.arange(1, after.size + 1)
        least = max(float(late.min()), 0.0)
        if gap - least <= _CAUGHT_UP * gap:
            continue
        count = int(np.argmax(late <= least + step / 2.0))
        where = f"after a gap of {gap + step:.6g} s before row {row + 1}"
        if least <= step / 2.0:
            stop = row + count
            time[row - 1 : stop + 1] = np.linspace(time[row - 1], time[stop], count + 2)
            notes.append(f"stamps of {count} samples {where} came late; taken as regular")
        else:
            keep[row : row + count] = False
            notes.append(
                f"{count} samples {where} left out: they came late, {round(least / step)} of them "
                "were lost, and their stamps do not say which"
            )
    if not notes:
        return log, []
    if not keep.all() and log.period is None:
        return rows_of(replace(log, time=time), keep), notes
    return replace(log, time=time), notes


def _step_before(log: Recording, row: int) -> float:
    """Return the mean step before the gap that ends at a row: the rate of a log may change."""
    steps = np.diff(log.time[max(0, row - _BEFORE) : row])
    steps = steps[steps <= longest_gap(log.step)]
    return float(steps.mean()) if steps.size >= _NEIGHBORS else log.step
