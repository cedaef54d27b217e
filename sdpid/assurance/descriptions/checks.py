"""Numbers of the bodies of a description, and checks of each and of all together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.descriptions.findings import DescriptionFinding, found
from sdpid.estimation.constraints.hull import Hull
from sdpid.robot.description.bodies import DescribedBody, exists
from sdpid.robot.inertia import complement, second_moment_from_inertia, transform

# Loaders refuse what rounding cannot tell from impossible: principal moments below 1e-14 kg·m²
# (MuJoCo), or triangle inequalities missed by a rounding. Bodies with less than this, in kg·m² or
# as a share of the largest moment, have no thickness.
THIN = 1e-13
THIN_SHARE = 1e-14
# Osmium has 22 600 kg/m³. The hull holds at least the volume of the shape.
DENSEST = 25e3
# Balsa and foam have 10 to 150 kg/m³; a hull ten times the volume of the part is no surprise.
LIGHTEST = 1.0
# Simplified geometry may be smaller than the part by this share.
SPREAD = 1.1
# A center of mass farther outside than this (m), or this share of the shape's radius, is not a
# matter of simplified geometry.
OUTSIDE, OUTSIDE_SHARE = 2e-3, 0.02
# Radius of gyration over the shape's radius: solids and shells have 0.3 to 0.8.
CONCENTRATED = 0.03
TYPICAL_RADIUS = 0.45
# Without geometry: no link of a robot has a radius of gyration of more than this, m.
LARGEST_RADIUS = 5.0
# Few digits explain anything; rounding is offered as the reason for misses up to this share.
_ROUNDED_SHARE = 0.01
# Factors that a wrong unit makes, with the mistake. Inertia over mass.
_INERTIA_UNITS = {
    1e3: "g·m² written as kg·m²",
    1e4: "kg·cm² written as kg·m²",
    1e6: "kg·mm² written as kg·m²",
    1e7: "g·cm² written as kg·m²",
    1e9: "g·mm² written as kg·m²",
}
# A ratio this near a factor of units, in decades, is taken for one.
_DECADES = 0.7
# Extents of the shapes of two links that differ by less, relative, are those of the same part or
# of its mirror image.
_SAME_PART = 0.01


@dataclass(frozen=True, kw_only=True)
class BodyAudit:
    """The numbers of one body.

    Attributes
    ----------
    link : str
        The link.
    moving : bool
        Whether a joint moves it.
    consistent : bool or None
        Whether some body has these numbers, decided in exact arithmetic; None without numbers.
    mass : float or None
        kg.
    com : tuple of float or None
        Center of mass in the link's frame, m.
    moments : tuple of float or None
        Principal moments about the center of mass, rising, kg·m².
    second_moment : float or None
        Smallest eigenvalue of the second moments about the center of mass, kg·m²: the one of the
        pseudo-inertia once its frame is moved there.
    triangle_ratio : float or None
        Largest principal moment over the sum of the others, at most 1 for a body; None where that
        sum is not positive.
    gyration : float or None
        Radius of gyration about the center of mass, m; None where it is not real.
    com_outside : float or None
        Distance of the center of mass from the hull of the collision geometry (of the visual one
        where there is no other), m; negative inside.
    density : float or None
        Mass over the volume of the hull of all geometry, kg/m³: the least that it can be.
    """

    link: str
    moving: bool
    consistent: bool | None
    mass: float | None
    com: tuple[float, ...] | None
    moments: tuple[float, ...] | None
    second_moment: float | None
    triangle_ratio: float | None
    gyration: float | None
    com_outside: float | None
    density: float | None


class Shapes(NamedTuple):
    """Hulls of a link's collision geometry (of all where it has none) and of all its geometry."""

    collision: Hull
    whole: Hull


def consistent(body: DescribedBody) -> bool | None:
    """Return whether some body has this mass and tensor, decided exactly; None if unreadable.

    A body without mass must have no inertia.
    """
    if body.mass is None or body.entries is None or body.com is None:
        return None
    if body.mass > 0.0:
        return exists(body.mass, body.entries, "pseudo_inertia")
    return body.mass == 0.0 and not any(body.entries)


def least_second_moment(tensor: Array) -> float:
    """Return the smallest second moment about the center of mass, kg·m²."""
    return float(np.linalg.eigvalsh(second_moment_from_inertia(tensor))[0])


