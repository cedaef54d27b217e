"""Check that the points at which feet touch the ground rest while they do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid.experiment.inspection.delays.standing import Standing
from sdpid.experiment.inspection.finding import Finding, Subject, check, vector
from sdpid.experiment.inspection.floating import feet_checks
from sdpid.experiment.inspection.places.point_fit import (
    BETTER,
    SIZE,
    FootPoint,
    RestingFrame,
    foot_points,
    resting_frames,
)
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
    if any(finding.kind == "feet_exchanged" for finding in feet_checks.feet(subject)):
        return
    log = subject.longest
    standing, contacts = Standing.of(robot, log), log.contacts
    if standing is None or contacts is None:
        return
    others = resting_frames(standing, contacts)
    if others:
        yield _other_frames(others)
        return
    limit = max(_NOISES * standing.noise, _RESTS)
    for found in foot_points(standing, contacts):
        yield (
            _slips(contacts, found, limit) if found.left > limit else _other_point(contacts, found)
        )


def _other_frames(others: list[RestingFrame]) -> Finding:
    worst = max(others, key=lambda each: each.speed)
    pairs = "; ".join(
        f"{each.given} by {each.speed:.2g} m/s (rms), {each.resting} by {each.least:.2g}"
        for each in others
    )
    return Finding(
        severity="refuse",
        kind="contact_frame",
        message=(
            f"frames of contacts move while they are said to be down, and others behind them rest "
            f"(limit a factor of {BETTER:g}): {pairs}"
        ),
        remedy=f"give the contacts' frames as {', '.join(each.resting for each in others)}",
        numbers={"speed": worst.speed, "resting": worst.least},
    )


def _slips(contacts: Contacts, found: FootPoint, limit: float) -> Finding:
    names = ", ".join(contacts.frames[i] for i in found.feet)
    return Finding(
        kind="foot_moves",
        message=(
            f"{names}: no point rests while a foot is said to be down; the slowest moves by "
            f"{found.left:.2g} m/s (rms along an axis), limit {limit:.2g}: it slips"
        ),
        remedy="mark it as not down where it slips",
        numbers={"speed": found.left, "limit": limit},
    )


def _other_point(contacts: Contacts, found: FootPoint) -> Finding:
    stated = contacts.offset[list(found.feet)].mean(axis=0)
    names = ", ".join(contacts.frames[i] for i in found.feet)
    size = float(np.linalg.norm(found.change))
    told = f"(standard error {found.error:.2g} m, limit {SIZE:g} m)"
    if found.in_link:
        message = (
            f"{names}: the point that rests while a foot is down lies {vector(found.change)} m "
            f"from the stated one in the frame's axes {told}"
        )
        remedy = "give the frame of the foot; where there is none, add one to the description"
    else:
        message = (
            f"{names} touch the ground at {vector(stated + found.change)} m from the frame, "
            f"{size:.3g} m from the stated offset {vector(stated)}: that point rests while a foot "
            f"is down {told}"
        )
        remedy = f"give the contacts' offset={vector(stated + found.change)}"
    return Finding(
        kind="contact_point",
        message=message,
        remedy=remedy,
        numbers={"distance": size, "error": found.error, "limit": SIZE},
    )
