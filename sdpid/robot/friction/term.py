"""The interface of a friction term: its parameters, their columns, and its open speeds.

A term names its parameters and gives their regressor columns from the joint velocities and
accelerations; its effort is ``columns @ parameters``. The columns may depend on further numbers
in which the effort is not linear, such as the width of a smooth sign. Those that are None are
open: `sdpid.estimation.effects.choose` fits them to the data.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid.errors import ModelError

# An open speed is searched from the 0.5 % quantile of the measured speeds, below which nothing
# shows it, to half of the top speed: beyond, the shapes are straight lines (tanh) or constants (the
# Stribeck peak), which other terms have. From the 5 % quantile on, signs 0.02 rad/s wide were out
# of reach, and friction at 0.1 rad/s 1.4 % wrong in a tenth of simulated joints, not 0.4 %.
_SLOW_SHARE = 0.005
_MOST_OF_TOP = 0.5

# The lower limit as a share of the top speed: never below (velocities are not that accurate), and
# never above (a motion that always runs fast must leave something to choose).
_LEAST_OF_TOP = (1e-3, 0.1)

# Speeds of friction curves, rad/s or m/s; beyond these, curves overflow or are constant.
SLOWEST, FASTEST = 1e-9, 1e9

# A joint whose top speed is below this (rad/s, or m/s) does not move: limits that follow it would
# fall below the slowest speed of a curve. Rounding of a filtered constant is far slower.
_MOVES = SLOWEST / _LEAST_OF_TOP[0]

# A simulation takes a term of one's own as linear between these speeds, rad/s or m/s, in steps of
# 7 %, which miss a square by less than 0.15 %. Below the first it may jump, above the last it goes
# on as before.
_SPEEDS = np.geomspace(1e-4, 1e2, 200)

# Less of a term's largest effort is no jump.
_JUMP = 1e-4

# Top speed (rad/s) taken for a joint that does not move: any will do.
_STANDING = 1.0


# Where a term acts: a recorded or another joint by name, or factors of the recorded joints.
Place = str | tuple[float, ...]

# Least and largest values.
Range = tuple[Array, Array]

# A function of joint velocities and accelerations, (M, n) each, to values (M, ...).
OfMotion = Callable[[Array, Array], Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledMotion:
    """States of K samples.

    Attributes
    ----------
    position : ndarray, shape (K, n) or (K, nq)
        Configurations, rad or m.
    velocity, acceleration : ndarray, shape (K, joints)
        Of the joints that have friction, rad/s and rad/s².
    robot : RobotModel
        Whose joints these are.
    through_filter : callable or None
        How functions of the velocity pass the filter of the efforts: from a function of velocities
        and accelerations at a rate and a band well above the filter's, and a key under which its
        values (K, ...) are kept for the next call, if any. None where there was no filter:
        friction then is that at the samples' own velocities.
    through_path : callable or None
        How functions of positions in the order of time, from (K, n) to (K, ...), see those before
        these samples too; None where these are all.
    """

    position: Array
    velocity: Array
    acceleration: Array
    robot: Any
    through_filter: Callable[[OfMotion, Hashable | None], Array] | None = None
    through_path: Callable[[Callable[[Array], Array]], Array] | None = None

    def along(self, function: Callable[[Array], Array]) -> Array:
        """Return a function of the positions so far, (K, ...)."""
        if self.through_path is None:
            return function(self.position)
        return self.through_path(function)

    def filtered(self, function: OfMotion, key: Hashable | None = None) -> Array:
        """Return a nonlinear function of the motion (K, ...), as it stands in the efforts.

        Efforts are filtered, and the filter smears what is steep in the velocity, such as the step
        of Coulomb friction. So the function is evaluated at a velocity of wider band, then passes
        the same filter.

        Parameters
        ----------
        function : callable
            Of velocities and accelerations (M, joints), to values (M, ...).
        key : hashable, optional
            Identifies the function, so that its values need not be computed again.
        """
        if self.through_filter is None:
            return function(self.velocity, self.acceleration)
        return self.through_filter(function, key)


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
    deviation : float or None
        Standard deviation about zero that it is believed to have, in its unit; None for one that
        follows the size of the efforts (see `sdpid.estimation.prior`).
    value : float or None
        Its value where that is known.

    Examples
    --------
    >>> sdpid.friction.Coulomb().parameters(("shoulder", "elbow"))[1]
    TermParameter(name='Fs2', unit='N.m', nonnegative=True, joint=1, deviation=None, value=None)
    """

    name: str
    unit: str
    nonnegative: bool
    joint: int
    deviation: float | None = None
    value: float | None = None

    @property
    def symbol(self) -> str:
        """The name without the joint's number."""
        return self.name.rstrip("0123456789")


