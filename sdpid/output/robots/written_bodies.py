"""Bodies to be written, for every format of robot."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import ExportError
from sdpid.estimation.estimate import Estimate
from sdpid.output.robots.urdf_tree import FixedChild
from sdpid.robot.description.inertials import inside
from sdpid.robot.inertia import (
    Consistency,
    margin,
    transform,
)
from sdpid.robot.model.model import RobotModel

# Rounding in the inertia about the center of mass, as a fraction of the size of the inertia that
# it is the difference of. A margin negative by no more than this is not negative.
_ROUNDING = 1e-14
# Readers reject a body that rounding has put on the edge (MuJoCo: principal moments below 1e-14
# kg·m², or a triangle inequality missed by one bit). Written bodies are at least this far inside,
# kg·m²; it changes efforts by some 1e-13 N·m.
_INSIDE = 1e-13
# The written file is read back at generic states; its efforts may differ by this fraction of the
# largest one.
_READ_BACK = 1e-10
STATES, SEED = 8, 20240229


def standard_parameters(estimate: Estimate, what: str, kind: str) -> Array:
    """Return theta of an estimate, or refuse an estimate without it.

    Raises
    ------
    ExportError
        When it has base parameters only.
    """
    if estimate.theta is None:
        raise ExportError(
            f"{what}: the estimate by {estimate.method} has base parameters only, "
            f"which no {kind} can hold; use solve_sdp or another solver that returns theta."
        )
    return estimate.theta


def _rounding(bodies: Array) -> Array:
    """Return the rounding error of the inertia about the center of mass, in kg·m²."""
    return np.asarray(_ROUNDING * np.abs(bodies[..., 4:]).max(axis=-1))


def require_consistent(
    robot: RobotModel, bodies: Array, consistency: Consistency, what: str
) -> None:
    """Raise where a body (links, 10) has no mass or violates the consistency.

    Raises
    ------
    ExportError
        With the link's name and its margin.
    """
    margins = margin(bodies, consistency)
    for name, body, value, error in zip(
        robot.link_names, bodies, margins, _rounding(bodies), strict=True
    ):
        if not body[0] > 0.0:
            raise ExportError(
                f"{what}: link '{name}' has a mass of {body[0]:.6g} kg, it must "
                "be positive; solve with a consistency."
            )
        if value < -error:
            raise ExportError(
                f"{what}: link '{name}' is not consistent, its margin is "
                f"{value:.3g} kg·m² and the least is 0; solve with a consistency, or with a "
                "positive Constraints.margin if the solver stopped just outside."
            )


def require_same_efforts(expected: Array, found: Array, what: str, reason: str) -> None:
    """Refuse a written robot whose efforts differ from those of the identified bodies.

    Raises
    ------
    ExportError
        With the difference and a reason.
    """
    error, scale = float(np.abs(found - expected).max()), float(np.abs(expected).max())
    if not error <= _READ_BACK * max(scale, 1.0):
        raise ExportError(
            f"{what}: the efforts of the written robot differ from the identified ones by "
            f"{error:.3g} of {scale:.3g} N·m (limit {_READ_BACK:.0e} of it); {reason}"
        )


def possible(bodies: Array, consistency: Consistency) -> bool:
    """Return whether bodies (..., 10) satisfy a consistency, but for rounding."""
    return bool(np.all(margin(bodies, consistency) >= -_rounding(bodies)))


def rest_of(body: Array, children: Sequence[FixedChild], consistency: Consistency) -> Array | None:
    """Return a body minus its fixed children's bodies, None where that is impossible.

    None also where a child's own inertial is impossible.
    """
    if not children:
        return body
    own = np.array([child.body for child in children])
    if not possible(own, consistency):
        return None
    inside = [
        transform(c.body, c.placement[:3, :3], c.placement[:3, 3])
        for c in children
        if c.body is not None
    ]
    rest = body - np.sum(inside, axis=0)
    enough = rest[0] > 0.0 and margin(rest, consistency) >= _INSIDE + _rounding(rest)
    return rest if enough else None


def possible_body(
    body: Sequence[Fraction], consistency: Consistency, link: str, what: str
) -> list[Fraction]:
    """Return a body off the edge of the consistent set by a few roundings, exactly.

    Raises
    ------
    ExportError
        When it is further outside than rounding.
    """
    found = inside(body, consistency)
    if found is None:
        raise ExportError(
            f"{what}: link '{link}' is not consistent; solve with a consistency, or with a "
            "positive Constraints.margin if the solver stopped just outside."
        )
    return found
