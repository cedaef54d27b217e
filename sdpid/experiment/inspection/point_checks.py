"""Check that the points at which feet touch the ground rest while they do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid.experiment.inspection import feet_checks
from sdpid.experiment.inspection.delays.standing import Standing
from sdpid.experiment.inspection.finding import Finding
from sdpid.experiment.inspection.kinds import found, vector
from sdpid.experiment.inspection.point_fit import (
    BETTER,
    SIZE,
    FootPoint,
    foot_points,
    resting_frames,
)
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.recording.floating.contacts import Contacts

# A point rests that is slower than so many times what noise makes, or than this (m/s): of
# simulated quadrupeds right points have 1.25 times the noise at most.
_NOISES, _RESTS = 1.5, 2e-3


@check
def points(subject: Subject) -> Iterator[Finding]:
    """Find contacts whose frame is not the foot's, or whose point is elsewhere."""
    robot = subject.floating
    if robot is None or not robot.free_flyer or subject.log.contacts is None or not subject.pieces:
        return
    if any(finding.kind == "feet_exchanged" for finding in feet_checks.feet_down(subject)):
        return
    log = subject.longest
    standing, contacts = Standing.of(robot, log), log.contacts
    if standing is None or contacts is None:
        return
    others = resting_frames(standing, contacts)
    if others:
        worst = max(others, key=lambda each: each.speed)
        pairs = "; ".join(
            f"{each.given} by {each.speed:.2g} m/s (rms), {each.resting} by {each.least:.2g}"
            for each in others
        )
        yield found(
            "contact_frame",
            pairs=pairs,
            frames=", ".join(each.resting for each in others),
            speed=worst.speed,
            resting=worst.least,
            limit=BETTER,
        )
        return
    limit = max(_NOISES * standing.noise, _RESTS)
    for point in foot_points(standing, contacts):
        names = ", ".join(contacts.frames[i] for i in point.feet)
        if point.left > limit:
            what = (
                f"{names}: no point rests while a foot is said to be down; the slowest moves by "
                f"{point.left:.2g} m/s (rms along an axis), limit {limit:.2g}: it slips"
            )
            yield found("foot_moves", what=what, speed=point.left, limit=limit)
        else:
            yield _other_point(contacts, names, point)


def _other_point(contacts: Contacts, names: str, point: FootPoint) -> Finding:
    stated = contacts.offset[list(point.feet)].mean(axis=0)
    size, offset = float(np.linalg.norm(point.change)), vector(stated + point.change)
    told = f"(standard error {point.error:.2g} m, limit {SIZE:g} m)"
    where = (
        f"touch the ground at {offset} m from the frame, {size:.3g} m from the stated offset "
        f"{vector(stated)}: that point rests while a foot is down {told}"
    )
    remedy = f"give the contacts' offset={offset}"
    if point.in_link:
        where = (
            f"rest, while down, at a point {vector(point.change)} m from the stated one in the "
            f"frame's axes {told}"
        )
        remedy = "give the frame of the foot; where there is none, add one to the description"
    numbers = {"distance": size, "error": point.error, "limit": SIZE}
    return found("contact_point", feet=names, where=where, remedy=remedy, **numbers)
