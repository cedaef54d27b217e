"""Checks of efforts against the dynamics of the description: signs, order, zeros, scale."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from sdpid.experiment.inspection.block_fit import block_fit
from sdpid.experiment.inspection.explain import (
    Correction,
    CorrectionStep,
    ExplainedLog,
    described,
    misfit,
)
from sdpid.experiment.inspection.kinds import (
    KINDS,
    Finding,
    exchanged,
    found,
    left_out,
    note,
    refuse,
    warning,
    words,
)
from sdpid.experiment.inspection.rows import FilteredRows
from sdpid.experiment.inspection.subject import Subject, check, check_of_efforts
from sdpid.robot.model.model import RobotModel

KINDS.update(
    effort_small=left_out(
        "effort of {joint} is {effort:.3g} {unit} (rms), and the description's bodies need "
        "{needed:.3g} {unit}, {ratio:.3g} times as much (limit {limit:g}): another unit, a "
        "counterweight or a spring",
    ),
    effort_spoils=left_out(
        "effort of {joint} contradicts the others, whose errors fall to {share:.2f} without it "
        "(limit {limit:g}); with it {why}",
    ),
    forces_ignored=warning(
        "the description has forces on joints that are not in the model: {what}; they are taken "
        "for gravity, offsets and friction",
        "take stiffness·(position − springref) off the recorded efforts of a joint with a spring, "
        "or leave it out (--without-effort)",
    ),
    actuators_ignored=note(
        "the description has actuators whose effort is not their control: {what}; efforts are read "
        "as the joints', whatever these are",
        "log the efforts of joints (qfrc_actuator), not controls",
    ),
    effort_not_compared=note(
        "efforts are not compared with the motion, for the robot's description {lacks}: wrong "
        "signs, units and orders of columns are not found",
        "check them by hand{give}",
    ),
    effort_sign=refuse(
        "effort of {of} has the wrong sign{mended}",
        "flip {its}: signs in [motors] of a mapping, with applies_to = ['effort']",
    ),
    position_sign=refuse(
        "position of {of} has the wrong sign{mended}",
        "flip its sign, and that of its velocity: signs in [motors] of a mapping, with applies_to "
        "= ['position', 'velocity', 'reference']",
        hides=("feet",),
    ),
    axis_sign=refuse(
        "position and effort of {of} count the other way round than the description's axis{mended}",
        "flip the signs of both (signs in [motors] of a mapping), or turn the axis in the "
        "description",
        hides=("feet",),
    ),
    position_zero=refuse(
        "position of {of} has another zero than the description{mended}",
        "add {add:+.0f °} ({add:+.4f} rad): offsets in [motors] of a mapping",
        hides=("feet",),
    ),
    gravity_direction=refuse(
        "gravity acts along {gravity} m/s² of the base, not as described{mended}",
        "give gravity= to load_robot, or mount the description's base as the robot's",
    ),
    joint_order=refuse(
        "columns are in the order {held}{mended}",
        "name the columns so (joint_names), or put them in the robot's order",
        hides=("feet",),
    ),
    effort_order=refuse(
        "columns of the efforts are in the order {held}{mended}",
        "name the effort columns one by one (columns)",
    ),
    flags_unlike_motion=warning(
        "flags of contacts are wrong: feet bear the robot while they are said to be up{mended}",
        "lower their threshold, or widen contact_margin_s; fuse forces where they are measured",
        about="flags",
    ),
    feet_exchanged=warning(
        "flags of contacts are of other feet: {feet}{mended}",
        "give the contacts' frames in the order of their columns",
        hides=("flags",),
        about="feet",
    ),
    effort_scale=refuse(
        "{whose} times {of}, limit {least:g} to {limit:g}: {unit}",
        "{remedy}",
        hides=("forces",),
    ),
    effort_unlike_description=warning(
        "effort of {joint} does not follow from the motion: the description and friction leave "
        "{unexplained:.3g %} of its variance unexplained, limit {limit:g %}",
        "check the columns, the units, the mounting and the description of this joint; with a "
        "spring or a counterweight leave its effort out (without_effort)",
        hides=("forces",),
    ),
    payload_differs=refuse(
        "it carries another load than recording 1: {mass:+.3g} kg (standard error {error:.2g} kg) "
        "on the last link, with a first moment of {moment:.2g} kg·m, takes {takes:.2g %} of the "
        "residual of both, limit {limit:g %}",
        "fit each load by itself, or identify the load with sdpid payload --without",
    ),
)

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
# More than this share of the effort of a joint that carries its links, unexplained by the
# description, is no model of that joint: at most 0.4 on good recordings of real arms.
_UNLIKE = 0.6
# Springs and actuators that are named.
_NAMED = 3
_CARRIES = 0.05
# Another load on the last link takes this share of the squared residuals of two recordings where
# there is one: 0.71 to 0.90 of 14 pairs of a UR10e with and without 2.8 kg, at most 0.09 of 21
# pairs of recordings without.
_TAKES, _TAKES_SURELY = 0.2, 0.4
# The arm's own parameters may differ from the description by this share of a link's mass (kg), its
# first moment at that many m, and its inertia at that many m²; neighboring rows are alike, so that
# their errors count for three times as large.
_BELIEF, _LARGER = (0.5, *3 * (0.1,), *6 * (0.02,)), 3.0
_LEAST_MASS = 0.1
# Friction, offsets and the load are free: nothing is as large.
_FREE = 1e3
# Passes in which the joints' residuals weigh their rows.
_PASSES = 3
# Mass and first moment of the load, of ten inertial parameters of the last link.
_LOAD = 4


def placeholders(robot: RobotModel) -> bool:
    """Return whether most bodies of a description are alike: made up, not measured."""
    bodies = robot.prior[robot.prior[:, 0] > 0.0]
    _, counts = np.unique(bodies[:, [0, 4, 6, 9]].round(9), axis=0, return_counts=True)
    return len(bodies) > 2 and 2 * int(counts.max()) > len(bodies)


@check_of_efforts("corrected", "low_passed", "fixed")
def of_another_size(
    subject: Subject, log: ExplainedLog, rows: FilteredRows, robot: RobotModel
) -> Iterator[Finding]:
    """Find joints whose effort is far below what the description's bodies need, mean included.

    Such efforts need not follow the motion: a lift carries its load at a steady force. Not told
    where half of the joints are such, where a joint's scale is known, or where what makes the
    efforts follow from the motion makes them large enough.
    """
    if placeholders(robot):
        return
    rigid = robot.described_efforts(rows.position, rows.velocity, rows.acceleration)
    need, has, needs, gives = (
        np.sqrt(np.mean(each**2, axis=0))
        for each in (rigid, rows.effort, log.rigid, log.signals["effort"])
    )
    small = rows.usable & (need > _SCALE * has)
    if 2 * small.sum() >= rows.usable.sum():
        return
    told = {finding.joint for finding in scales(log)}
    for j in np.flatnonzero(small & (needs > _SCALE * gives)):
        name, ratio = robot.joint_names[j], need[j] / has[j]
        if not told & {name, None}:
            numbers = {"effort": has[j], "needed": need[j], "ratio": ratio, "limit": _SCALE}
            yield found("effort_small", name, unit="N" if robot.slides[j] else "N.m", **numbers)


@check_of_efforts()
def not_compared(subject: Subject) -> Iterator[Finding]:
    """Say where efforts cannot be compared: of a free base, and of a description without masses."""
    give = ""
    if subject.closed:
        lacks = "has loops, in which unknown forces act"
    elif subject.corrected is not None or subject.robot is None:
        return
    elif subject.floating is not None:
        lacks = "has a free base, and the log no contacts or too few samples"
        give = ", or give contacts"
    elif not described(subject.robot):
        lacks, give = "has no masses", ", or give a description with rough masses"
    else:
        return
    yield found("effort_not_compared", lacks=lacks, give=give)


@check()
def left_out_of_the_model(subject: Subject) -> Iterator[Finding]:
    """Tell what acts on joints by the description, and is not in the model."""
    for kind in ("forces", "actuators"):
        names = getattr(subject.robot, kind, ())
        if names:
            more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
            yield found(f"{kind}_ignored", what=f"{', '.join(names[:_NAMED])}{more}")


@check_of_efforts("corrected")
def wrong_channels(subject: Subject, log: ExplainedLog) -> Iterator[Finding]:
    """Find wrong signs, zeros and orders of columns: what must be changed to make efforts fit."""
    steps: dict[Any, CorrectionStep] = {}
    for step in log.steps:
        kind, _, value = step.change
        # Several orders of columns, one after another, are one.
        key = kind if kind.endswith("_order") else step.change
        if key in steps:
            first, order = steps[key], steps[key].change.value
            change = first.change._replace(value=tuple(order[int(j)] for j in value))
            step = first._replace(change=change, after=step.after)
        steps[key] = step
    for step in steps.values():
        yield _finding(log, step)


@check_of_efforts("corrected")
def scales_and_shares(subject: Subject, log: ExplainedLog) -> Iterator[Finding]:
    """Find efforts of the wrong scale, or that the description does not explain at all."""
    told = list(scales(log))
    yield from told
    carries = log.borne > _CARRIES * log.borne.max(initial=0.0)
    for j in np.flatnonzero(carries & (log.left > _UNLIKE)):
        name = log.joint_names[j]
        if name not in {finding.joint for finding in told}:
            unexplained = min(float(log.left[j]), 1.0)
            yield found("effort_unlike_description", name, unexplained=unexplained, limit=_UNLIKE)


def scales(log: ExplainedLog) -> Iterator[Finding]:
    """Yield which efforts have the wrong scale, all of them or those of one joint."""
    gains, common, names = log.gains, log.gains.common, log.joint_names
    if common is None:
        return
    sizes, shows, made_up = np.abs(gains.gain), np.flatnonzero(gains.shows), placeholders(log.robot)
    need, limits = "what the description's bodies need", {"least": 1.0 / _SCALE, "limit": _SCALE}
    if not 1.0 / _SCALE < common < _SCALE:
        each = ", ".join(f"{names[j]} {sizes[j]:.3g}" for j in shows)
        fields = {"whose": f"efforts are {common:.3g}", "of": f"{need} ({each})", "scale": common}
        fields |= _unit(common)
        yield found("effort_scale", None, "warning" if made_up else None, **fields, **limits)
    for j in shows:
        ratio = sizes[j] / common
        if 1.0 / _SCALE < ratio < _SCALE or abs(gains.correlation[j]) < _FOLLOWS:
            continue
        minor = made_up or 1.0 / _FAR_SCALE < ratio < _FAR_SCALE
        fields = {"whose": f"effort of {names[j]} is {sizes[j]:.3g}", "scale": sizes[j]}
        fields |= {"of": f"{need}, {ratio:.3g} times as much as at the other joints"}
        fields |= {"ratio": ratio, **_unit(ratio)}
        yield found("effort_scale", names[j], "warning" if minor else None, **fields, **limits)


def _unit(scale: float) -> dict[str, str]:
    """Return which unit makes efforts so many times too large, and how to give it."""
    near = (u for f, u in _UNITS.items() if 1.0 / _UNIT_SLACK < scale / f < _UNIT_SLACK)
    unit, remedy = next(near, ""), "give the unit: units={'effort': 'mN.m'} (--unit effort=mN.m)"
    if unit != _UNITS[1000.0]:
        remedy = (
            "give N·m per unit of effort of each joint, torque constant times gear ratio: "
            f"effort_scale (--effort-scale), about {1.0 / scale:.3g} here; for currents 'sdpid "
            "gains' estimates it"
        )
    motors = "currents (A), torques of the motors before their gears, or " if scale < 1.0 else ""
    return {
        "unit": f"{unit} instead of N·m" if unit else f"{motors}another unit",
        "remedy": remedy,
    }


def _finding(log: ExplainedLog, step: CorrectionStep) -> Finding:
    """Return the finding of one change that makes the efforts follow from the motion."""
    change, usable, names = step.change, log.usable, log.joint_names
    joint = change.joint
    if joint is None:
        before, after = (float(np.mean(each[usable])) for each in (step.before, step.after))
        of = f"the efforts' variance (mean of {np.count_nonzero(usable)} joints)"
    else:
        worst = int(np.argmax(np.log(step.before + 0.01) - np.log(step.after + 0.01)))
        before, after = float(step.before[worst]), float(step.after[worst])
        own = worst == joint and change.kind == "effort_sign"
        of = "its variance" if own else f"the variance of the effort of {names[worst]}"
    what, *same = (
        words(each.kind, mended="", **_fields(each, log)) for each in (change, *step.alike)
    )
    others = [each for each in dict.fromkeys(same) if each != what][:3]
    also = f"; as good: {', or '.join(others)}" if others else ""
    # Signs of efforts are told by friction too, which takes power whatever the masses are.
    sure = change.kind in ("effort_sign", "position_sign") or not placeholders(log.robot)
    return found(
        change.kind,
        None if joint is None else names[joint],
        None if sure else "warning",
        mended=f": gravity, inertia and friction leave {100 * min(before, 1.0):.3g} % of {of} "
        f"unexplained, and {100 * after:.2g} % once that is mended{also}",
        gained=misfit(step.before) - misfit(step.after),
        unexplained=before,
        unexplained_mended=after,
        **_fields(change, log),
    )


def _fields(change: Correction, log: ExplainedLog) -> dict[str, Any]:
    """Return what words of a change are filled with."""
    kind, joint, value = change
    names = log.joint_names
    if kind == "feet_exchanged" and log.contacts is not None:
        return {"feet": exchanged(log.contacts.frames, value)}
    if kind.endswith("_order"):
        # Column k holds the joint whose place it takes when the order is put right.
        return {"held": ", ".join(names[value.index(k)] for k in range(len(names)))}
    if kind == "gravity_direction":
        return {"gravity": f"({', '.join(f'{each:.3g}' for each in value)})"}
    of, its = "all joints", "the signs of all efforts"
    if joint is not None:
        of, its = names[joint], "its sign"
    return {"of": of, "its": its, "seen": "", **({"add": value[0]} if value else {})}


def other_loads(subjects: Sequence[Subject]) -> Iterator[tuple[int, Finding]]:
    """Yield recordings that carry another load than the first, by their place, with the finding."""
    first, *others = subjects
    for place, other in enumerate(others, 1):
        robot, rows = first.fixed, [each.low_passed for each in (first, other)]
        logs = [each.corrected if each.fixed else None for each in (first, other)]
        if robot is None or any(log is None or log.steps for log in logs):
            continue
        told = _other_load(robot, *(each for each in rows if each is not None))
        if told is not None and told["takes"] >= _TAKES:
            severe = told["takes"] > _TAKES_SURELY
            yield place, found("payload_differs", None, None if severe else "warning", **told)


def _other_load(
    robot: RobotModel, one: FilteredRows, other: FilteredRows
) -> dict[str, float] | None:
    """Return how well another load in one of two recordings explains both.

    Parameters of the arm and friction are common, offsets are each recording's own, and the load
    acts in the second. The share of the squared residuals that the load takes, its mass (kg) with
    the standard error, and first moment (kg·m). None where no joint can be compared.
    """
    usable = np.flatnonzero(one.usable & other.usable)
    if not usable.size:
        return None
    parts, own = [], np.eye(robot.n)
    for place, rows in enumerate((one, other)):
        Y = robot.regressor(rows.position, rows.velocity, rows.acceleration)
        ones = np.ones_like(rows.velocity)
        # Friction, and the offsets of either recording.
        signals = [rows.sign, rows.velocity, np.sqrt(np.abs(rows.velocity)) * rows.sign]
        signals += [rows.acceleration, ones * (place == 0), ones * place]
        columns = (
            Y,
            *(each[:, :, None] * own for each in signals),
            Y[..., -10 : _LOAD - 10] * place,
        )
        due = rows.effort - Y @ robot.prior.ravel()
        parts.append((np.concatenate(columns, axis=2)[:, usable], due[:, usable]))
    A, due = (np.concatenate(each) for each in zip(*parts, strict=True))
    bodies = np.maximum(robot.prior[:, :1], _LEAST_MASS) * np.array(_BELIEF) / _LARGER
    scale = np.full(A.shape[2], _FREE)
    scale[: bodies.size] = bodies.ravel()
    weights = np.ones((usable.size, 1))
    for _ in range(_PASSES):
        weighted, signal = A * weights, due * weights[:, 0]
        fit = block_fit(weighted, signal, scale)
        weights[:, 0] = 1.0 / np.maximum((due - A @ fit.values).std(axis=0), 1e-9)
    without = block_fit(weighted[..., :-_LOAD], signal, scale[:-_LOAD]).left
    if not without > 0.0:
        return None
    mass, *moment = fit.values[-_LOAD:].tolist()
    return {
        "takes": 1.0 - (fit.left / without) ** 2,
        "mass": mass,
        "moment": float(np.linalg.norm(moment)),
        "error": float(fit.errors[-_LOAD]),
        "limit": _TAKES,
    }
