"""Friction and drive terms: what a joint's effort holds beside the links' inertia.

A term is a small object that names its parameters and gives their regressor columns from the
joint velocities and accelerations. The effort it stands for is ``columns @ parameters``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sdpid._arrays import Array
from sdpid.errors import ModelError


@dataclass(frozen=True)
class TermParameter:
    """One parameter of a term.

    Attributes
    ----------
    name : str
        Short name with the joint's number counted from 1, such as ``Fs1``.
    unit : str
        Its unit; for a prismatic joint read N for N.m and m for rad.
    nonnegative : bool
        Whether physics forbids negative values.
    joint : int
        Index of the joint after whose link it is listed.
    """

    name: str
    unit: str
    nonnegative: bool
    joint: int


class FrictionTerm(ABC):
    """Base of every term: its parameters, and their columns."""

    @abstractmethod
    def parameters(self, joint_names: Sequence[str]) -> tuple[TermParameter, ...]:
        """Return the parameters of a robot with these joints."""

    @abstractmethod
    def columns(self, velocity: Array, acceleration: Array, joint_names: Sequence[str]) -> Array:
        """Return the regressor columns, shape (K, n, number of parameters).

        Parameters
        ----------
        velocity, acceleration : ndarray, shape (K, n)
            Joint velocities (rad/s) and accelerations (rad/s²).
        joint_names : sequence of str
            The n joints.
        """


@dataclass(frozen=True)
class JointwiseTerm(FrictionTerm):
    """A term with one parameter a joint, which acts on that joint alone."""

    symbol: ClassVar[str]
    unit: ClassVar[str]
    nonnegative: ClassVar[bool]

    @abstractmethod
    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the effort of a unit parameter at every joint, shape (K, n)."""

    def parameters(self, joint_names: Sequence[str]) -> tuple[TermParameter, ...]:
        """Return one parameter for each joint."""
        return tuple(
            TermParameter(f"{self.symbol}{j + 1}", self.unit, self.nonnegative, j)
            for j in range(len(joint_names))
        )

    def columns(self, velocity: Array, acceleration: Array, joint_names: Sequence[str]) -> Array:
        """Return the columns: diagonal in the joints."""
        shape = self.shape(velocity, acceleration)
        count, n = shape.shape
        columns = np.zeros((count, n, n))
        joints = np.arange(n)
        columns[:, joints, joints] = shape
        return columns


def smooth_sign(velocity: Array, width: float, dead_zone: float) -> Array:
    """Return sign(v), tanh(v / width) when a width is given, zero within the dead zone."""
    shape = np.sign(velocity) if width == 0.0 else np.tanh(velocity / width)
    if dead_zone > 0.0:
        shape = np.where(np.abs(velocity) < dead_zone, 0.0, shape)
    return np.asarray(shape)


