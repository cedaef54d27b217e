"""Checks of the inertia of one body of a description."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.verify import positive_semidefinite
from sdpid.assurance.descriptions.link_shape import Shape
from sdpid.robot.description.bodies import DescribedBody, exact_second_moment
from sdpid.robot.inertia import complement, second_moment_from_inertia

Severity = Literal["error", "warning", "note"]

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


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One error, warning or note about a description.

    Attributes
    ----------
    severity : {"error", "warning", "note"}
        No body can have it; implausible; worth knowing.
    kind : str
        A short name, stable for programs.
    link : str
        The link, empty for the whole description.
    message : str
        What, the number against its limit, and what to do.
    value, limit : float or None
        The number and its limit.
    """

    severity: Severity
    kind: str
    link: str
    message: str
    value: float | None = None
    limit: float | None = None


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


def thin(body: DescribedBody) -> bool:
    """Return whether a consistent tensor that is not all zero is too flat for loaders."""
    tensor = body.tensor
    if tensor is None or body.mass is None or not body.mass > 0.0 or not tensor.any():
        return False
    least = float(np.linalg.eigvalsh(second_moment_from_inertia(tensor))[0])
    return least < thin_limit(tensor)


def thin_limit(tensor: Array) -> float:
    """Return the second moment below which loaders may refuse a body, kg·m²."""
    return max(THIN, THIN_SHARE * float(np.abs(tensor).max()))


def check_numbers(body: DescribedBody) -> list[Finding]:
    """Check what needs no geometry: the text, the mass and the tensor."""
    name = body.name
    found = [
        Finding(
            severity="error",
            kind="unreadable" if "symmetric" not in problem else "not_symmetric",
            link=name,
            message=f"{problem}; write the number that is meant.",
        )
        for problem in body.problems
    ]
    mass, tensor, possible = body.mass, body.tensor, consistent(body)
    if mass is None or tensor is None or possible is None or body.entries is None:
        return found
    if mass < 0.0:
        found.append(
            Finding(
                severity="error",
                kind="negative_mass",
                link=name,
                message=f"the mass is {mass:.4g} kg, the least is 0; give the true mass (it "
                "cannot be repaired from the rest).",
                value=mass,
                limit=0.0,
            )
        )
    elif mass == 0.0 and not possible:
        found.append(
            Finding(
                severity="error",
                kind="massless_inertia",
                link=name,
                message=f"an inertia of up to {np.abs(tensor).max():.3g} kg·m² without any mass; "
                "give the mass, or zeros for a frame that is no body.",
                value=float(np.abs(tensor).max()),
                limit=0.0,
            )
        )
    elif not possible:
        found.append(_impossible(body, tensor, mass))
    elif mass > 0.0 and not tensor.any():
        found.append(
            Finding(
                severity="warning" if body.moving and body.carrier == name else "note",
                kind="point",
                link=name,
                message=f"a mass of {mass:.4g} kg with no inertia at all, a point; give it the "
                "inertia of its shape.",
                value=0.0,
                limit=0.0,
            )
        )
    elif thin(body):
        moments = np.linalg.eigvalsh(tensor)
        found.append(
            Finding(
                severity="warning",
                kind="no_thickness",
                link=name,
                message=f"a rod or plate without thickness: the principal moments "
                f"{_triple(moments)} kg·m² are on the edge of what a body can have, and loaders "
                "(MuJoCo) refuse it; give it its thickness, or --repair.",
                value=float(np.linalg.eigvalsh(second_moment_from_inertia(tensor))[0]),
                limit=thin_limit(tensor),
            )
        )
    if np.array_equal(tensor, np.eye(3)):
        found.append(
            Finding(
                severity="warning",
                kind="identity",
                link=name,
                message=f"the inertia is the identity, 1 kg·m² about every axis: a placeholder "
                f"(with its mass of {mass:.4g} kg a radius of gyration of "
                f"{np.sqrt(1.5 / mass) if mass > 0.0 else np.inf:.3g} m); give the true one.",
                value=1.0,
            )
        )
    return found


