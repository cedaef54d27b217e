"""Checks of single channels: values that stay, stand alone, are rounded, clipped or no signal.

On 63 sound recordings (423 joints) the largest values were these shares of a rule's limit:
effort_frozen 0, velocity_frozen 0.21, position_frozen 0.29, effort_spike 0.62, position_lone 0.2,
position_coarse 0.30.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
from sdpid.experiment.inspection.kinds import KINDS, Finding, found, left_out, note, refuse, warning
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.processing.motion import motion_frequency, power_density
from sdpid.experiment.recording.plausible import moving
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.stored import ROWS, extremes, middle

_STAYS = " of {joint} stays at {value:.4g} from {begin:.4g} to {end:.4g} s (rows {row} to {last})"
_LEAVE = "leave those rows out"
KINDS.update(
    effort_noisy=note(
        "effort of {joint} has {share:.2g %} of its power above {band:.3g} Hz, where the motion "
        "has none, limit {limit:g %}: most at {frequency:.3g} Hz",
        "look at its drive, which may swing by itself; its parameters will be poorly known",
    ),
    position_lone=refuse(
        "position of {joint} is {off:.3g} rad off those before and after it at row {row}, limit "
        "{limit:.2g} rad: a wrong sample",
        "remove that sample: a gap of a few samples is interpolated",
    ),
    position_coarse=warning(
        "position of {joint} has {values} different values (limit {limit}), {step:.2g} rad apart "
        "(limit {step_limit:g} rad): it is rounded",
        "log positions with all their digits",
        spoils=True,
    ),
    position_frozen=refuse(
        f"position{_STAYS}, while {{joint}} moves by {{moved:.2g}} rad, limit {{limit:.2g}}",
        _LEAVE,
    ),
    velocity_frozen=warning(
        f"velocity{_STAYS}, while {{joint}} leaves that speed by {{moved:.2g}} rad (limit "
        "{limit:.2g} rad)",
        f"{_LEAVE}, or the velocity (velocity=none)",
        hides=("velocity_clipped",),
    ),
    effort_frozen=warning(
        f"effort{_STAYS}, while {{joint}} moves by {{way:.2g}} rad",
        f"{_LEAVE}, or the efforts of that joint (without_effort)",
        hides=("effort_clipped",),
    ),
    effort_spike=warning(
        "effort of {joint} is {off:.3g} off those before and after it at row {row}, limit "
        "{limit:.2g}: an outlier",
        "remove that sample",
    ),
    effort_silent=left_out(
        "effort of {joint} is exactly 0 in {share:.3g %} of the rows in which it moves "
        "(limit {limit:g %}): it was not measured there",
        about="log",
    ),
    effort_constant=warning(
        "effort of {joint} never changes: it is {value:.4g} in every row",
        "if it was not measured, leave it out (without_effort)",
    ),
    effort_clipped=warning(
        "effort of {joint} stays at {at} in {rows} of {all} rows ({share:.2g %}, limit "
        "{limit:g %}): it is clipped",
        "leave those rows out, or move more gently: what the drive gave is unknown",
    ),
    velocity_clipped=warning(
        "velocity of {joint} stays at {at} in {rows} of {all} rows ({share:.2g %}, limit "
        "{limit:g %}): it is clipped",
        "leave the velocity out (velocity=none): it is then had from the position",
        hides=("velocity_unlike",),
    ),
)

# The motion's band ends at this many times the frequency below which 95 % of it lies, and at this
# one (Hz) at least; beyond this share of half the rate there is nothing. More than this share of
# an effort's power above it is told: 0.56 at a drive with a limit cycle, 0.36 at most at the joints
# of ten good recordings; its largest line is so many times the median there, where noise alone has
# none. So many samples are heard, in stretches of so many seconds.
_BAND, _LEAST_BAND, _BELOW, _NOISY, _PEAK = 20.0, 2.0, 0.8, 0.5, 10.0
_HEARD, _HEARD_S = 1 << 17, 4.0

# A channel stays where it has one value for so long (s), in so many rows, and so many times as long
# as usual: a slow bus holds every value.
_LEAST_S, _LEAST_ROWS, _LONGER = 0.1, 5, 5.0
# Shares of the joint's range. It moves during a run of equal efforts where it leaves the run's
# chord by this: at constant speed simulated efforts without noise are constant too.
_OFF_CHORD = 5e-4
# And where it leaves the line that a velocity draws which stays.
_OFF_LINE = 3e-3
# What the velocity says that a position moves which stays, and what it jumps by at the end: one
# that waits beside a stale velocity does not jump. Without a velocity it is the jump alone, as a
# multiple of 99.9 % of all steps.
_WAITED, _JUMPED, _STEPS = 0.02, 2.0, 99.9
# Where it never moves on, the velocity must say so many times as much.
_UNSEEN = 5.0
# An effort stands alone where it is this many times as far from the median of four neighbors as
# 99 % of all are, and as 99 % of all are from the median of all.
_ALONE, _TALL, _PERCENTILE = 8.0, 4.0, 99.0
# A position is wrong where it is off two neighbors that agree, and off the lines through two on
# either side (a joint that is hit turns round at a corner), by this many times 99 % of all second
# differences and by this (rad, or m).
_OFF, _LEAST_OFF, _AGREE = 6.0, 2e-3, 0.5
# A joint that moves by more than this (rad, or m) has this many different positions, or more, that
# are less apart than this.
_RANGE, _VALUES, _APART = 0.1, 50, 0.02
# This share of their distances are whole multiples of one, as nearly as this.
_ON_GRID, _CLOSE = 0.9, 0.05
# Neighbors are at most so many usual steps apart, on average.
_STEP = 2.0
# Where a value is off by less, nothing is.
_TINY = 1e-300
# Fewer rows do not show what is usual.
_FEW_ROWS = 100


@dataclass(frozen=True, kw_only=True, eq=False)
class JointChannels:
    """One joint's channels over some rows of a recording, and its range over all of them."""

    time: Array
    position: Array
    effort: Array
    velocity: Array | None = None
    reach: float
    moves: bool

    def near(self, rows: int) -> Mask:
        """Return whether the rows so many further on follow without a gap."""
        usual = float(np.median(np.diff(self.time)))
        return np.asarray(self.time[rows:] - self.time[:-rows] < rows * _STEP * usual)

    def off_line(self, rows: slice, speed: float | None = None) -> float:
        """Return how far the position leaves a line of some speed, or its chord, over a run."""
        time = self.time[rows] - self.time[rows.start]
        way = self.position[rows] - self.position[rows.start]
        return float(np.ptp(way - time * (way[-1] / time[-1] if speed is None else speed)))


