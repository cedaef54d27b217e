"""Checks of the inertia of one body of a description."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid.assurance.descriptions import findings
from sdpid.assurance.descriptions.findings import Finding, Severity
from sdpid.assurance.descriptions.link_shape import Shape, Shapes
from sdpid.robot.description.bodies import DescribedBody, exact_second_moment
from sdpid.robot.inertia import complement, second_moment_from_inertia
from sdpid.verifier.exact import positive_semidefinite

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


def consistent(body: DescribedBody) -> bool | None:
    """Return whether some body has this mass and tensor, decided exactly; None if unreadable.

    A body without mass must have no inertia.
    """
    if body.mass is None or body.entries is None or body.com is None:
        return None
    if body.mass < 0.0:
        return False
    if body.mass == 0.0:
        return not any(body.entries)
    return positive_semidefinite(exact_second_moment(body.entries))


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


def check_numbers(body: DescribedBody) -> Iterator[Finding]:
    """Check what needs no geometry: the text, the mass and the tensor."""
    name = body.name
    for problem in body.problems:
        rule = findings.NOT_SYMMETRIC if "symmetric" in problem else findings.UNREADABLE
        yield rule.found(name, problem=problem)
    mass, tensor, possible = body.mass, body.tensor, consistent(body)
    if mass is None or tensor is None or possible is None:
        return
    if mass < 0.0:
        yield findings.NEGATIVE_MASS.found(name, value=mass, limit=0.0)
    elif mass == 0.0 and not possible:
        largest = float(np.abs(tensor).max())
        yield findings.MASSLESS_INERTIA.found(name, value=largest, limit=0.0)
    elif not possible:
        yield _impossible(body, tensor, mass)
    elif mass > 0.0 and not tensor.any():
        moves = body.moving and body.carrier == name
        severity: Severity = "warning" if moves else "note"
        yield findings.POINT.found(name, value=0.0, limit=0.0, severity=severity, mass=mass)
    elif thin(body):
        value, moments = least_second_moment(tensor), _triple(np.linalg.eigvalsh(tensor))
        limit = thin_limit(tensor)
        yield findings.NO_THICKNESS.found(name, value=value, limit=limit, moments=moments)
    if np.array_equal(tensor, np.eye(3)):
        gyration = np.sqrt(1.5 / mass) if mass > 0.0 else np.inf
        yield findings.IDENTITY.found(name, value=1.0, mass=mass, gyration=gyration)


def _impossible(body: DescribedBody, tensor: Array, mass: float) -> Finding:
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
    negative = moments[0] < -1e-15 * largest
    return (findings.NEGATIVE_MOMENT if negative else findings.TRIANGLE).found(
        body.name,
        value=least,
        limit=0.0,
        moments=_triple(moments),
        excess=moments[2] / others if others > 0.0 else np.inf,
        hints="".join(f"{hint}; " for hint in hints),
    )


def check_shape(body: DescribedBody, shapes: Shapes | None) -> Iterator[Finding]:
    """Check a body with mass against the geometry of its link, as far as there is one."""
    name, mass, com, tensor = body.name, body.mass, body.com, body.tensor
    if mass is None or tensor is None or not mass > 0.0:
        return
    if shapes is None:
        gyration = float(np.sqrt(max(0.5 * np.trace(tensor) / mass, 0.0)))
        if consistent(body) and gyration > LARGEST_RADIUS:
            rule = findings.TOO_WIDE_WITHOUT_SHAPE
            yield rule.found(name, value=gyration, limit=LARGEST_RADIUS)
        return
    if com is None:
        return
    yield from _check_center(name, com, shapes)
    yield from _check_density(name, mass, shapes.whole)
    if tensor.any() and consistent(body):
        P = second_moment_from_inertia(tensor)
        turned = body.rotation @ P @ body.rotation.T / mass
        yield from _check_spread(name, com, turned, shapes.whole)


def _check_center(name: str, com: Array, shapes: Shapes) -> Iterator[Finding]:
    """Check that the center of mass is inside the collision geometry."""
    collision = shapes.collision
    outside = collision.distance(com)
    size = collision.radius(collision.corners.mean(axis=0))
    limit = OUTSIDE + OUTSIDE_SHARE * size
    if outside > limit:
        hidden = shapes.whole.distance(com) <= limit
        yield findings.COM_OUTSIDE.found(
            name,
            value=outside,
            limit=limit,
            severity="note" if hidden else "warning",
            visual=", inside the one with the visual geometry" if hidden else "",
            units=" (millimeters?)" if outside > 100.0 * size else "",
        )


def _check_density(name: str, mass: float, shape: Shape) -> Iterator[Finding]:
    """Check that the mass over the volume of the hull is that of some material."""
    density = mass / shape.volume
    advice = "check the mass and the geometry."
    if density > DENSEST:
        if LIGHTEST * 100.0 < density * 1e-3 < DENSEST:
            advice = "is the mass in grams?"
        yield findings.TOO_DENSE.found(name, value=density, limit=DENSEST, advice=advice)
    elif density < LIGHTEST:
        if density < 1e-4:
            advice = "is the geometry in millimeters (mesh scale)?"
        yield findings.TOO_LIGHT.found(name, value=density, limit=LIGHTEST, advice=advice)


def _check_spread(name: str, com: Array, covariance: Array, shape: Shape) -> Iterator[Finding]:
    """Check that the mass is spread neither wider nor far less than the geometry."""
    radius = shape.radius(com)
    gyration = float(np.sqrt(max(np.trace(covariance), 0.0)))
    slack = OUTSIDE + OUTSIDE_SHARE * radius
    spread = shape.spread(com, covariance, slack=slack) or 0.0
    if spread > SPREAD or gyration > radius + slack:
        about = covariance - np.outer(com, com)
        other = shape.spread(com, about, slack=slack)
        possible = np.linalg.eigvalsh(about)[0] >= -1e-12 * float(np.trace(covariance))
        fits = possible and other is not None and other <= 1.0
        yield (findings.WRONG_POINT if fits else findings.TOO_WIDE).found(
            name,
            value=max(spread, gyration / radius),
            limit=SPREAD,
            gyration=gyration,
            radius=radius,
            advice=_unit((gyration / (TYPICAL_RADIUS * radius)) ** 2),
        )
    elif gyration < CONCENTRATED * radius:
        share = gyration / radius
        yield findings.TOO_NARROW.found(name, value=share, limit=CONCENTRATED, gyration=gyration)


def _unit(factor: float) -> str:
    """Return the unit that makes the inertia too large by about this factor, as advice."""
    for unit, mistake in _INERTIA_UNITS.items():
        if abs(np.log10(factor / unit)) < _DECADES and factor > 300.0:
            return f"that is about {unit:.0e} times too much: {mistake}?"
    return "check the tensor and the geometry"


def _triple(values: NDArray[np.floating[Any]]) -> str:
    """Return three numbers as text."""
    return ", ".join(f"{float(x):.6g}" for x in values)
