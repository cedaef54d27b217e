"""Friction and drive terms: what a joint's effort holds beside the inertia of the links.

``build_problem(..., friction=("coulomb", "viscous", sdpid.friction.Stribeck()))`` takes names and
term objects. A term of your own is a `JointwiseTerm` with its own ``shape``, or, where that depends
on the position, a `PositionwiseTerm`, or a `FrictionTerm`.
"""

from sdpid.robot.friction.posed import LoadFriction, PositionFriction, Tilt
from sdpid.robot.friction.position import (
    AtJoints,
    Hysteresis,
    PositionTerm,
    PositionwiseTerm,
    Spring,
)
from sdpid.robot.friction.term import FrictionTerm, JointwiseTerm, OpenParameter, TermParameter
from sdpid.robot.friction.terms import (
    AsymmetricCoulomb,
    Coulomb,
    Coupling,
    Offset,
    RotorInertia,
    SigmoidFriction,
    SquareRootFriction,
    Stribeck,
    Viscous,
)

__all__ = [
    "AsymmetricCoulomb",
    "AtJoints",
    "Coulomb",
    "Coupling",
    "FrictionTerm",
    "Hysteresis",
    "JointwiseTerm",
    "LoadFriction",
    "Offset",
    "OpenParameter",
    "PositionFriction",
    "PositionTerm",
    "PositionwiseTerm",
    "RotorInertia",
    "SigmoidFriction",
    "Spring",
    "SquareRootFriction",
    "Stribeck",
    "TermParameter",
    "Tilt",
    "Viscous",
]
