"""Check measured contact forces against the torques of the legs that bear them.

Forces are seen twice: by sensors, and by torques. Where both agree they are right up to a common
scale, for which the description's mass is asked.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.finding import Finding, Subject, check, exchanged, vector
from sdpid.experiment.inspection.forces.flag_checks import explained_log, follow_forces
from sdpid.experiment.inspection.forces.free_legs import FreeLegs, free_legs
from sdpid.experiment.inspection.forces.readings import BETTER, Reading, readings
from sdpid.experiment.inspection.forces.scales import Scale, common_scale, foot_scales

# Told from so many standard errors on, and beyond these: of 72 simulated logs of quadrupeds, links
# 15 % off their description, the common scale is up to 1.1 % off, that of a foot against all 2.7 %,
# an offset 0.9 % of the weight.
_SURE = 5.0
_APART, _ONE_APART, _OFFSET = 0.02, 0.04, 0.02
# Of moments six logs of a humanoid on soles are up to 3.6 % off, of their point 3 cm, 3 errors.
_MOMENTS_APART, _POINT = 0.1, 0.02
# With more than this no reading is right.
_UNLIKE = 0.1
# A foot that is up for fewer samples shows no offset in the air.
_LEAST_UP = 20
# What is measured in the air is the sensor's: within this share the offset that torques tell.
_SAME = 0.5


@check
def forces(subject: Subject) -> Iterator[Finding]:
    """Find measured forces of the wrong foot, axes, sign, scale or with an offset."""
    if explained_log(subject) is None or subject.floating is None or subject.samples is None:
        return
    legs = free_legs(subject.floating, subject.samples, subject.without)
    if legs is None:
        return
    given, best = readings(legs)
    if best.left > _UNLIKE:
        yield Finding(
            kind="forces_unlike_motion",
            message=(
                f"contact forces are not those of this motion: {100 * best.left:.3g} % of what the "
                f"legs' torques need beside their own links stays unexplained, limit "
                f"{100 * _UNLIKE:g} %, whatever feet and axes they are of"
            ),
            remedy="check that forces are in N and on time, and what their sensors hold",
            numbers={"unexplained": best.left, "limit": _UNLIKE},
        )
        return
    yield from _misread(subject, legs, given, best)
    wrenches = best.apply(legs)
    scales, of_moments = foot_scales(legs, wrenches)
    yield from _scales(legs, scales, legs.borne(wrenches[..., :3]), subject.total_mass)
    yield from _offsets(legs, scales, wrenches[..., :3])
    yield from _moments(legs, scales, of_moments)


def _misread(subject: Subject, legs: FreeLegs, given: Reading, best: Reading) -> Iterator[Finding]:
    """Tell of which feet and axes, and of which sign, forces are."""
    names = legs.frames
    better = (
        f"so read they leave {100 * best.left:.2g} % of what the legs' torques need beside their "
        f"own links, as given {100 * given.left:.3g} %, limit a factor of {BETTER:g}"
    )
    numbers = {"unexplained": given.left, "unexplained_mended": best.left, "limit": BETTER}
    if best.order != given.order:
        both = follow_forces(subject.log.contacts, subject.floating)
        yield Finding(
            kind="forces_exchanged",
            message=(
                f"contact forces{', and flags with them,' if both else ''} are of other feet: "
                f"{exchanged(names, best.order)}; {better}"
            ),
            remedy="give the contacts' frames in the order of their columns"
            if both
            else "put the columns of the forces in the order of the contacts' frames",
            numbers={**numbers, "flags": float(both)},
        )
    if best.axes != given.axes:
        own = "the base" if best.axes == "base" else "each foot's frame"
        yield Finding(
            kind="forces_axes",
            message=f"contact forces are in the axes of {own}, not in the world's: {better}",
            remedy="turn them into the world's axes: R @ force, R the rotation from those axes",
            numbers=numbers,
        )
    wrong = [names[j] for j, sign in zip(best.order, best.signs, strict=True) if sign < 0]
    if wrong:
        of = "" if len(wrong) == len(names) else f" of {', '.join(wrong)}"
        yield Finding(
            kind="forces_axes",
            message=f"contact forces{of} have the wrong sign: they are those on the ground",
            remedy="flip their signs: forces are those on the robot",
            numbers={"feet": float(len(wrong))},
        )


def _scales(
    legs: FreeLegs, scales: list[Scale], borne: float, weighed: float | None
) -> Iterator[Finding]:
    """Tell the scale of forces against torques, in common and foot by foot."""
    ratio, error = common_scale(scales)
    described = float(legs.robot.prior[:, 0].sum())
    mass = described if weighed is None else weighed
    who = "the description has" if weighed is None else "the robot weighs"
    borne *= described / mass
    limit = max(_APART, _SURE * error)
    if abs(ratio - 1.0) > limit:
        by_torques = borne / ratio
        carried = ""
        if legs.whole:
            # The nearer to what is known is the likelier.
            off = [abs(np.log(max(share, 1e-3))) for share in (borne, by_torques)]
            likely = "forces" if off[0] > off[1] else "torques"
            carried = (
                f"; forces carry {borne * mass:.4g} kg, torques {by_torques * mass:.4g} kg, {who} "
                f"{mass:.4g} kg, so that the {likely} are likelier wrong"
            )
        yield Finding(
            kind="forces_scale",
            message=(
                f"contact forces are {ratio:.4g} times (standard error {error:.2g}) those that the "
                f"legs' torques show, limit {1 - limit:.3g} to {1 + limit:.3g}{carried}"
            ),
            remedy="do not fuse these forces; weigh the robot, and give its mass (TotalMass)",
            numbers={"ratio": ratio, "error": error, "limit": limit},
        )
    if len(scales) < 2:
        return
    for foot, (name, scale) in enumerate(zip(legs.frames, scales, strict=True)):
        others, uncertain = common_scale([each for i, each in enumerate(scales) if i != foot])
        against = scale.ratio / others
        limit = max(_ONE_APART, _SURE * float(np.hypot(scale.error, uncertain)))
        if abs(against - 1.0) <= limit:
            continue
        yield Finding(
            kind="forces_scale",
            message=(
                f"contact forces of {name} are {against:.3g} times those of the other feet, by "
                f"their legs' torques, limit {1 - limit:.3g} to {1 + limit:.3g}"
            ),
            remedy="calibrate this sensor and the torques of its leg, or leave its forces out",
            numbers={"ratio": against, "limit": limit},
        )


def _offsets(legs: FreeLegs, scales: list[Scale], forces: Array) -> Iterator[Finding]:
    """Tell forces that are measured where there are none."""
    least = _OFFSET * legs.weight
    for foot, (name, scale) in enumerate(zip(legs.frames, scales, strict=True)):
        offset, errors = scale.shift, scale.shift_errors
        size = np.abs(offset)
        told = size > np.maximum(least, _SURE * errors)
        if not told.any():
            continue
        seen = (
            "while it is down; it is never up, so that torques with an offset would show the same"
        )
        up = ~legs.down[:, foot]
        if np.count_nonzero(up) >= _LEAST_UP:
            in_air = forces[up, foot].mean(axis=0)
            if np.linalg.norm(in_air - offset) > _SAME * np.linalg.norm(offset):
                continue  # Torques have it, not the sensor.
            seen = "up as down"
        axis = int(np.argmax(np.where(told, size, 0.0)))
        limit = max(least, _SURE * float(errors[axis]))
        yield Finding(
            kind="forces_offset",
            message=(
                f"contact forces of {name} are off by {vector(offset)} N in x, y, z "
                f"(standard errors {vector(errors)}, limit {limit:.3g} N in "
                f"{'xyz'[axis]}), {seen}"
            ),
            remedy="take it off, or zero the sensor while the foot is up",
            numbers={
                **{f"offset_{key}": value for key, value in zip("xyz", offset, strict=True)},
                "limit": limit,
            },
        )


def _moments(
    legs: FreeLegs, scales: list[Scale], of_moments: list[Scale | None]
) -> Iterator[Finding]:
    """Tell moments of soles of another scale than the forces, or about another point."""
    for name, scale, found in zip(legs.frames, scales, of_moments, strict=True):
        if found is None:
            continue
        # Of a sensor that is wrong as a whole the forces tell.
        ratio = found.ratio / scale.ratio
        limit = max(_MOMENTS_APART, _SURE * float(np.hypot(found.error, scale.error)))
        if abs(ratio - 1.0) > limit:
            sign = ": they have the wrong sign" if abs(ratio + 1.0) < limit else ""
            yield Finding(
                kind="wrenches_moments",
                message=(
                    f"moments of {name} are {ratio:.3g} times those that the legs' torques show, "
                    f"forces being right, limit {1 - limit:.3g} to {1 + limit:.3g}{sign}"
                ),
                remedy="give moments in N·m on the robot, in the world's axes",
                numbers={"ratio": ratio, "error": found.error, "limit": limit},
            )
        limits = np.maximum(_POINT, _SURE * found.shift_errors)
        if not np.any(np.abs(found.shift) > limits):
            continue
        yield Finding(
            kind="wrenches_point",
            message=(
                f"moments of {name} are about a point {vector(found.shift)} m from its frame's "
                f"origin, in the world's axes (standard errors {vector(found.shift_errors)}, "
                f"limits {vector(limits)})"
            ),
            remedy="give moments about the origin of the contact's frame, or the sensor's frame",
            numbers={
                **{f"point_{key}": value for key, value in zip("xyz", found.shift, strict=True)},
                "limit": _POINT,
            },
        )
