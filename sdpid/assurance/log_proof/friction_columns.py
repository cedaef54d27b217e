"""Columns of friction terms, enclosed where a formula of the samples' own motion gives them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.outward import UNIT as U
from sdpid.assurance.log_proof.elementary import decaying, hyperbolic_tangent
from sdpid.assurance.log_proof.enclosure import Enclosed
from sdpid.robot.friction.motion import Motion
from sdpid.robot.friction.term import FrictionTerm, joint_speeds
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

# Columns (joints, parameters, K) of a term and bounds (joints, parameters) of their errors.
Columns = tuple[Array, Array]


def has_formula(term: FrictionTerm, *, filtered: bool) -> bool:
    """Return whether a term's columns are a formula of the samples' velocity and acceleration.

    They are not where they passed the efforts' filter, or depend on the pose; nor are those of
    terms that are not of this package.
    """
    if filtered and not term.linear:
        return False
    if isinstance(term, Stribeck) and term.exponent not in (1.0, 2.0):
        return False
    return type(term) in (*_SHAPES, AsymmetricCoulomb, Coupling)


def enclosed_columns(term: FrictionTerm, motion: Motion, names: Sequence[str]) -> Columns:
    """Return the columns of a term that has a formula, at K samples.

    Parameters
    ----------
    term : FrictionTerm
        The term.
    motion : Motion
        The samples.
    names : sequence of str
        The joints that have friction.
    """
    v, a = (
        Enclosed.exact(np.ascontiguousarray(x.T)) for x in (motion.velocity, motion.acceleration)
    )
    if isinstance(term, Coupling):
        return _coupling(term, v, a, names)
    if isinstance(term, AsymmetricCoulomb):
        sign = _sign(term, v)
        # To clip at zero does not make errors larger.
        sides = [replace(sign, mid=clip(sign.mid, 0.0)) for clip in (np.maximum, np.minimum)]
        pairs = [_diagonal(side) for side in sides]
        return (
            np.concatenate([mid for mid, _ in pairs], axis=1),
            np.concatenate([rad for _, rad in pairs], axis=1),
        )
    return _diagonal(_SHAPES[type(term)](term, v, a))


def _sign(term: Any, v: Enclosed) -> Enclosed:
    """Return the smooth sign of velocities, zero in the dead zone."""
    sign = _smooth_sign(v, joint_speeds(term, "width", len(v.mid)))
    return replace(sign, mid=np.where(np.abs(v.mid) < term.dead_zone, 0.0, sign.mid))


def _smooth_sign(v: Enclosed, width: Array) -> Enclosed:
    """Return sign(v), or tanh(v/width) where the width is positive, as for `_bend`."""
    smooth = width > 0.0
    sign = Enclosed.exact(np.sign(v.mid))
    if not smooth.any():
        return sign
    curve = _bend(v, np.where(smooth, width, 1.0))
    mid = np.where(smooth[:, None], curve.mid, sign.mid)
    return Enclosed(mid, np.where(smooth, curve.rad, 0.0), sign.size)


def _bend(v: Enclosed, speed: Array) -> Enclosed:
    """Return tanh(v/speed) of velocities that are right but for one rounding.

    With the quotient's the argument is off by 2u of itself, and x·tanh′(x) is at most 0.45.
    """
    return hyperbolic_tangent(_quotient(v, speed)).off(U)


def _quotient(v: Enclosed, speed: Array) -> Enclosed:
    """Return the midpoints over speeds, as they are rounded."""
    return Enclosed.exact(v.mid / speed[:, None])


def _square_root(term: Any, v: Enclosed, a: Enclosed) -> Enclosed:
    """Return sign(v)·√|v|; the root rounds once."""
    root = Enclosed.exact(np.sign(v.mid) * np.sqrt(np.abs(v.mid)))
    return root.off(U * root.size)


def _peak(term: Any, v: Enclosed, a: Enclosed) -> Enclosed:
    """Return the Stribeck peak, exp(−|v/speed|^exponent)·sign(v)."""
    n = len(v.mid)
    ratio = _quotient(replace(v, mid=np.abs(v.mid)), joint_speeds(term, "velocity", n))
    power = Enclosed.exact(ratio.mid**2) if term.exponent == 2.0 else ratio
    # The exponent is off by 3u of itself at most, and x·exp(−x) is at most 0.37.
    return decaying(power).off(2.0 * U) * _smooth_sign(v, joint_speeds(term, "width", n))


def _sigmoid(term: Any, v: Enclosed, a: Enclosed) -> Enclosed:
    """Return tanh(v/speed)."""
    return _bend(v, joint_speeds(term, "velocity", len(v.mid)))


_SHAPES: dict[type[FrictionTerm], Callable[[Any, Enclosed, Enclosed], Enclosed]] = {
    Coulomb: lambda term, v, a: _sign(term, v),
    Viscous: lambda term, v, a: v,
    Offset: lambda term, v, a: Enclosed.exact(np.ones_like(v.mid)),
    RotorInertia: lambda term, v, a: a,
    SquareRootFriction: _square_root,
    Stribeck: _peak,
    SigmoidFriction: _sigmoid,
}


def _coupling(term: Coupling, v: Enclosed, a: Enclosed, names: Sequence[str]) -> Columns:
    """Return the three columns of a coupling; the sign of a sum survives its rounding."""
    i, j = (list(names).index(name) for name in (term.first, term.second))
    sign = _smooth_sign(v.at([i]) + v.at([j]), np.full(1, term.width))
    n, count = v.mid.shape
    mid, rad = np.zeros((n, 3, count)), np.zeros((n, 3))
    for own, other in ((i, j), (j, i)):
        mid[own] = a.mid[other], v.mid[other], sign.mid[0]
        rad[own, 2] = sign.rad[0]
    return mid, rad


def _diagonal(shape: Enclosed) -> Columns:
    """Return the columns of which each joint has its own."""
    n, count = shape.mid.shape
    mid, rad, joints = np.zeros((n, n, count)), np.zeros((n, n)), np.arange(n)
    mid[joints, joints], rad[joints, joints] = shape.mid, shape.rad
    return mid, rad
