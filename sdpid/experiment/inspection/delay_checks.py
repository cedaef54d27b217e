"""Checks of channels that are late against each other."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.block_fit import SURE, beyond, orthonormal, pooled
from sdpid.experiment.inspection.delays import (
    DEVIATIONS,
    LEAST,
    channel_delays,
    delay_step,
    is_significant,
    lag,
)
from sdpid.experiment.inspection.kinds import KINDS, Finding, found, note, warning
from sdpid.experiment.inspection.rows import FilteredRows, friction
from sdpid.experiment.inspection.subject import Subject, check, check_of_efforts
from sdpid.experiment.processing.process import CHANNELS
from sdpid.experiment.recording.joints import FOLLOWS, two_encoders, unlike
from sdpid.experiment.recording.plausible import moving
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.model import RobotModel

_LATE = partial(warning, "{what}", "{remedy}", about="late")
KINDS.update(
    velocity_late=warning(
        "velocity of {joints} is {late} by up to {size:.3g ms} against the rate of the position, "
        "limit {limit:.3g ms}",
        "shift it, or leave the velocity out (velocity=none)",
        about="speed",
    ),
    effort_late=_LATE(excuses=True),
    imu_late=_LATE(),
    base_late=_LATE(),
    link_late=note("{what}", "{remedy}", about="late"),
    link_unlike=note(
        "position of the link of {joint} is off that of its motor by {share:.2g} of the motion, "
        "limit {limit:g}: it is of another joint, or in another unit",
        "leave it out: a joint without an encoder at its link repeats its position",
    ),
    # Forces that are late differ from those of their time.
    contacts_late=_LATE(hides=("forces_unlike_motion",)),
)

# Delays below this (s), and below this many samples, are the drives' own and those of filters: of
# 17 good recordings the efforts seem late by -13 to 12 ms.
_LEAST_DELAY, _LEAST_STEPS = 0.02, 1.5
# A delay of all efforts counts where it takes this share of the residual.
_TAKES = 0.1
# Rows slower than tanh of one width and a half are left out: stiction has delays of its own.
_MOVES = 0.9
# One joint alone may have a delay for other reasons, such as backlash.
_LEAST_JOINTS = 2
# It is late from this delay on (s), where a shift takes this share of what columns of any links
# leave; or this of what those leave and what the described links do, with delays this close (s). Of
# 116 joints of good recordings none is.
_LEAST_ALONE, _TAKES_ALONE, _ALSO_TAKES, _ALIKE = 0.025, 0.6, 0.5, 0.02
# Samples of encoders that are compared.
_READ = 200_000
# A delay is told that explains this share of what is between them.
_EXPLAINS = 0.1
# Directions of the regressor with less than this share of the largest singular value are noise.
_RANK = 1e-3
# Rows that are left beside the columns, at least.
_LEAST_ROWS = 24
_CORRELATED = 0.9


def _late(delay: float) -> str:
    return "late" if delay > 0.0 else "early"


@check("low_passed")
def late_velocities(subject: Subject, rows: FilteredRows) -> Iterator[Finding]:
    """Find recorded velocities that are late, or early, against the rate of the positions."""
    limit = max(_LEAST_DELAY, _LEAST_STEPS * rows.step)
    moves = moving(*subject.log.position_range)
    # Another signal has no delay; without recorded velocities there are no fits.
    lags = {
        name: -fit["lag"]
        for name, own, fit in zip(subject.log.names, moves, rows.velocity_fits, strict=False)
        if own and fit["correlation"] > _CORRELATED and abs(fit["lag"]) >= limit
    }
    if lags:
        worst = max(lags.values(), key=abs)
        joint = next(iter(lags)) if len(lags) == 1 else None
        words = {"joints": ", ".join(lags), "late": _late(worst)}
        numbers = {"size": abs(worst), "delay": worst, "limit": limit}
        yield found("velocity_late", joint, subject.about_velocity, **words, **numbers)


@check("longest")
def late_links(subject: Subject, log: Recording) -> Iterator[Finding]:
    """Find encoders at links that are late against those of motors, or follow other joints."""
    if log.link_position is None:
        return
    both = two_encoders(log)
    rows = slice(0, _READ)
    motor, link = np.asarray(log.position[rows]), np.asarray(log.link_position[rows])
    moves = moving(*subject.log.position_range)
    shares = unlike(motor, link)
    for j in np.flatnonzero(~both & moves & (shares >= FOLLOWS)).tolist():
        share = float(shares[j])
        yield found("link_unlike", log.names[j], share=share, limit=FOLLOWS)
    delay = lag(motor[:, both], link[:, both], log.step) if both.any() else None
    if delay is None or not (late := -delay.value) or abs(late) < SURE * delay.error:
        return
    difference = motor[:, both] - link[:, both]
    left = difference - late * np.gradient(motor[:, both], log.step, axis=0)
    share = 1.0 - float(np.mean(left.var(axis=0) / difference.var(axis=0)))
    if share < _EXPLAINS:
        return
    what = (
        f"encoders at links are {_late(late)} by {1e3 * abs(late):.3g} ms (error "
        f"{1e3 * delay.error:.2g} ms) against those at motors: that explains "
        f"{100.0 * share:.3g} % of what lies between them, which is then no elasticity"
    )
    speed, fits = "", subject.low_passed.velocity_fits if subject.low_passed else []
    if fits:
        size = -float(np.median([fits[j]["lag"] for j in np.flatnonzero(both)]))
        speed = f"; the recorded velocity is {_late(size)} by {1e3 * abs(size):.2g} ms"
    remedy = f"identify_elasticity takes this delay off by itself{speed}"
    numbers = {"delay": late, "error": delay.error, "share": share}
    yield found("link_late", what=what, remedy=remedy, **numbers)


@check_of_efforts("low_passed", "fixed")
def late_efforts(subject: Subject, rows: FilteredRows, robot: RobotModel) -> Iterator[Finding]:
    """Find efforts that are late, or early, against the motion: of all joints, or late ones of few.

    Of a single joint most is taken for friction or inertia: no more is told than that it is late.
    """
    if robot.n_base or subject.closed:
        return
    Y = robot.regressor(rows.position, rows.velocity, rows.acceleration)
    delays = effort_delays(rows, Y)
    limit = max(_LEAST_DELAY, _LEAST_STEPS * rows.step)
    # With a wrong sign or order nothing can be said of delays.
    right = subject.corrected is None or not subject.corrected.steps
    if right and len(delays) >= _LEAST_JOINTS:
        values, errors, takes = np.transpose([*delays.values()])
        delay, error = pooled(values, errors)
        if takes.mean() >= _TAKES and abs(delay) >= max(limit, SURE * error):
            what = (
                f"efforts are {_late(delay)} by {1e3 * abs(delay):.2g} ms or more against the "
                f"motion, limit {1e3 * limit:.2g} ms: of delays in simulated logs 62 to 80 % are "
                "told"
            )
            remedy = (
                "take both from one clock, or raise the delay in processing={'effort_delay_s': "
                f"{delay:.3f}}} while the error falls"
            )
            numbers = {"delay": delay, "error": error, "limit": limit}
            yield found("effort_late", what=what, remedy=remedy, **numbers)
            return
    described = effort_delays(rows, (Y @ robot.prior.ravel())[..., None])
    limit = max(_LEAST_ALONE, limit)
    alone = []
    for j, (delay, _, share) in delays.items():
        other, _, also = described.get(j, (0.0, 0.0, 0.0))
        both = min(share, also) >= _ALSO_TAKES and abs(delay - other) <= _ALIKE
        if delay >= limit and (share >= _TAKES_ALONE or both):
            alone.append((robot.joint_names[j], delay, share))
    for name, delay, share in alone if 2 * len(alone) <= len(delays) else ():
        what = (
            f"effort of {name} alone is late by {1e3 * delay:.2g} ms or more against the motion, "
            f"limit {1e3 * limit:.2g} ms: a shift takes {100 * share:.2g} % of what links and "
            "friction leave"
        )
        remedy = "take it from the clock of the others, or leave it out (without_effort)"
        numbers = {"delay": delay, "share": share, "limit": limit}
        yield found("effort_late", name, what=what, remedy=remedy, **numbers)


def effort_delays(rows: FilteredRows, links: Array) -> dict[int, tuple[float, float, float]]:
    """Return by how much each joint's effort is late, s, the standard error, and what that takes.

    An effort that is late by a little is the effort of the motion less its derivative times the
    delay. What columns of links (K, n, p) and friction leave of either is compared. They take a
    part of the delay: of six delays of 30 to 100 ms in three simulated logs 62 to 80 % are
    found.

    Returns
    -------
    dict of int to tuple of float
        The last is a share of the mean square that the columns leave. Without joints that move too
        little.
    """
    delays = {}
    for j in np.flatnonzero(rows.usable).tolist():
        keep = np.abs(rows.sign[:, j]) > _MOVES
        columns = np.column_stack([links[:, j], *friction(rows, j), np.ones(len(links))])[keep]
        if len(columns) < _LEAST_ROWS:
            continue
        basis, _ = orthonormal(columns, _RANK)
        effort, rate = (
            beyond(basis, each[keep, j])[:, None] for each in (rows.effort, rows.effort_rate)
        )
        step = delay_step(effort, -rate[..., None])
        if step is not None and len(columns) >= 2 * basis.shape[1] + _LEAST_ROWS:
            delay, error, left = step
            takes = 1.0 - float(np.sum(left**2) / np.sum(effort**2))
            delays[j] = delay.item(), error.item(), takes
    return delays


@check_of_efforts()
def late_channels(subject: Subject) -> Iterator[Finding]:
    """Find channels of a recording with a base that are late, or early, against the joints."""
    robot, log = subject.floating, subject.log
    if subject.base is None or subject.closed:
        return
    if subject.corrected is not None and subject.corrected.steps:
        return  # With a wrong sign or order nothing can be said of delays.
    if robot is not None and robot.free_flyer:
        delays, against = subject.delays(subject.without), "the joints' positions"
    else:
        delays, against = channel_delays(None, log), "the orientation of the base"
    for channel, (delay, error) in delays.items():
        if is_significant(channel, delays[channel]):
            limit = max(LEAST[channel], DEVIATIONS * error)
            what = (
                f"{CHANNELS[channel]} {'is' if channel == 'imu' else 'are'} {_late(delay)} by "
                f"{1e3 * abs(delay):.3g} ms (error {1e3 * error:.2g} ms) against {against}, limit "
                f"{1e3 * limit:.2g} ms"
            )
            remedy = (
                "identify takes this off by itself; elsewhere give processing="
                f"{{'{channel}_delay_s': {delay:.5f}}}, or record with one clock"
            )
            numbers = {"delay": delay, "error": error, "limit": limit}
            yield found(f"{channel}_late", what=what, remedy=remedy, **numbers)
