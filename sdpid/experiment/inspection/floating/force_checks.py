"""Check measured contact forces and flags against the torques and the description.

Forces are seen twice: by sensors, and by the torques of the legs, which bear them. Where both agree
they are right up to a common scale, which the mass of the robot shows: torques carry it, contact
forces being eliminated under the flags.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.finding import Finding, Subject, check
from sdpid.experiment.inspection.floating.floating_log import FloatingLog, fitted
from sdpid.robot.model.contacts.jacobians import contact_jacobians

# Median feet of 27 simulated logs with noise are 0.4 to 1 % off, single feet 1.8 %; of real force
# sensors several per cent are usual. Told beyond this share and so many standard errors.
_APART, _SURE = 0.05, 5.0
# One foot's scale against the others'.
_ONE_APART = 0.1
# A mass that is this far off the description's is a scale of the torques, or a load.
_MASS_APART = 0.2
# Beyond this factor efforts are in another unit, which is told as such.
_OTHER_UNIT = 5.0
# With measured forces the description leaves 0.001 to 0.003 of all rows' demand, with forces of
# other feet 0.4.
_UNLIKE = 0.1
# Flags contradict forces where this share of all force acts while its foot is said to be up: rows
# of landings are half a sample off, which makes 0.004 at most.
_UP_SHARE = 0.01


@dataclass(frozen=True, kw_only=True)
class Carried:
    """What part of the description's mass measured forces carry, beside torques.

    Attributes
    ----------
    by_torques : float
        The mass that torques carry, of the description's.
    ratio, error : float
        Measured forces over those that the legs' torques bear: the median foot, and the standard
        error of a foot.
    of_feet : ndarray, shape (c,)
        The same foot by foot, 0 where it is not known.
    unlike_torques, unlike_forces : float
        Shares of what the description asks for that are left: by torques with forces eliminated
        under the flags, and with measured forces.
    """

    by_torques: float
    ratio: float
    error: float
    of_feet: Array
    unlike_torques: float
    unlike_forces: float


def carried(log: FloatingLog) -> Carried | None:
    """Compare elimination of forces with their measurement; None where none were measured."""
    forces = log.contacts.forces
    if forces is None or not np.any(forces):
        return None
    J = contact_jacobians(log.robot, log.configuration, log.contacts.frames, log.contacts.offset)
    pushes = np.einsum("kcin,kci->knc", J, forces) / log.unit[:, None]
    columns, due = log.columns / log.unit[:, None], log.rigid / log.unit
    p, n = columns.shape[2], len(log.joint_names)
    both = np.concatenate([columns, pushes], axis=2)
    each, _ = fitted(both, due)
    # A leg's own torques weigh its foot's force; of the description only the leg's mass counts.
    torques = columns[:, 6:, :n].sum(axis=2)
    beside = np.concatenate([columns[:, 6:, n:], pushes[:, 6:]], axis=2)
    feet, feet_errors = fitted(-beside, torques - due[:, 6:])
    feet, feet_errors = feet[p - n :], feet_errors[p - n :]
    known = np.abs(feet) > _SURE * feet_errors
    if not known.any():
        return None
    of_feet = np.where(known, 1.0 / np.where(known, feet, 1.0), 0.0)
    demand = float(np.sum(log.equations[1] ** 2))
    left = float(np.sum((log.equations[1] - log.equations[0] @ log.freely[0]) ** 2))
    return Carried(
        by_torques=log.carried()[0],
        ratio=float(np.median(of_feet[known])),
        error=float(np.median(feet_errors[known])),
        of_feet=of_feet,
        unlike_torques=left / max(demand, 1e-300),
        unlike_forces=float(np.sum((due - both @ each) ** 2) / np.sum(due**2)),
    )


def _log(subject: Subject) -> FloatingLog | None:
    """Return the rows of a recording whose efforts are N·m, and explained as they are."""
    log = subject.corrected
    if not isinstance(log, FloatingLog) or log.steps:
        return None
    common = log.gains.common
    if common is not None and not 1.0 / _OTHER_UNIT < common < _OTHER_UNIT:
        return None
    return log


@check
def total_mass(subject: Subject) -> Iterator[Finding]:
    """Find torques that carry another mass than the description's."""
    log = _log(subject)
    if log is None or not log.explained or log.scale != 1.0:
        return
    share, error = log.carried()
    if abs(share - 1.0) < max(_MASS_APART, _SURE * error):
        return
    mass = float(log.robot.prior[:, 0].sum())
    yield Finding(
        severity="warning",
        kind="total_mass",
        message=(
            f"torques carry {share * mass:.4g} kg (standard error {error * mass:.2g} kg), "
            f"{share:.3g} times the {mass:.4g} kg of the description, limit "
            f"{1 - _MASS_APART:g} to {1 + _MASS_APART:g}: a load, or another scale of all torques"
        ),
        remedy="weigh the robot, and give its mass (TotalMass); check the torque constants",
        numbers={"share": share, "error": error, "limit": _MASS_APART},
    )


