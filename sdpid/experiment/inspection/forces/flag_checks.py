"""Check the mass that torques carry, flags against forces, and that sensors show anything."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid.experiment.inspection.dynamics_checks import OF_FLAGS
from sdpid.experiment.inspection.finding import Finding, Subject, check
from sdpid.experiment.inspection.floating.floating_log import FloatingLog
from sdpid.experiment.inspection.forces.free_legs import described_weight
from sdpid.experiment.recording.floating.contacts import Contacts
from sdpid.robot.model.model import RobotModel

# A mass that is this far off the description's is a scale of the torques, or a load; off what the
# robot weighs it is a scale. Of 72 simulated logs, links 15 % off, torques carry up to 2.5 % less
# or more than the robot weighs. Both from so many standard errors on.
_MASS_APART, _WEIGHED_APART, _SURE = 0.2, 0.04, 5.0
# Beyond this factor efforts are in another unit, which is told as such.
_OTHER_UNIT = 5.0
# Flags contradict forces where this share of all force acts while its foot is said to be up: rows
# of landings are half a sample off, which makes 0.004 at most.
_UP_SHARE = 0.01
# What shows less is no force: three times what a sensor shows where nothing touches it, and at
# least this share of the largest force, and of the weight.
_NOISE = 0.03
# A foot that is down more rarely may bear nothing while it is.
_OFTEN = 0.1


@check
def missing_forces(subject: Subject) -> Iterator[Finding]:
    """Find forces of feet that are down which never change, and components that do not."""
    contacts = subject.log.contacts
    if contacts is None or contacts.down is None:
        return
    measured = contacts.measured
    if measured is None:
        return
    still = np.ptp(measured, axis=0) == 0.0
    for foot in np.flatnonzero(still.any(axis=1)).tolist():
        down = float(contacts.down[:, foot].mean())
        if down < _OFTEN:
            continue
        dead = bool(still[foot].all())
        which = "" if dead else f" in {', '.join(np.array(list('xyz'))[still[foot]])}"
        shown = ", ".join(f"{value + 0.0:.4g}" for value in measured[0, foot, still[foot]])
        yield Finding(
            severity="refuse" if dead else "warning",
            kind="forces_missing",
            message=(
                f"contact forces of {contacts.frames[foot]}{which} never change: they are "
                f"({shown}) N in every row, while the foot is down in {100 * down:.3g} % of them, "
                f"limit {100 * _OFTEN:g} %"
            ),
            remedy="if they were not measured, leave all forces out, and keep the flags",
            numbers={"down": down, "limit": _OFTEN},
        )


def explained_log(subject: Subject) -> FloatingLog | None:
    """Return the rows of a recording whose efforts are N·m, and explained as they are.

    Wrong flags are no matter of efforts.
    """
    log = subject.corrected
    if not isinstance(log, FloatingLog):
        return None
    if any(step.change.kind not in OF_FLAGS for step in log.steps):
        return None
    common = log.gains.common
    if common is not None and not 1.0 / _OTHER_UNIT < common < _OTHER_UNIT:
        return None
    return log


@check
def total_mass(subject: Subject) -> Iterator[Finding]:
    """Find torques that carry another mass than the description's, or than the robot's."""
    log = explained_log(subject)
    if log is None or log.steps or not log.explained or log.scale != 1.0 or not log.bears_base:
        return
    share, error = log.carried()
    described = float(log.robot.prior[:, 0].sum())
    mass, said, means, limit = described, "of the description", "a load, or another", _MASS_APART
    if subject.total_mass is not None:
        mass, said, means, limit = subject.total_mass, "that it weighs", "another", _WEIGHED_APART
    share, error = (value * described / mass for value in (share, error))
    if abs(share - 1.0) < max(limit, _SURE * error):
        return
    yield Finding(
        kind="total_mass",
        message=(
            f"torques carry {share * mass:.4g} kg (standard error {error * mass:.2g} kg), "
            f"{share:.3g} times the {mass:.4g} kg {said}, limit {1 - limit:g} to {1 + limit:g}: "
            f"{means} scale of all torques"
        ),
        remedy="weigh the robot, and give its mass (TotalMass); check the torque constants",
        numbers={"share": share, "error": error, "limit": limit},
    )


def _felt_up(contacts: Contacts | None, robot: RobotModel | None) -> float | None:
    """Return the share of all measured force that acts on feet that are said to be up."""
    if contacts is None or contacts.down is None:
        return None
    measured = contacts.measured
    if measured is None:
        return None
    size = np.linalg.norm(measured, axis=-1)
    weight = 0.0 if robot is None else described_weight(robot)
    least = _NOISE * max(float(size.max(initial=0.0)), weight)
    felt = size * (size > max(3.0 * float(np.percentile(size, 1.0)), least))
    return float(felt[~contacts.down].sum() / max(float(felt.sum()), 1e-300))


def follow_forces(contacts: Contacts | None, robot: RobotModel | None) -> bool:
    """Return whether flags differ from foot to foot, and are those of the measured forces."""
    up = _felt_up(contacts, robot)
    if contacts is None or contacts.down is None or up is None:
        return False
    differ = bool((contacts.down != contacts.down[:, :1]).any())
    return differ and up < _UP_SHARE


@check
def flags_and_forces(subject: Subject) -> Iterator[Finding]:
    """Find flags that say a foot is up while its force is measured."""
    up = _felt_up(subject.log.contacts, subject.floating)
    if up is None or up < _UP_SHARE:
        return
    yield Finding(
        kind="flags_unlike_forces",
        message=(
            f"{100 * up:.3g} % of all measured contact force acts on feet that are said to be up, "
            f"limit {100 * _UP_SHARE:g} %: flags are late, have too high a threshold, or are of "
            "other feet"
        ),
        remedy="leave the flags out, and they are made of the forces; or widen contact_margin_s",
        numbers={"share": up, "limit": _UP_SHARE},
    )
