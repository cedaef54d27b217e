"""Checks of efforts against the dynamics of the description: signs, order, zeros, scale."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdpid.experiment.inspection.corrections import (
    CorrectedLog,
    Correction,
    Step,
    described,
    misfit,
    placeholders,
)
from sdpid.experiment.inspection.effort_checks import left_out
from sdpid.experiment.inspection.finding import Finding, Severity, Subject, check, exchanged

# Efforts beyond this many times the description's, either way, are in another unit: of six real
# arms they are 0.7 to 2.3 times.
_SCALE = 5.0
# The correlation with which one joint's efforts must follow, if its scale alone is to be told.
_FOLLOWS = 0.9
# Beyond this many times that of the other joints, a joint's scale is no matter of its description.
_FAR_SCALE = 20.0
# Units that are met, with the effort of 1 N·m in them.
_UNITS = {1000.0: "N·mm or mN·m", 100.0: "N·cm", 10.2: "kgf·cm or per cent", 0.001: "kN·m"}
_UNIT_SLACK = 2.5
# Changes of flags of contacts, which leave efforts as they are.
OF_FLAGS = ("feet_exchanged", "flags_unlike_motion")
# More than this share of the effort of a joint that carries its links, unexplained by the
# description, is no model of that joint: at most 0.4 on good recordings of real arms.
_UNLIKE = 0.6
# Springs and actuators that are named.
_NAMED = 3
_CARRIES = 0.05


def of_another_size(subject: Subject) -> list[Finding]:
    """Find joints whose effort is far below what the description's bodies need, mean included.

    Such efforts need not follow the motion: a lift carries its load at a steady force. Not told
    where half of the joints are such, where a joint's scale is known, or where what makes the
    efforts follow from the motion makes them large enough.
    """
    log, rows, found = subject.corrected, subject.low_passed, []
    if log is None or rows is None or subject.robot is None or placeholders(log.robot):
        return []
    given = replace(log, rows=rows, gravity=subject.robot.gravity)
    need, has = (np.sqrt(np.mean(each**2, axis=0)) for each in (given.rigid, rows.effort))
    small = rows.usable & (need > _SCALE * has)
    if not small.any() or 2 * small.sum() >= rows.usable.sum():
        return []
    mended = np.mean(log.rigid**2, axis=0) <= _SCALE**2 * np.mean(log.rows.effort**2, axis=0)
    told = {finding.joint for finding in scales(subject)}
    for j in np.flatnonzero(small & ~mended):
        name, unit = log.joint_names[j], "N" if log.robot.slides[j] else "N.m"
        if not told & {name, None}:
            message = (
                f"is {has[j]:.3g} {unit} (rms), and the description's bodies need {need[j]:.3g} "
                f"{unit}, {need[j] / has[j]:.3g} times as much (limit {_SCALE:g}): another unit, a "
                "counterweight or a spring"
            )
            numbers = {"effort": has[j], "needed": need[j], "limit": _SCALE}
            found.append(left_out("effort_small", name, message, **numbers))
    return found


@check
def not_compared(subject: Subject) -> Iterator[Finding]:
    """Say where efforts cannot be compared: of a free base, and of a description without masses."""
    robot, give = subject.robot, None
    if subject.closed:
        lacks = "has loops, in which unknown forces act"
    elif subject.floating is not None:
        if subject.corrected is not None:
            return
        lacks, give = "has a free base, and the log no contacts or too few samples", "contacts"
    elif robot is None or described(robot):
        return
    else:
        lacks, give = "has no masses", "a description with rough masses"
    yield Finding(
        severity="note",
        kind="effort_not_compared",
        message=(
            f"efforts are not compared with the motion, for the robot's description {lacks}: wrong "
            "signs, units and orders of columns are not found"
        ),
        remedy="check them by hand" + ("" if give is None else f", or give {give}"),
    )


@check
def left_out_of_the_model(subject: Subject) -> Iterator[Finding]:
    """Tell what acts on joints by the description, and is not in the model."""
    robot = subject.robot or subject.floating
    if robot is None:
        return
    if robot.forces:
        yield Finding(
            kind="forces_ignored",
            message=(
                f"the description has forces on joints that are not in the model: "
                f"{_some(robot.forces)}; they are taken for gravity, offsets and friction"
            ),
            remedy=(
                "take stiffness·(position − springref) off the recorded efforts of a joint with a "
                "spring, or leave it out (--without-effort)"
            ),
        )
    if robot.actuators:
        yield Finding(
            severity="note",
            kind="actuators_ignored",
            message=(
                "the description has actuators whose effort is not their control: "
                f"{_some(robot.actuators)}; efforts are read as the joints', whatever these are"
            ),
            remedy="log the efforts of joints (qfrc_actuator), not controls",
        )


def _some(words: tuple[str, ...]) -> str:
    """Return the first of some words."""
    more = f" and {len(words) - _NAMED} more" if len(words) > _NAMED else ""
    return f"{', '.join(words[:_NAMED])}{more}"


@check
def wrong_channels(subject: Subject) -> Iterator[Finding]:
    """Find wrong signs, zeros and orders of columns: what must be changed to make efforts fit."""
    log = subject.corrected
    if log is None:
        return
    order = np.arange(len(log.joint_names))
    for step in log.steps:
        change = step.change
        if change.kind == "joint_order":
            order = order[np.array(change.value, dtype=np.intp)]
    ordered = False
    for step in log.steps:
        if step.change.kind == "joint_order":
            if not ordered:
                value = tuple(float(i) for i in order)
                yield _finding(log, step, Correction(kind="joint_order", value=value))
            ordered = True
        else:
            yield _finding(log, step, step.change)


@check
def scales(subject: Subject) -> Iterator[Finding]:
    """Find efforts of the wrong scale, of all joints or of one."""
    log = subject.corrected
    if log is None:
        return
    found = log.gains
    names = log.joint_names
    common = found.common
    if common is None:
        return
    sizes = np.abs(found.gain)
    if not 1.0 / _SCALE < common < _SCALE:
        each = ", ".join(f"{names[j]} {sizes[j]:.3g}" for j in np.flatnonzero(found.shows))
        yield Finding(
            severity="warning" if placeholders(log.robot) else "refuse",
            kind="effort_scale",
            message=(
                f"efforts are {common:.3g} times what the description's bodies need ({each}), "
                f"limit {1.0 / _SCALE:g} to {_SCALE:g}: {_unit(common)}"
            ),
            remedy=_scale_remedy(common),
            numbers={"scale": common, "limit": _SCALE},
        )
    for j in np.flatnonzero(found.shows):
        ratio = sizes[j] / common
        if 1.0 / _SCALE < ratio < _SCALE or abs(found.correlation[j]) < _FOLLOWS:
            continue
        far = not 1.0 / _FAR_SCALE < ratio < _FAR_SCALE
        yield Finding(
            severity="refuse" if far and not placeholders(log.robot) else "warning",
            kind="effort_scale",
            joint=names[j],
            message=(
                f"effort of {names[j]} is {sizes[j]:.3g} times what the description's bodies "
                f"need, {ratio:.3g} times as much as at the other joints, limit {1.0 / _SCALE:g} "
                f"to {_SCALE:g}: {_unit(ratio)}"
            ),
            remedy=_scale_remedy(ratio),
            numbers={"scale": sizes[j], "ratio": ratio, "limit": _SCALE},
        )


@check
def unlike_the_description(subject: Subject) -> Iterator[Finding]:
    """Find efforts that the description does not explain, whatever is changed."""
    log = subject.corrected
    if log is None:
        return
    size = log.borne
    mended = {finding.joint for finding in scales(subject)}
    for j in np.flatnonzero((size > _CARRIES * size.max(initial=0.0)) & (log.left > _UNLIKE)):
        name = log.joint_names[j]
        if name in mended:
            continue
        share = min(float(log.left[j]), 1.0)
        yield Finding(
            kind="effort_unlike_description",
            joint=name,
            message=(
                f"effort of {name} does not follow from the motion: the description and friction "
                f"leave {100 * share:.3g} % of its variance unexplained, limit {100 * _UNLIKE:g} %"
            ),
            remedy="check the columns, the units, the mounting and the description of this joint",
            numbers={"unexplained": share, "limit": _UNLIKE},
        )


def _finding(log: CorrectedLog, step: Step, change: Correction) -> Finding:
    """Return the finding of one change that makes the efforts follow from the motion."""
    names = log.joint_names
    gained = misfit(step.before) - misfit(step.after)
    numbers = {"gained": gained}
    if change.joint is None:
        joints = [name for name, usable in zip(names, log.rows.usable, strict=True) if usable]
        before, after = (
            float(np.mean(each[log.rows.usable])) for each in (step.before, step.after)
        )
        of = f"the efforts' variance (mean of {len(joints)} joints)"
    else:
        worst = int(np.argmax(np.log(step.before + 0.01) - np.log(step.after + 0.01)))
        before, after = float(step.before[worst]), float(step.after[worst])
        own = worst == change.joint and change.kind == "effort_sign"
        of = "its variance" if own else f"the variance of the effort of {names[worst]}"
    numbers |= {"unexplained": before, "unexplained_mended": after}
    feet = log.feet
    what, remedy = _words(change, names, feet)
    same = dict.fromkeys(_words(each, names, feet)[0] for each in step.alike)
    others = [each for each in same if each != what][:3]
    also = f"; as good: {', or '.join(others)}" if others else ""
    # Signs of efforts are told by friction too, which takes power whatever the masses are.
    sure = change.kind in ("effort_sign", "position_sign") or not placeholders(log.robot)
    severity: Severity = "refuse" if sure and change.kind not in OF_FLAGS else "warning"
    return Finding(
        severity=severity,
        kind=change.kind,
        joint=None if change.joint is None else names[change.joint],
        message=(
            f"{what}: gravity, inertia and friction leave {100 * min(before, 1.0):.3g} % of {of} "
            f"unexplained, and {100 * after:.2g} % once that is mended{also}"
        ),
        remedy=remedy,
        numbers=numbers,
    )


def _words(change: Correction, names: tuple[str, ...], feet: tuple[str, ...]) -> tuple[str, str]:
    """Return what is wrong, and the remedy."""
    if change.kind == "feet_exchanged":
        return (
            f"flags of contacts are of other feet: {exchanged(feet, change.value)}",
            "give the contacts' frames in the order of their columns",
        )
    if change.kind == "flags_unlike_motion":
        return (
            "flags of contacts are wrong: feet bear the robot while they are said to be up",
            "lower their threshold, or widen contact_margin_s; fuse forces where they are measured",
        )
    of = "all joints" if change.joint is None else names[change.joint]
    if change.kind == "effort_sign":
        which = "the signs of all efforts" if change.joint is None else "its sign"
        return f"effort of {of} has the wrong sign", f"flip {which}"
    if change.kind == "position_sign":
        return f"position of {of} has the wrong sign", "flip its sign, and that of its velocity"
    if change.kind == "axis_sign":
        return (
            f"position and effort of {of} count the other way round than the description's axis",
            "flip the signs of both, or turn the axis in the description",
        )
    if change.kind == "position_zero":
        degrees = math.degrees(change.value[0])
        return (
            f"position of {of} has another zero than the description",
            f"add {degrees:+.0f}° ({change.value[0]:+.4f} rad)",
        )
    if change.kind == "position_in_degrees":
        return "positions look like degrees, not radians", "read with units={'position': 'deg'}"
    if change.kind == "gravity_direction":
        x, y, z = change.value
        return (
            f"gravity acts along ({x:.3g}, {y:.3g}, {z:.3g}) m/s² of the base, not as described",
            "give gravity= to load_robot, or mount the description's base as the robot's",
        )
    if change.kind == "joint_order":
        # Column k holds the joint whose place it takes when the order is put right.
        held = [names[list(change.value).index(k)] for k in range(len(names))]
        return (
            f"columns are in the order {', '.join(held)}",
            "name the columns so (joint_names), or put them in the robot's order",
        )
    held = [names[list(change.value).index(k)] for k in range(len(names))]
    return (
        f"columns of the efforts are in the order {', '.join(held)}",
        "name the effort columns one by one (columns)",
    )


def _unit(scale: float) -> str:
    """Return which unit makes efforts so many times too large."""
    for factor, unit in _UNITS.items():
        if 1.0 / _UNIT_SLACK < scale / factor < _UNIT_SLACK:
            return f"{unit} instead of N·m"
    if scale < 1.0:
        return "currents (A), torques of the motors before their gears, or another unit"
    return "another unit"


def _scale_remedy(scale: float) -> str:
    """Return how to give the unit of the efforts."""
    for factor, unit in ((1000.0, "mN.m"),):
        if 1.0 / _UNIT_SLACK < scale / factor < _UNIT_SLACK:
            return f"give the unit: units={{'effort': '{unit}'}} (--unit effort={unit})"
    return (
        "give N·m per unit of effort of each joint, torque constant times gear ratio: "
        f"effort_scale (--effort-scale), about {1.0 / scale:.3g} here; for currents 'sdpid gains' "
        "estimates it"
    )