@dataclass(frozen=True)
class _SignTerm(JointwiseTerm):
    width: float = 0.0
    dead_zone: float = 0.0

    def __post_init__(self) -> None:
        for name in ("width", "dead_zone"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise ModelError(
                    f"{type(self).__name__}: {name} is {value}; give a velocity of at least 0."
                )

    def _sign(self, velocity: Array) -> Array:
        return smooth_sign(velocity, self.width, self.dead_zone)


@dataclass(frozen=True)
class Coulomb(_SignTerm):
    """Coulomb friction ``Fs·sign(v)``.

    Attributes
    ----------
    width : float
        With a positive width (rad/s), ``tanh(v / width)`` takes the place of the sign.
    dead_zone : float
        Speed (rad/s) below which the term is zero.
    """

    symbol: ClassVar[str] = "Fs"
    unit: ClassVar[str] = "N.m"
    nonnegative: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the sign of the velocity, smoothed as asked."""
        return self._sign(velocity)


@dataclass(frozen=True)
class Viscous(JointwiseTerm):
    """Viscous friction ``Fv·v``."""

    symbol: ClassVar[str] = "Fv"
    unit: ClassVar[str] = "N.m.s/rad"
    nonnegative: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the velocity."""
        return velocity


@dataclass(frozen=True)
class Offset(JointwiseTerm):
    """A constant effort ``Fo``: a sensor's or a current's zero error."""

    symbol: ClassVar[str] = "Fo"
    unit: ClassVar[str] = "N.m"
    nonnegative: ClassVar[bool] = False

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return ones."""
        return np.ones_like(velocity)


@dataclass(frozen=True)
class RotorInertia(JointwiseTerm):
    """Inertia of the rotor seen through the gear, ``Ia·a``, without its gyroscopic effects."""

    symbol: ClassVar[str] = "Ia"
    unit: ClassVar[str] = "kg.m2"
    nonnegative: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the acceleration."""
        return acceleration


@dataclass(frozen=True)
class _OneSidedCoulomb(_SignTerm):
    direction: ClassVar[float]
    unit: ClassVar[str] = "N.m"
    nonnegative: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        sign = self._sign(velocity)
        return np.where(sign * self.direction > 0.0, sign, 0.0)


@dataclass(frozen=True)
class _PositiveCoulomb(_OneSidedCoulomb):
    symbol: ClassVar[str] = "Fsp"
    direction: ClassVar[float] = 1.0


@dataclass(frozen=True)
class _NegativeCoulomb(_OneSidedCoulomb):
    symbol: ClassVar[str] = "Fsn"
    direction: ClassVar[float] = -1.0


@dataclass(frozen=True)
class AsymmetricCoulomb(FrictionTerm):
    """Coulomb friction ``Fsp`` for positive and ``Fsn`` for negative velocity, both ≥ 0.

    Attributes
    ----------
    width, dead_zone : float
        As for `Coulomb`.
    """

    width: float = 0.0
    dead_zone: float = 0.0

    def _sides(self) -> tuple[_OneSidedCoulomb, _OneSidedCoulomb]:
        return (
            _PositiveCoulomb(self.width, self.dead_zone),
            _NegativeCoulomb(self.width, self.dead_zone),
        )

    def parameters(self, joint_names: Sequence[str]) -> tuple[TermParameter, ...]:
        """Return the positive side of every joint, then the negative side."""
        return tuple(p for side in self._sides() for p in side.parameters(joint_names))

    def columns(self, velocity: Array, acceleration: Array, joint_names: Sequence[str]) -> Array:
        """Return the columns of the two sides."""
        sides = [side.columns(velocity, acceleration, joint_names) for side in self._sides()]
        return np.concatenate(sides, axis=2)


@dataclass(frozen=True)
class Coupling(FrictionTerm):
    """The drive of one motor that turns two joints, as in a coupled wrist.

    The motor's speed is the sum of both joints' speeds. Its inertia, viscous and Coulomb
    friction that the two joints' own terms do not hold appear crosswise:
    ``tau_i += Ia·a_j + Fv·v_j + Fs·sign(v_i + v_j)`` and the same with i and j exchanged.

    Attributes
    ----------
    first, second : str
        Names of the two joints.
    width : float
        As for `Coulomb`.
    """

    first: str
    second: str
    width: float = 0.0

    def _joints(self, joint_names: Sequence[str]) -> tuple[int, int]:
        for name in (self.first, self.second):
            if name not in joint_names:
                raise ModelError(
                    f"Coupling: the robot has no joint '{name}'; it has {', '.join(joint_names)}."
                )
        if self.first == self.second:
            raise ModelError(f"Coupling: '{self.first}' is named twice; name two joints.")
        return joint_names.index(self.first), joint_names.index(self.second)

    def parameters(self, joint_names: Sequence[str]) -> tuple[TermParameter, ...]:
        """Return rotor inertia, viscous and Coulomb friction of the coupling."""
        i, j = self._joints(joint_names)
        pair = f"{i + 1}_{j + 1}"
        last = max(i, j)
        # The viscous and inertial cross terms may have either sign: they are differences.
        return (
            TermParameter(f"Ia{pair}", "kg.m2", False, last),
            TermParameter(f"Fv{pair}", "N.m.s/rad", False, last),
            TermParameter(f"Fs{pair}", "N.m", True, last),
        )

    def columns(self, velocity: Array, acceleration: Array, joint_names: Sequence[str]) -> Array:
        """Return the three columns, which act on both joints."""
        i, j = self._joints(joint_names)
        columns = np.zeros((*velocity.shape, 3))
        for own, other in ((i, j), (j, i)):
            columns[:, own, 0] = acceleration[:, other]
            columns[:, own, 1] = velocity[:, other]
            columns[:, own, 2] = smooth_sign(velocity[:, i] + velocity[:, j], self.width, 0.0)
        return columns


_BY_NAME: dict[str, type[FrictionTerm]] = {
    "coulomb": Coulomb,
    "viscous": Viscous,
    "offset": Offset,
    "asymmetric_coulomb": AsymmetricCoulomb,
    "rotor_inertia": RotorInertia,
}


@dataclass(frozen=True)
class FrictionModel:
    """The terms of a robot's joints, in order.

    Attributes
    ----------
    terms : tuple of FrictionTerm
        The terms.
    joint_names : tuple of str
        The joints that have friction: all but a floating base.
    parameters : tuple of TermParameter
        All parameters, term by term over the joints: the tail of theta.
    first : int
        Velocity coordinates before the first of these joints (6 with a floating base).
    """

    terms: tuple[FrictionTerm, ...]
    joint_names: tuple[str, ...]
    parameters: tuple[TermParameter, ...]
    first: int = 0

    @classmethod
    def from_terms(
        cls, terms: Iterable[str | FrictionTerm], joint_names: Sequence[str], *, first: int = 0
    ) -> FrictionModel:
        """Build from names and term objects.

        Parameters
        ----------
        terms : iterable of str or FrictionTerm
            Names are coulomb, viscous, offset, asymmetric_coulomb, rotor_inertia.
        joint_names : sequence of str
            The robot's velocity coordinates.
        first : int, optional
            How many of them belong to a floating base, which has no friction.

        Raises
        ------
        ModelError
            For an unknown name, a term given twice, or a joint that the robot does not have.
        """
        if isinstance(terms, str):
            raise ModelError(f"friction: give a tuple of terms, such as ('{terms}',).")
        objects = []
        for term in terms:
            if isinstance(term, FrictionTerm):
                objects.append(term)
            elif isinstance(term, str) and term in _BY_NAME:
                objects.append(_BY_NAME[term]())
            else:
                raise ModelError(
                    f"friction: no term is called {term!r}; there are {', '.join(_BY_NAME)}, "
                    "or give a FrictionTerm object."
                )
        names = tuple(joint_names)[first:]
        parameters = tuple(p for term in objects for p in term.parameters(names))
        seen: set[str] = set()
        for parameter in parameters:
            if parameter.name in seen:
                raise ModelError(f"friction: the parameter {parameter.name} is defined twice.")
            seen.add(parameter.name)
        return cls(tuple(objects), names, parameters, first)

    def columns(self, velocity: Array, acceleration: Array) -> Array:
        """Return all columns, shape (K, n, number of parameters)."""
        columns = np.zeros((*velocity.shape, len(self.parameters)))
        v, a = velocity[:, self.first :], acceleration[:, self.first :]
        start = 0
        for term in self.terms:
            block = term.columns(v, a, self.joint_names)
            columns[:, self.first :, start : start + block.shape[2]] = block
            start += block.shape[2]
        return columns
