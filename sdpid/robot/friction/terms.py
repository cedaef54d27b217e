"""Friction and drive terms: Coulomb, viscous, Stribeck, rotor inertia, coupling and others."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import plain
from sdpid.errors import ModelError
from sdpid.robot.friction.posed import LoadFriction, PositionFriction, Tilt
from sdpid.robot.friction.position import AtJoints, Hysteresis, PositionTerm, Spring, way_of
from sdpid.robot.friction.term import (
    SLOWEST,
    EffortCurve,
    FrictionTerm,
    JointwiseTerm,
    OpenParameter,
    Place,
    Range,
    SampledMotion,
    TermParameter,
    check_speeds,
    diagonal,
    of_each_joint,
    sign_curves,
    smooth_sign,
)

# Far out a power may overflow; the Stribeck peak is zero long before.
_STEEPEST = 50.0

# Of a motor and the two joints that it turns, whose own terms hold what is theirs alone.
_CROSSWISE = np.array([1.0, -1.0, -1.0])

# A speed of a term: one for all joints, one per joint, or None to fit it to the data.
Speed = float | tuple[float, ...] | None


@dataclass(frozen=True)
class _EffortTerm(JointwiseTerm):
    """One parameter a joint: an effort against the motion, unless a class says otherwise."""

    unit: ClassVar[str] = "N.m"
    nonnegative: ClassVar[bool] = True


@dataclass(frozen=True)
class Coulomb(_EffortTerm):
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

    width: Speed = 0.0
    dead_zone: float = 0.0
    describes: ClassVar[str] = "Coulomb"
    symbol: ClassVar[str] = "Fs"
    efforts: ClassVar[Mapping[str, str]] = {"Fs": "{sign}"}
    speed_fields: ClassVar[tuple[str, ...]] = ("width",)

    def __post_init__(self) -> None:
        check_speeds(self, ("width", "dead_zone"))

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the sign of the velocity, or its smooth or dead-zone variant."""
        return smooth_sign(velocity, self.speed("width", velocity.shape[-1]), self.dead_zone)

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the signs."""
        for j, width in enumerate(self.speed("width", len(values)).tolist()):
            yield from sign_curves(j, float(values[j]), width, self.dead_zone)


@dataclass(frozen=True)
class Viscous(_EffortTerm):
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
    linear: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the velocity."""
        return velocity

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the slopes."""
        for j, value in enumerate(values.tolist()):
            yield EffortCurve("slope", j, value)


@dataclass(frozen=True)
class Offset(_EffortTerm):
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
    nonnegative: ClassVar[bool] = False
    linear: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return ones."""
        return np.ones_like(velocity)

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the constants."""
        for j, value in enumerate(values.tolist()):
            yield EffortCurve("constant", j, value)


@dataclass(frozen=True)
class RotorInertia(_EffortTerm):
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
    linear: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the acceleration."""
        return acceleration

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield nothing: mass is no friction."""
        yield from ()


@dataclass(frozen=True)
class SquareRootFriction(_EffortTerm):
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
    curve: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the signed root of the speed."""
        return np.asarray(np.sign(velocity) * np.sqrt(np.abs(velocity)))

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the roots."""
        for j, value in enumerate(values.tolist()):
            yield EffortCurve("root", j, value)


@dataclass(frozen=True)
class Stribeck(_EffortTerm):
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
    curve: ClassVar[bool] = True
    speed_fields: ClassVar[tuple[str, ...]] = ("velocity", "width")

    def __post_init__(self) -> None:
        super().__post_init__()
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
                yield EffortCurve("smooth_peak", j, value, numbers)
            else:
                yield EffortCurve("jump", j, value, (0.0, -value, 0.0))
                yield EffortCurve("peak", j, value, numbers)

    def enclosed(self, velocity: Range, acceleration: Range, joint_names: Sequence[str]) -> Range:
        """Return bounds of the columns over ranges of motion: the peak is highest at the slowest.

        Either side of standstill bounds its own sign; zero bounds the other.
        """
        low, high = velocity
        slowest = np.maximum(np.maximum(low, -high), 0.0)
        peaks = replace(self, width=0.0).shape(np.maximum(slowest, SLOWEST), acceleration[0])
        # At standstill the peak is one, but for the speed that stands for it.
        peaks = np.where(slowest > 0.0, peaks, 1.0)
        least, most = np.where(low < 0.0, -peaks, 0.0), np.where(high > 0.0, peaks, 0.0)
        return diagonal(least), diagonal(most)


@dataclass(frozen=True)
class SigmoidFriction(_EffortTerm):
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
    curve: ClassVar[bool] = True
    speed_fields: ClassVar[tuple[str, ...]] = ("velocity",)
    # Samples this slow are masked by default, but the filter carries what happens there to others.
    # From the slowest of the samples, 0.025 to 0.03 rad/s, signs 0.02 rad/s wide were out of reach:
    # 83 % of the 95 % intervals of viscous friction held the truth of simulated logs, now 98 %.
    # What is narrower is left to `Coulomb`.
    slowest: ClassVar[float | None] = 0.02

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the sigmoid."""
        return np.tanh(velocity / self.speed("velocity", velocity.shape[-1]))

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the sigmoids."""
        for j, speed in enumerate(self.speed("velocity", len(values)).tolist()):
            yield from sign_curves(j, float(values[j]), speed, 0.0)


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
        return of_each_joint(joint_names, self.efforts, "N.m", True)

    def _sides(self, velocity: Array, acceleration: Array) -> Array:
        """Return the sign of the velocity where it is positive, then where not, (K, 2, n)."""
        sign = smooth_sign(velocity, self.speed("width", velocity.shape[-1]), self.dead_zone)
        return np.stack([np.maximum(sign, 0.0), np.minimum(sign, 0.0)], axis=1)

    def columns(self, velocity: Array, acceleration: Array, joint_names: Sequence[str]) -> Array:
        """Return the columns of the two sides."""
        return diagonal(*self._sides(velocity, acceleration).swapaxes(0, 1))

    def columns_in(self, motion: SampledMotion, joint_names: Sequence[str]) -> Array:
        """Return the columns of the two sides as they stand in filtered efforts."""
        return diagonal(*motion.filtered(self._sides, self).swapaxes(0, 1))

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the signs of both sides."""
        n = len(joint_names)
        for j, width in enumerate(self.speed("width", n).tolist()):
            for value, side in ((values[j], 1), (values[n + j], -1)):
                yield from sign_curves(j, float(value), width, self.dead_zone, side)

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
        given: Any = self.width
        if isinstance(given, tuple):
            if len(given) != 1:
                raise ModelError(f"Coupling: width is {given}; give one number for the motor.")
            # `with_values` gives a tuple of one.
            object.__setattr__(self, "width", given[0])
        super().__post_init__()

    def _ways(self, joint_names: Sequence[str]) -> Array:
        """Return how each joint follows all of them, (2, n)."""
        if self.first == self.second:
            raise ModelError(f"Coupling: '{self.first}' is named twice; name two joints.")
        places = (self.first, self.second)
        return np.array([way_of("Coupling", each, None, joint_names)[0] for each in places])

    def parameters(self, joint_names: Sequence[str]) -> tuple[TermParameter, ...]:
        """Return rotor inertia, viscous and Coulomb friction of the coupling."""
        i, j = self._ways(joint_names).argmax(axis=1).tolist()
        pair = f"{i + 1}_{j + 1}"
        last = max(i, j)
        # The viscous and inertial cross terms may have either sign: they are differences.
        return (
            TermParameter(f"Ia{pair}", "kg.m2", False, last),
            TermParameter(f"Fv{pair}", "N.m.s/rad", False, last),
            TermParameter(f"Fs{pair}", "N.m", True, last),
        )

    def acting(
        self, values: Array, joint_names: Sequence[str]
    ) -> Iterator[tuple[FrictionTerm, Sequence[Place], Array]]:
        """Yield inertia, viscous and Coulomb friction of the motor, less what the joints hold.

        Below zero, inertia and viscous friction are those of the joints' difference.
        """
        *linear, coulomb = values.tolist()
        units = self._ways(joint_names)
        for term, value in zip((RotorInertia(), Viscous()), linear, strict=True):
            places = (units[0] + math.copysign(1.0, value) * units[1], *units)
            yield term, [tuple(each.tolist()) for each in places], abs(value) * _CROSSWISE
        yield Coulomb(self.width), [tuple(units.sum(axis=0).tolist())], np.array([coulomb])

    def columns_in(self, motion: SampledMotion, joint_names: Sequence[str]) -> Array:
        """Return the three columns as they stand in filtered efforts; two of them are linear."""
        return np.stack(
            [
                AtJoints(term, tuple(places)).columns_in(motion, joint_names) @ values
                for term, places, values in self.acting(np.ones(3), joint_names)
            ],
            axis=2,
        )

    def columns(self, velocity: Array, acceleration: Array, joint_names: Sequence[str]) -> Array:
        """Return the three columns, which act on both joints."""
        motion = SampledMotion(
            position=velocity, velocity=velocity, acceleration=acceleration, robot=None
        )
        return self.columns_in(motion, joint_names)

    def open_parameters(
        self, speeds: Sequence[Array], joint_names: Sequence[str]
    ) -> tuple[OpenParameter, ...]:
        """Return the open width when it is None, with search limits from both joints' speeds."""
        i, j = self._ways(joint_names).argmax(axis=1).tolist()
        both = [np.concatenate([speeds[i], speeds[j]])]
        return tuple(
            replace(each, name=f"width{i + 1}_{j + 1}")
            for each in super().open_parameters(both, joint_names)
        )


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