def thin(body: DescribedBody) -> bool:
    """Return whether a consistent tensor that is not all zero is too flat for loaders."""
    tensor = body.tensor
    if tensor is None or body.mass is None or not body.mass > 0.0 or not tensor.any():
        return False
    return least_second_moment(tensor) < thin_limit(tensor)


def thin_limit(tensor: Array) -> float:
    """Return the second moment below which loaders may refuse a body, kg·m²."""
    return max(THIN, THIN_SHARE * float(np.abs(tensor).max()))


def numbers_of(body: DescribedBody, shapes: Shapes | None) -> BodyAudit:
    """Return the numbers of a body, as far as they exist."""
    tensor, mass, com = body.tensor, body.mass, body.com
    moments = second = ratio = gyration = outside = density = None
    heavy = mass if mass is not None and mass > 0.0 else None
    if tensor is not None:
        moments = tuple(np.linalg.eigvalsh(tensor).tolist())
        second, others = least_second_moment(tensor), moments[0] + moments[1]
        ratio = moments[2] / others if others > 0.0 else None
        trace = float(np.trace(tensor))
        gyration = float(np.sqrt(0.5 * trace / heavy)) if heavy and trace >= 0.0 else None
    if shapes is not None and heavy:
        density = heavy / shapes.whole.volume
        outside = None if com is None else shapes.collision.distance(com)
    return BodyAudit(
        link=body.name,
        moving=body.moving,
        consistent=consistent(body) if body.described else None,
        mass=mass,
        com=None if com is None else tuple(com.tolist()),
        moments=moments,
        second_moment=second,
        triangle_ratio=ratio,
        gyration=gyration,
        com_outside=outside,
        density=density,
    )


def check_numbers(body: DescribedBody) -> Iterator[DescriptionFinding]:
    """Check what needs no geometry: the text, the mass and the tensor."""
    name = body.name
    for problem in body.problems:
        kind = "not_symmetric" if "symmetric" in problem else "unreadable"
        yield found(kind, name, problem=problem)
    mass, tensor, possible = body.mass, body.tensor, consistent(body)
    if mass is None or tensor is None or possible is None:
        return
    if mass < 0.0:
        yield found("negative_mass", name, mass, 0.0)
    elif mass == 0.0 and not possible:
        yield found("massless_inertia", name, float(np.abs(tensor).max()), 0.0)
    elif not possible:
        yield _impossible(body, tensor, mass)
    elif mass > 0.0 and not tensor.any():
        moves = body.moving and body.carrier == name
        yield found("point", name, 0.0, 0.0, "warning" if moves else "note", mass=mass)
    elif thin(body):
        value, moments = least_second_moment(tensor), np.linalg.eigvalsh(tensor)
        yield found("no_thickness", name, value, thin_limit(tensor), moments=_triple(moments))
    if np.array_equal(tensor, np.eye(3)):
        gyration = np.sqrt(1.5 / mass) if mass > 0.0 else np.inf
        yield found("identity", name, 1.0, mass=mass, gyration=gyration)


def _impossible(body: DescribedBody, tensor: Array, mass: float) -> DescriptionFinding:
    """Return the finding of a tensor that no body has, with what may explain it."""
    moments = np.linalg.eigvalsh(tensor)
    largest = float(np.abs(moments).max())
    # Exactly it is negative; rounding may not see it.
    least = min(least_second_moment(tensor), -0.0)
    hints = []
    # A change of every entry by h moves eigenvalues of the second moments by at most 4.5·h: 3·h by
    # the tensor, 1.5·h by half its trace.
    if -least <= min(4.5 * body.half_digit, _ROUNDED_SHARE * largest):
        hints.append(
            "the rounding of the written digits can explain it: write more digits, or --repair"
        )
    if float(np.abs(tensor).max()) < THIN:
        hints.append("they are zero but for rounding: a point, which has no inertia")
    elif body.com is not None and body.com.any():
        com = body.rotation.T @ body.com
        if least_second_moment(tensor + mass * complement(np.outer(com, com))) >= 0.0:
            hints.append(
                "it holds once the parallel-axis term of the center of mass is added: perhaps "
                "that was taken off twice, or the tensor belongs to another point"
            )
    others = moments[0] + moments[1]
    return found(
        "negative_moment" if moments[0] < -1e-15 * largest else "triangle",
        body.name,
        least,
        0.0,
        moments=_triple(moments),
        excess=moments[2] / others if others > 0.0 else np.inf,
        hints="".join(f"{hint}; " for hint in hints),
    )


