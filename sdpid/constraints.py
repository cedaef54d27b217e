"""Constraints beside margins and bounds: masses, places of mass, symmetries, known parameters.

``sdpid.Constraints(others=(sdpid.constraints.TotalMass(12.5),))`` takes objects of these. One
of your own is a `Condition` whose `compile` returns rows and cones.
"""

from sdpid.estimation.constraints.condition import Condition, Cone, Layout, Row
from sdpid.estimation.constraints.equalities import (
    EqualLinks,
    Fixed,
    FixedLink,
    MirrorPair,
    MirrorSymmetry,
)
from sdpid.estimation.constraints.mass import (
    CenterOfMassInBox,
    CenterOfMassInEllipsoid,
    CenterOfMassInHull,
    MassInEllipsoid,
    TotalMass,
)
from sdpid.estimation.constraints.pairs import EqualFriction, equal_friction, mirror_pairs

__all__ = [
    "CenterOfMassInBox",
    "CenterOfMassInEllipsoid",
    "CenterOfMassInHull",
    "Condition",
    "Cone",
    "EqualFriction",
    "EqualLinks",
    "Fixed",
    "FixedLink",
    "Layout",
    "MassInEllipsoid",
    "MirrorPair",
    "MirrorSymmetry",
    "Row",
    "TotalMass",
    "equal_friction",
    "mirror_pairs",
]
