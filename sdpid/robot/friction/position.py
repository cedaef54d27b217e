"""Terms of the position, of its history, and terms on the joints behind a transmission."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, is_number, real_array
from sdpid.errors import ModelError
from sdpid.robot.friction.term import (
    EffortCurve,
    FrictionTerm,
    OfEachJoint,
    OfMotion,
    OfPosition,
    Place,
    SampledMotion,
    TermParameter,
    diagonal,
)

# Parameters of a spring that is not linear.
_BENT = ("Kq", "Kc")
# Parameters of one term at most, each of which has a letter.
_LETTERS = 26
# The number of a joint at the end of a parameter's name.
_NUMBER = re.compile(r"\d+$")
# A parameter: symbol, unit, whether it is not negative, and its value where that is known.
Symbol = tuple[str, str, bool, float | None]


class OneJoint(OfPosition):
    """A base of terms that act on one joint, at any speed."""

    # A joint whose position is recorded, or one behind a transmission.
    joint: str

    def parameters(self, joint_names: Sequence[str]) -> tuple[TermParameter, ...]:
        """Return the parameters, called by the joint's number, or its name where it has none."""
        if not isinstance(self.joint, str):
            raise ModelError(
                f"{type(self).__name__}: joint is {self.joint!r:.80}; give the name of a joint."
            )
        known = self.joint in joint_names
        place = joint_names.index(self.joint) if known else 0
        end = str(place + 1) if known else f"_{self.joint}"
        return tuple(
            TermParameter(f"{symbol}{end}", unit, nonnegative, place, value=known)
            for symbol, unit, nonnegative, known in self._symbols()
        )

    @abstractmethod
    def _symbols(self) -> Iterable[Symbol]:
        """Return every parameter."""

    def columns_in(self, motion: SampledMotion, joint_names: Sequence[str]) -> Array:
        """Return the shapes of the joint's position, on the joints that move it."""
        robot, n = motion.robot, len(joint_names)
        way, offset = way_of(type(self).__name__, self.joint, robot, joint_names)

        def shapes(positions: Array) -> Array:
            return self._shapes(positions[:, -n:] @ way + offset)

        _require_angles(self, motion, n)
        return np.asarray(motion.along(shapes)[:, None, :] * way[:, None])

    def acting(
        self, values: Array, joint_names: Sequence[str]
    ) -> Iterator[tuple[FrictionTerm, Sequence[Place], Array]]:
        """Yield itself, on its joint."""
        yield self, (self.joint,), values

    @abstractmethod
    def _shapes(self, position: Array) -> Array:
        """Return the efforts (K, parameters) of parameters of one at positions (K,) in time."""