# The classes whose settings say everything about a term; a class of someone else's may hold code.
CLASSES = {each.__name__: each for each in BY_NAME.values()}
CLASSES |= {
    each.__name__: each
    for each in (AtJoints, Coupling, Hysteresis, PositionFriction, PositionTerm, Spring)
}


def term_to_dict(term: FrictionTerm) -> dict[str, Any]:
    """Return the class and the settings of a term as JSON has them.

    Raises
    ------
    ModelError
        When the term is of a class that this package does not have.
    """
    name = type(term).__name__
    if CLASSES.get(name) is not type(term):
        raise ModelError(
            f"friction: {name} is a class of your own, which no file can hold; its settings alone "
            "do not say what it computes."
        )
    settings = {each: getattr(term, each) for each in _settings(type(term))}
    if code := [each for each, value in settings.items() if callable(value)]:
        raise ModelError(
            f"friction: {code[0]} of {name} is code of your own, which no file can hold; give a "
            "table in its place."
        )
    return {"term": name} | {
        each: term_to_dict(value) if isinstance(value, FrictionTerm) else plain(value)
        for each, value in settings.items()
    }


def term_from_dict(given: Mapping[str, Any]) -> FrictionTerm:
    """Return the term of `term_to_dict`.

    Raises
    ------
    ModelError
        When class, settings or values are none of a term.
    """
    found = CLASSES.get(str(given.get("term")))
    if found is None:
        raise ModelError(
            f"friction: no term is of the class {given.get('term')!r:.80}; there are "
            f"{', '.join(CLASSES)}."
        )
    settings = {name: value for name, value in given.items() if name != "term"}
    if wrong := settings.keys() ^ set(_settings(found)):
        raise ModelError(
            f"friction: {found.__name__} has the settings {', '.join(_settings(found)) or 'none'}; "
            f"missing or not known: {', '.join(sorted(map(repr, wrong)))[:200]}."
        )
    try:
        return found(**{name: _value(value) for name, value in settings.items()})
    except (TypeError, ValueError) as cause:
        raise ModelError(f"friction: {found.__name__}: {cause}.") from None


def _settings(term: type[FrictionTerm]) -> tuple[str, ...]:
    return tuple(each.name for each in fields(term))  # type: ignore[arg-type]


def _value(value: Any) -> Any:
    """Return what JSON holds as a setting is held: numbers as floats, lists as tuples."""
    if isinstance(value, list):
        return tuple(_value(each) for each in value)
    if isinstance(value, Mapping) and "term" in value:
        return term_from_dict(value)
    if value is None or isinstance(value, str | bool):
        return value
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"a setting is {value!r:.80}")
    return float(value)
