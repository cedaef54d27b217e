"""Constraints as named objects: of which messages, multipliers, verdicts and prices are made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ConstraintKind = Literal["consistency", "mass", "sign", "theta_max", "row", "cone", "exists"]
Side = Literal["least", "most"]


@dataclass(frozen=True)
class Constraint:
    """One inequality or equation of a feasible set.

    Attributes
    ----------
    kind : {"consistency", "mass", "sign", "theta_max", "row", "cone", "exists"}
        Consistency of a link, bound on a mass, sign of a friction parameter, the widest bound on a
        parameter, a linear row or cone of a further condition, or that a body exists, which an
        entropic prior asks for.
    name : str
        The constraint in words, unlike any other's.
    index : int
        Of the matrix inequality, the parameter or the linear row in the `FeasibleSet`.
    link : str or None
        The link that it is about; None where it is about none, or several.
    side : {"least", "most"} or None
        Which limit of the quantity it is; None for consistency, equations and cones.
    limit : float or None
        The limit, of consistency the margin; None for cones.
    unit : str or None
        Of the limit; None where a condition does not say.
    """

    kind: ConstraintKind
    name: str
    index: int
    link: str | None = None
    side: Side | None = None
    limit: float | None = None
    unit: str | None = None

    @property
    def sign(self) -> float:
        """1 for a lower limit and for what has no side, −1 for an upper one."""
        return -1.0 if self.side == "most" else 1.0

    @property
    def group(self) -> str:
        """What it belongs to: all links' consistency, all masses' upper bounds, or itself."""
        if self.kind == "mass":
            return f"masses at {self.side} {self.limit:g} kg"
        groups = {
            "consistency": "consistency of the links",
            "sign": "friction_nonnegative",
            "exists": "entropic prior",
        }
        return groups.get(self.kind, self.name)
