"""Checks of positions and velocities: units, jumps, rest, directions, wrong velocities."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from sdpid.experiment.inspection.finding import Finding
from sdpid.experiment.inspection.kinds import found
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.recording.degrees import suspect_units
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.rest import AT_REST, moving
from sdpid.experiment.recording.stored import ROWS, taken
from sdpid.experiment.recording.velocities import velocity_fit

# No joint of an arm turns faster (rad/s); the fastest reach some 15.
_FASTEST = 40.0
# An encoder that is read late repeats its position for less than this (s), and then catches up; one
# of few digits for any time, and then changes by a step of about its usual size. Either took the
# time since the last change.
_STALE, _ROUNDED = 0.1, 1.5
# Two signals belong together when they correlate like this, and differ in their units when the
# scale between them is off by this factor: filters explain less.
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
        scale = fit.scale
        what = "has the sign opposite to the rate of its position"
        if 1.0 / _SCALE < scale < _SCALE:
            continue
        if scale > 0.0:
            what = (
                f"is {scale:.3g} times the rate of its position{scale_in_words(scale)}, limit "
                f"{1.0 / _SCALE:.2g} to {_SCALE:g}"
            )
        numbers = {"scale": scale, "correlation": fit.correlation}
        yield found("velocity_scale", name, subject.about_velocity, what=what, **numbers)


def scale_in_words(scale: float) -> str:
    """Return which units mixed up make a scale, in brackets; empty for none."""
    known = [u for factor, u in _FACTORS.items() if abs(scale / factor - 1.0) < _FACTOR_SLACK]
    return f" ({known[0]})" if known else ""
