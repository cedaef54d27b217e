"""Checks of a whole description: copied inertias, joints that move no mass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.descriptions.body_checks import Finding, Severity, consistent
from sdpid.assurance.descriptions.link_shape import Shape
from sdpid.robot.description.bodies import DescribedBody
from sdpid.robot.inertia import transform

# Extents of the shapes of two links that differ by less, relative, are those of the same part or
# of its mirror image.
_SAME_PART = 0.01


def check_copies(
    bodies: Sequence[DescribedBody], shapes: Mapping[str, Shape | None]
) -> list[Finding]:
    """Find tensors that several links share although their masses or shapes differ."""
    groups: dict[Any, list[DescribedBody]] = {}
    for body in bodies:
        if body.entries is not None and any(body.entries) and body.mass:
            groups.setdefault(body.entries, []).append(body)
    found = []
    for group in groups.values():
        first = group[0]
        if first.tensor is not None and np.array_equal(first.tensor, np.eye(3)):
            continue  # already reported as a placeholder
        masses = sorted({body.mass for body in group if body.mass is not None})
        if len(masses) > 1:
            found.append(
                Finding(
                    severity="warning",
                    kind="copied",
                    link=first.name,
                    message=f"the same inertia as {_names(group[1:])}, with masses from "
                    f"{masses[0]:.4g} to {masses[-1]:.4g} kg: at most one of them is right; give "
                    "each its own.",
                    value=float(len(group)),
                )
            )
        elif len(group) > 1 and _differ([shapes.get(b.name) for b in group]):
            found.append(
                Finding(
                    severity="note",
                    kind="copied",
                    link=first.name,
                    message=f"the same mass and inertia as {_names(group[1:])}, whose shape "
                    "differs; check that they were not copied.",
                    value=float(len(group)),
                )
            )
    return found


def _differ(shapes: Sequence[Shape | None]) -> bool:
    extents = [np.sort(np.ptp(shape.corners, axis=0)) for shape in shapes if shape is not None]
    return any(not np.allclose(e, extents[0], rtol=_SAME_PART, atol=0.0) for e in extents[1:])


def check_moving(bodies: Sequence[DescribedBody]) -> list[Finding]:
    """Find joints that move nothing, directly or at all."""
    groups = carried(bodies)
    if groups and not any(b.described or b.inferred or b.problems for b in bodies):
        return [
            Finding(
                severity="warning",
                kind="no_inertials",
                link="",
                message="no link has an inertial: this describes kinematics only; identify the "
                "inertias, or take them from the maker.",
            )
        ]
    carriers = {body.name: body.carrier for body in bodies}
    heavy = {
        carrier
        for carrier, group in groups.items()
        # What is wrong or made from shapes counts as mass here: it is reported elsewhere.
        if any(b.mass or b.inferred or b.problems or consistent(b) is False for b in group)
    }
    moved = set()
    for carrier in heavy:
        at: str | None = carrier
        while at in groups and at not in moved:
            moved.add(at)
            at = carriers.get(groups[at][0].parent or "")
    found = []
    for carrier, group in groups.items():
        if carrier in heavy:
            continue
        joint = group[0].joint
        what = "has no inertial" if not any(b.described for b in group) else "has no mass"
        if carrier in moved:
            severity: Severity = "warning"
            text = "some loaders refuse it (MuJoCo), others invent a mass"
        else:
            severity = "error"
            text = "neither is there any beyond it: the joint has no inertia, its acceleration none"
        found.append(
            Finding(
                severity=severity,
                kind="moving_without_mass" if carrier in moved else "moves_nothing",
                link=carrier,
                message=f"is moved by joint '{joint}' but {what}, and nothing with mass is fixed "
                f"to it; {text}. Give it a mass, or --repair gives it a token one.",
                value=0.0,
                limit=0.0,
            )
        )
    return found


def carried(bodies: Sequence[DescribedBody]) -> dict[str, list[DescribedBody]]:
    """Return the bodies that move as one, by the link that carries them; the base is left out."""
    groups: dict[str, list[DescribedBody]] = {}
    for body in bodies:
        if body.moving:
            groups.setdefault(body.carrier, []).append(body)
    return groups


def carried_theta(group: Sequence[DescribedBody]) -> Array:
    """Return the ten parameters of bodies that move as one, in the carrier's frame."""
    total = np.zeros(10)
    for body in group:
        theta = body.theta
        if theta is not None and np.isfinite(body.placement).all():
            total += transform(theta, body.placement[:3, :3], body.placement[:3, 3])
    return total


def _names(bodies: Sequence[DescribedBody]) -> str:
    names = [body.name for body in bodies]
    if len(names) > 4:
        names[3:] = [f"{len(names) - 3} more"]
    return ", ".join(names)
