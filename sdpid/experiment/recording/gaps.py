"""Which instants a record has: when rows were read, gaps, wrapped angles, and a uniform grid."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array, Indices
from sdpid._common.kept import kept
from sdpid.errors import DataError
from sdpid.experiment.recording.recording import OPTIONAL, Recording, channels
from sdpid.experiment.recording.stored import ROWS, middle

# The first words of the note on times that speeds tell.
RETIMED = "times taken"

Timing = Literal["auto", "nominal", "resample"]

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

# Stamps are uniform when no step is off by more than this part of the nominal one. A stamp in
# seconds since 1970 has a resolution of 2.4e-7 s, which is 2.4e-4 of a step at 1 kHz.
_JITTER = 1e-3
# Gaps up to this many steps, or this long (s: a tenth of a period of the fastest motion of an arm),
# are bridged by the spline; in a longer one motion is unknown, and records without periods
# are split there.
MAX_GAP_STEPS = 5.0
_MAX_GAP_S = 0.01
# Stamps that stay this close (in steps) to a straight line can be late stamps of regular samples.
_MAX_WANDER_STEPS = 0.5
# Interpolate only if the stamps predict left-out positions at least this much better than the
# sample index does. On the Panda's log they tie (0.999), on the LWR4+'s the stamps are 10^4
# times worse; interpolation costs bandwidth, so ties go to the index.
_CLEARLY_BETTER = 0.95
# Samples used for that comparison: enough to tell, cheap on long records.
_COMPARED = 20_000
# A cubic spline forgets a knot by a factor of 3.7 a knot: 30 knots away 1e-17 is left.
_SPLINE_REACH = 30


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
    log, notes = _in_time(log)
    if (clock := told_clock(log)) is not None:
        notes.append(
            f"{RETIMED} from the speeds of joints {', '.join(log.names[j] for j in clock.joints)}"
            f", for {clock.repeats:.3g} of the rows repeat others and the rest were read "
            f"{1e3 * clock.jitter:.2g} ms (rms) from their stamps: steps of positions then differ "
            f"from speeds by {100.0 * clock.left:.2g} % instead of {100.0 * clock.missed:.2g} %"
        )
        log = retimed(log, clock)
    pieces = split_at_gaps(log)
    if pieces != (log,):
        longest = _longest_gap(log.step)
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
        counts = zip(log.names, jumps, strict=True)
        listed = ", ".join(f"{name} {count}" for name, count in counts if count)
        notes.append(f"angles that wrap continued by whole turns; jumps of joint {listed}")
    return tuple(piece for piece, _ in turned), notes


def _longest_gap(step: float) -> float:
    """Return the longest distance of two samples that is bridged, in s."""
    return max(MAX_GAP_STEPS * step, _MAX_GAP_S)


def split_at_gaps(log: Recording) -> tuple[Recording, ...]:
    """Split a recording where samples are missing for too long to interpolate.

    Parameters
    ----------
    log : Recording
        A record without periods. One with periods is returned as it is: a period with a gap
        cannot be averaged with the others, and `make_grid` says so.

    Returns
    -------
    tuple of Recording
        What lies between steps of more than five nominal ones and 10 ms, without single samples;
        ``(log,)`` itself without such a gap.
    """
    # The same arithmetic as in `make_grid`, which refuses what is left.
    longest = _longest_gap(log.step) - log.step
    if log.period is not None or not log.stamps.most - log.step > longest:
        return (log,)
    rows = np.flatnonzero(np.diff(log.time) - log.step > longest) + 1
    pieces: list[Recording] = []
    # Half of all steps are no longer than their median, so some samples do lie together.
    for first, stop in pairwise([0, *rows.tolist(), log.n_samples]):
        if stop - first > 1:
            # A piece may have a shorter nominal step, so that another of its steps is a gap.
            pieces += split_at_gaps(log.rows(slice(first, stop)))
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
        Without such jumps, references and links whole turns from where they were; the same object
        where there were none.
    jumps : (n,) ndarray of int
        Jumps of each joint. A joint that also jumps by something between 1 rad and a turn
        less 1 rad is left alone: it is in another unit, or has outliers.
    """
    jumps = np.zeros(log.n, dtype=np.intp)
    low, high = log.position_range
    position: Array | None = None
    for j in np.flatnonzero(high - low >= _TURN - _LARGEST_STEP).tolist():
        steps = np.diff(log.position[:, j])
        turns = np.rint(steps / _TURN)
        if turns.any() and np.abs(steps - _TURN * turns).max() <= _LARGEST_STEP:
            jumps[j] = np.count_nonzero(turns)
            position = np.array(log.position) if position is None else position
            position[1:, j] -= _TURN * np.cumsum(turns)
    others: dict[str, Any] = {} if position is None else {"position": position}
    straight = others.get("position", log.position)
    for name in OPTIONAL:
        table = getattr(log, name)
        for j in range(0 if table is None else log.n):
            apart = table[:, j] - straight[:, j]
            if max(-apart.min(), apart.max()) < 0.5 * _TURN:
                continue
            turns = np.rint(apart / _TURN)
            moved = table[:, j] - _TURN * turns
            # One in another unit, or of another joint, jumps where it leaves the position.
            if turns.any() and np.abs(np.diff(moved)).max() <= _LARGEST_STEP:
                others.setdefault(name, np.array(table))[:, j] = moved
    return (replace(log, **others) if others else log), jumps


