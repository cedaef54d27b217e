"""Checks of a whole description: copied inertias, joints that move no mass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.descriptions import findings
from sdpid.assurance.descriptions.body_checks import consistent
from sdpid.assurance.descriptions.findings import Finding
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
        others, count = _names(group[1:]), float(len(group))
        if len(masses) > 1:
            least, most = masses[0], masses[-1]
            found.append(
                findings.COPIED.found(
                    first.name, value=count, others=others, least=least, most=most
                )
            )
        elif len(group) > 1 and _differ([shapes.get(b.name) for b in group]):
            found.append(findings.COPIED_WITH_MASS.found(first.name, value=count, others=others))
    return found


def _differ(shapes: Sequence[Shape | None]) -> bool:
    """Return whether the shapes are not all of the same part or its mirror image."""
    extents = [np.sort(np.ptp(shape.corners, axis=0)) for shape in shapes if shape is not None]
    return any(not np.allclose(e, extents[0], rtol=_SAME_PART, atol=0.0) for e in extents[1:])


def check_moving(bodies: Sequence[DescribedBody]) -> list[Finding]:
    """Find joints that move nothing, directly or at all."""
    groups = carried(bodies)
    if groups and not any(b.described or b.inferred or b.problems for b in bodies):
        return [findings.NO_INERTIALS.found("")]
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
        rule = findings.MOVING_WITHOUT_MASS if carrier in moved else findings.MOVES_NOTHING
        lacks = "has no mass" if any(b.described for b in group) else "has no inertial"
        found.append(rule.found(carrier, value=0.0, limit=0.0, joint=group[0].joint, lacks=lacks))
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
    """Return the names of bodies as text, shortened after three."""
    names = [body.name for body in bodies]
    if len(names) > 4:
        names[3:] = [f"{len(names) - 3} more"]
    return ", ".join(names)