def _impossible(body: DescribedBody, tensor: Array, mass: float) -> Finding:
    moments = np.linalg.eigvalsh(tensor)
    least = float(np.linalg.eigvalsh(second_moment_from_inertia(tensor))[0])
    # Exactly it is negative; rounding may not see it.
    least = min(least, -0.0)
    negative = moments[0] < -1e-15 * float(np.abs(moments).max())
    if negative:
        text = f"the principal moments are {_triple(moments)} kg·m², the least a body can have is 0"
    else:
        excess = moments[2] / (moments[0] + moments[1]) if moments[0] + moments[1] > 0.0 else np.inf
        text = (
            f"the principal moments {_triple(moments)} kg·m² violate the triangle inequality: "
            f"the largest is {excess:.6g} times the sum of the others (limit 1)"
        )
    hints = []
    # A change of every entry by h moves eigenvalues of the second moments by at most 4.5·h: 3·h by
    # the tensor, 1.5·h by half its trace.
    if -least <= min(4.5 * body.half_digit, _ROUNDED_SHARE * float(np.abs(moments).max())):
        hints.append(
            "the rounding of the written digits can explain it: write more digits, or --repair"
        )
    if float(np.abs(tensor).max()) < THIN:
        hints.append("they are zero but for rounding: a point, which has no inertia")
    elif body.com is not None:
        com = body.rotation.T @ body.com
        lifted = tensor + mass * complement(np.outer(com, com))
        if np.linalg.eigvalsh(second_moment_from_inertia(lifted))[0] >= 0.0 and com.any():
            hints.append(
                "it holds once the parallel-axis term of the center of mass is added: perhaps "
                "that was taken off twice, or the tensor belongs to another point"
            )
    hints.append("correct the tensor, or --repair writes the nearest that a body can have")
    return Finding(
        severity="error",
        kind="negative_moment" if negative else "triangle",
        link=body.name,
        message=f"{text}; smallest second moment about the center of mass {least:.3g} kg·m² "
        f"(limit 0); {'; '.join(hints)}.",
        value=least,
        limit=0.0,
    )


def check_without_shape(body: DescribedBody) -> list[Finding]:
    """Check a body whose link has no geometry to be compared with."""
    mass, tensor = body.mass, body.tensor
    if mass is None or tensor is None or not mass > 0.0 or not consistent(body):
        return []
    gyration = float(np.sqrt(0.5 * np.trace(tensor) / mass))
    if gyration <= LARGEST_RADIUS:
        return []
    return [
        Finding(
            severity="warning",
            kind="too_wide",
            link=body.name,
            message=f"the radius of gyration is {gyration:.3g} m (limit {LARGEST_RADIUS:g} m; the "
            "link has no geometry to compare with); check the units of mass and tensor.",
            value=gyration,
            limit=LARGEST_RADIUS,
        )
    ]


def check_shape(body: DescribedBody, collision: Shape, whole: Shape) -> list[Finding]:
    """Check a body with mass against its geometry.

    Parameters
    ----------
    body : DescribedBody
        The body.
    collision : Shape
        Hull of the collision geometry, in which the center of mass should be.
    whole : Shape
        Hull of all geometry, into which the body should fit.
    """
    mass, com, tensor = body.mass, body.com, body.tensor
    if mass is None or com is None or tensor is None or not mass > 0.0:
        return []
    name, found = body.name, []
    outside = collision.distance(com)
    size = collision.radius(collision.corners.mean(axis=0))
    limit = OUTSIDE + OUTSIDE_SHARE * size
    if outside > limit:
        hidden = whole.distance(com) <= limit
        found.append(
            Finding(
                severity="note" if hidden else "warning",
                kind="com_outside",
                link=name,
                message=f"the center of mass is {outside:.3g} m outside the convex hull of the "
                f"collision geometry (limit {limit:.2g} m)"
                + (", inside the one with the visual geometry" if hidden else "")
                + "; check the origin of the inertial"
                + (" (millimeters?)." if outside > 100.0 * size else "."),
                value=outside,
                limit=limit,
            )
        )
    found += _check_density(name, mass, whole)
    P = second_moment_from_inertia(tensor)
    if tensor.any() and consistent(body):
        turned = body.rotation @ P @ body.rotation.T / mass
        found += _check_spread(name, com, turned, whole)
    return found


