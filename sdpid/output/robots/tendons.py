"""Drives that turn two joints, as fixed tendons of MuJoCo.

The length of a fixed tendon is q_i + s·q_j with s = ±1. Its armature A adds A to the diagonal of
the mass matrix at both joints and s·A crosswise, its damping likewise; its dry friction acts with
the sign of v_i + s·v_j. So a `Coupling` is tendons, less what they add to the joints themselves.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.output.robots.mjcf_skeleton import quoted
from sdpid.robot.description.mjcf import MjcfTendon
from sdpid.robot.friction.terms import Coupling


@dataclass(frozen=True)
class Tendon:
    """A fixed tendon over two joints, (first, second), with factors 1 and `sign`."""

    name: str
    joints: tuple[str, str]
    sign: float
    armature: float = 0.0
    damping: float = 0.0
    frictionloss: float = 0.0

    def markup(self) -> str:
        """Return its element, without numbers that are zero."""
        values = {"armature": self.armature, "damping": self.damping}
        values["frictionloss"] = self.frictionloss
        given = "".join(f' {key}="{value!r}"' for key, value in values.items() if value)
        ends = "".join(
            f"<joint joint={quoted(joint)} coef={quoted(repr(factor))}/>"
            for joint, factor in zip(self.joints, (1.0, self.sign), strict=True)
        )
        return f"<fixed name={quoted(self.name)}{given}>{ends}</fixed>"


def tendons_of(term: Coupling, values: Array, joint_names: Sequence[str]) -> tuple[Tendon, ...]:
    """Return the tendons of a drive: one, or two where inertia and damping differ in sign."""
    inertia, viscous, coulomb = (float(value) for value in values)
    i, j = (joint_names.index(name) for name in (term.first, term.second))
    found = []
    for sign in (1.0, -1.0):
        tendon = Tendon(
            f"coupling_{i + 1}_{j + 1}{'' if sign > 0.0 else '_difference'}",
            (term.first, term.second),
            sign,
            max(sign * inertia, 0.0),
            max(sign * viscous, 0.0),
            max(coulomb, 0.0) if sign > 0.0 else 0.0,
        )
        if tendon.armature or tendon.damping or tendon.frictionloss:
            found.append(tendon)
    return tuple(found)


def added(tendons: Iterable[Tendon], joint_names: Sequence[str]) -> tuple[Array, Array]:
    """Return armature and damping (joints,) that tendons add at the joints themselves."""
    armature, damping = np.zeros((2, len(joint_names)))
    for each in tendons:
        for joint in each.joints:
            armature[joint_names.index(joint)] += each.armature
            damping[joint_names.index(joint)] += each.damping
    return armature, damping


def tendons_markup(tendons: Sequence[Tendon]) -> str:
    """Return the element that holds tendons."""
    return "\n".join(["<tendon>", *(f"  {each.markup()}" for each in tendons), "</tendon>"])


def couplings_of(
    tendons: Iterable[MjcfTendon], joint_names: Sequence[str]
) -> tuple[tuple[tuple[str, str], tuple[float, float, float]], ...]:
    """Return the crosswise inertia, viscous and dry friction of a file's tendons by two joints.

    Dry friction of the joints' sum alone: a `Coupling` has no other.
    """
    found: dict[tuple[str, str], Array] = {}
    for each in tendons:
        first, second = each.joints
        if {first, second} <= set(joint_names):
            sign = each.factors[0] * each.factors[1]
            dry = each.frictionloss if each.factors == (1.0, 1.0) else 0.0
            values = np.array([sign * each.armature, sign * each.damping, dry])
            found[first, second] = found.get((first, second), np.zeros(3)) + values
    return tuple(
        (pair, (float(values[0]), float(values[1]), float(values[2])))
        for pair, values in found.items()
    )
