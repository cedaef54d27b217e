"""Everything that an audit of a description can find: kind, severity, message and remedy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

Severity = Literal["error", "warning", "note"]


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


@dataclass(frozen=True)
class Rule:
    """One kind of finding; ``what; remedy`` is the template of its message."""

    kind: str
    severity: Severity
    what: str
    remedy: str

    def found(
        self,
        link: str,
        *,
        value: float | None = None,
        limit: float | None = None,
        severity: Severity | None = None,
        **words: object,
    ) -> Finding:
        """Return the finding; `value`, `limit` and `words` fill the message."""
        numbers: dict[str, Any] = {"value": value, "limit": limit, **words}
        return Finding(
            severity=severity or self.severity,
            kind=self.kind,
            link=link,
            message=f"{self.what}; {self.remedy}".format(**numbers),
            value=value,
            limit=limit,
        )


# The text of the file.
UNREADABLE = Rule("unreadable", "error", "{problem}", "write the number that is meant.")
NOT_SYMMETRIC = Rule("not_symmetric", "error", "{problem}", "write the number that is meant.")
GEOMETRY = Rule(
    "geometry",
    "note",
    "{count} geometries cannot be read and are not compared",
    "the first: {first}",
)

# The mass and the tensor of one body.
NEGATIVE_MASS = Rule(
    "negative_mass",
    "error",
    "the mass is {value:.4g} kg, the least is 0",
    "give the true mass (it cannot be repaired from the rest).",
)
MASSLESS_INERTIA = Rule(
    "massless_inertia",
    "error",
    "an inertia of up to {value:.3g} kg·m² without any mass",
    "give the mass, or zeros for a frame that is no body.",
)
_SECOND_MOMENT = "; smallest second moment about the center of mass {value:.3g} kg·m² (limit 0)"
_CORRECT = "{hints}correct the tensor, or --repair writes the nearest that a body can have."
NEGATIVE_MOMENT = Rule(
    "negative_moment",
    "error",
    "the principal moments are {moments} kg·m², the least a body can have is 0" + _SECOND_MOMENT,
    _CORRECT,
)
TRIANGLE = Rule(
    "triangle",
    "error",
    "the principal moments {moments} kg·m² violate the triangle inequality: the largest is "
    "{excess:.6g} times the sum of the others (limit 1)" + _SECOND_MOMENT,
    _CORRECT,
)
POINT = Rule(
    "point",
    "note",
    "a mass of {mass:.4g} kg with no inertia at all, a point",
    "give it the inertia of its shape.",
)
NO_THICKNESS = Rule(
    "no_thickness",
    "warning",
    "a rod or plate without thickness: the principal moments {moments} kg·m² are on the edge of "
    "what a body can have, and loaders (MuJoCo) refuse it",
    "give it its thickness, or --repair.",
)
IDENTITY = Rule(
    "identity",
    "warning",
    "the inertia is the identity, 1 kg·m² about every axis: a placeholder (with its mass of "
    "{mass:.4g} kg a radius of gyration of {gyration:.3g} m)",
    "give the true one.",
)

# The body against its geometry.
COM_OUTSIDE = Rule(
    "com_outside",
    "warning",
    "the center of mass is {value:.3g} m outside the convex hull of the collision geometry "
    "(limit {limit:.2g} m){visual}",
    "check the origin of the inertial{units}.",
)
TOO_DENSE = Rule(
    "too_dense",
    "warning",
    "the hull of the geometry would have {value:.3g} kg/m³, more than any metal (limit "
    "{limit:.0f})",
    "{advice}",
)
TOO_LIGHT = Rule(
    "too_light",
    "warning",
    "the hull of the geometry would have {value:.3g} kg/m³, less than air or foam (limit "
    "{limit:g})",
    "{advice}",
)
_SPREAD = (
    "the mass is spread {value:.3g} times as wide as the geometry allows (radius of gyration "
    "{gyration:.3g} m, geometry within {radius:.3g} m of the center of mass)"
)
WRONG_POINT = Rule(
    "wrong_point",
    "warning",
    _SPREAD,
    "it fits when it was given about the origin of the link: a URDF wants it about the center of "
    "mass.",
)
TOO_WIDE = Rule("too_wide", "warning", _SPREAD, "{advice}.")
TOO_WIDE_WITHOUT_SHAPE = Rule(
    "too_wide",
    "warning",
    "the radius of gyration is {value:.3g} m (limit {limit:g} m; the link has no geometry to "
    "compare with)",
    "check the units of mass and tensor.",
)
TOO_NARROW = Rule(
    "too_narrow",
    "warning",
    "the radius of gyration is {gyration:.2g} m, {value:.2g} of the geometry's radius (least "
    "{limit}): a placeholder, or moments over mass too small by a unit",
    "give the true inertia.",
)

# Several bodies, and the joints between them.
COPIED = Rule(
    "copied",
    "warning",
    "the same inertia as {others}, with masses from {least:.4g} to {most:.4g} kg: at most one of "
    "them is right",
    "give each its own.",
)
COPIED_WITH_MASS = Rule(
    "copied",
    "note",
    "the same mass and inertia as {others}, whose shape differs",
    "check that they were not copied.",
)
NO_INERTIALS = Rule(
    "no_inertials",
    "warning",
    "no link has an inertial: this describes kinematics only",
    "identify the inertias, or take them from the maker.",
)
_CARRIES_NOTHING = "is moved by joint '{joint}' but {lacks}, and nothing with mass is fixed to it"
MOVING_WITHOUT_MASS = Rule(
    "moving_without_mass",
    "warning",
    _CARRIES_NOTHING,
    "some loaders refuse it (MuJoCo), others invent a mass. Give it a mass, or --repair gives it "
    "a token one.",
)
MOVES_NOTHING = Rule(
    "moves_nothing",
    "error",
    _CARRIES_NOTHING,
    "neither is there any beyond it: the joint has no inertia, its acceleration none. Give it a "
    "mass, or --repair gives it a token one.",
)
