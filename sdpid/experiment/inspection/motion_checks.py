"""Checks of time stamps, positions, velocities and references."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from sdpid.experiment.inspection.kinds import KINDS, Finding, found, note, refuse, warning
from sdpid.experiment.inspection.rows import FilteredRows, follows
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.recording.gaps import MAX_GAP_STEPS, told_clock
from sdpid.experiment.recording.plausible import AT_REST, moving, suspect_units, turning_limits
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.stored import middle

KINDS.update(
    units=note("{note}"),
    recording=note("{note}"),
    time_unit=refuse("{seen}", "{remedy}", hides=("speed",), spoils=True),
    jitter=note(
        "time stamps jitter by {jitter:.3g %} of a step of {step:.4g} s (rms), limit {limit:g %}",
        "stamp samples where they are measured",
    ),
    clock_jitter=note(
        "rows were read {jitter:.2g ms} (rms) from their stamps, and {repeats:.3g %} repeat "
        "others: steps of {joints} are {missed:.2g %} off their speeds times steps of the stamps, "
        "and {left:.2g %} at times that the speeds of other joints tell",
        "processing takes those times; stamp samples where they are measured",
    ),
    lost_samples=warning(
        "{lost} of {all} samples ({share:.3g %}) are missing between the others, limit {limit:g %}",
        "log with a larger buffer, or at a lower rate",
    ),
    repeated_rows=warning(
        "{rows} of {all} rows ({share:.3g %}) repeat the row before in every position and effort, "
        "limit {limit:g %}: the log is written faster than the robot measures",
        "remove the repeated rows, or log at the robot's rate",
    ),
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
        # They raise most of the other alarms as well.
        hides=("everything",),
        spoils=True,
        about="log",
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
    velocity_unlike=note(
        "velocity of {joint} is no rate of its position: {scale:.4g} times it, limit {least:g} to "
        "{limit:g}, where those of {others} joints are within {close:g %}",
        "leave the velocity out (velocity=differentiated)",
        about="speed",
    ),
    reference_unlike=note(
        "reference of {wrong}",
        "name its column, unit or joints, or leave it out (reference=none); fits that simulate the "
        "controller would be wrong",
        about="speed",
    ),
)

# What is looked at of longer recordings is this many rows from the middle.
_COMPARED = 100_000
# A row is repeated where no position and no effort changes. More repeats than these in a row are
# rest; a logger that runs faster than the robot makes fewer, many times.
_MOST_REPEATS, _REPEATED = 20, 0.02
# Slower or faster, in Hz, no controller logs; stamps in ms that are read as seconds do, and stamps
# in seconds that are read as ms. The fastest logs of drives have 20 kHz.
_LEAST_RATE, _FASTEST_RATE = 2.0, 25e3
# Logs of 5 kHz, too, whose stamps in ms are read as seconds: below this rate some joint must be
# faster than this (rad/s, or m/s). Excitations reach fifty times as much.
_SLOW_RATE, _LEAST_SPEED = 25.0, 0.02
# Stamps that are off a regular clock by this part of a step jitter. More than this share of lost
# samples is no accident.
_JITTER, _LOST = 0.05, 0.05
# Seconds in the units of stamps that may be read as seconds.
_UNITS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_GIVE_UNIT = "give the unit: units={'time': 's'} (--unit time=s), or ms, us, ns"
# No joint of an arm turns faster (rad/s); the fastest reach some 15.
_FASTEST = 40.0
# An encoder that is read late repeats its position for less than this (s), and then catches up; one
# of few digits for any time, and then changes by a step of about its usual size. Either took the
# time since the last change.
_STALE, _ROUNDED = 0.1, 1.5
# A joint that moves less than this part of its way back moves in one direction.
_BACK = 0.02
# The whole robot rests below this speed (rad/s, or m/s). Rows at rest are masked by default, so a
# recording that rests longer has less to say than its length promises.
_RESTING, _LONGEST_REST = 0.005, 0.3
# Two signals belong together when they correlate like this, and differ in their units when the
# scale between them is off by this factor: filters explain less. On six simulated arms fits of a
# reference to its own joint correlate by more than 0.999, to another one by less than 0.75.
_CORRELATED, _SCALE = 0.9, 1.3
# A velocity is this far off where those of two joints and of half of all are this close: by up to
# 0.4 % on good recordings, by 4.4 to 18 % at three joints of a surgical robot's master.
_OFF, _ALIKE, _LEAST_ALIKE = 0.04, 0.015, 2
_LIMITS = f"limit {1.0 / _SCALE:.2g} to {_SCALE:g}"
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
# What is left between them once the effort that gravity and friction need is accounted for
# (rad, or m).
_OFFSET = 0.1
# Positions do not come before their references (s); clocks and filters account for a few samples.
_EARLIEST = -0.02


@check()
def units_of_time(subject: Subject) -> Iterator[Finding]:
    """Say where the unit of time was inferred, and find rates of no robot's logger."""
    log, rate, rows = subject.log, subject.log.rate_hz, subject.low_passed
    for text in log.notes:
        if text.startswith("time:"):
            remedy = f"where that is wrong, {_GIVE_UNIT}"
            yield found("time_unit", None, "note", seen=text, remedy=remedy, rate=rate)
        else:
            # Else of who made the recording, such as a simulator.
            yield found("units" if text.startswith("units:") else "recording", note=text)
    numbers = {"rate": rate}
    if not _LEAST_RATE <= rate <= _FASTEST_RATE:
        seen = f"a sample every {log.step:.6g} s is a rate of {rate:.3g} Hz, limit "
        seen += f"{_LEAST_RATE:g} to {_FASTEST_RATE:g} Hz"
        numbers["limit"] = _LEAST_RATE if rate < _LEAST_RATE else _FASTEST_RATE
    elif rate < _SLOW_RATE and rows is not None and np.abs(rows.velocity).max() < _LEAST_SPEED:
        numbers |= {"speed": float(np.abs(rows.velocity).max()), "limit": _LEAST_SPEED}
        seen = f"at {rate:.3g} Hz no joint is faster than {numbers['speed']:.2g} rad/s, limit "
        seen += f"{_LEAST_SPEED:g} rad/s"
    else:
        return
    cause, remedy = _read_as_seconds(rate)
    yield found("time_unit", seen=f"time: {seen}: {cause}", remedy=remedy, **numbers)


