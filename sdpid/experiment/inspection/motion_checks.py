"""Checks of positions, velocities and references: units, jumps, rest, directions, other motion."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.kinds import KINDS, Finding, found, note, refuse, warning
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.recording.degrees import suspect_units
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.rest import AT_REST, moving
from sdpid.experiment.recording.stored import ROWS, taken
from sdpid.experiment.recording.velocities import velocity_fit

KINDS.update(
    time_scale=refuse(
        "velocities of all joints are {scale:.3g} times the rate of their positions, limit "
        "{least:.2g} to {limit:g}: the time stamps count {scale:.3g} s for every second",
        "give the stamps in s, or the true rate (rate_hz); where they are right, leave the "
        "velocity out (velocity=none)",
        hides=("speed",),
        spoils=True,
    ),
    position_in_degrees=refuse(
        "positions look like degrees, not radians{seen}{mended}",
        "convert them, or read the file with units={{'position': 'deg'}}",
        spoils=True,
    ),
    joint_at_rest=warning(
        "{joint} {moved} (limit {limit:g} rad)",
        "its inertia and friction are unknown; excite it",
    ),
    position_jumps=refuse(
        "position of {joint} changes by {size:.4g} rad in one step at row {row}, that is "
        "{speed:.4g} rad/s (limit {limit:g}): an outlier, or wrong units",
        "remove that sample, or give the unit",
        spoils=True,
        about="speed",
    ),
    one_direction=warning(
        "{joints} in one direction only: {of}{share:.2g %} of the way goes back, limit {limit:g %}",
        "move both ways: friction looks like an offset else, or like gravity",
        about="speed",
    ),
    long_rest=warning(
        "the robot stands still in {share:.2g %} of the recording (no joint faster than {speed:g} "
        "rad/s), limit {limit:g %}",
        "no need to cut it: rows at rest are left out by default; record more motion",
        about="speed",
    ),
    velocity_scale=warning(
        "velocity of {joint} {what}", "correct it, or leave the velocity out", about="speed"
    ),
    reference_unlike=note(
        "reference of {wrong}",
        "name its column, unit or joints, or leave it out (reference=none); fits that simulate the "
        "controller would be wrong",
        about="speed",
    ),
)

# No joint of an arm turns faster (rad/s); the fastest reach some 15.
_FASTEST = 40.0
# An encoder that is read late repeats its position for less than this (s), and then catches up; one
# of few digits for any time, and then changes by a step of about its usual size. Either took the
# time since the last change.
_STALE, _ROUNDED = 0.1, 1.5
# Two signals belong together when they correlate like this, and differ in their units when the
# scale between them is off by this factor: filters explain less. On six simulated arms fits of a
# reference to its own joint correlate by more than 0.999, to another one by less than 0.75.
_CORRELATED = 0.9
_SCALE = 1.3
# Factors that one meets: the unit in the file instead of the one that was meant.
_FACTORS = {
    180.0 / math.pi: "deg instead of rad",
    math.pi / 180.0: "rad instead of deg",
    30.0 / math.pi: "rpm instead of rad/s",
    1000.0: "a factor of 1000: time or velocity in thousandths",
    0.001: "a factor of 1/1000: time or velocity in thousandths",
    1.0 / (2.0 * math.pi): "turns instead of rad",
}
_FACTOR_SLACK = 0.1
# Where this share of the joints agrees this well on a scale that is off by this factor, it is the
# time stamps that are wrong: of sound recordings it is off by 2 % at most.
_CLOCK, _CLOSE, _MOST = 1.1, 0.05, 0.6
# A joint that moves less than this part of its way back moves in one direction.
_BACK = 0.02
# The whole robot rests below this speed (rad/s, or m/s). Rows at rest are masked by default, so a
# recording that rests longer has less to say than its length promises.
_RESTING, _LONGEST_REST = 0.005, 0.3


@check
def degrees(subject: Subject) -> Iterator[Finding]:
    """Find positions in degrees."""
    robot = subject.fixed
    limits = None if robot is None else robot.position_limits[robot.n_base :]
    suspects = suspect_units(subject.log, limits, subject.position_range)
    if suspects:
        yield found("position_in_degrees", seen=f": {', '.join(suspects)}", mended="")


@check
def rest_and_jumps(subject: Subject) -> Iterator[Finding]:
    """Find joints that never move, and positions that jump."""
    log = subject.log
    low, high = subject.position_range
    reach = high - low
    jumps: dict[int, tuple[float, float, int]] = {}
    for first, piece in subject.pieces:
        for j, speed, step, row in _fast_steps(first, piece):
            jumps[j] = max(jumps.get(j, (0.0, 0.0, 0)), (speed, step, row))
    for j, name in enumerate(log.names):
        # A joint without a motor moves as far as its loop moves it: nobody can excite it.
        if reach[j] < AT_REST and name not in subject.passive:
            moved = "never moves" if reach[j] == 0.0 else f"moves by {reach[j]:.3g} rad only"
            yield found("joint_at_rest", name, moved=moved, range=reach[j], limit=AT_REST)
            continue
        speed, jump, row = jumps.get(j, (0.0, 0.0, 0))
        if speed > _FASTEST:
            numbers = {"jump": jump, "size": abs(jump), "row": row, "speed": speed}
            yield found("position_jumps", name, limit=_FASTEST, **numbers)


@check
def directions_and_rest(subject: Subject) -> Iterator[Finding]:
    """Find joints that move in one direction only, and recordings that mostly stand still."""
    rows = subject.low_passed
    if rows is None:
        return
    names = subject.log.names
    forth, back = (np.maximum(sign * rows.velocity, 0.0).sum(axis=0) for sign in (1.0, -1.0))
    shares = np.minimum(forth, back) / np.maximum(forth + back, 1e-300)
    one_way = np.flatnonzero(moving(*subject.position_range) & (shares < _BACK)).tolist()
    if one_way:
        share, alone = float(shares[one_way].max()), len(one_way) == 1
        yield found(
            "one_direction",
            names[one_way[0]] if alone else None,
            joints=f"{', '.join(names[j] for j in one_way)} {'moves' if alone else 'move'}",
            of="" if alone else "of each at most ",
            share=share,
            limit=_BACK,
        )
    resting = float(np.mean(np.abs(rows.velocity).max(axis=1) < _RESTING))
    if resting > _LONGEST_REST:
        yield found("long_rest", share=resting, speed=_RESTING, limit=_LONGEST_REST)


def _fast_steps(first: int, piece: Recording) -> Iterator[tuple[int, float, float, int]]:
    """Yield joint, speed, size and row, from 1, of its fastest step in blocks beyond the limit."""
    for begin in range(0, piece.n_samples - 1, ROWS):
        stop = begin + ROWS + 1
        steps = np.diff(taken(piece.position, begin, stop), axis=0)
        durations = np.diff(piece.time[begin:stop])
        if max(steps.max(), -steps.min()) <= _FASTEST * durations.min():
            continue
        fast = (np.abs(steps) / durations[:, None]).max(axis=0) > _FASTEST
        for j in np.flatnonzero(fast).tolist():
            rows = np.flatnonzero(steps[:, j])
            waited = np.diff(piece.time[begin + 1 + rows], prepend=piece.time[begin])
            sizes = np.abs(steps[rows, j])
            late = (waited < _STALE) | (sizes <= _ROUNDED * np.median(sizes))
            speeds = sizes / np.where(late, waited, durations[rows])
            k = int(speeds.argmax())
            yield j, float(speeds[k]), float(steps[rows[k], j]), first + begin + int(rows[k]) + 2


@check
def velocities(subject: Subject) -> Iterator[Finding]:
    """Find velocities that are not the rate of the positions, and stamps that run wrong."""
    if subject.log.velocity is None or not subject.pieces:
        return
    each = ((name, velocity_fit(subject.longest, j)) for j, name in enumerate(subject.log.names))
    fits = {name: fit for name, fit in each if fit and fit.correlation >= _CORRELATED}
    scales = np.array([fit.scale for fit in fits.values()])
    common = float(np.median(scales)) if len(scales) > 1 else 1.0
    share = float(np.mean(np.abs(scales / common - 1.0) < _CLOSE)) if len(scales) else 0.0
    wrong = common > 0.0 and not 1.0 / _CLOCK < common < _CLOCK
    if wrong and share >= _MOST and not scale_in_words(common):
        yield found("time_scale", scale=common, share=share, least=1.0 / _CLOCK, limit=_CLOCK)
        return
    for name, fit in fits.items():
        if 1.0 / _SCALE < fit.scale < _SCALE:
            continue
        what = "has the sign opposite to the rate of its position"
        if fit.scale > 0.0:
            what = (
                f"is {fit.scale:.3g} times the rate of its position{scale_in_words(fit.scale)}, "
                f"limit {1.0 / _SCALE:.2g} to {_SCALE:g}"
            )
        numbers = {"scale": fit.scale, "correlation": fit.correlation}
        yield found("velocity_scale", name, subject.about_velocity, what=what, **numbers)


def scale_in_words(scale: float) -> str:
    """Return which units mixed up make a scale, in brackets; empty for none."""
    known = [u for factor, u in _FACTORS.items() if abs(scale / factor - 1.0) < _FACTOR_SLACK]
    return f" ({known[0]})" if known else ""


# References are compared on this many samples from the middle of a piece, as means over 1000
# intervals.
_COMPARED = 100_000
_INTERVALS = 1000
_LEAST_INTERVALS = 20
# What is left between them once the effort that gravity and friction need is accounted for
# (rad, or m).
_OFFSET = 0.1
# Positions do not come before their references (s); clocks and filters account for a few samples.
_EARLIEST = -0.02

# Positions, references and efforts as means over intervals, and the intervals' length in s.
_Means: TypeAlias = tuple[Array, Array, Array, float]


@dataclass(frozen=True, kw_only=True)
class _ReferenceFit:
    """A reference as scale × the position some time later, plus an offset.

    What a proportional controller lags behind for its effort is accounted for: a slow loop is no
    wrong reference.
    """

    scale: float
    offset: float
    lag: float
    correlation: float


@check
def references(subject: Subject) -> Iterator[Finding]:
    """Find references that the positions do not follow."""
    if subject.log.reference is None or not subject.pieces:
        return
    longest = subject.longest
    means = _means(longest)
    if means is None:
        return
    position, reference, effort, step = means
    wrong: dict[str, tuple[str, _ReferenceFit]] = {}
    for j in np.flatnonzero(moving(*subject.position_range)).tolist():
        fit = _fit(position[:, j], reference[:, j], effort[:, j], step)
        what = _wrong(fit, longest.names, j, means)
        if what is not None:
            wrong[longest.names[j]] = what, fit
    if not wrong:
        return
    # Joints mostly share the defect: columns that are swapped, a unit, another signal.
    alone = len(wrong) == 1
    numbers = {
        key if alone else f"{name}: {key}": value
        for name, (_, fit) in wrong.items()
        for key, value in vars(fit).items()
    }
    told = "; of ".join(f"{name} {what}" for name, (what, _) in wrong.items())
    yield found("reference_unlike", next(iter(wrong)) if alone else None, wrong=told, **numbers)


def _wrong(fit: _ReferenceFit, names: tuple[str, ...], j: int, means: _Means) -> str | None:
    """Return what is wrong with a joint's reference, in words."""
    if fit.correlation < _CORRELATED:
        position, reference, effort, step = means
        each = zip(position.T, effort.T, strict=True)
        others = [_fit(q, reference[:, j], tau, step).correlation for q, tau in each]
        best = int(np.argmax(others))
        if others[best] > _CORRELATED:
            return f"is followed by {names[best]} (correlation {others[best]:.3g})"
        return f"is not followed (correlation {fit.correlation:.2f}, limit {_CORRELATED:g})"
    if not 1.0 / _SCALE < fit.scale < _SCALE:
        words = scale_in_words(fit.scale)
        limits = f"limit {1.0 / _SCALE:.2g} to {_SCALE:g}"
        return f"is {fit.scale:.3g} times the position{words}, {limits}"
    if abs(fit.offset) > _OFFSET:
        return f"is {fit.offset:.3g} rad off the position on average, limit {_OFFSET:g}"
    if fit.lag < _EARLIEST:
        return f"comes {-fit.lag:.3g} s after the motion, limit {-_EARLIEST:g}: it is no command"
    return None