class EffortCurve(NamedTuple):
    """A part of a term's effort over the velocity, as a simulation takes it.

    Attributes
    ----------
    kind : str
        ``"slope"``: `size` times the velocity. ``"constant"``: `size`. ``"jump"``: at
        the velocity `numbers[0]`, from `numbers[1]` to `size`. ``"load"``: `size` times the load
        and a sign, with share and speed of a sigmoid and the width of the sign. ``"position"``: a
        sign of the width `size` times a parabola over positions between the first two of
        `numbers`, with the control values that follow. Of the position less
        ``numbers[0]``: ``"powers"``: the first one times `size`, square and cube; ``"table"``:
        `size` times that of the points, whose count is ``numbers[1]``; ``"play"``: of an element
        that slips after ``numbers[1]``. Smooth curves without jumps, where s is the speed:
        ``"tanh"``: ``tanh(s/w)`` beyond a dead zone (1, dead zone, w); ``"root"``: √s; ``"peak"``:
        ``exp(−(s/a)^b) − 1`` (a, b, 1); ``"smooth_peak"``: ``exp(−(s/a)^b)·tanh(s/w)`` (a, b, w);
        ``"line"``: a slope between two speeds (1, from, to).
    joint : int
        The joint it acts on.
    size : float
        What it is multiplied by.
    numbers : tuple of float
        By kind.
    side : int
        1 or -1 where it acts at velocities of one sign only, 0 for both.
    points : tuple
        Positions and efforts of a table.
    """

    kind: str
    joint: int
    size: float
    numbers: tuple[float, ...] = (1.0, 1.0, 1.0)
    side: int = 0
    points: tuple[tuple[float, float], ...] = ()


def sign_curves(
    joint: int, size: float, width: float, dead_zone: float, side: int = 0
) -> Iterator[EffortCurve]:
    """Yield the curve and the jumps of a sign, exact or smooth, beyond a dead zone."""
    at_edge = size * (math.tanh(dead_zone / width) if width > 0.0 else 1.0)
    if width > 0.0:
        yield EffortCurve("tanh", joint, size, (1.0, dead_zone, width), side)
    if width > 0.0 and not dead_zone:
        return
    if side >= 0:
        yield EffortCurve("jump", joint, at_edge, (dead_zone, 0.0, 0.0))
    if side <= 0:
        yield EffortCurve("jump", joint, 0.0, (-dead_zone if dead_zone else 0.0, -at_edge, 0.0))


@dataclass(frozen=True)
class OpenParameter:
    """A number in which the effort is not linear, to be fitted to the data.

    Attributes
    ----------
    name : str
        Its name, such as ``width3`` for joint 3.
    lower, upper : float
        Where it is looked for, both positive: the search is logarithmic.
    unit : str
        Its unit.

    Examples
    --------
    >>> speeds = [np.linspace(0.0, 1.0, 100)]
    >>> sdpid.friction.Stribeck().open_parameters(speeds, ("joint_1",))
    (OpenParameter(name='velocity1', lower=0.005, upper=0.5, unit='rad/s'),)
    """

    name: str
    lower: float
    upper: float
    unit: str

    def __post_init__(self) -> None:
        if not 0.0 < self.lower <= self.upper < np.inf:
            raise ModelError(
                f"OpenParameter {self.name}: limits are {self.lower} and {self.upper}; give "
                "0 < lower <= upper."
            )


def smooth_sign(velocity: Array, width: ArrayLike, dead_zone: float) -> Array:
    """Return sign(v), or tanh(v / width) where width > 0; zero within the dead zone.

    Parameters
    ----------
    velocity : ndarray, shape (..., n)
        Velocities, rad/s.
    width : array_like, scalar or shape (n,)
        Widths of the smooth sign, rad/s; 0 for the exact one.
    dead_zone : float
        Speed below which the result is zero, rad/s.
    """
    widths = np.asarray(width, dtype=np.float64)
    shape = np.sign(velocity)
    if np.any(widths > 0.0):
        smooth = np.tanh(velocity / np.where(widths > 0.0, widths, 1.0))
        shape = np.where(widths > 0.0, smooth, shape)
    if dead_zone > 0.0:
        shape = np.where(np.abs(velocity) < dead_zone, 0.0, shape)
    return np.asarray(shape)