# Runs of rows, by how much they are off against a limit, and other numbers to tell.
_Runs: TypeAlias = Iterator[tuple[slice, float, float, dict[str, float]]]


def _frozen(joint: JointChannels, name: str) -> _Runs:
    """Yield runs of equal values of a joint that moves, by how far it goes meanwhile."""
    values, time = getattr(joint, name), joint.time
    if values is None or not joint.moves:
        return
    edges = np.flatnonzero((np.diff(values) != 0.0) | ~joint.near(1)) + 1
    starts, stops = np.r_[0, edges], np.r_[edges, len(values)]
    lasting = time[np.minimum(stops, len(time) - 1)] - time[starts]
    stays = lasting >= max(_LEAST_S, _LONGER * float(np.median(lasting)))
    for i in np.flatnonzero(stays & (stops - starts >= _LEAST_ROWS)).tolist():
        rows = slice(int(starts[i]), int(stops[i]))
        value = float(values[rows.start])
        extreme = name != "position" and value in (values.min(), values.max())
        # A channel that comes back to its largest or least value is clipped.
        if extreme and np.count_nonzero(values[starts] == value) > 1:
            continue
        if name == "position":
            moved, limit = _waited(joint, rows), _WAITED
        elif name == "velocity":
            moved, limit = joint.off_line(rows, value), _OFF_LINE
        else:
            moved, limit = joint.off_line(rows), _OFF_CHORD
        numbers = {"value": value, "way": float(np.ptp(joint.position[rows])), "moved": moved}
        yield rows, moved, limit * joint.reach, numbers


