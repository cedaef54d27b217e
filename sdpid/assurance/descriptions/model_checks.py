"""Checks of a whole description: copied inertias, joints that move no mass."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.descriptions.body_checks import Shapes, consistent
from sdpid.assurance.descriptions.findings import Finding, found
from sdpid.robot.description.bodies import DescribedBody
from sdpid.robot.inertia import transform

# Extents of the shapes of two links that differ by less, relative, are those of the same part or
# of its mirror image.
_SAME_PART = 0.01


def check_copies(
    bodies: Sequence[DescribedBody], shapes: Mapping[str, Shapes]
) -> Iterator[Finding]:
    """Find tensors that several links share although their masses or shapes differ."""
    groups: dict[Any, list[DescribedBody]] = {}
    for body in bodies:
        # The identity is told as a placeholder.
        placeholder = body.tensor is not None and np.array_equal(body.tensor, np.eye(3))
        if body.entries is not None and any(body.entries) and body.mass and not placeholder:
            groups.setdefault(body.entries, []).append(body)
    for group in groups.values():
        first, names = group[0].name, [body.name for body in group[1:]]
        if len(names) > 4:
            names[3:] = [f"{len(names) - 3} more"]
        many, others = float(len(group)), ", ".join(names)
        masses = sorted({body.mass for body in group if body.mass is not None})
        hulls = [shapes[body.name].whole for body in group if body.name in shapes]
        extents = [np.sort(np.ptp(hull.corners, axis=0)) for hull in hulls]
        same = all(np.allclose(e, extents[0], rtol=_SAME_PART, atol=0.0) for e in extents)
        if len(masses) > 1:
            yield found("copied", first, many, others=others, least=masses[0], most=masses[-1])
        elif not same:
            yield found("copied with the mass", first, many, others=others)


def check_moving(bodies: Sequence[DescribedBody]) -> Iterator[Finding]:
    """Find joints that move nothing, directly or at all."""
    groups = carried(bodies)
    if groups and not any(b.described or b.inferred or b.problems for b in bodies):
        yield found("no_inertials", "")
        return
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
    for carrier, group in groups.items():
        if carrier not in heavy:
            kind = "moving_without_mass" if carrier in moved else "moves_nothing"
            lacks = "has no mass" if any(b.described for b in group) else "has no inertial"
            yield found(kind, carrier, 0.0, 0.0, joint=group[0].joint, lacks=lacks)


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