class FrictionTerm(ABC):
    """Base of every term: its parameters, and their columns.

    Attributes
    ----------
    linear : bool
        Whether the columns are linear in velocity and acceleration, so that those of filtered
        motion are the filtered columns.
    posed : bool
        Whether the columns depend on the position, so that only `columns_in` can give them.
    speed_fields : tuple of str
        Fields that are speeds: one number for all joints, a tuple with one a joint, or None for
        numbers that the data choose, one a joint.
    slowest : float or None
        Slowest speed that is searched for open fields, rad/s; None leaves it to the data.
    describes : str
        Which friction that every joint has it describes, ``"Coulomb"`` or ``"viscous"``, else
        ``""``: reports say what no term describes.
    curve : bool
        Whether dry friction and damping stand in for it in files that have room for these alone.
    efforts : mapping of str to str
        Formulas of the efforts of a joint's parameters of one, by their symbols, for friction
        written as code: of its velocity ``{v}``, acceleration ``{a}`` and load ``{load}``, the sign
        of its velocity ``{sign}``, and settings such as ``{width!r}``, with the functions ``sign``,
        ``tanh``, ``size``, ``root`` and others that stand in the written files. A class must give
        them itself.

    Examples
    --------
    >>> term = sdpid.friction.Viscous()
    >>> [parameter.name for parameter in term.parameters(("shoulder", "elbow"))]
    ['Fv1', 'Fv2']
    """

    linear: ClassVar[bool] = False
    posed: ClassVar[bool] = False
    speed_fields: ClassVar[tuple[str, ...]] = ()
    slowest: ClassVar[float | None] = None
    describes: ClassVar[str] = ""
    curve: ClassVar[bool] = False
    efforts: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        check_speeds(self, self.speed_fields)

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

    def enclosed(self, velocity: Range, acceleration: Range, joint_names: Sequence[str]) -> Range:
        """Return bounds of the columns, below and above, over ranges of motion.

        By default those of columns that do not fall as velocity or acceleration grows.

        Parameters
        ----------
        velocity, acceleration : tuple of 2 ndarrays, shape (K, n) each
            Least and largest values.
        joint_names : sequence of str
            The n joints.
        """
        low, high = zip(velocity, acceleration, strict=True)
        return self.columns(*low, joint_names), self.columns(*high, joint_names)

    def acting(
        self, values: Array, joint_names: Sequence[str]
    ) -> Iterator[tuple[FrictionTerm, Sequence[Place], Array]]:
        """Yield what acts with parameters of these values: terms, where, and their own values.

        By default the term itself, on the joints.
        """
        yield self, joint_names, values

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the effort of parameters of these values, curve by curve.

        A class must give it itself: its base's may be of another effort.

        Raises
        ------
        ModelError
            By default: the jumps and slopes of any columns are not known.
        """
        raise ModelError(
            f"simulation: the friction term {type(self).__name__} is neither one of sdpid's own "
            "nor a JointwiseTerm, so that its jumps and slopes are not known; give it a method "
            "simulated(values, joint_names), or identify with terms of sdpid.friction."
        )

    def columns_in(self, motion: SampledMotion, joint_names: Sequence[str]) -> Array:
        """Return the columns (K, n, number of parameters) as they stand in filtered efforts.

        Parameters
        ----------
        motion : SampledMotion
            States of K samples.
        joint_names : sequence of str
            The n joints.
        """
        if self.linear:
            return self.columns(motion.velocity, motion.acceleration, joint_names)
        names = tuple(joint_names)
        return motion.filtered(lambda v, a: self.columns(v, a, names), (self, names))

    def speed(self, field: str, n: int) -> Array:
        """Return the values (n,) of a speed field.

        Raises
        ------
        ModelError
            When it is still open, or has not one value a joint.
        """
        value = getattr(self, field)
        if value is None:
            raise ModelError(
                f"{type(self).__name__}: {field} is open; give it a value, or let build_problem "
                "choose it by the data."
            )
        if isinstance(value, tuple) and len(value) != n:
            raise ModelError(
                f"{type(self).__name__}: {field} has {len(value)} values, the robot {n} joints; "
                "give one a joint, or one for all."
            )
        return np.broadcast_to(np.asarray(value, dtype=np.float64), (n,))

    def open_parameters(
        self, speeds: Sequence[Array], joint_names: Sequence[str]
    ) -> tuple[OpenParameter, ...]:
        """Return the parameters to be fitted before the regressor exists.

        By default one a joint for each speed field that is None.

        Parameters
        ----------
        speeds : sequence of ndarray
            Of each joint the measured speeds ``|v|`` (rad/s) of the samples in use, possibly none.
        joint_names : sequence of str
            The n joints.
        """
        return tuple(
            OpenParameter(f"{field}{j + 1}", *speed_limits(measured, self.slowest), "rad/s")
            for field in self.speed_fields
            if getattr(self, field) is None
            for j, measured in enumerate(speeds)
        )

    def with_values(self, values: Sequence[float]) -> FrictionTerm:
        """Return a copy with values for the open parameters, in their order.

        Raises
        ------
        ModelError
            When there are none, or the values are not one a joint for each.
        """
        missing = [field for field in self.speed_fields if getattr(self, field) is None]
        if not missing:
            if len(values):
                raise ModelError(f"{type(self).__name__}: has no open parameters.")
            return self
        each, rest = divmod(len(values), len(missing))
        if rest or not each:
            raise ModelError(
                f"{type(self).__name__}: {len(values)} values for {', '.join(missing)}; give one a "
                "joint for each."
            )
        chosen = [tuple(float(x) for x in values[k * each :][:each]) for k in range(len(missing))]
        changes = dict(zip(missing, chosen, strict=True))
        return replace(self, **changes)  # type: ignore[type-var]

    def alike(self, joint_names: Sequence[str]) -> tuple[tuple[int, int], ...]:
        """Return pairs of parameters, by index, that are believed to be alike. None by default."""
        return ()

    def characteristic_speeds(self, n: int) -> Array:
        """Return speeds (k, n) at which columns bend: those of the speed fields.

        The scan for base parameters looks at states with such speeds too; a term that is all but
        zero or constant at other speeds would else be taken for dependent.
        """
        rows = [self.speed(field, n) for field in self.speed_fields]
        kept = [row for row in rows if np.any(row > 0.0)]
        return np.reshape(kept, (len(kept), n))


class OfPosition(FrictionTerm):
    """A base of terms whose columns depend on the position."""

    posed: ClassVar[bool] = True

    def columns(self, velocity: Array, acceleration: Array, joint_names: Sequence[str]) -> Array:
        """Refuse: velocities and accelerations alone do not determine the columns.

        Raises
        ------
        ModelError
            Always; `columns_in` takes the whole motion.
        """
        raise ModelError(
            f"{type(self).__name__}: its effort depends on the position; evaluate it with "
            "columns_in(SampledMotion(...), joint_names)."
        )


class OfEachJoint(FrictionTerm):
    """A base of terms with one parameter of one symbol for each joint."""

    symbol: ClassVar[str]
    unit: ClassVar[str]
    nonnegative: ClassVar[bool]

    def parameters(self, joint_names: Sequence[str]) -> tuple[TermParameter, ...]:
        """Return one parameter for each joint."""
        return of_each_joint(joint_names, (self.symbol,), self.unit, self.nonnegative)


@dataclass(frozen=True)
class JointwiseTerm(OfEachJoint):
    """A term with one parameter per joint, which acts on that joint alone.

    A class gives its `symbol`, with which names of parameters begin (it does not end in ``r``),
    their `unit`, `nonnegative`, whether physics forbids negative values, and its `shape`.

    Examples
    --------
    >>> class Drag(sdpid.friction.JointwiseTerm):
    ...     symbol, unit, nonnegative = "Fd", "N.m.s2/rad2", True
    ...     def shape(self, velocity, acceleration):
    ...         return velocity * np.abs(velocity)
    >>> problem = sdpid.build_problem(robot, samples, friction=("coulomb", "viscous", Drag()))
    >>> problem.base.names[-3:]
    ('Fs6', 'Fv6', 'Fd6')
    """

    @abstractmethod
    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the effort of a unit parameter at every joint, shape (K, n)."""

    def columns(self, velocity: Array, acceleration: Array, joint_names: Sequence[str]) -> Array:
        """Return the columns: diagonal in the joints."""
        return diagonal(self.shape(velocity, acceleration))

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield lines between speeds, and a jump at rest.

        Raises
        ------
        ModelError
            When the effort depends on the acceleration, or the term has columns of its own.
        """
        if type(self).columns is not JointwiseTerm.columns:
            yield from FrictionTerm.simulated(self, values, joint_names)
        v = np.array([-1.0, 1.0])[:, None, None] * np.tile(_SPEEDS[:, None], (1, len(values)))
        still, fast = (
            np.stack([self.shape(x, np.full_like(x, a)) for x in v]) * values for a in (0.0, 1.0)
        )
        if not np.array_equal(still, fast):
            raise ModelError(
                f"simulation: the effort of {type(self).__name__} depends on the acceleration, "
                "which is not simulated; identify with terms of sdpid.friction."
            )
        slopes, ends = np.diff(still, axis=1) / np.diff(v, axis=1), [*_SPEEDS[:-1], np.inf]
        for side, k, j in np.argwhere(slopes != 0.0).tolist():
            numbers = (1.0, float(ends[k]), float(ends[k + 1]))
            yield EffortCurve("line", j, float(slopes[side, k, j]), numbers, 2 * side - 1)
        for j, (low, high) in enumerate(still[:, 0].T.tolist()):
            if abs(high - low) > _JUMP * np.abs(still[..., j]).max():
                yield EffortCurve("jump", j, high, (0.0, low, 0.0))
            else:
                yield EffortCurve("constant", j, 0.5 * (low + high))

    def columns_in(self, motion: SampledMotion, joint_names: Sequence[str]) -> Array:
        """Return the columns as they stand in filtered efforts: diagonal in the joints."""
        if type(self).columns is not JointwiseTerm.columns:
            return FrictionTerm.columns_in(self, motion, joint_names)
        return diagonal(self.shape_in(motion))

    def shape_in(self, motion: SampledMotion) -> Array:
        """Return the effort (K, n) of a unit parameter as it stands in filtered efforts."""
        if self.linear:
            return self.shape(motion.velocity, motion.acceleration)
        return motion.filtered(self.shape, self)


def simulated_curves(
    term: FrictionTerm, values: Array, joint_names: Sequence[str]
) -> Iterator[EffortCurve]:
    """Yield the curves of a term: its class's own, else lines of any jointwise one."""
    if "simulated" in vars(type(term)):
        return term.simulated(values, joint_names)
    if isinstance(term, JointwiseTerm):
        return JointwiseTerm.simulated(term, values, joint_names)
    return FrictionTerm.simulated(term, values, joint_names)


