"""Rules for single channels: values that stay, stand alone or are rounded.

On 63 sound recordings (423 joints) the largest values were these shares of a rule's limit:
effort_frozen 0, velocity_frozen 0.21, position_frozen 0.29, effort_spike 0.62, position_lone 0.2,
position_coarse 0.30.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.experiment.inspection.kinds import KINDS, Finding, found, left_out, refuse, warning
from sdpid.experiment.inspection.subject import Subject
from sdpid.experiment.recording.rest import moving
from sdpid.experiment.recording.stored import ROWS, taken

_STAYS = " of {joint} stays at {value:.4g} from {begin:.4g} to {end:.4g} s (rows {row} to {last})"
_LEAVE = "leave those rows out"
KINDS.update(
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
    ),
)

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
# Fewer rows do not show what is usual.
_FEW_ROWS = 100


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint:
    """One joint's channels over some rows of a recording, and its range over all of them."""

    rows: Indices
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


class Seen(NamedTuple):
    """Where a value is how many times a rule's limit, and numbers to tell."""

    excess: float
    rows: slice
    numbers: dict[str, float]


def _frozen(
    joint: Joint, values: Array, limit: float, way: Callable[[slice], float]
) -> Iterator[Seen]:
    """Yield runs of equal values of a joint that moves, by how far it goes meanwhile."""
    if not joint.moves:
        return
    time, limit = joint.time, limit * joint.reach
    edges = np.flatnonzero((np.diff(values) != 0.0) | ~joint.near(1)) + 1
    starts, stops = np.r_[0, edges], np.r_[edges, len(values)]
    lasting = time[np.minimum(stops, len(time) - 1)] - time[starts]
    stays = lasting >= max(_LEAST_S, _LONGER * float(np.median(lasting)))
    for i in np.flatnonzero(stays & (stops - starts >= _LEAST_ROWS)).tolist():
        rows = slice(int(starts[i]), int(stops[i]))
        value, moved = float(values[rows.start]), way(rows)
        extreme = values is not joint.position and value in (values.min(), values.max())
        if extreme and np.count_nonzero(values[starts] == value) > 1:
            continue  # A channel that comes back to its largest or least value is clipped.
        numbers = {
            "value": value,
            "begin": float(time[rows.start]),
            "end": float(time[rows.stop - 1]),
            "way": float(np.ptp(joint.position[rows])),
            "moved": moved,
            "limit": limit,
        }
        yield Seen(moved / limit, rows, numbers)


def _off_line(joint: Joint, rows: slice, speed: float | None = None) -> float:
    """Return how far the position leaves a line of some speed, or its chord, over a run."""
    time = joint.time[rows] - joint.time[rows.start]
    way = joint.position[rows] - joint.position[rows.start]
    return float(np.ptp(way - time * (way[-1] / time[-1] if speed is None else speed)))


def _effort_frozen(joint: Joint) -> Iterator[Seen]:
    return _frozen(joint, joint.effort, _OFF_CHORD, lambda rows: _off_line(joint, rows))


def _velocity_frozen(joint: Joint) -> Iterator[Seen]:
    speeds = joint.velocity
    if speeds is None:
        return iter(())
    return _frozen(joint, speeds, _OFF_LINE, lambda run: _off_line(joint, run, speeds[run.start]))


def _position_frozen(joint: Joint) -> Iterator[Seen]:
    velocity, jumps = joint.velocity, np.zeros(len(joint.position))
    jumps[:-1] = np.abs(np.diff(joint.position)) * joint.near(1)
    if not jumps.any():
        return iter(())
    usual = float(np.percentile(jumps[jumps > 0.0], _STEPS, method="lower"))

    def waited(rows: slice) -> float:
        jump = float(jumps[rows.stop - 1])
        if velocity is None or jump >= _JUMPED * usual:
            return jump if jump >= _JUMPED * usual else 0.0
        way = abs(float(np.trapezoid(velocity[rows], joint.time[rows])))
        return min(way, jump if jump > 0.0 else way / _UNSEEN)

    return _frozen(joint, joint.position, _WAITED, waited)


def _effort_spike(joint: Joint) -> Iterator[Seen]:
    effort = np.pad(joint.effort, 2, "reflect")
    beside = np.stack([effort[:-4], effort[1:-3], effort[3:-1], effort[4:]])
    off = np.abs(joint.effort - np.median(beside, axis=0))
    off[2:-2] *= joint.near(4)
    from_median = np.abs(joint.effort - np.median(joint.effort))
    usual = _TALL * float(np.percentile(from_median, _PERCENTILE))
    yield from _lone(off, off, _ALONE, usual)