def _in_time(log: Recording) -> tuple[Recording, list[str]]:
    """Correct the time stamps of samples that came late, in a burst after a gap.

    Samples that a busy logger stamps late follow each other faster until the stamps are back on
    the regular clock. Where none is missing, they get regular stamps. Where some were lost as
    well, it is not known which, and the burst is left out.
    """
    limit = MAX_GAP_STEPS * log.step
    if not log.stamps.most > limit:
        return log, []
    time = np.array(log.time)
    keep = np.ones(time.size, dtype=np.bool_)
    notes = []
    for row in (np.flatnonzero(np.diff(time) > limit) + 1).tolist():
        # The mean step before the gap: the rate of a log may change.
        steps = np.diff(log.time[max(0, row - _BEFORE) : row])
        steps = steps[steps <= _longest_gap(log.step)]
        step = float(steps.mean()) if steps.size >= _NEIGHBORS else log.step
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
    log = replace(log, time=time) if notes else log
    return (log if keep.all() or log.period is not None else log.rows(keep)), notes


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """A uniform time grid over a recording, read channel by channel.

    Attributes
    ----------
    origin, step : float
        Time of the first grid point and the distance of two, in s.
    count : int
        Number of grid points.
    stamps : (N,) ndarray or None
        Time stamps to interpolate from; None where samples are taken by index.
    note : str or None
        What was done to the time stamps, if anything.
    """

    origin: float
    step: float
    count: int
    stamps: Array | None = None
    note: str | None = None

    def read(self, column: Array, start: int, stop: int) -> Array:
        """Return grid points `start` to `stop` of one channel, given its recorded samples."""
        if self.stamps is None:
            return np.ascontiguousarray(column[start:stop])
        from scipy.interpolate import CubicSpline

        wanted = self.origin + self.step * np.arange(start, stop)
        begin, end = np.searchsorted(self.stamps, (wanted[0], wanted[-1]))
        knots = slice(max(0, int(begin) - _SPLINE_REACH), int(end) + _SPLINE_REACH)
        # Times are taken relative to the chunk: stamps since 1970 lose digits in the cubes.
        spline = CubicSpline(self.stamps[knots] - wanted[0], column[knots])
        return np.asarray(spline(wanted - wanted[0]))