@check
def forces(subject: Subject) -> Iterator[Finding]:
    """Find measured forces of the wrong scale, sign or foot."""
    log = _log(subject)
    found = None if log is None else carried(log)
    if log is None or found is None:
        return
    if found.unlike_forces > _UNLIKE:
        yield Finding(
            severity="warning",
            kind="forces_unlike_motion",
            message=(
                f"contact forces are not those of this motion: {100 * found.unlike_forces:.3g} % "
                f"of what weight and inertia ask for stay unexplained, limit {100 * _UNLIKE:g} % "
                f"(torques with forces eliminated leave {100 * found.unlike_torques:.3g} %)"
            ),
            remedy="check the feet's order, and that forces are in world axes, on the robot, in N",
            numbers={"unexplained": found.unlike_forces, "limit": _UNLIKE},
        )
        return
    if found.unlike_torques > _UNLIKE:
        yield Finding(
            severity="warning",
            kind="flags_unlike_motion",
            message=(
                "flags of contacts are wrong: with them torques leave "
                f"{100 * found.unlike_torques:.3g} % of what weight and inertia ask for, limit "
                f"{100 * _UNLIKE:g} %, and measured forces {100 * found.unlike_forces:.3g} %"
            ),
            remedy="fuse the forces (contact_force_std), or make the flags of them",
            numbers={"unexplained": found.unlike_torques, "limit": _UNLIKE},
        )
        return
    ratio, error = found.ratio, found.error
    by_torques, by_forces = found.by_torques, found.by_torques * ratio
    mass = float(log.robot.prior[:, 0].sum())
    if abs(ratio - 1.0) > max(_APART, _SURE * error):
        # The nearer to the description is the likelier.
        off = [abs(np.log(max(share, 1e-3))) for share in (by_forces, by_torques)]
        likely = "forces" if off[0] > off[1] else "torques"
        sign = ": forces are those on the ground" if ratio < 0.0 else ""
        yield Finding(
            severity="warning",
            kind="forces_scale",
            message=(
                f"contact forces carry {by_forces * mass:.4g} kg, torques "
                f"{by_torques * mass:.4g} kg, {ratio:.3g} times as much, limit "
                f"{1 - _APART:g} to {1 + _APART:g}; the description has {mass:.4g} kg, so that the "
                f"{likely} are likely wrong{sign}"
            ),
            remedy="do not fuse these forces; weigh the robot, and give its mass (TotalMass)",
            numbers={"ratio": ratio, "error": error, "limit": _APART},
        )
    known = found.of_feet != 0.0
    if np.count_nonzero(known) < 2:
        return
    middle = float(np.median(found.of_feet[known]))
    for i in np.flatnonzero(known & (np.abs(found.of_feet / middle - 1.0) > _ONE_APART)).tolist():
        yield Finding(
            severity="warning",
            kind="forces_scale",
            message=(
                f"contact forces of {log.contacts.frames[i]} are {found.of_feet[i] / middle:.3g} "
                f"times those of the others by the robot's motion, limit {1 - _ONE_APART:g} to "
                f"{1 + _ONE_APART:g}"
            ),
            remedy="calibrate this sensor, or leave its forces out",
            numbers={"ratio": found.of_feet[i] / middle, "limit": _ONE_APART},
        )


@check
def flags(subject: Subject) -> Iterator[Finding]:
    """Find flags that say a foot is up while its force is measured."""
    contacts = subject.log.contacts
    if contacts is None or contacts.down is None or contacts.forces is None:
        return
    size = np.linalg.norm(np.asarray(contacts.forces), axis=-1)
    # What a sensor shows where nothing touches it, and at least a hundredth of the largest force.
    noise = max(float(np.percentile(size, 1.0)), 0.01 * float(size.max(initial=0.0)))
    felt = size * (size > 3.0 * noise)
    up = float(felt[~contacts.down].sum() / max(float(felt.sum()), 1e-300))
    if up < _UP_SHARE:
        return
    yield Finding(
        severity="warning",
        kind="flags_unlike_forces",
        message=(
            f"{100 * up:.3g} % of all measured contact force acts on feet that are said to be up, "
            f"limit {100 * _UP_SHARE:g} %: flags are late, have too high a threshold, or are of "
            "other feet"
        ),
        remedy="leave the flags out, and they are made of the forces; or widen contact_margin_s",
        numbers={"share": up, "limit": _UP_SHARE},
    )