class PositionwiseTerm(OfEachJoint, OfPosition):
    """A term of your own with one parameter a joint, whose effort depends on the whole motion.

    A class gives its `symbol`, with which names of parameters begin (it does not end in ``r``),
    their `unit`, `nonnegative`, whether physics forbids negative values, and its `shape`.
    It is evaluated at the samples, whatever the filter of the efforts.

    Examples
    --------
    >>> class Ripple(sdpid.friction.PositionwiseTerm):
    ...     symbol, unit, nonnegative = "Fp", "N.m", False
    ...     def shape(self, position, velocity, acceleration):
    ...         return np.cos(12.0 * position) * np.tanh(velocity / 0.01)
    >>> problem = sdpid.build_problem(robot, samples, friction=("coulomb", "viscous", Ripple()))
    >>> problem.base.names[-2:]
    ('Fv6', 'Fp6')
    """

    @abstractmethod
    def shape(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the effort of a unit parameter at every joint, shape (K, n)."""

    def columns_in(self, motion: SampledMotion, joint_names: Sequence[str]) -> Array:
        """Return the columns: diagonal in the joints."""
        n = len(joint_names)
        _require_angles(self, motion, n)
        found = self.shape(motion.position[:, -n:], motion.velocity, motion.acceleration)
        shape = np.asarray(found, dtype=np.float64)
        if shape.shape != motion.velocity.shape or not np.isfinite(shape).all():
            raise ModelError(
                f"{type(self).__name__}: its shape is {shape.shape} for {motion.velocity.shape} "
                "(samples, joints), or not finite; give one finite number for each."
            )
        return diagonal(shape)


def _require_angles(term: FrictionTerm, motion: SampledMotion, n: int) -> None:
    """Refuse positions that are not one of each joint behind a base's seven."""
    pose = 7 if motion.robot.n_base else 0
    if motion.position.shape[1] != pose + n:
        raise ModelError(
            f"{type(term).__name__}: positions of '{motion.robot.name}' have "
            f"{motion.position.shape[1]} columns, which are not one of each of {n} joints "
            f"behind the base's {pose}; give these in place of configurations."
        )


def way_of(what: str, place: Place, robot: Any, joint_names: Sequence[str]) -> tuple[Array, float]:
    """Return how a position follows the recorded ones: factors (n,) and an offset."""
    if not isinstance(place, str):
        return np.array(place), 0.0
    if place in joint_names:
        return np.eye(len(joint_names))[joint_names.index(place)], 0.0
    tree = () if robot is None else robot.tree_joints[robot.n_base :]
    if place not in tree:
        behind = [name for name in tree if name not in joint_names]
        more = f", behind its transmission {', '.join(behind)}" if behind else ""
        raise ModelError(
            f"{what}: the robot has no joint '{place}'; it has {', '.join(joint_names)}{more}."
        )
    way, offset = robot.way({place: 1.0})
    return way[robot.n_base :], offset


@dataclass(frozen=True)
class Spring(OneJoint):
    """A spring about a joint: the effort ``K·(q − rest)`` holds against it.

    Attributes
    ----------
    joint : str
        A joint whose position is recorded, or one behind a transmission.
    stiffness : float, optional
        Where it is known, N·m/rad (N/m).
    rest : float, optional
        Position at which it is slack, where that is known, rad (m). Where it is not, the parameter
        Kr is stiffness times rest, N·m.
    polynomial : tuple of float, optional
        Known factors of the square and the cube of the way from rest, N·m/rad² and N·m/rad³, as
        MuJoCo has them; the rest is then known too.

    Examples
    --------
    >>> spring = sdpid.friction.Spring("joint_2", rest=0.1)
    >>> problem = sdpid.build_problem(robot, samples, friction=("coulomb", "viscous", spring))
    >>> "K2" in problem.base.names
    True
    """

    joint: str
    stiffness: float | None = None
    rest: float | None = None
    polynomial: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name in ("stiffness", "rest"):
            value = getattr(self, name)
            if value is not None and not (is_number(value) and np.isfinite(value)):
                raise ModelError(f"Spring: {name} is {value!r:.80}; give a finite number.")
        given = self.polynomial
        factors = real_array(given, "Spring: polynomial", ndim=1, error=ModelError)
        object.__setattr__(self, "polynomial", bent := tuple(factors.tolist()))
        if len(bent) > len(_BENT) or (bent and self.rest is None):
            raise ModelError(
                f"Spring: polynomial is {bent!r:.80}; give at most two finite numbers, and the "
                "rest with them."
            )
        if self.stiffness is not None and self.stiffness < 0.0:
            raise ModelError(
                f"Spring: stiffness is {self.stiffness}, the least is 0; a PositionTerm may push "
                "away from a position."
            )

    def _symbols(self) -> Iterable[Symbol]:
        yield "K", "N.m/rad", True, self.stiffness
        if self.rest is None:
            yield "Kr", "N.m", False, None
        yield from ((s, "1", False, x) for s, x in zip(_BENT, self.polynomial, strict=False))

    def _shapes(self, position: Array) -> Array:
        if self.rest is not None:
            powers = np.arange(1, 2 + len(self.polynomial))
            return np.asarray((position - self.rest)[:, None] ** powers)
        return np.stack([position, -np.ones_like(position)], axis=1)

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield powers of the position, and a constant where the rest is not known."""
        first, second, third = (*values.tolist(), 0.0, 0.0)[:3]
        if self.rest is None:
            yield EffortCurve("powers", 0, first, (0.0, 0.0, 0.0))
            yield EffortCurve("constant", 0, -second)
        else:
            yield EffortCurve("powers", 0, first, (self.rest, second, third))


@dataclass(frozen=True)
class PositionTerm(OneJoint):
    """Efforts that are known functions of a joint's position: a cable, a counterbalance, cogging.

    Attributes
    ----------
    function : callable, or pair of tuples of float
        Takes positions (K,) and returns efforts (K,), or (K, m) of m parameters. Or a table of
        positions, rising, and efforts, linear in between and constant beyond.
    name : str
        What the parameters are called: of several, letters follow.
    joint : str
        A joint whose position is recorded, or one behind a transmission.
    count : int
        Number of parameters.
    unit : str
        Their unit: "1" where the function returns N·m (N).
    nonnegative : bool
        Whether they cannot be negative.
    value : float, optional
        That of the parameter, where it is known.

    Examples
    --------
    >>> cable = sdpid.friction.PositionTerm(np.sin, "cable", joint="joint_4")
    >>> problem = sdpid.build_problem(robot, samples, friction=("coulomb", "viscous", cable))
    >>> "cable4" in problem.base.names
    True
    """

    function: Callable[[Array], Array] | tuple[tuple[float, ...], tuple[float, ...]]
    name: str
    joint: str
    count: int = 1
    unit: str = "1"
    nonnegative: bool = False
    value: float | None = None

    def __post_init__(self) -> None:
        value, least = self.value, 0.0 if self.nonnegative else -np.inf
        known = value is None or (is_number(value) and np.isfinite(value) and value >= least)
        whole = is_number(self.count) and self.count in range(1, _LETTERS + 1)
        for name, good, asked in (
            ("name", isinstance(self.name, str) and self.name, "a text"),
            ("count", whole, f"a whole number from 1 to {_LETTERS}"),
            ("value", known, f"a finite number{' from 0 on' if self.nonnegative else ''}"),
        ):
            if not good:
                given = getattr(self, name)
                raise ModelError(
                    f"PositionTerm {self.name}: {name} is {given!r:.80}; give {asked}."
                )
        # Files of results hold all numbers as decimals.
        object.__setattr__(self, "count", int(self.count))
        if callable(self.function):
            return
        try:
            table = np.asarray(self.function, dtype=np.float64)
        except (TypeError, ValueError):
            table = np.zeros(0)
        if table.ndim != 2 or len(table) != 2 or not table.size or not np.isfinite(table).all():
            raise ModelError(
                f"PositionTerm {self.name}: function is {self.function!r:.80}; give a function of "
                "positions, or two tuples of as many finite numbers: positions and efforts."
            )
        if not (np.diff(table[0]) > 0.0).all():
            raise ModelError(f"PositionTerm {self.name}: the positions of its table do not rise.")
        rows = tuple(tuple(float(x) for x in row) for row in table)
        object.__setattr__(self, "function", rows)

    def _symbols(self) -> Iterable[Symbol]:
        for k in range(self.count):
            letter = chr(97 + k) if self.count > 1 else ""
            yield self.name + letter, self.unit, self.nonnegative, self.value

    def _shapes(self, position: Array) -> Array:
        found = (
            self.function(position)
            if callable(self.function)
            else np.interp(position, *self.function)
        )
        try:
            shapes = np.asarray(found, dtype=np.float64)
        except (TypeError, ValueError):
            shapes = np.zeros(())
        if shapes.shape not in ((len(position),) * (self.count == 1), (len(position), self.count)):
            shapes = np.full(1, np.nan)
        if not np.isfinite(shapes).all():
            raise ModelError(
                f"PositionTerm {self.name}: its function returned the shape {np.shape(found)} for "
                f"{len(position)} positions; give {self.count} finite value(s) each."
            )
        return shapes.reshape(len(position), -1)

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the table.

        Raises
        ------
        ModelError
            For a function of one's own.
        """
        if callable(self.function):
            raise ModelError(
                f"simulation: PositionTerm {self.name} has a function of your own, which is not "
                "simulated; give a table in its place."
            )
        points = tuple(zip(*self.function, strict=True))
        yield EffortCurve("table", 0, float(values[0]), (0.0, len(points), 0.0), points=points)


@dataclass(frozen=True)
class Hysteresis(OneJoint):
    """Dry friction that builds up over a way: springs in parallel that slip, one behind the other.

    An element of weight F pulls by ``F·(q − z)/slip``, where z follows q at a distance of at most
    `slip`. Weights are not negative, so that it takes energy up.

    Attributes
    ----------
    joint : str
        A joint whose position is recorded, or one behind a transmission.
    slips : tuple of float
        Ways after which the elements slip, rad (m).

    Examples
    --------
    >>> soft = sdpid.friction.Hysteresis("joint_4", (0.02, 0.1))
    >>> problem = sdpid.build_problem(robot, samples, friction=("coulomb", "viscous", soft))
    >>> [name for name in problem.base.names if name.startswith("Fh")]
    ['Fha4', 'Fhb4']
    """

    joint: str
    slips: tuple[float, ...]

    def __post_init__(self) -> None:
        given: Any = self.slips
        slips = given if isinstance(given, Sequence) else ()
        if not slips or not all(is_number(s) and 0.0 < s < np.inf for s in slips):
            raise ModelError(f"Hysteresis: slips are {self.slips!r:.80}; give positive numbers.")

    def _symbols(self) -> Iterable[Symbol]:
        return ((f"Fh{chr(97 + k)}", "N.m", True, None) for k in range(len(self.slips)))

    def _shapes(self, position: Array) -> Array:
        return np.stack([(position - play(position, s)) / s for s in self.slips], axis=1)

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the elements."""
        for value, slip in zip(values.tolist(), self.slips, strict=True):
            yield EffortCurve("play", 0, value, (0.0, slip, 0.0))


def play(position: Array, slip: float) -> Array:
    """Return what follows a signal (K,) at a distance of at most a slip."""
    followed, now = np.empty(len(position)), float(position[0]) if len(position) else 0.0
    for k, value in enumerate(position.tolist()):
        now = min(max(now, value - slip), value + slip)
        followed[k] = now
    return followed


@dataclass(frozen=True)
class AtJoints(OfPosition):
    """A term on joints behind a transmission, in place of those whose positions are recorded.

    Attributes
    ----------
    friction : FrictionTerm
        What acts on each of the joints.
    joints : tuple of str
        The joints. In place of a name there may be the factors of all recorded joints, one each:
        the term then acts on the sum of these.

    Examples
    --------
    >>> drag = sdpid.friction.AtJoints(sdpid.friction.Viscous(), ("joint_2", "joint_3"))
    >>> problem = sdpid.build_problem(robot, samples, friction=("coulomb", drag))
    >>> [name for name in problem.base.names if name.startswith("Fv")]
    ['Fv_joint_2', 'Fv_joint_3']
    """

    friction: FrictionTerm
    joints: tuple[Place, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.friction, FrictionTerm) or self.friction.posed:
            raise ModelError(
                f"AtJoints: {self.friction!r:.80} is no term of several joints' motion alone; give "
                "one such as friction.Viscous(). Springs and terms of the position name their "
                "joint themselves."
            )
        object.__setattr__(self, "joints", tuple(self.joints))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints; sums of joints have numbers."""
        return tuple(
            place if isinstance(place, str) else f"sum{k}" for k, place in enumerate(self.joints, 1)
        )

    def parameters(self, joint_names: Sequence[str]) -> tuple[TermParameter, ...]:
        """Return those of the term, called by the joints' names."""
        found = self.friction.parameters(self.names)
        return tuple(
            replace(
                each,
                name=f"{_NUMBER.sub('', each.name)}_{self.names[each.joint]}",
                joint=min(each.joint, len(joint_names) - 1),
            )
            for each in found
        )

    def columns_in(self, motion: SampledMotion, joint_names: Sequence[str]) -> Array:
        """Return the term's columns at the motion of its joints, on the joints that move them."""
        ways = np.array(
            [way_of("AtJoints", place, motion.robot, joint_names)[0] for place in self.joints]
        )
        through = motion.through_filter

        def through_filter(function: OfMotion, key: Hashable | None) -> Array:
            assert through is not None
            mapped = None if key is None else (self, key)
            return through(lambda v, a: function(v @ ways.T, a @ ways.T), mapped)

        # Its term does not depend on positions.
        own = SampledMotion(
            position=motion.position,
            velocity=motion.velocity @ ways.T,
            acceleration=motion.acceleration @ ways.T,
            robot=motion.robot,
            through_filter=None if through is None else through_filter,
        )
        return np.asarray(ways.T @ self.friction.columns_in(own, self.names))

    def acting(
        self, values: Array, joint_names: Sequence[str]
    ) -> Iterator[tuple[FrictionTerm, Sequence[Place], Array]]:
        """Yield its term, on its joints."""
        yield self.friction, self.joints, values

    def with_values(self, values: Sequence[float]) -> FrictionTerm:
        """Return a copy with values for the open parameters of its term."""
        return replace(self, friction=self.friction.with_values(values))