def _waited(joint: JointChannels, rows: slice) -> float:
    """Return how far a joint goes whose position stays: what it jumps by, or its velocity says."""
    jumps = np.append(np.abs(np.diff(joint.position)) * joint.near(1), 0.0)
    least = _JUMPED * float(np.percentile(jumps[jumps > 0.0], _STEPS, method="lower"))
    jump = float(jumps[rows.stop - 1])
    if joint.velocity is None or jump >= least:
        return jump if jump >= least else 0.0
    way = abs(float(np.trapezoid(joint.velocity[rows], joint.time[rows])))
    return min(way, jump if jump > 0.0 else way / _UNSEEN)


def _effort_spike(joint: JointChannels) -> _Runs:
    effort = np.pad(joint.effort, 2, "reflect")
    beside = np.stack([effort[:-4], effort[1:-3], effort[3:-1], effort[4:]])
    off = np.abs(joint.effort - np.median(beside, axis=0))
    off[2:-2] *= joint.near(4)
    from_median = np.abs(joint.effort - np.median(joint.effort))
    return _lone(off, off, _ALONE, _TALL * float(np.percentile(from_median, _PERCENTILE)))


def _position_lone(joint: JointChannels) -> _Runs:
    position = joint.position
    off, step = np.zeros((2, len(position)))
    off[1:-1] = np.abs(position[1:-1] - 0.5 * (position[:-2] + position[2:]))
    step[1:-1] = np.abs(position[2:] - position[:-2])
    alone = off.copy()
    for order in (1, -1):
        values, part = position[::order], alone[::order][2:]
        np.minimum(part, np.abs(values[2:] - 2.0 * values[1:-1] + values[:-2]), out=part)
    alone *= step < _AGREE * alone
    alone[1:-1] *= joint.near(2)
    return _lone(alone, off, _OFF, _LEAST_OFF)


def _lone(alone: Array, off: Array, times: float, least: float) -> _Runs:
    """Yield rows whose value is alone: so many times as far off as others are, and so far."""
    far = np.ones(len(off), dtype=np.bool_)
    worst = int(alone.argmax())
    far[max(0, worst - 5) : worst + 6] = False
    limit = max(times * float(np.percentile(off[far], _PERCENTILE)), least)
    for row in np.flatnonzero(alone >= max(limit, _TINY)).tolist():
        yield slice(row, row + 1), alone[row], limit, {"off": alone[row]}


def _position_coarse(joint: JointChannels) -> _Runs:
    values = np.unique(joint.position.round(9))
    count, rows = len(values), len(joint.position)
    if not 1 < count < rows / 2 or not values[-1] - values[0] > _RANGE:
        return
    gaps = np.diff(values)
    apart = float(np.median(gaps))
    # A motion that repeats itself has few values too, but not on a grid.
    if np.mean(np.abs(gaps / apart - np.rint(gaps / apart)) < _CLOSE) > _ON_GRID:
        numbers = {"values": count, "limit": _VALUES, "step": apart, "step_limit": _APART}
        yield slice(0, rows), max(_VALUES / count, apart / _APART), 1.0, numbers


# In this order: what is far off hides the rest, and what is rounded stays and jumps.
_RULES: dict[str, Callable[[JointChannels], _Runs]] = {
    "position_lone": _position_lone,
    "position_coarse": _position_coarse,
    "position_frozen": partial(_frozen, name="position"),
    "velocity_frozen": partial(_frozen, name="velocity"),
    "effort_frozen": partial(_frozen, name="effort"),
    "effort_spike": _effort_spike,
}


