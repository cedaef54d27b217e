"""Friction and drive terms: Coulomb, viscous, Stribeck, rotor inertia, coupling and others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.term import (
    SLOWEST,
    EffortCurve,
    FrictionTerm,
    JointwiseTerm,
    OpenParameter,
    SampledMotion,
    TermParameter,
    check_speeds,
    diagonal,
    sign_curves,
    smooth_sign,
)

# Far out a power may overflow; the Stribeck peak is zero long before.
_STEEPEST = 50.0

# A speed of a term: one for all joints, one per joint, or None to fit it to the data.
Speed = float | tuple[float, ...] | None


@dataclass(frozen=True)
class _SignTerm(JointwiseTerm):
    width: Speed = 0.0
    dead_zone: float = 0.0
    unit: ClassVar[str] = "N.m"
    nonnegative: ClassVar[bool] = True
    speed_fields: ClassVar[tuple[str, ...]] = ("width",)

    def __post_init__(self) -> None:
        check_speeds(self, ("width", "dead_zone"))

    def _sign(self, velocity: Array) -> Array:
        return smooth_sign(velocity, self.speed("width", velocity.shape[-1]), self.dead_zone)


@dataclass(frozen=True)
class Coulomb(_SignTerm):
    """Coulomb friction ``Fs·sign(v)``.

    Its name is ``"coulomb"``; Fs is in N·m, of sliding joints in N.

    Attributes
    ----------
    width : float, tuple of float, or None
        Where positive (rad/s), ``tanh(v / width)`` takes the place of the sign. One for all
        joints, one per joint, or None to fit it to the data.
    dead_zone : float
        Speed (rad/s) below which the term is zero.

    Examples
    --------
    >>> v = np.array([[-0.5, 0.0, 0.5]])
    >>> sdpid.friction.Coulomb().shape(v, v)
    array([[-1.,  0.,  1.]])
    >>> sdpid.friction.Coulomb(width=0.5).shape(v, v).round(3)
    array([[-0.762,  0.   ,  0.762]])
    >>> terms = (sdpid.friction.Coulomb(width=0.01), "viscous")
    >>> smooth = sdpid.build_problem(robot, samples, friction=terms)
    """

    describes: ClassVar[str] = "Coulomb"
    symbol: ClassVar[str] = "Fs"
    efforts: ClassVar[Mapping[str, str]] = {"Fs": "{sign}"}

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the sign of the velocity, or its smooth or dead-zone variant."""
        return self._sign(velocity)

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the signs."""
        for j, width in enumerate(self.speed("width", len(values)).tolist()):
            yield from sign_curves((j, -1), float(values[j]), width, self.dead_zone)


@dataclass(frozen=True)
class Viscous(JointwiseTerm):
    """Viscous friction ``Fv·v``.

    Its name is ``"viscous"``; Fv is in N·m·s/rad, of sliding joints in N·s/m.

    Examples
    --------
    >>> v = np.array([[-0.5, 0.0, 2.0]])
    >>> sdpid.friction.Viscous().shape(v, v)
    array([[-0.5,  0. ,  2. ]])
    """

    describes: ClassVar[str] = "viscous"
    symbol: ClassVar[str] = "Fv"
    efforts: ClassVar[Mapping[str, str]] = {"Fv": "{v}"}
    unit: ClassVar[str] = "N.m.s/rad"
    nonnegative: ClassVar[bool] = True
    linear: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the velocity."""
        return velocity

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the slopes."""
        yield from (EffortCurve("slope", (j, j), value) for j, value in enumerate(values.tolist()))


@dataclass(frozen=True)
class Offset(JointwiseTerm):
    """A constant effort ``Fo``: a sensor's or a current's zero error.

    Its name is ``"offset"``; Fo is in N·m, of sliding joints in N.

    Examples
    --------
    >>> problem = sdpid.build_problem(robot, samples, friction=("coulomb", "viscous", "offset"))
    >>> bool(abs(sdpid.solve_sdp(problem).named()["Fo1"]) < 1.0)
    True
    """

    symbol: ClassVar[str] = "Fo"
    efforts: ClassVar[Mapping[str, str]] = {"Fo": ""}
    unit: ClassVar[str] = "N.m"
    nonnegative: ClassVar[bool] = False
    linear: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return ones."""
        return np.ones_like(velocity)

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the constants."""
        yield from (
            EffortCurve("constant", (j, -1), value) for j, value in enumerate(values.tolist())
        )


@dataclass(frozen=True)
class RotorInertia(JointwiseTerm):
    """Inertia of the rotor seen through the gear, ``Ia·a``, without its gyroscopic effects.

    Its name is ``"rotor_inertia"``; Ia is in kg·m², of sliding joints in kg.

    Examples
    --------
    >>> terms = ("coulomb", "viscous", "rotor_inertia")
    >>> problem = sdpid.build_problem(robot, samples, friction=terms)
    >>> problem.base.names[-3:]
    ('Fs6', 'Fv6', 'Ia6')
    >>> problem.base.expression("zzr1").endswith("+ Ia1")  # not to be told from zz_1
    True
    """

    symbol: ClassVar[str] = "Ia"
    efforts: ClassVar[Mapping[str, str]] = {"Ia": "{a}"}
    unit: ClassVar[str] = "kg.m2"
    nonnegative: ClassVar[bool] = True
    linear: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the acceleration."""
        return acceleration

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield nothing: mass is no friction."""
        yield from ()


@dataclass(frozen=True)
class SquareRootFriction(JointwiseTerm):
    """Square-root friction ``Fq·sign(v)·√|v|``.

    Between Coulomb and viscous friction, for harmonic drives and greased gears. Its name is
    ``"square_root"``; Fq is in N·m·√(s/rad), of sliding joints in N·√(s/m).

    Examples
    --------
    >>> v = np.array([[-0.25, 0.0, 4.0]])
    >>> sdpid.friction.SquareRootFriction().shape(v, v)
    array([[-0.5,  0. ,  2. ]])
    """

    symbol: ClassVar[str] = "Fq"
    efforts: ClassVar[Mapping[str, str]] = {"Fq": "root({v})"}
    unit: ClassVar[str] = "N.m.s^0.5/rad^0.5"
    nonnegative: ClassVar[bool] = True
    curve: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the signed root of the speed."""
        return np.asarray(np.sign(velocity) * np.sqrt(np.abs(velocity)))

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the roots."""
        yield from (EffortCurve("root", (j, -1), value) for j, value in enumerate(values.tolist()))


@dataclass(frozen=True)
class Stribeck(JointwiseTerm):
    """Stribeck peak: friction above Coulomb's at low speed, ``Fst·exp(−|v/vs|^exponent)·sign(v)``.

    A companion of `Coulomb`: the sum is the Stribeck curve [armstrong1994]_. Its name is
    ``"stribeck"``; Fst is in N·m, of sliding joints in N.

    Attributes
    ----------
    velocity : float, tuple of float, or None
        The speed vs (rad/s) at which the peak has fallen to 1/e: one for all joints, one per
        joint, or None to fit it to the data.
    exponent : float
        2 for a Gaussian peak, 1 for an exponential one.
    width : float, tuple of float, or None
        Width (rad/s) of the sign, as for `Coulomb`.

    Examples
    --------
    >>> v = np.array([[0.01, 0.1, 1.0]])
    >>> sdpid.friction.Stribeck(velocity=0.1).shape(v, v).round(3)
    array([[0.99 , 0.368, 0.   ]])
    >>> terms = ("coulomb", "viscous", sdpid.friction.Stribeck(velocity=0.1))
    >>> sdpid.build_problem(robot, samples, friction=terms).base.names[-3:]
    ('Fs6', 'Fv6', 'Fst6')
    """

    velocity: Speed = None
    exponent: float = 2.0
    width: Speed = 0.0
    symbol: ClassVar[str] = "Fst"
    efforts: ClassVar[Mapping[str, str]] = {
        "Fst": "peak({v} / {velocity!r}, {exponent!r}) * {sign}"
    }
    unit: ClassVar[str] = "N.m"
    nonnegative: ClassVar[bool] = True
    curve: ClassVar[bool] = True
    speed_fields: ClassVar[tuple[str, ...]] = ("velocity", "width")

    def __post_init__(self) -> None:
        check_speeds(self, ("velocity",), positive=True)
        check_speeds(self, ("width",))
        if not (np.isfinite(self.exponent) and self.exponent > 0.0):
            raise ModelError(f"Stribeck: exponent is {self.exponent}; give a positive number.")

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the peak about standstill, signed."""
        n = velocity.shape[-1]
        ratio = np.abs(velocity) / self.speed("velocity", n)
        # Far out the power may overflow; the peak is zero long before.
        peak = np.exp(-(np.minimum(ratio, 1e3) ** min(self.exponent, _STEEPEST)))
        return np.asarray(peak * smooth_sign(velocity, self.speed("width", n), 0.0))

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the peaks."""
        speeds, power = self.speed("velocity", len(values)), min(self.exponent, _STEEPEST)
        for j, width in enumerate(self.speed("width", len(values)).tolist()):
            value, numbers = float(values[j]), (float(speeds[j]), power, width or 1.0)
            if width > 0.0:
                yield EffortCurve("smooth_peak", (j, -1), value, numbers)
            else:
                yield EffortCurve("jump", (j, -1), value, (0.0, -value, 0.0))
                yield EffortCurve("peak", (j, -1), value, numbers)

    def enclosed(
        self,
        velocity: tuple[Array, Array],
        acceleration: tuple[Array, Array],
        joint_names: Sequence[str],
    ) -> tuple[Array, Array]:
        """Return bounds of the columns over ranges of motion: the peak is highest at the slowest.

        Either side of standstill bounds its own sign; zero bounds the other.
        """
        low, high = velocity
        slowest = np.maximum(np.maximum(low, -high), 0.0)
        peaks = replace(self, width=0.0).shape(np.maximum(slowest, SLOWEST), acceleration[0])
        # At standstill the peak is one, but for the speed that stands for it.
        peaks = np.where(slowest > 0.0, peaks, 1.0)
        return diagonal(np.where(low < 0.0, -peaks, 0.0)), diagonal(
            np.where(high > 0.0, peaks, 0.0)
        )


@dataclass(frozen=True)
class SigmoidFriction(JointwiseTerm):
    """Friction that saturates, ``Fsg·tanh(v / w)``.

    The field's sigmoid ``c/(1 + exp(−2·v/w)) − c/2`` with Fsg = c/2 [gaz2019]_. Alone it is
    Coulomb friction with a smooth sign; beside `Coulomb` it is what still grows at first. Its name
    is ``"sigmoid"``; Fsg is in N·m, of sliding joints in N.

    Attributes
    ----------
    velocity : float, tuple of float, or None
        The speed w (rad/s): one for all joints, one per joint, or None to fit it to the data.

    Examples
    --------
    >>> v = np.array([[-0.2, 0.0, 0.1]])
    >>> sdpid.friction.SigmoidFriction(velocity=0.1).shape(v, v).round(3)
    array([[-0.964,  0.   ,  0.762]])
    >>> problem = sdpid.build_problem(robot, samples, friction=("viscous", "sigmoid"))
    >>> problem.origin.profiled[0].name, problem.origin.profiled[0].unit
    ('velocity1', 'rad/s')
    """

    velocity: Speed = None
    describes: ClassVar[str] = "Coulomb"
    symbol: ClassVar[str] = "Fsg"
    efforts: ClassVar[Mapping[str, str]] = {"Fsg": "tanh({v} / {velocity!r})"}
    unit: ClassVar[str] = "N.m"
    nonnegative: ClassVar[bool] = True
    curve: ClassVar[bool] = True
    speed_fields: ClassVar[tuple[str, ...]] = ("velocity",)
    # Samples this slow are masked by default, but the filter carries what happens there to others.
    # From the slowest of the samples, 0.025 to 0.03 rad/s, signs 0.02 rad/s wide were out of reach:
    # 83 % of the 95 % intervals of viscous friction held the truth of simulated logs, now 98 %.
    # What is narrower is left to `Coulomb`.
    slowest: ClassVar[float | None] = 0.02

    def __post_init__(self) -> None:
        check_speeds(self, ("velocity",), positive=True)

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the sigmoid."""
        return np.tanh(velocity / self.speed("velocity", velocity.shape[-1]))

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the sigmoids."""
        for j, speed in enumerate(self.speed("velocity", len(values)).tolist()):
            yield from sign_curves((j, -1), float(values[j]), speed, 0.0)


@dataclass(frozen=True)
class AsymmetricCoulomb(FrictionTerm):
    """Coulomb friction ``Fsp`` for positive and ``Fsn`` for negative velocity, both ≥ 0.

    A prior believes that both sides are alike, so that a motion in one direction determines both.
    Its name is ``"asymmetric_coulomb"``; Fsp and Fsn are in N·m, of sliding joints in N.

    Attributes
    ----------
    width, dead_zone
        As for `Coulomb`.

    Examples
    --------
    >>> problem = sdpid.build_problem(robot, samples, friction=("asymmetric_coulomb", "viscous"))
    >>> found = sdpid.solve_sdp(problem).named()
    >>> round(found["Fsp1"]), round(found["Fsn1"])
    (50, 50)
    """

    width: Speed = 0.0
    dead_zone: float = 0.0
    describes: ClassVar[str] = "Coulomb"
    efforts: ClassVar[Mapping[str, str]] = {"Fsp": "ahead({sign})", "Fsn": "back({sign})"}
    curve: ClassVar[bool] = True
    speed_fields: ClassVar[tuple[str, ...]] = ("width",)

    def __post_init__(self) -> None:
        check_speeds(self, ("width", "dead_zone"))

    def parameters(self, joint_names: Sequence[str]) -> tuple[TermParameter, ...]:
        """Return the positive side of every joint, then the negative side."""
        return tuple(
            TermParameter(f"{symbol}{j + 1}", "N.m", True, j)
            for symbol in self.efforts
            for j in range(len(joint_names))
        )

    def _sides(self, velocity: Array, acceleration: Array) -> Array:
        """Return the sign of the velocity where it is positive, then where not, (K, 2, n)."""
        widths = self.speed("width", velocity.shape[-1])
        sign = smooth_sign(velocity, widths, self.dead_zone)
        return np.stack([np.where(sign > 0.0, sign, 0.0), np.where(sign < 0.0, sign, 0.0)], axis=1)

    def columns(self, velocity: Array, acceleration: Array, joint_names: Sequence[str]) -> Array:
        """Return the columns of the two sides."""
        sides = self._sides(velocity, acceleration)
        return np.concatenate([diagonal(sides[:, 0]), diagonal(sides[:, 1])], axis=2)

    def columns_in(self, motion: SampledMotion, joint_names: Sequence[str]) -> Array:
        """Return the columns of the two sides as they stand in filtered efforts."""
        sides = motion.filtered(self._sides, self)
        return np.concatenate([diagonal(sides[:, 0]), diagonal(sides[:, 1])], axis=2)

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the signs of both sides."""
        n = len(joint_names)
        for j, width in enumerate(self.speed("width", n).tolist()):
            for value, side in ((values[j], 1), (values[n + j], -1)):
                yield from sign_curves((j, -1), float(value), width, self.dead_zone, side)

    def alike(self, joint_names: Sequence[str]) -> tuple[tuple[int, int], ...]:
        """Return both sides of every joint: a side that never moved is like the other."""
        n = len(joint_names)
        return tuple((j, n + j) for j in range(n))


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
    width : float or None
        Width (rad/s) of the sign of the motor's speed, as for `Coulomb`.

    Examples
    --------
    >>> wrist = sdpid.friction.Coupling("joint_5", "joint_6")
    >>> problem = sdpid.build_problem(robot, samples, friction=("coulomb", "viscous", wrist))
    >>> problem.base.names[-3:]
    ('Ia5_6', 'Fv5_6', 'Fs5_6')
    """

    first: str
    second: str
    width: float | None = 0.0
    speed_fields: ClassVar[tuple[str, ...]] = ("width",)
    efforts: ClassVar[Mapping[str, str]] = {"Ia": "{a}", "Fv": "{v}", "Fs": "{sign}"}

    def __post_init__(self) -> None:
        if isinstance(self.width, tuple):
            raise ModelError(f"Coupling: width is {self.width}; give one number for the motor.")
        check_speeds(self, ("width",))

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

    def columns_in(self, motion: SampledMotion, joint_names: Sequence[str]) -> Array:
        """Return the three columns as they stand in filtered efforts; two of them are linear."""
        columns = self.columns(motion.velocity, motion.acceleration, joint_names)
        i, j = self._joints(joint_names)
        width = float(self.speed("width", 1)[0])
        sign = motion.filtered(
            lambda v, _: smooth_sign(v[:, i] + v[:, j], width, 0.0), (self, i, j)
        )
        columns[:, i, 2] = columns[:, j, 2] = sign
        return columns

    def columns(self, velocity: Array, acceleration: Array, joint_names: Sequence[str]) -> Array:
        """Return the three columns, which act on both joints."""
        width = float(self.speed("width", 1)[0])
        i, j = self._joints(joint_names)
        columns = np.zeros((*velocity.shape, 3))
        for own, other in ((i, j), (j, i)):
            columns[:, own, 0] = acceleration[:, other]
            columns[:, own, 1] = velocity[:, other]
            columns[:, own, 2] = smooth_sign(velocity[:, i] + velocity[:, j], width, 0.0)
        return columns

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the slopes and the sign of the motor's speed; its inertia is no friction."""
        _, viscous, coulomb = values.tolist()
        i, j = self._joints(joint_names)
        yield EffortCurve("slope", (i, j), viscous)
        yield EffortCurve("slope", (j, i), viscous)
        yield from sign_curves((min(i, j), max(i, j)), coulomb, self.width or 0.0, 0.0)

    def open_parameters(
        self, speeds: Sequence[Array], joint_names: Sequence[str]
    ) -> tuple[OpenParameter, ...]:
        """Return the open width when it is None, with search limits from both joints' speeds."""
        if self.width is not None:
            return ()
        i, j = self._joints(joint_names)
        both = [np.concatenate([speeds[i], speeds[j]])]
        (found,) = FrictionTerm.open_parameters(self, both, joint_names)
        return (OpenParameter(f"width{i + 1}_{j + 1}", found.lower, found.upper, found.unit),)

    def with_values(self, values: Sequence[float]) -> FrictionTerm:
        """Return a copy with this width."""
        if self.width is None and len(values) == 1:
            return replace(self, width=float(values[0]))
        return FrictionTerm.with_values(self, values)


# All terms that need nothing but a name.
BY_NAME: dict[str, type[FrictionTerm]] = {
    "coulomb": Coulomb,
    "viscous": Viscous,
    "offset": Offset,
    "asymmetric_coulomb": AsymmetricCoulomb,
    "rotor_inertia": RotorInertia,
    "stribeck": Stribeck,
    "sigmoid": SigmoidFriction,
    "square_root": SquareRootFriction,
    "load": LoadFriction,
    "tilt": Tilt,
}