def _check_density(name: str, mass: float, shape: Shape) -> list[Finding]:
    density = mass / shape.volume
    if LIGHTEST <= density <= DENSEST:
        return []
    if density > DENSEST:
        grams = LIGHTEST * 100.0 < density * 1e-3 < DENSEST
        text = (
            f"the hull of the geometry would have {density:.3g} kg/m³, more than any metal "
            f"(limit {DENSEST:.0f})"
        )
        advice = "is the mass in grams?" if grams else "check the mass and the geometry."
        return [
            Finding(
                severity="warning",
                kind="too_dense",
                link=name,
                message=f"{text}; {advice}",
                value=density,
                limit=DENSEST,
            )
        ]
    advice = (
        "is the geometry in millimeters (mesh scale)?"
        if density < 1e-4
        else "check the mass and the geometry."
    )
    return [
        Finding(
            severity="warning",
            kind="too_light",
            link=name,
            message=f"the hull of the geometry would have {density:.3g} kg/m³, less than air or "
            f"foam (limit {LIGHTEST:g}); {advice}",
            value=density,
            limit=LIGHTEST,
        )
    ]


def _check_spread(name: str, com: Array, covariance: Array, shape: Shape) -> list[Finding]:
    radius = shape.radius(com)
    gyration = float(np.sqrt(max(np.trace(covariance), 0.0)))
    slack = OUTSIDE + OUTSIDE_SHARE * radius
    spread = shape.spread(com, covariance, slack=slack)
    wide = spread is not None and spread > SPREAD
    if wide or gyration > radius + slack:
        about = covariance - np.outer(com, com)
        other = shape.spread(com, about, slack=slack)
        possible = np.linalg.eigvalsh(about)[0] >= -1e-12 * float(np.trace(covariance))
        if possible and other is not None and other <= 1.0:
            kind, advice = (
                "wrong_point",
                (
                    "it fits when it was given about the origin of the link: a URDF wants it about "
                    "the center of mass"
                ),
            )
        else:
            kind, advice = "too_wide", _unit((gyration / (TYPICAL_RADIUS * radius)) ** 2)
        ratio = max(spread or 0.0, gyration / radius)
        return [
            Finding(
                severity="warning",
                kind=kind,
                link=name,
                message=f"the mass is spread {ratio:.3g} times as wide as the geometry allows "
                f"(radius of gyration {gyration:.3g} m, geometry within {radius:.3g} m of the "
                f"center of mass); {advice}.",
                value=ratio,
                limit=SPREAD,
            )
        ]
    if gyration < CONCENTRATED * radius:
        return [
            Finding(
                severity="warning",
                kind="too_narrow",
                link=name,
                message=f"the radius of gyration is {gyration:.2g} m, {gyration / radius:.2g} of "
                f"the geometry's radius (least {CONCENTRATED}): a placeholder, or moments over "
                "mass too small by a unit; give the true inertia.",
                value=gyration / radius,
                limit=CONCENTRATED,
            )
        ]
    return []


def _unit(factor: float) -> str:
    for unit, mistake in _INERTIA_UNITS.items():
        if abs(np.log10(factor / unit)) < _DECADES and factor > 300.0:
            return f"that is about {unit:.0e} times too much: {mistake}?"
    return "check the tensor and the geometry"


def _triple(values: NDArray[np.floating[Any]]) -> str:
    return ", ".join(f"{float(x):.6g}" for x in values)