def _position_lone(joint: Joint) -> Iterator[Seen]:
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
    yield from _lone(alone, off, _OFF, _LEAST_OFF)


def _lone(alone: Array, off: Array, times: float, least: float) -> Iterator[Seen]:
    """Yield rows whose value is alone: so many times as far off as others are, and so far."""
    far = np.ones(len(off), dtype=np.bool_)
    worst = int(alone.argmax())
    far[max(0, worst - 5) : worst + 6] = False
    limit = max(times * float(np.percentile(off[far], _PERCENTILE)), least)
    for row in np.flatnonzero(alone >= limit).tolist() if limit > 0.0 else ():
        numbers = {"off": float(alone[row]), "limit": limit}
        yield Seen(float(alone[row]) / limit, slice(row, row + 1), numbers)


def _position_coarse(joint: Joint) -> Iterator[Seen]:
    values = np.unique(joint.position.round(9))
    count, rows = len(values), len(joint.position)
    if not 1 < count < rows / 2 or not values[-1] - values[0] > _RANGE:
        return
    gaps = np.diff(values)
    apart = float(np.median(gaps))
    # A motion that repeats itself has few values too, but not on a grid.
    if not np.mean(np.abs(gaps / apart - np.rint(gaps / apart)) < _CLOSE) > _ON_GRID:
        return
    numbers = {"values": count, "limit": _VALUES, "step": apart, "step_limit": _APART}
    yield Seen(max(_VALUES / count, apart / _APART), slice(0, rows), numbers)


# In this order: what is far off hides the rest, and what is rounded stays and jumps.
RULES: dict[str, Callable[[Joint], Iterator[Seen]]] = {
    "position_lone": _position_lone,
    "position_coarse": _position_coarse,
    "position_frozen": _position_frozen,
    "velocity_frozen": _velocity_frozen,
    "effort_frozen": _effort_frozen,
    "effort_spike": _effort_spike,
}


def wrong_channels(subject: Subject) -> tuple[list[Finding], Subject]:
    """Return what is wrong with single channels, and the subject without the rows that are."""
    findings: list[Finding] = []
    left_out: list[slice] = []
    for kind, rule in RULES.items():
        of_position = kind.startswith("position")
        rounded = {f.joint for f in findings if of_position and f.kind == "position_coarse"}
        unused = subject.without if kind.startswith("effort") else frozenset()
        for j, name in enumerate(subject.log.names):
            if name in rounded or name in unused:
                continue
            seen = [
                (each, slice(int(part.rows[each.rows][0]), int(part.rows[each.rows][-1]) + 1))
                for part in _parts(subject, j)
                for each in rule(part)
                if each.excess >= 1.0
            ]
            if not seen:
                continue
            worst, rows = max(seen, key=lambda each: each[0].excess)
            severity = subject.about_velocity if kind == "velocity_frozen" else None
            numbers = {"row": rows.start + 1, "last": rows.stop, **worst.numbers}
            told = found(kind, name, severity, **numbers)
            if len(seen) > 1:
                told = replace(told, message=f"{told.message}; {len(seen)} such in all")
            findings.append(told)
            left_out += [each for _, each in seen if kind != "position_coarse"]
        if left_out and kind == "position_lone":
            subject = replace(subject, left_out=tuple(left_out))
    return findings, replace(subject, left_out=tuple(left_out)) if left_out else subject


def _parts(subject: Subject, j: int) -> Iterator[Joint]:
    """Yield a joint's channels: at once, or in parts of as many rows as are worked on at a time."""
    low, high = subject.position_range
    blocks = [
        (first, piece, slice(begin, min(begin + ROWS, piece.n_samples)))
        for first, piece in subject.pieces
        for begin in range(0, piece.n_samples, ROWS)
    ]
    groups = [blocks] if subject.log.n_samples <= ROWS else [[block] for block in blocks]
    for group in groups:
        count = sum(rows.stop - rows.start for _, _, rows in group)
        if count < _FEW_ROWS:
            continue
        yield Joint(
            rows=np.concatenate([np.arange(r.start, r.stop) + first for first, _, r in group]),
            time=_joined([(piece.time, r) for _, piece, r in group]) - subject.log.time[0],
            **{
                name: _joined([(getattr(piece, name)[:, j], r) for _, piece, r in group])
                for name in ("position", "effort", "velocity")
                if getattr(subject.log, name) is not None
            },
            reach=float(high[j] - low[j]),
            moves=bool(moving(low, high)[j]),
        )


def _joined(columns: list[tuple[Array, slice]]) -> Array:
    """Return some rows of columns, one after the other."""
    return np.concatenate([taken(column, rows.start, rows.stop) for column, rows in columns])