def wrong_channels(subject: Subject) -> tuple[list[Finding], Subject]:
    """Return what is wrong with single channels, and the subject without the rows that are."""
    findings: list[Finding] = []
    wrong: list[Array] = []
    skipped = {"position": frozenset[str](), "velocity": frozenset(), "effort": subject.without}
    for kind, rule in _RULES.items():
        quantity = kind.split("_")[0]
        for j, name in enumerate(subject.log.names):
            runs = []
            for joint in [] if name in skipped[quantity] else _parts(subject, j):
                for rows, size, limit, numbers in rule(joint):
                    if size >= limit:
                        runs.append((size / limit, joint.time[rows], {"limit": limit, **numbers}))
            if not runs:
                continue
            _, time, numbers = max(runs, key=lambda run: run[0])
            numbers |= {"row": subject.row(time[0]), "last": subject.row(time[-1])}
            if kind.endswith("_frozen"):
                begin, end = time[[0, -1]] - subject.given.time[0]
                numbers |= {"begin": begin, "end": end}
            severity = subject.about_velocity if quantity == "velocity" else None
            told = found(kind, name, severity, **numbers)
            if len(runs) > 1:
                told = replace(told, message=f"{told.message}; {len(runs)} such in all")
            findings.append(told)
            if kind == "position_coarse":
                skipped["position"] |= {name}
            else:
                wrong += [time for _, time, _ in runs]
        if wrong and kind in ("position_lone", "effort_spike"):
            subject, wrong = subject.less(np.concatenate(wrong)), []
    return findings, subject


def _parts(subject: Subject, j: int) -> Iterator[JointChannels]:
    """Yield a joint's channels: at once, or in parts of as many rows as are worked on at a time."""
    low, high = subject.log.position_range
    names = [x for x in ("position", "effort", "velocity") if getattr(subject.log, x) is not None]
    parts = [
        (piece, slice(begin, begin + ROWS))
        for piece in subject.pieces
        for begin in range(0, piece.n_samples, ROWS)
    ]
    for group in [parts] if subject.log.n_samples <= ROWS else [[part] for part in parts]:
        time = np.concatenate([piece.time[rows] for piece, rows in group])
        if len(time) >= _FEW_ROWS:
            channels = {
                name: np.concatenate([getattr(piece, name)[rows, j] for piece, rows in group])
                for name in names
            }
            reach, moves = float(high[j] - low[j]), bool(moving(low, high)[j])
            yield JointChannels(time=time, **channels, reach=reach, moves=moves)


# A joint whose effort is exactly zero in more than this share of the rows in which it moves has no
# signal there; of 30 real recordings at most 0.1 %. Of so many rows, those count whose step is
# more than this share of its 90th percentile.
_ZERO, _SOME, _FAST, _MOST_STEPS = 0.5, 2000, 0.1, 90.0
# Steps are taken from the row before to the row behind.
_FEWEST = 3
# A channel is clipped where it stays at its very largest value for this many samples in a row,
# this many times or once for so many samples, and in this share of all rows.
_PLATEAU, _PLATEAUS, _LONG, _CLIPPED = 5, 2, 20, 0.002
# A clipped velocity is passed by the rate of the position by this share of what that spans; a robot
# that runs at one speed is not clipped.
_PASSED = 0.01
# Of a signal in coarse steps the step below the largest is as long: clipped ones are this many
# times as long there as on it.
_AS_LONG = 3.0
# Looked for among this many rows from the middle of the recording.
_COMPARED = 200_000


def silent(subject: Subject) -> list[Finding]:
    """Find joints whose effort is zero while they move; not where that is so of all that move."""
    log, told = subject.log, []
    if log.n_samples < _FEWEST:
        return []
    rows = np.unique(np.linspace(1, log.n_samples - 2, _SOME).astype(np.intp))
    steps = np.abs(log.position[rows + 1] - log.position[rows - 1])
    moves = moving(*log.position_range) & [name not in subject.passive for name in log.names]
    for j in np.flatnonzero(moves):
        fast = steps[:, j] > _FAST * np.percentile(steps[:, j], _MOST_STEPS)
        share = float(np.mean(log.effort[rows[fast], j] == 0.0)) if fast.any() else 0.0
        if share > _ZERO:
            told.append(found("effort_silent", log.names[j], share=share, limit=_ZERO))
    return told if len(told) < np.count_nonzero(moves) else []


