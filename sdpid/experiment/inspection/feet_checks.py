"""Check that feet that are down stand still, on the ground, at the stated frames and points.

And check the forces that were measured at them. Forces are seen twice: by sensors, and by torques.
Legs are free bodies: the rows of a leg's joints hold its own links, which move as they were
measured to, its torques, its friction and the force at its foot. Neither the rest of the robot nor
flags of contacts enter them. The links may differ from their description as far as is believed of
them, so that errors of the description are not taken for wrong forces.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.experiment.inspection.block_fit import SURE, block_fit, pooled, sure_part
from sdpid.experiment.inspection.explain import ExplainedLog
from sdpid.experiment.inspection.kinds import (
    KINDS,
    Finding,
    Severity,
    exchanged,
    found,
    refuse,
    vector,
    warning,
)
from sdpid.experiment.inspection.rows import Standing
from sdpid.experiment.inspection.subject import Subject, check, check_of_efforts
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.inertia import skew
from sdpid.robot.model.jacobians import contact_jacobians, frame_axes, frame_places
from sdpid.robot.model.model import RobotModel

KINDS.update(
    foot_moves=warning(
        "{what}", "mark it as not down where it slips; check frames, offset and base", about="feet"
    ),
    foot_high=warning(
        "{foot} is {height:.3g} m above the other feet while it is said to be down, limit "
        "{limit:g} m",
        "check its flags and the order of the joints, unless the ground is not level",
        about="feet",
    ),
    contact_frame=refuse(
        "frames of contacts move while they are said to be down, and others behind them rest "
        "(limit a factor of {limit:g}): {pairs}",
        "give the contacts' frames as {frames}",
        hides=("foot_moves", "foot_high"),
        spoils=True,
        about="feet",
    ),
    contact_point=warning("{feet} {where}", "{remedy}", about="feet"),
    total_mass=warning(
        "torques carry {carried:.4g} kg (standard error {kg_error:.2g} kg), {share:.3g} times the "
        "{mass:.4g} kg {said}, limit {least:g} to {most:g}: {means} scale of all torques",
        "weigh the robot, and give its mass (TotalMass); check the torque constants",
    ),
    forces_missing=refuse(
        "contact forces of {foot}{axes} never change: they are {shown} N in every row, while the "
        "foot is down in {down:.3g %} of them, limit {limit:g %}",
        "if they were not measured, leave all forces out, and keep the flags",
        hides=("forces", "flags_unlike_forces"),
    ),
    flags_unlike_forces=warning(
        "{share:.3g %} of all measured contact force acts on feet that are said to be up, limit "
        "{limit:g %}: flags are late, have too high a threshold, or are of other feet",
        "leave the flags out, and they are made of the forces; or widen contact_margin_s",
        hides=("flags_unlike_motion",),
        about="flags",
    ),
    forces_unlike_motion=warning(
        "contact forces are not those that the torques of the legs show: {seen}",
        "do not fuse them; check the order of their columns, their axes (the world's), sign (those "
        "on the robot), unit, zero, and the point that moments are about; weigh the robot, and "
        "give its mass (TotalMass), which tells whether torques are wrong",
        hides=("flags_unlike_forces",),
        about="forces",
    ),
)

# Told from five standard errors on and from this size (m), about half the radius of a quadruped's
# foot. Right logs of three quadrupeds are off by 4.4 mm at most, where feet land hard in a trot.
SIZE = 0.01
# Least number of samples at which a foot stands, and those at which other frames are looked at.
_LEAST, _FEW = 60, 150
# Few stances have errors of their own, which their spread does not show: blocks of time (of 20) in
# which feet stand.
_LEAST_BLOCKS = 10
# A foot that is down and faster than this (m/s, rms) is not down, or slips. Feet of simulated
# robots roll and slip by less than a tenth of it.
_SLIPS = 0.1
# The ground is not known to be level; a foot this far above the others' median (m) is in the air.
_HIGH = 0.05
# Exchanged flags make down feet faster by this factor.
_FASTER = 3.0
# Feet that are always down, or so often in the same state, cannot be told from each other.
_LEAST_SHARE = 0.02
# A frame that is faster than this does not rest.
_STILL = 0.05
# Another frame rests where it is slower by this factor, and farther away than this (m).
BETTER, _AWAY = 3.0, 0.03
# A point rests that is slower than so many times what noise makes, or than this (m/s): of
# simulated quadrupeds right points have 1.25 times the noise at most.
_NOISES, _RESTS = 1.5, 2e-3
# Where feet roll: from the stated point, with the error of its least certain direction, m; whether
# that is in the axes of the frame or in the world's below the link; and how fast that point moves,
# m/s rms along an axis.
_Point: TypeAlias = tuple[Array, float, bool, float]
# Columns of what a foot may do: stand on a point in the world's axes, or in those of its frame,
# while the pose is late; and how far off that is at most: m, s.
_IN_WORLD, _IN_LINK = (0, 1, 2, 6), (3, 4, 5, 6)
_MOST = np.array([0.5, 0.5, 0.5, 0.1])


def _motion(
    standing: Standing, frames: Sequence[str], offset: Array, rows: Indices | slice = slice(None)
) -> tuple[Array, Array, Array]:
    """Return velocities of points at frames, angular velocities, and what a delay of the pose adds.

    Each has the shape (K, frames, 3).
    """
    J = contact_jacobians(standing.robot, standing.position[rows], frames, offset)
    velocity = np.hstack([standing.base[standing.rows[rows]], standing.speeds[rows]])
    rate = np.gradient(standing.base, standing.step, axis=0)[standing.rows[rows]]
    moved = np.einsum("kcij,kj->kci", J, velocity)
    late = np.einsum("kcij,kj->kci", J[:, :, :3, :6], rate)
    return moved[:, :, :3], moved[:, :, 3:], late


@check("standing")
def feet(subject: Subject, standing: Standing) -> Iterator[Finding]:
    """Find contacts with the flags of other feet, that move, or whose frame or point is elsewhere.

    Of feet with each other's flags there is no other finding.
    """
    from scipy.optimize import linear_sum_assignment

    names, down = standing.contacts.frames, standing.stands
    motion = _motion(standing, names, standing.contacts.offset)
    # Mean squares of each foot's speed while the flag of each is down.
    squares = np.sum(motion[0] ** 2, axis=2).T @ down / np.maximum(down.sum(axis=0), 1)
    own, (rows, order) = np.diagonal(squares), linear_sum_assignment(squares)
    worse, better = (float(np.sqrt(np.mean(each))) for each in (own, squares[rows, order]))
    if better * _FASTER <= worse and worse >= _SLIPS / 2.0:
        mended = (
            f"; feet that are down then move by {better:.3g} m/s (rms) in place of {worse:.3g}, "
            f"limit a factor of {_FASTER:g}"
        )
        numbers = {"speed": worse, "exchanged": better, "limit": _FASTER}
        yield found("feet_exchanged", feet=exchanged(names, order), mended=mended, **numbers)
        return
    yield from _moving_feet(standing, np.sqrt(own))
    others = [*_resting_frames(standing)]
    if others:
        pairs = "; ".join(
            f"{name} by {speed:.2g} m/s (rms), {resting} by {least:.2g}"
            for speed, name, least, resting in others
        )
        speed, _, least, _ = max(others)
        numbers = {"speed": speed, "resting": least, "limit": BETTER}
        frames = ", ".join(resting for *_, resting in others)
        yield found("contact_frame", pairs=pairs, frames=frames, **numbers)
    else:
        yield from _points(standing, *motion)


def _moving_feet(standing: Standing, speeds: Array) -> Iterator[Finding]:
    """Find feet that are said to be down and move by (c,) m/s, or are above the others."""
    down, names = standing.stands, standing.contacts.frames
    seen = down.mean(axis=0) > _LEAST_SHARE
    for i in np.flatnonzero(seen & (speeds > _SLIPS)).tolist():
        what = (
            f"{names[i]} moves by {speeds[i]:.3g} m/s (rms) while it is said to be down, limit "
            f"{_SLIPS:g}: it slips, its flags are wrong, or the pose of the base is"
        )
        yield found("foot_moves", what=what, speed=speeds[i], limit=_SLIPS)
    several = down.sum(axis=1) >= 2
    if np.count_nonzero(seen) < 2 or not several.any():
        return
    places = frame_places(standing.robot, standing.position, names) + standing.contacts.offset
    heights = np.where(down, places[..., 2], np.nan)[several]
    level = np.nanmedian(heights, axis=1)
    for i in np.flatnonzero(seen & ~np.isnan(heights).all(axis=0)).tolist():
        height = float(np.nanmedian(heights[:, i] - level))
        if height > _HIGH:
            yield found("foot_high", foot=names[i], height=height, limit=_HIGH)


def _resting_frames(standing: Standing) -> Iterator[tuple[float, str, float, str]]:
    """Yield frames of contacts that move, and those that rest in their place, with speeds."""
    for i, name in enumerate(standing.contacts.frames):
        rows, behind = np.flatnonzero(standing.stands[:, i]), _beyond(standing.robot, name)
        if len(rows) < _LEAST or not behind:
            continue
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, _FEW).astype(np.intp))]
        velocity, _, _ = _motion(standing, [name, *behind], standing.contacts.offset[i], rows)
        speeds = np.sqrt(np.mean(np.sum(velocity**2, axis=2), axis=0)).tolist()
        best = int(np.argmin(speeds))
        if best and speeds[best] < _STILL and BETTER * speeds[best] < speeds[0]:
            yield speeds[0], name, speeds[best], behind[best - 1]


def _beyond(robot: RobotModel, name: str) -> list[str]:
    """Return frames of bodies on the link of a frame, and on those behind it, away from it."""
    model = robot.pin_model
    own = model.frames[robot.frame_numbers[name]]
    found = []
    for other, number in robot.frame_numbers.items():
        frame = model.frames[number]
        if str(frame.type) != "BODY" or own.parentJoint not in model.supports[frame.parentJoint]:
            continue
        away = np.linalg.norm(frame.placement.translation - own.placement.translation)
        if frame.parentJoint != own.parentJoint or away > _AWAY:
            found.append(other)
    return found


def _points(standing: Standing, velocity: Array, turning: Array, late: Array) -> Iterator[Finding]:
    """Find contacts that are points and stand on others than stated, or on none that rests.

    A foot that stands turns about the point where it touches: ``v + w x (o + x) = 0`` for the
    velocity v of its frame, its angular velocity w and the stated offset o.
    """
    contacts, parts = standing.contacts, {}
    across = skew(turning)
    axes = frame_axes(standing.robot, standing.position, contacts.frames)
    columns = np.concatenate([across, across @ axes, late[..., None]], axis=3)
    for i, kind in enumerate(contacts.kind):
        stands = standing.stands[:, i, None]
        if kind != "point" or np.count_nonzero(stands) < _LEAST:
            continue
        # Rows are zero while it does not stand.
        signal = -velocity[:, i] * stands
        if np.sum(signal**2) < np.count_nonzero(stands) * _SLIPS**2:
            parts[i] = columns[:, i] * stands[..., None], signal
    if not parts:
        return
    together = _point([*parts.values()])
    groups = {tuple(parts): together}
    if together is None or any(_point([each], together) for each in parts.values()):
        groups = {(i,): _point([each]) for i, each in parts.items()}
    limit = max(_NOISES * standing.noise, _RESTS)
    for feet, point in groups.items():
        if point is None:
            continue
        change, error, in_link, left = point
        names = ", ".join(contacts.frames[i] for i in feet)
        if left > limit:
            what = (
                f"{names}: no point rests while a foot is said to be down; the slowest moves by "
                f"{left:.2g} m/s (rms along an axis), limit {limit:.2g}: it slips"
            )
            yield found("foot_moves", what=what, speed=left, limit=limit)
            continue
        stated = contacts.offset[[*feet]].mean(axis=0)
        size, offset = float(np.linalg.norm(change)), vector(stated + change)
        told = f"(standard error {error:.2g} m, limit {SIZE:g} m)"
        where = (
            f"touch the ground at {offset} m from the frame, {size:.3g} m from the stated offset "
            f"{vector(stated)}: that point rests while a foot is down {told}"
        )
        remedy = f"give the contacts' offset={offset}"
        if in_link:
            where = (
                f"rest, while down, at a point {vector(change)} m from the stated one in the "
                f"frame's axes {told}"
            )
            remedy = "give the frame of the foot; where there is none, add one to the description"
        numbers = {"distance": size, "error": error, "limit": SIZE}
        yield found("contact_point", feet=names, where=where, remedy=remedy, **numbers)


def _point(parts: list[tuple[Array, Array]], known: _Point | None = None) -> _Point | None:
    """Return where feet touch the ground that roll alike, None where it is as stated, or known."""
    columns, signal = (np.concatenate(each, axis=1) for each in zip(*parts, strict=True))
    world, link = (block_fit(columns[..., at], signal, _MOST) for at in (_IN_WORLD, _IN_LINK))
    # What is as small as a ball's radius is one below a ball.
    in_link = link.left < world.left and float(np.linalg.norm(link.values[:3])) > _AWAY
    beside, _, in_link, _ = known or (np.zeros(3), 0.0, in_link, 0.0)
    fit = link if in_link else world
    sure = sure_part(fit.values[:3] - beside, fit.covariance[:3, :3], SIZE)
    return (*sure, in_link, fit.left) if sure and fit.filled >= _LEAST_BLOCKS else None


# Changes of flags of contacts, which leave efforts as they are.
_OF_FLAGS = ("feet_exchanged", "flags_unlike_motion")
# A mass that is this far off the description's is a scale of the torques, or a load; off what the
# robot weighs it is a scale. Of 72 simulated logs, links 15 % off, torques carry up to 2.5 % less
# or more than the robot weighs.
_MASS_APART, _WEIGHED_APART = 0.2, 0.04
# Beyond this factor efforts are in another unit, which is told as such.
_OTHER_UNIT = 5.0
# Flags contradict forces where this share of all force acts while its foot is said to be up: rows
# of landings are half a sample off, which makes 0.004 at most.
_UP_SHARE = 0.01
# What shows less is no force: three times what a sensor shows where nothing touches it, and at
# least this share of the largest force, and of the weight.
_NOISE = 0.03
# A foot bears something where it is down so often, or where the root mean square of its force is
# this share of the weight: below it there is nothing that checks would tell, such as the noise of
# sensors in the air.
_OFTEN, _BEARING = 0.1, 0.02
# Samples that are compared.
_ROWS = 600
# A link's mass may be off by this share of it, its first moments and moments of inertia by what
# this share makes at such a distance (m): twice the 15 % that simulated links are off, and more.
_BELIEF, _AT = 0.3, 0.1
# Width of the smooth sign of the velocity, rad/s.
_WIDTH = 0.02
# Friction and rotor inertia are free: in units of the largest effort no joint has as much. Torques
# show at most so many times the forces.
_FREE, _LARGEST = 100.0, 10.0
# Of 72 simulated logs right forces leave at most 0.0005 of what the legs' torques need beside their
# own links, of humanoids on soles 0.015; what is read wrong leaves more.
_LEFT, _LEFT_BY_SOLES = 0.001, 0.03
# In those logs, links 15 % off their description, the scale of all forces is up to 1.1 % off, that
# of a foot 2.7 %.
_APART, _ONE_APART = 0.02, 0.04


@check()
def measured_forces(subject: Subject) -> Iterator[Finding]:
    """Find forces that never change of feet that are down, and flags that deny forces."""
    contacts, robot = subject.log.contacts, subject.floating
    measured = None if contacts is None else contacts.measured
    if contacts is None or contacts.down is None or measured is None:
        return
    still, down = np.ptp(measured, axis=0) == 0.0, contacts.down.mean(axis=0)
    for foot in np.flatnonzero(still.any(axis=1) & (down >= _OFTEN)).tolist():
        dead, stuck = bool(still[foot].all()), still[foot]
        axes = "" if dead else f" in {', '.join(np.array(list('xyz'))[stuck])}"
        fields = {"foot": contacts.frames[foot], "axes": axes}
        fields["shown"] = vector(measured[0, foot, stuck])
        severity: Severity = "refuse" if dead else "warning"
        yield found("forces_missing", None, severity, down=down[foot], limit=_OFTEN, **fields)
    size = np.linalg.norm(measured, axis=-1)
    largest = max(float(size.max(initial=0.0)), 0.0 if robot is None else _weight(robot))
    felt = size * (size > max(3.0 * float(np.percentile(size, 1.0)), _NOISE * largest))
    up = float(felt[~contacts.down].sum() / max(float(felt.sum()), 1e-300))
    if up >= _UP_SHARE:
        yield found("flags_unlike_forces", share=up, limit=_UP_SHARE)


def _weight(robot: RobotModel) -> float:
    """Return the weight of a description, N."""
    return float(robot.prior[:, 0].sum() * np.linalg.norm(robot.gravity))


def _is_explained(log: ExplainedLog) -> bool:
    """Return whether efforts of legs are N·m, and explained as they are.

    Wrong flags are no matter of efforts.
    """
    if log.contacts is None or any(step.change.kind not in _OF_FLAGS for step in log.steps):
        return False
    common = log.gains.common
    return common is None or 1.0 / _OTHER_UNIT < common < _OTHER_UNIT


@check_of_efforts("corrected")
def total_mass(subject: Subject, log: ExplainedLog) -> Iterator[Finding]:
    """Find torques that carry another mass than the description's, or than the robot's."""
    told = _is_explained(log) and log.explained and log.bears_base
    if log.steps or log.scale != 1.0 or not told:
        return
    described = float(log.robot.prior[:, 0].sum())
    mass, said, means, limit = described, "of the description", "a load, or another", _MASS_APART
    if subject.total_mass is not None:
        mass, said, means, limit = subject.total_mass, "that it weighs", "another", _WEIGHED_APART
    share, error = (value * described / mass for value in log.carried())
    if abs(share - 1.0) < max(limit, SURE * error):
        return
    weight = {"carried": share * mass, "kg_error": error * mass, "mass": mass, "said": said}
    limits = {"least": 1.0 - limit, "most": 1.0 + limit, "limit": limit}
    yield found("total_mass", means=means, share=share, error=error, **weight, **limits)


@check_of_efforts("floating", "samples", "corrected")
def forces(
    subject: Subject, robot: RobotModel, samples: Samples, log: ExplainedLog
) -> Iterator[Finding]:
    """Find measured forces that are not those that the torques of the legs show."""
    legs = [*_leg_forces(robot, samples, subject.without)] if _is_explained(log) else []
    if not legs:
        return
    ratio, error = pooled(*np.transpose([each[1:3] for each in legs]))
    seen = [
        f"those of {frame} leave {100 * left:.3g} % of what the torques of its leg need beside its "
        f"own links, limit {100 * most:g} %"
        for frame, _, _, left, most in legs
        if left > most
    ]
    if not seen:
        apart = [("they", ratio, error, _APART)]
        apart += [(f"those of {each[0]}", *each[1:3], _ONE_APART) for each in legs]
        seen = [
            f"{who} are {scale:.4g} times (standard error {uncertain:.2g}) those, limit "
            f"{1 - limit:.3g} to {1 + limit:.3g}"
            for who, scale, uncertain, least in apart
            if abs(scale - 1.0) > (limit := max(least, SURE * uncertain))
        ]
    if seen:
        numbers = {"unexplained": max(left for *_, left, _ in legs), "ratio": ratio, "error": error}
        yield found("forces_unlike_motion", seen="; ".join(seen), **numbers)


def _leg_forces(
    robot: RobotModel, samples: Samples, unused: Collection[str]
) -> Iterator[tuple[str, float, float, float, float]]:
    """Compare the forces of the contacts that bear something with torques.

    Yield the frame, how many times those that torques show its forces are, with the standard error,
    and the share that they leave of what the torques need beside the leg's own links, and may leave
    at most. Contacts that share joints with others, or have joints whose effort says nothing, are
    left out.
    """
    some = np.unique(np.linspace(0, samples.n_samples - 1, _ROWS).astype(np.intp))
    states = (samples.position, samples.velocity, samples.acceleration, samples.effort)
    q, v, a, effort = (each[some] for each in states)
    contacts = samples.contacts and samples.contacts.rows(some)
    if contacts is None or contacts.forces is None:
        return
    J = contact_jacobians(robot, q, contacts.frames, contacts.offset)
    moved: Mask = np.any(J[..., robot.n_base :], axis=(0, 2))
    unknown = [name in unused for name in robot.joint_names[robot.n_base :]]
    own = moved & (moved.sum(axis=0) == 1) & ~np.array(unknown)
    felt = np.sqrt(np.mean(np.sum(contacts.forces[..., :3] ** 2, axis=2), axis=0))
    bearing = (contacts.down.mean(axis=0) >= _OFTEN) | (felt >= _BEARING * _weight(robot))
    taken = bearing & (felt > 0.0) & moved.any(axis=1) & (own == moved).all(axis=1)
    Y, described = robot.regressor(q, v, a), robot.described_efforts(q, v, a)
    borne = np.einsum("kcin,kci->kcn", J, contacts.forces)
    masses = np.maximum(robot.prior[:, :1], 1e-3 * robot.prior[:, 0].sum())
    believed = (_BELIEF * masses * np.array([1.0, *3 * (_AT,), *6 * (_AT**2,)])).ravel()
    for contact in np.flatnonzero(taken).tolist():
        joints = robot.n_base + np.flatnonzero(moved[contact])
        rows, due = Y[:, joints], effort[:, joints] - described[:, joints]
        links = np.flatnonzero(np.any(rows != 0.0, axis=(0, 1)))
        signals = (np.tanh(v[:, joints] / _WIDTH), v[:, joints], a[:, joints])
        friction = [signal[:, :, None] * np.eye(len(joints)) for signal in signals]
        largest = _FREE * max(float(np.abs(effort[:, joints]).max()), 1e-9)
        size = np.r_[_LARGEST, believed[links], np.full(3 * len(joints), largest)]
        columns = [-borne[:, contact, joints, None], rows[:, :, links], *friction]
        every = np.concatenate(columns, axis=2)
        fit, without = block_fit(every, due, size), block_fit(every[..., 1:], due, size[1:])
        shown, error = float(fit.values[0]), float(fit.errors[0])
        left = (fit.left / max(without.left, 1e-300)) ** 2
        most = _LEFT if contacts.kind[contact] == "point" else _LEFT_BY_SOLES
        yield contacts.frames[contact], 1.0 / shown, error / shown**2, left, most