def _check_shape(
    body: DescribedBody, numbers: BodyAudit, shapes: Shapes | None
) -> Iterator[DescriptionFinding]:
    """Check a body with mass against the geometry of its link, as far as there is one."""
    name, mass, com, tensor = body.name, body.mass, body.com, body.tensor
    if mass is None or tensor is None or not mass > 0.0:
        return
    gyration, possible = numbers.gyration or 0.0, consistent(body)
    if shapes is None:
        if possible and gyration > LARGEST_RADIUS:
            yield found("too_wide without a shape", name, gyration, LARGEST_RADIUS)
        return
    if com is None or numbers.com_outside is None or numbers.density is None:
        return
    collision, whole = shapes
    outside, size = numbers.com_outside, collision.radius(collision.corners.mean(axis=0))
    limit = OUTSIDE + OUTSIDE_SHARE * size
    if outside > limit:
        hidden = whole.distance(com) <= limit
        yield found(
            "com_outside",
            name,
            outside,
            limit,
            "note" if hidden else "warning",
            visual=", inside the one with the visual geometry" if hidden else "",
            units=" (millimeters?)" if outside > 100.0 * size else "",
        )
    density, advice = numbers.density, "check the mass and the geometry."
    if density > DENSEST:
        grams = LIGHTEST * 100.0 < density * 1e-3 < DENSEST
        yield found(
            "too_dense", name, density, DENSEST, advice="is the mass in grams?" if grams else advice
        )
    elif density < LIGHTEST:
        scale = "is the geometry in millimeters (mesh scale)?"
        yield found(
            "too_light", name, density, LIGHTEST, advice=scale if density < 1e-4 else advice
        )
    if tensor.any() and possible:
        P = second_moment_from_inertia(tensor)
        turned = body.rotation @ P @ body.rotation.T / mass
        yield from _check_spread(name, com, turned, gyration, whole)


def _check_spread(
    name: str, com: Array, covariance: Array, gyration: float, hull: Hull
) -> Iterator[DescriptionFinding]:
    """Check that the mass is spread neither wider nor far less than the geometry."""
    radius = hull.radius(com)
    slack = OUTSIDE + OUTSIDE_SHARE * radius
    spread = hull.spread(com, covariance, slack=slack) or 0.0
    if spread > SPREAD or gyration > radius + slack:
        about = covariance - np.outer(com, com)
        other = hull.spread(com, about, slack=slack)
        possible = np.linalg.eigvalsh(about)[0] >= -1e-12 * float(np.trace(covariance))
        fits = possible and other is not None and other <= 1.0
        yield found(
            "wrong_point" if fits else "too_wide",
            name,
            max(spread, gyration / radius),
            SPREAD,
            gyration=gyration,
            radius=radius,
            advice=_unit((gyration / (TYPICAL_RADIUS * radius)) ** 2),
        )
    elif gyration < CONCENTRATED * radius:
        yield found("too_narrow", name, gyration / radius, CONCENTRATED, gyration=gyration)


def _unit(factor: float) -> str:
    """Return the unit that makes the inertia too large by about this factor, as advice."""
    for unit, mistake in _INERTIA_UNITS.items():
        if abs(np.log10(factor / unit)) < _DECADES and factor > 300.0:
            return f"that is about {unit:.0e} times too much: {mistake}?"
    return "check the tensor and the geometry"


def _triple(values: Iterable[float]) -> str:
    """Return three numbers as text."""
    return ", ".join(f"{x:.6g}" for x in values)


def checked(
    bodies: Sequence[DescribedBody], numbers: Sequence[BodyAudit], shapes: Mapping[str, Shapes]
) -> Iterator[DescriptionFinding]:
    """Check each body with its numbers, and all of them together."""
    for body, of_it in zip(bodies, numbers, strict=True):
        yield from check_numbers(body)
        yield from _check_shape(body, of_it, shapes.get(body.name))
    yield from _check_copies(bodies, shapes)
    yield from _check_moving(bodies)


def _check_copies(
    bodies: Sequence[DescribedBody], shapes: Mapping[str, Shapes]
) -> Iterator[DescriptionFinding]:
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


def _check_moving(bodies: Sequence[DescribedBody]) -> Iterator[DescriptionFinding]:
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