def _read_as_seconds(rate: float) -> tuple[str, str]:
    """Return in which unit stamps are that make so low a rate as seconds, and how to give it."""
    if rate > _FASTEST_RATE:
        return "the stamps may be in s, and were read as ms, us or ns", _GIVE_UNIT
    rates = {unit: rate / seconds for unit, seconds in _UNITS.items()}
    likely = {unit: hz for unit, hz in rates.items() if _LEAST_RATE <= hz <= _FASTEST_RATE}
    if not likely:
        return "in no unit do the stamps make a rate of a robot", "give time stamps in s"
    words = " or ".join(f"{unit} ({hz:.4g} Hz)" for unit, hz in likely.items())
    units = [f"units={{'time': '{unit}'}} (--unit time={unit})" for unit in likely]
    certain = "must be" if len(likely) == 1 else "may be"
    return f"the stamps {certain} in {words}", f"give the unit: {' or '.join(units)}"


@check()
def jitter_and_losses(subject: Subject) -> Iterator[Finding]:
    """Find stamps off a regular clock, and samples that were lost."""
    log, part = subject.log, middle(subject.log.n_samples, _COMPARED)
    steps = np.diff(np.asarray(log.time[part])) / log.step
    jitter = float(np.sqrt(np.mean((steps - np.rint(steps)) ** 2)))
    if jitter > _JITTER:
        yield found("jitter", jitter=jitter, step=log.step, limit=_JITTER)
    # Longer steps are gaps, at which the recording is split.
    few = np.rint(steps[steps < MAX_GAP_STEPS])
    lost = int(np.maximum(few - 1.0, 0.0).sum())
    every = steps.size + lost
    if lost / every > _LOST:
        yield found("lost_samples", lost=lost, all=every, share=lost / every, limit=_LOST)


@check()
def jitter_of_reading(subject: Subject) -> Iterator[Finding]:
    """Find regular stamps of rows that were read at other times, which speeds tell."""
    if (clock := told_clock(subject.log)) is not None:
        names = ", ".join(subject.log.names[j] for j in clock.joints)
        numbers = {key: getattr(clock, key) for key in ("jitter", "repeats", "missed", "left")}
        yield found("clock_jitter", joints=names, **numbers)