def _means(log: Recording) -> _Means | None:
    """Return means of positions, references, efforts over intervals, and the intervals' length."""
    assert log.reference is not None
    begin = max(0, (log.n_samples - _COMPARED) // 2)
    given = (log.position, log.reference, log.effort)
    tables = [taken(each, begin, begin + _COMPARED) for each in given]
    stride = max(1, len(tables[0]) // _INTERVALS)
    count = len(tables[0]) // stride
    if count < _LEAST_INTERVALS:
        return None
    position, reference, effort = (
        table[: count * stride].reshape(count, stride, -1).mean(axis=1) for table in tables
    )
    return position, reference, effort, stride * log.step


def _fit(position: Array, reference: Array, effort: Array, step: float) -> _ReferenceFit:
    """Fit a reference by the position, its rate, the effort and a constant."""
    rate = (position[2:] - position[:-2]) / (2.0 * step)
    position, reference = position[1:-1], reference[1:-1]
    mean = float(position.mean())
    signals = (position - mean, rate, effort[1:-1], np.ones_like(rate))
    columns = np.column_stack(signals)
    weights = np.linalg.lstsq(columns, reference)[0]
    scale, slope, _, level = weights.tolist()
    return _ReferenceFit(
        scale=scale,
        offset=level - mean,
        lag=slope / scale if scale != 0.0 else 0.0,
        correlation=_correlation(columns @ weights, reference),
    )


def _correlation(a: Array, b: Array) -> float:
    """Return the correlation of two signals, 0 where one is constant."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else 0.0