def make_grid(recording: Recording, timing: Timing = "auto") -> Grid:
    """Choose a uniform grid for a recording.

    Parameters
    ----------
    recording : Recording
        The log.
    timing : {"auto", "nominal", "resample"}
        ``"nominal"`` trusts the sample index: sample k was taken at k nominal steps, whatever its
        stamp says. ``"resample"`` trusts the stamps and interpolates every channel by a cubic
        spline. ``"auto"`` takes uniform stamps as they are; otherwise it compares how well every
        second position is predicted from the others, by index and by stamp, and interpolates only
        if the stamps are clearly better or wander off a straight line by more than half a step.

    Returns
    -------
    Grid

    Raises
    ------
    DataError
        When a gap of more than five steps and 10 ms would have to be bridged; `process` splits
        records without periods there beforehand.
    """
    time, stamps, nominal = recording.time, recording.stamps, recording.step
    layout, step = recording.period_layout, nominal
    if layout is not None and recording.period is not None:
        # A whole number of steps to the period, to the last bit.
        step = recording.period / layout[1]
    late = stamps.most - nominal
    jitter = max(late, nominal - stamps.least) / nominal
    if jitter <= _JITTER and timing != "resample":
        return Grid(origin=stamps.first, step=step, count=time.size)
    # The same arithmetic as in `split_at_gaps`, which leaves no such gap.
    longest = _longest_gap(nominal)
    if late > longest - nominal:
        row = stamps.row
        raise DataError(
            f"time: gap of {late + nominal:.6g} s before row {row + 1} (from "
            f"{time[row - 1]:.9g} s to {time[row]:.9g} s), {late / nominal + 1.0:.1f} steps of "
            f"{nominal:.6g} s, more than {longest / nominal:.3g}; without its period the record "
            "is split there."
        )
    timing, why = _better_timing(recording) if timing == "auto" else (timing, "as given")
    seen = f"time stamps jitter by {100.0 * jitter:.3g} % of a step of {nominal:.6g} s"
    if timing == "nominal":
        note = f"{seen}; samples taken as regular, {1.0 / step:.6g} Hz ({why})"
        return Grid(origin=stamps.first, step=step, count=time.size, note=note)
    # Rounded, not cut: an early last stamp must not cost a sample of the last period.
    count = round(recording.duration / step) + 1
    note = f"{seen}; channels resampled to {1.0 / step:.6g} Hz by cubic splines ({why})"
    return Grid(origin=stamps.first, step=step, count=count, stamps=np.asarray(time), note=note)


def _better_timing(recording: Recording) -> tuple[Timing, str]:
    """Return whether to trust the sample index or the stamps, and why."""
    from scipy.interpolate import CubicSpline

    step = recording.step
    wander = float(np.ptp(recording.time - step * np.arange(recording.n_samples))) / 2.0 / step
    if wander > _MAX_WANDER_STEPS:
        return "resample", f"they wander off a regular clock by {wander:.3g} steps"
    part = middle(recording.n_samples, _COMPARED)
    time, position = recording.time[part] - recording.time[part.start], recording.position[part]
    ratio = 1.0
    if time.size >= 2 * _SPLINE_REACH:
        errors = []
        for knots in (time, np.arange(time.size) * step):
            guess = CubicSpline(knots[::2], position[::2])(knots[1::2])
            # The ends of a spline are worse than its middle for either choice.
            errors.append(float(np.sqrt(np.mean((guess - position[1::2])[2:-2] ** 2))))
        # Where the index is exact, so are the stamps, or they are infinitely worse.
        ratio = errors[0] / errors[1] if errors[1] else 1.0 if not errors[0] else math.inf
    why = f"positions left out are predicted from the stamps with {ratio:.4g} times the error from"
    timing: Timing = "resample" if ratio < _CLEARLY_BETTER else "nominal"
    return timing, f"{why} the sample index"


# Positions follow a speed that is their rate by steps of this correlation, over so many rows, in
# which errors of the clock average out, and as far as this share.
_FOLLOWS, _ROWS, _CLOSE = 0.99, 100, 0.03
# Joints that must agree on the clock, and the share of rows that repeat others exactly.
_LEAST_JOINTS, _LEAST_REPEATS = 2, 0.01
# Steps that regular stamps explain worse than this are of another clock, if one that the other
# joints tell explains them better by this factor.
_MISSED, _BETTER = 0.1, 2.0
# How far the clock is from regular stamps, and how well speeds tell a step, in steps.
_WANDER, _NOISE = 2.0, 0.05
# Stamps whose longest step is longer than this are their own clock, or have gaps.
_REGULAR = 1.5
# No row is read sooner after another one, in steps.
_LEAST_STEP = 0.05


class Clock(NamedTuple):
    """When rows were read.

    Attributes
    ----------
    rows : ndarray of int, shape (K,)
        Those that do not repeat the row before.
    time : ndarray, shape (K,)
        When they were read, s.
    repeats : float
        Share of rows that repeat others.
    jitter : float
        How far times are from regular stamps, s, rms.
    missed, left : float
        What steps of positions are off speeds times steps of the stamps, and of these times, as a
        share of the steps, rms.
    joints : ndarray of int
        Those whose speeds tell it.
    """

    rows: Indices
    time: Array
    repeats: float
    jitter: float
    missed: float
    left: float
    joints: Indices


