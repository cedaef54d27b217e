"""Everything that an audit of a description can find: kind, severity, message and remedy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "note"]

_SECOND_MOMENT = (
    "; smallest second moment about the center of mass {value:.3g} kg·m² (limit 0); {hints}correct "
    "the tensor, or --repair writes the nearest that a body can have."
)
_SPREAD = (
    "the mass is spread {value:.3g} times as wide as the geometry allows (radius of gyration "
    "{gyration:.3g} m, geometry within {radius:.3g} m of the center of mass); "
)
_CARRIES_NOTHING = "is moved by joint '{joint}' but {lacks}, and nothing with mass is fixed to it; "

# By kind: the severity, and what is wrong, the number against its limit, and what to do.
_KINDS: dict[str, tuple[Severity, str]] = {
    # The text of the file.
    "unreadable": ("error", "{problem}; write the number that is meant."),
    "not_symmetric": ("error", "{problem}; write the number that is meant."),
    "geometry": (
        "note",
        "{count} geometries cannot be read and are not compared; the first: {first}",
    ),
    # The mass and the tensor of one body.
    "negative_mass": (
        "error",
        "the mass is {value:.4g} kg, the least is 0; give the true mass (it cannot be repaired "
        "from the rest).",
    ),
    "massless_inertia": (
        "error",
        "an inertia of up to {value:.3g} kg·m² without any mass; give the mass, or zeros for a "
        "frame that is no body.",
    ),
    "negative_moment": (
        "error",
        "the principal moments are {moments} kg·m², the least a body can have is 0"
        + _SECOND_MOMENT,
    ),
    "triangle": (
        "error",
        "the principal moments {moments} kg·m² violate the triangle inequality: the largest is "
        "{excess:.6g} times the sum of the others (limit 1)" + _SECOND_MOMENT,
    ),
    "point": (
        "note",
        "a mass of {mass:.4g} kg with no inertia at all, a point; give it the inertia of its "
        "shape.",
    ),
    "no_thickness": (
        "warning",
        "a rod or plate without thickness: the principal moments {moments} kg·m² are on the edge "
        "of what a body can have, and loaders (MuJoCo) refuse it; give it its thickness, or "
        "--repair.",
    ),
    "identity": (
        "warning",
        "the inertia is the identity, 1 kg·m² about every axis: a placeholder (with its mass of "
        "{mass:.4g} kg a radius of gyration of {gyration:.3g} m); give the true one.",
    ),
    # The body against its geometry.
    "com_outside": (
        "warning",
        "the center of mass is {value:.3g} m outside the convex hull of the collision geometry "
        "(limit {limit:.2g} m){visual}; check the origin of the inertial{units}.",
    ),
    "too_dense": (
        "warning",
        "the hull of the geometry would have {value:.3g} kg/m³, more than any metal (limit "
        "{limit:.0f}); {advice}",
    ),
    "too_light": (
        "warning",
        "the hull of the geometry would have {value:.3g} kg/m³, less than air or foam (limit "
        "{limit:g}); {advice}",
    ),
    "wrong_point": (
        "warning",
        _SPREAD + "it fits when it was given about the origin of the link: a URDF wants it about "
        "the center of mass.",
    ),
    "too_wide": ("warning", _SPREAD + "{advice}."),
    "too_wide without a shape": (
        "warning",
        "the radius of gyration is {value:.3g} m (limit {limit:g} m; the link has no geometry to "
        "compare with); check the units of mass and tensor.",
    ),
    "too_narrow": (
        "warning",
        "the radius of gyration is {gyration:.2g} m, {value:.2g} of the geometry's radius (least "
        "{limit}): a placeholder, or moments over mass too small by a unit; give the true inertia.",
    ),
    # Several bodies, and the joints between them.
    "copied": (
        "warning",
        "the same inertia as {others}, with masses from {least:.4g} to {most:.4g} kg: at most one "
        "of them is right; give each its own.",
    ),
    "copied with the mass": (
        "note",
        "the same mass and inertia as {others}, whose shape differs; check that they were not "
        "copied.",
    ),
    "no_inertials": (
        "warning",
        "no link has an inertial: this describes kinematics only; identify the inertias, or take "
        "them from the maker.",
    ),
    "moving_without_mass": (
        "warning",
        _CARRIES_NOTHING + "some loaders refuse it (MuJoCo), others invent a mass. Give it a mass, "
        "or --repair gives it a token one.",
    ),
    "moves_nothing": (
        "error",
        _CARRIES_NOTHING + "neither is there any beyond it: the joint has no inertia, its "
        "acceleration none. Give it a mass, or --repair gives it a token one.",
    ),
}


@dataclass(frozen=True, kw_only=True)
class DescriptionFinding:
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


def found(
    kind: str,
    link: str,
    value: float | None = None,
    limit: float | None = None,
    severity: Severity | None = None,
    **words: object,
) -> DescriptionFinding:
    """Return a finding of one kind; `value`, `limit` and `words` fill its message."""
    usual, message = _KINDS[kind]
    return DescriptionFinding(
        severity=severity or usual,
        kind=kind.partition(" ")[0],
        link=link,
        message=message.format(value=value, limit=limit, **words),
        value=value,
        limit=limit,
    )