@check()
def repeated_rows(subject: Subject) -> Iterator[Finding]:
    """Find rows that repeat the row before, as loggers write that run faster than the robot."""
    log, part = subject.log, middle(subject.log.n_samples, _COMPARED)
    values = np.hstack([np.asarray(log.position[part]), np.asarray(log.effort[part])])
    changed = np.flatnonzero((values[1:] != values[:-1]).any(axis=1))
    runs = np.diff(changed, prepend=-1, append=len(values) - 1) - 1
    repeats = int(runs[runs <= _MOST_REPEATS].sum())
    share = repeats / len(values)
    if share > _REPEATED:
        yield found("repeated_rows", rows=repeats, all=len(values), share=share, limit=_REPEATED)


@check()
def degrees(subject: Subject) -> Iterator[Finding]:
    """Find positions in degrees."""
    robot = subject.fixed
    limits = None if robot is None else turning_limits(robot)
    suspects = suspect_units(subject.log, limits)
    if suspects:
        yield found("position_in_degrees", seen=f": {', '.join(suspects)}", mended="")


@check()
def rest_and_jumps(subject: Subject) -> Iterator[Finding]:
    """Find joints that never move, and positions that jump."""
    low, high = subject.log.position_range
    robot = subject.robot
    gears = np.ones(subject.log.n) if robot is None else robot.gears[robot.n_base :]
    for j, (name, reach) in enumerate(zip(subject.log.names, (high - low).tolist(), strict=True)):
        # A joint without a motor moves as far as its loop moves it: nobody can excite it.
        if reach < AT_REST and name not in subject.passive:
            moved = "never moves" if reach == 0.0 else f"moves by {reach:.3g} rad only"
            yield found("joint_at_rest", name, moved=moved, range=reach, limit=AT_REST)
            continue
        # Motors are as much faster as their gears make the joints slower.
        limit = _FASTEST * float(gears[j])
        steps = [_fastest_step(piece, j, limit) for piece in subject.pieces]
        speed, jump, time = max(steps, default=(0.0, 0.0, 0.0))
        if speed > limit:
            numbers = {"jump": jump, "size": abs(jump), "row": subject.row(time), "speed": speed}
            yield found("position_jumps", name, limit=limit, **numbers)


def _fastest_step(piece: Recording, j: int, limit: float) -> tuple[float, float, float]:
    """Return speed and size of a joint's fastest step, and when it ends; 0 if none is too fast."""
    time = np.asarray(piece.time)
    steps, durations = np.diff(piece.position[:, j]), np.diff(time)
    if not np.any(np.abs(steps) > limit * durations):
        return 0.0, 0.0, 0.0
    rows = np.flatnonzero(steps)
    waited = np.diff(time[rows + 1], prepend=time[0])
    sizes = np.abs(steps[rows])
    late = (waited < _STALE) | (sizes <= _ROUNDED * np.median(sizes))
    speeds = sizes / np.where(late, waited, durations[rows])
    k = int(speeds.argmax())
    return float(speeds[k]), float(steps[rows[k]]), float(time[rows[k] + 1])


@check("low_passed")
def directions_and_rest(subject: Subject, rows: FilteredRows) -> Iterator[Finding]:
    """Find joints that move in one direction only, and recordings that mostly stand still."""
    names = subject.log.names
    forth, back = (np.maximum(sign * rows.velocity, 0.0).sum(axis=0) for sign in (1.0, -1.0))
    shares = np.minimum(forth, back) / np.maximum(forth + back, 1e-300)
    one_way = np.flatnonzero(moving(*subject.log.position_range) & (shares < _BACK)).tolist()
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


