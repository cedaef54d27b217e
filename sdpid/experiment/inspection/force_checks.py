"""Check measured contact forces against the torques of the legs that bear them, and flags.

Forces are seen twice: by sensors, and by torques. Legs are free bodies: the rows of a leg's joints
hold its own links, which move as they were measured to, its torques, its friction and the force at
its foot. Neither the rest of the robot nor flags of contacts enter them. The links may differ from
their description as far as is believed of them, so that errors of the description are not taken for
wrong forces.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Mask
from sdpid.experiment.inspection.block_fit import SURE, block_fit, pooled
from sdpid.experiment.inspection.explain import ExplainedLog
from sdpid.experiment.inspection.kinds import KINDS, Finding, Severity, found, refuse, warning
from sdpid.experiment.inspection.subject import Subject, check, check_of_efforts
from sdpid.robot.model.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

KINDS.update(
    total_mass=warning(
        "torques carry {carried:.4g} kg (standard error {kg_error:.2g} kg), {share:.3g} times the "
        "{mass:.4g} kg {said}, limit {least:g} to {most:g}: {means} scale of all torques",
        "weigh the robot, and give its mass (TotalMass); check the torque constants",
    ),
    forces_missing=refuse(
        "contact forces of {foot}{axes} never change: they are ({shown}) N in every row, while the "
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


@check
def missing_forces(subject: Subject) -> Iterator[Finding]:
    """Find forces of feet that are down which never change, and components that do not."""
    contacts = subject.log.contacts
    measured = None if contacts is None else contacts.measured
    if contacts is None or contacts.down is None or measured is None:
        return
    still = np.ptp(measured, axis=0) == 0.0
    for foot in np.flatnonzero(still.any(axis=1)).tolist():
        down, dead = float(contacts.down[:, foot].mean()), bool(still[foot].all())
        if down < _OFTEN:
            continue
        axes = "" if dead else f" in {', '.join(np.array(list('xyz'))[still[foot]])}"
        shown = ", ".join(f"{value + 0.0:.4g}" for value in measured[0, foot, still[foot]])
        fields = {"foot": contacts.frames[foot], "axes": axes, "shown": shown}
        severity: Severity = "refuse" if dead else "warning"
        yield found("forces_missing", None, severity, down=down, limit=_OFTEN, **fields)


def explained_log(subject: Subject) -> ExplainedLog | None:
    """Return the rows of a recording whose efforts are N·m, and explained as they are.

    Wrong flags are no matter of efforts.
    """
    log = subject.corrected
    if log is None or log.contacts is None:
        return None
    if any(step.change.kind not in _OF_FLAGS for step in log.steps):
        return None
    common = log.gains.common
    return log if common is None or 1.0 / _OTHER_UNIT < common < _OTHER_UNIT else None


@check_of_efforts
def total_mass(subject: Subject) -> Iterator[Finding]:
    """Find torques that carry another mass than the description's, or than the robot's."""
    log = explained_log(subject)
    if log is None or log.steps or not log.explained or log.scale != 1.0 or not log.bears_base:
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


@check
def flags_and_forces(subject: Subject) -> Iterator[Finding]:
    """Find flags that say a foot is up while its force is measured."""
    contacts, robot = subject.log.contacts, subject.floating
    measured = None if contacts is None else contacts.measured
    if contacts is None or contacts.down is None or measured is None:
        return
    size = np.linalg.norm(measured, axis=-1)
    largest = max(float(size.max(initial=0.0)), 0.0 if robot is None else _weight(robot))
    felt = size * (size > max(3.0 * float(np.percentile(size, 1.0)), _NOISE * largest))
    up = float(felt[~contacts.down].sum() / max(float(felt.sum()), 1e-300))
    if up >= _UP_SHARE:
        yield found("flags_unlike_forces", share=up, limit=_UP_SHARE)


def _weight(robot: RobotModel) -> float:
    """Return the weight of a description, N."""
    return float(robot.prior[:, 0].sum() * np.linalg.norm(robot.gravity))


@check_of_efforts
def forces(subject: Subject) -> Iterator[Finding]:
    """Find measured forces that are not those that the torques of the legs show."""
    legs = [] if explained_log(subject) is None else leg_forces(subject)
    if not legs:
        return
    ratio, error = pooled(*np.transpose([(leg.ratio, leg.error) for leg in legs]))
    seen = [
        f"those of {leg.frame} leave {100 * leg.left:.3g} % of what the torques of its leg need "
        f"beside its own links, limit {100 * leg.most:g} %"
        for leg in legs
        if leg.left > leg.most
    ]
    if not seen:
        apart = [("they", ratio, error, _APART)]
        apart += [(f"those of {leg.frame}", leg.ratio, leg.error, _ONE_APART) for leg in legs]
        seen = [
            f"{who} are {scale:.4g} times (standard error {uncertain:.2g}) those, limit "
            f"{1 - limit:.3g} to {1 + limit:.3g}"
            for who, scale, uncertain, least in apart
            if abs(scale - 1.0) > (limit := max(least, SURE * uncertain))
        ]
    if seen:
        numbers = {"unexplained": max(leg.left for leg in legs), "ratio": ratio, "error": error}
        yield found("forces_unlike_motion", seen="; ".join(seen), **numbers)


class LegForces(NamedTuple):
    """Forces at a foot against the torques of its leg.

    How many times those that torques show they are, with the standard error, and the share that
    they leave of what the torques need beside the leg's own links, and may leave at most.
    """

    frame: str
    ratio: float
    error: float
    left: float
    most: float


def leg_forces(subject: Subject) -> list[LegForces]:
    """Compare the forces of the contacts that bear something with torques.

    Contacts that share joints with others, or have joints whose effort says nothing, are left out.
    """
    robot, samples = subject.floating, subject.samples
    contacts = None if samples is None else samples.contacts
    if robot is None or samples is None or contacts is None or contacts.forces is None:
        return []
    some = np.unique(np.linspace(0, samples.n_samples - 1, _ROWS).astype(np.intp))
    q, v, a, effort = (
        each[some]
        for each in (samples.position, samples.velocity, samples.acceleration, samples.effort)
    )
    contacts = contacts.picked(some)
    assert contacts.forces is not None
    J = contact_jacobians(robot, q, contacts.frames, contacts.offset)
    moved: Mask = np.any(J[..., robot.n_base :], axis=(0, 2))
    unknown = [name in subject.without for name in robot.joint_names[robot.n_base :]]
    shared = moved & (moved.sum(axis=0) > 1)
    felt = np.sqrt(np.mean(np.sum(contacts.forces[..., :3] ** 2, axis=2), axis=0))
    bearing = (contacts.down.mean(axis=0) >= _OFTEN) | (felt >= _BEARING * _weight(robot))
    bearing &= felt > 0.0
    taken = bearing & moved.any(axis=1) & ~shared.any(axis=1) & ~(moved & unknown).any(axis=1)
    if not np.any(taken):
        return []
    Y, described = robot.regressor(q, v, a), robot.described_efforts(q, v, a)
    borne = np.einsum("kcin,kci->kcn", J, contacts.forces)
    masses = np.maximum(robot.prior[:, :1], 1e-3 * robot.prior[:, 0].sum())
    believed = (_BELIEF * masses * np.array([1.0, *3 * (_AT,), *6 * (_AT**2,)])).ravel()
    legs = []
    for contact in np.flatnonzero(taken).tolist():
        joints = robot.n_base + np.flatnonzero(moved[contact])
        rows, largest = Y[:, joints], max(float(np.abs(effort[:, joints]).max()), 1e-9)
        links = np.flatnonzero(np.any(rows != 0.0, axis=(0, 1)))
        signals = (np.tanh(v[:, joints] / _WIDTH), v[:, joints], a[:, joints])
        friction = [signal[:, :, None] * np.eye(len(joints)) for signal in signals]
        columns = [-borne[:, contact, joints, None], rows[:, :, links], *friction]
        size = np.r_[_LARGEST, believed[links], np.full(3 * len(joints), _FREE * largest)]
        own, due = np.concatenate(columns, axis=2), effort[:, joints] - described[:, joints]
        fit, without = block_fit(own, due, size), block_fit(own[..., 1:], due, size[1:])
        shown, error = float(fit.values[0]), float(fit.errors[0])
        left = (fit.left / max(without.left, 1e-300)) ** 2
        most = _LEFT if contacts.kind[contact] == "point" else _LEFT_BY_SOLES
        frame = contacts.frames[contact]
        legs.append(LegForces(frame, 1.0 / shown, error / shown**2, left, most))
    return legs