@kept
def told_clock(log: Recording) -> Clock | None:
    """Return when rows were read; None where stamps are as good, or speeds do not tell.

    A driver that is read at times of its own repeats rows, and gives others earlier or later than
    their stamps say: steps of all joints are then longer or shorter than their speeds by the same
    share. Each joint's steps are explained by the clock that the others tell.
    """
    if log.velocity is None or log.period is not None or log.base is not None:
        return None
    if log.stamps.most > _REGULAR * log.step:
        return None
    # Block by block: comparing all of a recording that is larger than the memory takes an eighth.
    repeated = np.zeros(log.n_samples, dtype=bool)
    for begin in range(1, log.n_samples, ROWS):
        part = np.asarray(log.position[begin - 1 : begin + ROWS])
        repeated[begin : begin + ROWS] = (part[1:] == part[:-1]).all(axis=1)
    repeats = float(repeated.mean())
    if not _LEAST_REPEATS <= repeats < 0.5:
        return None
    position, velocity = np.asarray(log.position), np.asarray(log.velocity)
    rows = np.flatnonzero(~repeated)
    steps = np.diff(position[rows], axis=0)
    speeds = 0.5 * (velocity[rows[1:]] + velocity[rows[:-1]])
    regular = log.step * np.diff(rows)
    joints = np.flatnonzero(
        [_is_rate(d, v * regular) for d, v in zip(steps.T, speeds.T, strict=True)]
    )
    if len(joints) < _LEAST_JOINTS:
        return None
    off = []
    for j in joints.tolist():
        others = joints[joints != j]
        times = _times(steps[:, others], speeds[:, others], rows, log.step)
        ways = speeds[:, [j]] * np.column_stack([regular, np.diff(times)])
        off.append((steps[:, [j]] - ways).std(axis=0) / ways[:, 0].std())
    missed, left = np.median(off, axis=0).tolist()
    if not missed > max(_MISSED, _BETTER * left):
        return None
    times = _times(steps[:, joints], speeds[:, joints], rows, log.step)
    later = np.r_[True, np.diff(np.maximum.accumulate(times)) > _LEAST_STEP * log.step]
    return Clock(
        rows=rows[later],
        time=log.stamps.first + times[later],
        repeats=repeats,
        jitter=float(np.std(times - log.step * rows)),
        missed=missed,
        left=left,
        joints=joints,
    )


def retimed(log: Recording, clock: Clock) -> Recording:
    """Return a recording at regular times, interpolated from those at which rows were read.

    Positions pass a cubic spline; between efforts, speeds and commands lines are drawn.
    """
    from scipy.interpolate import CubicSpline

    begin, end = clock.time[0], clock.time[-1]
    time = begin + log.step * np.arange(int((end - begin) / log.step) + 1)
    tables = {name: np.asarray(table)[clock.rows] for name, table in channels(log).items()}
    found: dict[str, Any] = {
        name: CubicSpline(clock.time - begin, table)(time - begin)
        if name in ("position", "link_position")
        else np.stack([np.interp(time, clock.time, column) for column in table.T], axis=1)
        for name, table in tables.items()
    }
    return replace(log, time=time, **found)


def _is_rate(steps: Array, ways: Array) -> bool:
    """Tell whether ways, speeds times steps of the time, are a joint's steps over many rows."""
    count = len(steps) // _ROWS
    if count < 4:
        return False
    long, expected = (
        each[: count * _ROWS].reshape(count, _ROWS).sum(axis=1) for each in (steps, ways)
    )
    if not (power := float(expected @ expected)) or not long.any():
        return False
    slope = float(long @ expected) / power
    correlation = slope * np.sqrt(power / float(long @ long))
    return abs(slope - 1.0) < _CLOSE and correlation > _FOLLOWS


def _times(steps: Array, speeds: Array, rows: Indices, step: float) -> Array:
    """Return times (K,) whose steps explain positions by speeds, near to regular ones."""
    from scipy.linalg import solveh_banded

    weights = 1.0 / np.mean(speeds**2, axis=0) / speeds.shape[1]
    power = (speeds**2 @ weights) / (_NOISE * step) ** 2
    ways = ((speeds * steps) @ weights) / (_NOISE * step) ** 2
    near = 1.0 / (_WANDER * step) ** 2
    before, after = np.pad(power, (1, 0)), np.pad(power, (0, 1))
    right = near * step * rows - np.diff(ways, prepend=0.0, append=0.0)
    return np.asarray(solveh_banded(np.stack([-before, near + after + before]), right))
