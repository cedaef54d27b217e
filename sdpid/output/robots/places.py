"""Places of identified friction terms in a robot file: attributes of joints, and tendons of MuJoCo.

The length of a fixed tendon is q_i + s·q_j with s = ±1. Its armature A adds A to the diagonal of
the mass matrix at both joints and s·A crosswise, its damping likewise; its dry friction acts with
the sign of v_i + s·v_j. So a `Coupling` is tendons, less what they add to the joints themselves.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import ExportError
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.for_robot import SMOOTH
from sdpid.output.robots.mjcf_skeleton import quoted
from sdpid.robot.description.mjcf import MjcfTendon
from sdpid.robot.friction.posed import Tilt
from sdpid.robot.friction.term import FrictionTerm, JointwiseTerm
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
from sdpid.robot.model.dynamics import RobotDynamics


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


Kind = type[JointwiseTerm]

# Functions of speed that dry friction and damping stand in for.
_CURVES = (SigmoidFriction, SquareRootFriction, Stribeck, AsymmetricCoulomb)

# Friction negative by no more than this (N·m, N·m·s/rad) is zero with a solver's rounding.
_FRICTION_ZERO = 1e-9

# Speeds, rad/s or m/s, up to which a curve is fitted where no recording says otherwise.
_NOMINAL = 1.0


@dataclass(frozen=True, eq=False)
class Part:
    """A term, the names of its parameters, and their values."""

    term: FrictionTerm
    names: tuple[str, ...]
    values: Array


class Places:
    """The terms of a problem by what a file can hold of them.

    Attributes
    ----------
    exact : dict of term to ndarray, shape (n,)
        Terms that have an attribute, and their values, negative ones as zero.
    curves : list of Part
        Functions of speed that dry friction and damping stand in for.
    lost : list of Part
        Terms for which there is no place.
    coupled : list of Part
        Drives of two joints that become tendons.
    offsets : list of Part
        Constant efforts that are written.
    kinds : list
        The terms whose attributes are written.
    robot : RobotModel
        The robot, under gravity as a tilt of the base turns it.

    Parameters
    ----------
    problem : Problem
        Terms and samples.
    theta : ndarray, shape (p,)
        Standard parameters.
    attributes : mapping
        The attribute for the parameter of a term, with Coulomb and Viscous among them.
    tendons, offsets : bool, optional
        Whether drives of two joints and constant efforts have a place.
    """

    def __init__(
        self,
        problem: Problem,
        theta: Array,
        attributes: Mapping[Kind, str],
        *,
        tendons: bool = False,
        offsets: bool = False,
    ) -> None:
        model = RobotDynamics(robot=problem.robot, terms=problem.friction, theta=theta)
        # Every file has room for the direction of gravity.
        self.robot = problem.robot.with_gravity(model.tilted_gravity)
        self.joints = problem.friction.joint_names
        self.attributes = attributes
        self.exact: dict[Kind, Array] = {}
        self._held: list[Part] = []
        self.curves: list[Part] = []
        self.lost: list[Part] = []
        self.coupled: list[Part] = []
        self.offsets: list[Part] = []
        at = 10 * problem.robot.n_links
        for term in problem.friction.terms:
            names = tuple(p.name for p in term.parameters(self.joints))
            part = Part(term, names, theta[at : at + len(names)])
            at += len(names)
            if isinstance(term, _CURVES) or (isinstance(term, Coulomb) and not _sharp(term)):
                self.curves.append(part)
            elif isinstance(term, JointwiseTerm) and type(term) in attributes:
                self._held.append(part)
                self.exact[type(term)] = np.maximum(part.values, 0.0)
            elif isinstance(term, Coupling) and tendons:
                self.coupled.append(part)
            elif isinstance(term, Offset) and offsets:
                self.offsets.append(part)
            elif type(term) is not Tilt:
                self.lost.append(part)
        self._keep_real_drives()
        stand_in = {Coulomb, Viscous} if self.curves or self.coupled else set()
        self.kinds = [kind for kind in attributes if kind in self.exact or kind in stand_in]

    @property
    def tendons(self) -> tuple[Tendon, ...]:
        """Tendons of the drives of two joints."""
        return tuple(
            each
            for part in self.coupled
            if isinstance(part.term, Coupling)
            for each in tendons_of(part.term, part.values, self.joints)
        )

    def added(self) -> dict[Kind, Array]:
        """Return armature and damping (n,) that tendons add at the joints themselves."""
        armature, damping = added(self.tendons, self.joints)
        return {RotorInertia: armature, Viscous: damping}

    @property
    def holds_tendons(self) -> bool:
        """Whether the joints have all of what tendons add at them."""
        return all(
            bool(np.all(more <= self.exact.get(kind, 0.0))) for kind, more in self.added().items()
        )

    def _keep_real_drives(self) -> None:
        """Leave out tendons that add more armature than the joints have: what is left is none."""
        own = self.exact.get(RotorInertia, np.zeros(len(self.joints)))
        if np.any(self.added()[RotorInertia] > own):
            self.lost = self.coupled + self.lost
            self.coupled = []

    def require_nonnegative(self, what: str) -> None:
        """Refuse identified values that have an attribute and are negative.

        Raises
        ------
        ExportError
            With the parameter, its joint and its value.
        """
        for part in self._held:
            parameters = part.term.parameters(self.joints)
            for joint, parameter, value in zip(self.joints, parameters, part.values, strict=True):
                if value < -_FRICTION_ZERO:
                    raise ExportError(
                        f"{what}: {parameter.name} of joint '{joint}' is {value:.3g} "
                        f"{parameter.unit}, the least is 0; solve with "
                        "Constraints(friction_nonnegative=True)."
                    )

    def by_joint(self, values: Mapping[Kind, Array]) -> dict[str, dict[str, float]]:
        """Return values (n,) of terms by joint and attribute."""
        return {
            joint: {self.attributes[kind]: float(numbers[j]) for kind, numbers in values.items()}
            for j, joint in enumerate(self.joints)
            if values
        }

    def at_nominal_speeds(self) -> dict[Kind, Array]:
        """Return values (n,) for the attributes, without a look at recorded efforts.

        Curves become the dry friction and damping, none negative, that fit them best at speeds up
        to a nominal one.
        """
        from scipy.optimize import nnls

        found = {kind: np.zeros(len(self.joints)) for kind in self.kinds} | self.exact
        if not self.curves:
            return self._less_tendons(found)
        speeds = np.linspace(-_NOMINAL, _NOMINAL, 101)
        v = np.tile(speeds[:, None], (1, len(self.joints)))
        effort = np.zeros_like(v)
        for part in self.curves:
            effort += part.term.columns(v, np.zeros_like(v), self.joints) @ part.values
        columns = np.column_stack([np.sign(speeds), speeds])
        fits = np.array([nnls(columns, effort[:, j])[0] for j in range(len(self.joints))])
        found[Coulomb] = found[Coulomb] + fits[:, 0]
        found[Viscous] = found[Viscous] + fits[:, 1]
        return self._less_tendons(found)

    def _less_tendons(self, values: dict[Kind, Array]) -> dict[Kind, Array]:
        """Return values without what tendons add at the joints themselves, at least zero."""
        more = self.added()
        return {kind: np.maximum(x - more.get(kind, 0.0), 0.0) for kind, x in values.items()}


def _sharp(term: Coulomb) -> bool:
    """Return whether Coulomb friction is as sharp as that of a description."""
    widths = np.atleast_1d(np.asarray(term.width, dtype=np.float64))
    return term.dead_zone == 0.0 and bool(np.all(widths <= SMOOTH))