def of_each_joint(
    joint_names: Sequence[str], symbols: Iterable[str], unit: str, nonnegative: bool, **more: Any
) -> tuple[TermParameter, ...]:
    """Return a parameter of each joint for every symbol in turn."""
    names = product(symbols, range(len(joint_names)))
    return tuple(TermParameter(f"{s}{j + 1}", unit, nonnegative, j, **more) for s, j in names)


def diagonal(*shapes: Array) -> Array:
    """Return columns (K, n, n) of which each joint has its own, of every shape (K, n) in turn."""
    count, n = shapes[0].shape
    columns = np.zeros((count, n, len(shapes) * n))
    joints = np.arange(n)
    for k, shape in enumerate(shapes):
        columns[:, joints, k * n + joints] = shape
    return columns


def check_speeds(term: FrictionTerm, fields: Sequence[str]) -> None:
    """Raise `ModelError` unless the fields hold None, a speed, or a tuple of speeds."""
    for field in fields:
        value, positive = getattr(term, field), field == "velocity"
        if value is None:
            continue
        numbers = value if isinstance(value, tuple) else (value,)
        zero = "" if positive else " or 0"
        if not all(SLOWEST <= x <= FASTEST or (x == 0.0 and not positive) for x in numbers):
            raise ModelError(
                f"{type(term).__name__}: {field} is {value}; give a positive velocity{zero}, "
                f"between {SLOWEST:g} and {FASTEST:g} rad/s."
            )


def speed_limits(measured: Array, slowest: float | None = None) -> tuple[float, float]:
    """Return the lower and upper search limits of an open speed, from measured speeds (K,).

    The lower one is `slowest`, by default a quantile of the speeds, within shares of the top one.
    """
    top = float(measured.max(initial=0.0))
    if top < _MOVES:
        top = _STANDING
    slow = slowest
    if slow is None:
        slow = float(np.quantile(measured, _SLOW_SHARE)) if measured.size else 0.0
    least, most = _LEAST_OF_TOP
    return float(np.clip(slow, least * top, most * top)), _MOST_OF_TOP * top