@check("low_passed")
def velocities(subject: Subject, rows: FilteredRows) -> Iterator[Finding]:
    """Find velocities that are not the rate of the positions, and stamps that run wrong."""
    fast = np.sqrt(np.mean(rows.velocity**2, axis=0)) >= _LEAST_SPEED
    # Without recorded velocities there are no fits.
    told = zip(subject.log.names, fast, rows.velocity_fits, strict=False)
    fits = {name: fit for name, moves, fit in told if moves and fit["correlation"] >= _CORRELATED}
    scales = np.array([fit["scale"] for fit in fits.values()])
    common = float(np.median(scales)) if len(scales) > 1 else 1.0
    share = float(np.mean(np.abs(scales / common - 1.0) < _CLOSE)) if len(scales) else 0.0
    wrong = common > 0.0 and not 1.0 / _CLOCK < common < _CLOCK
    if wrong and share >= _MOST and not scale_in_words(common):
        yield found("time_scale", scale=common, share=share, least=1.0 / _CLOCK, limit=_CLOCK)
        return
    alike = np.abs(scales - 1.0) < _ALIKE
    agreed = alike.sum() >= max(_LEAST_ALIKE, 0.5 * len(scales))
    for name, fit in fits.items():
        scale, what = fit["scale"], "has the sign opposite to the rate of its position"
        if 1.0 / _SCALE < scale < _SCALE:
            if agreed and abs(scale - 1.0) > _OFF:
                numbers = {"scale": scale, "least": 1.0 - _OFF, "limit": 1.0 + _OFF}
                others = int(alike.sum())
                yield found("velocity_unlike", name, **numbers, others=others, close=_ALIKE)
            continue
        if scale > 0.0:
            what = (
                f"is {scale:.3g} times the rate of its position{scale_in_words(scale)}, {_LIMITS}"
            )
        numbers = {"scale": scale, "correlation": fit["correlation"]}
        yield found("velocity_scale", name, subject.about_velocity, what=what, **numbers)


def scale_in_words(scale: float) -> str:
    """Return which units mixed up make a scale, in brackets; empty for none."""
    known = [u for factor, u in _FACTORS.items() if abs(scale / factor - 1.0) < _FACTOR_SLACK]
    return f" ({known[0]})" if known else ""


@check("low_passed")
def references(subject: Subject, rows: FilteredRows) -> Iterator[Finding]:
    """Find references that the positions do not follow.

    What a proportional controller lags behind for its effort is accounted for: a slow loop is no
    wrong reference.
    """
    if rows.recorded_reference is None:
        return
    motion = list(zip(rows.position.T, rows.velocity.T, rows.effort.T, strict=True))
    wrong, numbers = {}, {}
    for j in np.flatnonzero(moving(*subject.log.position_range)).tolist():
        name, reference = subject.log.names[j], rows.recorded_reference[:, j]
        fit = follows(reference, *motion[j])
        what = _unlike(fit)
        if fit["correlation"] < _CORRELATED:
            others = [follows(reference, *other)["correlation"] for other in motion]
            best = int(np.argmax(others))
            if others[best] > _CORRELATED:
                followed = subject.log.names[best]
                what = f"is followed by {followed} (correlation {others[best]:.3g})"
        if what:
            wrong[name], numbers[name] = what, fit
    if not wrong:
        return
    # Joints mostly share the defect: columns that are swapped, a unit, another signal.
    told = "; of ".join(f"{name} {what}" for name, what in wrong.items())
    if len(wrong) == 1:
        ((name, fit),) = numbers.items()
        yield found("reference_unlike", name, wrong=told, **fit)
    else:
        every = {f"{name}: {key}": x for name, fit in numbers.items() for key, x in fit.items()}
        yield found("reference_unlike", wrong=told, **every)


def _unlike(fit: dict[str, float]) -> str:
    """Return what is wrong with a joint's reference, in words; empty for nothing."""
    scale, offset, lag = fit["scale"], fit["offset"], fit["lag"]
    if fit["correlation"] < _CORRELATED:
        return f"is not followed (correlation {fit['correlation']:.2f}, limit {_CORRELATED:g})"
    if not 1.0 / _SCALE < scale < _SCALE:
        return f"is {scale:.3g} times the position{scale_in_words(scale)}, {_LIMITS}"
    if abs(offset) > _OFFSET:
        return f"is {offset:.3g} rad off the position on average, limit {_OFFSET:g}"
    if lag < _EARLIEST:
        return f"comes {-lag:.3g} s after the motion, limit {-_EARLIEST:g}: it is no command"
    return ""