@check()
def signals(subject: Subject) -> Iterator[Finding]:
    """Find efforts that never change."""
    low, high = extremes(subject.log.effort)
    for j, name in enumerate(subject.log.names):
        # Without a motor a joint has none.
        if name not in subject.passive and not high[j] > low[j]:
            yield found("effort_constant", name, value=low[j])


@check()
def clipped(subject: Subject) -> Iterator[Finding]:
    """Find efforts and velocities that stop at a largest value while the joint moves."""
    log, moves = subject.log, np.flatnonzero(moving(*subject.log.position_range)).tolist()
    compared = middle(log.n_samples, _COMPARED)
    for quantity, severity in (("effort", None), ("velocity", subject.about_velocity)):
        table = getattr(log, quantity)
        for j in moves if table is not None else ():
            values, ends = np.asarray(table[compared, j]), {}
            for end in (1.0, -1.0):
                limit = end * float((end * values).max())
                rows = _plateaus(values, limit)
                if limit == 0.0 or rows < _CLIPPED * values.size:
                    continue
                if quantity == "effort" or _passed(subject, j, limit, end):
                    ends[limit] = rows
            if ends:
                rows = sum(ends.values())
                numbers = {"rows": rows, "all": values.size, "share": rows / values.size}
                yield found(
                    f"{quantity}_clipped",
                    log.names[j],
                    severity,
                    at=" and at ".join(f"{limit:.5g}" for limit in ends),
                    value=max(ends, key=abs),
                    limit=_CLIPPED,
                    **numbers,
                )


def _passed(subject: Subject, j: int, limit: float, end: float) -> bool:
    """Return whether the rate of a joint's position goes beyond a largest or least velocity."""
    rows = subject.low_passed
    if rows is None:
        return False
    rates = rows.velocity[:, j]
    return bool(np.max(end * rates) - end * limit > _PASSED * np.ptp(rates))


def _plateaus(values: Array, limit: float) -> int:
    """Return the number of rows in plateaus at the largest or least value, 0 if not clipped."""
    edges = np.flatnonzero(np.diff((values == limit).astype(np.int8), prepend=0, append=0))
    lengths = edges[1::2] - edges[::2]
    lengths = lengths[lengths >= _PLATEAU]
    if lengths.size < _PLATEAUS and lengths.max(initial=0) < _LONG:
        return 0
    others = values[values != limit]
    # A coarse signal holds its last but one value as long as its last.
    nearest = others[np.abs(others - limit).argmin()] if others.size else limit
    beside = np.count_nonzero(others == nearest)
    return int(lengths.sum()) if lengths.sum() >= _AS_LONG * beside else 0


@check("longest")
def noisy_efforts(subject: Subject, piece: Recording) -> Iterator[Finding]:
    """Find efforts of moving joints whose power lies far above the band of the motion."""
    try:
        band = max(_BAND * motion_frequency(piece), _LEAST_BAND)
    except DataError:
        return
    rows, length = slice(0, _HEARD), min(piece.n_samples, _HEARD, round(_HEARD_S / piece.step))
    moves = moving(*subject.log.position_range)
    for j in np.flatnonzero(moves).tolist() if band < 0.5 * _BELOW / piece.step else ():
        name, effort = piece.names[j], np.asarray(piece.effort[rows, j], dtype=np.float64)
        if name in subject.without or not np.ptp(effort):
            continue
        frequency, power = power_density(effort, 1.0 / piece.step, length, centered=True)
        above = np.where(frequency > band, power, 0.0)
        # A steady effort counts: a motion at constant speed needs no more.
        share = float(above.sum() / power.sum() * effort.var() / np.mean(effort**2))
        peak = above.max() / np.median(power[frequency > band])
        if share > _NOISY and peak > _PEAK:
            most = float(frequency[above.argmax()])
            numbers = {"share": share, "band": band, "frequency": most, "limit": _NOISY}
            yield found("effort_noisy", name, **numbers)
