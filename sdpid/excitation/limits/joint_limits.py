"""`JointLimits`: the limits of the joints of one robot, described and given."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Mask, frozen, generator, is_number, shaped
from sdpid._common.tables import Table
from sdpid.errors import DataError
from sdpid.robot.model.arms import require_fixed_robot
from sdpid.robot.model.model import RobotModel

# Where a limit comes from.
GIVEN, DESCRIBED, ASSUMED, NONE = "given", "description", "assumed", "none"

# Kinds of limits of each joint.
KINDS = ("lower", "upper", "velocity", "acceleration", "jerk", "torque")

# A motion is worth its while when every joint can travel this part of its range and back.
_WORTHWHILE = 0.1

# Units of turning and of sliding joints.
UNITS = {
    "position": ("rad", "m"),
    "lower": ("rad", "m"),
    "upper": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "acceleration": ("rad/s²", "m/s²"),
    "jerk": ("rad/s³", "m/s³"),
    "torque": ("N·m", "N"),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class JointLimits:
    """Limits of every joint of a robot, from `Limits.of`; infinite where there is none.

    Attributes
    ----------
    joint_names : tuple of str
        The n joints.
    sliding : tuple of bool
        Which of them slide.
    rest : ndarray, shape (n,)
        Position at rest, rad (m of sliding joints); within the limits.
    lower, upper : ndarray, shape (n,)
        Least and largest position, rad (m).
    velocity, acceleration, jerk : ndarray, shape (n,)
        Largest sizes, rad/s, rad/s² and rad/s³ (m).
    torque : ndarray, shape (n,)
        Largest sizes, N·m (N).
    tool_speed : float or None
        Largest speed of the tool, m/s.
    tool : str or None
        Frame whose speed that is; None for the outermost point of every last link.
    clearance : float or None
        Least distance between parts that must not touch, m.
    sources : dict of str to tuple of str
        Of each kind of limit, joint by joint, ``"given"``, ``"description"``, ``"assumed"`` or
        ``"none"``.
    assumed : tuple of str
        What was assumed or left out, one sentence each.
    """

    joint_names: tuple[str, ...]
    sliding: tuple[bool, ...]
    rest: Array
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    torque: Array
    tool_speed: float | None = None
    tool: str | None = None
    clearance: float | None = None
    sources: dict[str, tuple[str, ...]]
    assumed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, each.name, frozen(value))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    def table(self) -> Table:
        """Return one row a joint; a dash where there is no limit."""
        columns: dict[str, Any] = {"joint": self.joint_names}
        return Table.of_columns(columns | {kind: getattr(self, kind).tolist() for kind in KINDS})

    def shortest_duration(self, part: float = _WORTHWHILE) -> Array:
        """Return the least time (n,) in s to travel a part of the range and back, rest to rest.

        By motions of bounded speed, acceleration and jerk, each as fast as its limits allow. A
        plan that is shorter cannot excite that joint.

        Parameters
        ----------
        part : float, optional
            Part of the range from the lower to the upper limit; by default a tenth.
        """
        distance = part * (self.upper - self.lower)
        limits = zip(distance, self.velocity, self.acceleration, self.jerk, strict=True)
        return np.array([2.0 * rest_to_rest(*map(float, joint)) for joint in limits])


def rest_to_rest(distance: float, velocity: float, acceleration: float, jerk: float) -> float:
    """Return the least time from rest to rest over a distance, under three limits, s.

    The fastest motion raises the acceleration at the full jerk, holds it, lowers it, holds the
    speed, and does the same backwards. Infinite limits are none.
    """
    # Each of the four ramps of the acceleration ends where the acceleration, the speed or half of
    # the way is reached.
    to_full = 0.0 if math.isinf(jerk) else acceleration / jerk
    ramp = min(to_full, math.sqrt(velocity / jerk), math.pow(0.5 * distance / jerk, 1.0 / 3.0))
    if math.isinf(jerk):
        ramp = 0.0
    if ramp < to_full:
        rise, top = ramp, jerk * ramp**2
    elif math.isinf(acceleration):
        rise, top = 0.0, velocity
    else:
        # Time from the first ramp's start to the second's, during which the speed rises.
        rise = 0.5 * (math.sqrt(ramp**2 + 4.0 * distance / acceleration) - ramp)
        rise = min(rise, velocity / acceleration)
        top = acceleration * rise
    cruise = distance / top - (rise + ramp) if top > 0.0 else 0.0
    return 2.0 * (rise + ramp) + max(cruise, 0.0)


def unit_of(kind: str, sliding: object) -> str:
    """Return the unit of a limit of a turning or a sliding joint."""
    return UNITS[kind][bool(sliding)]


# A value for all joints, one a joint in the robot's order (None for none), or values by joint.
Values = float | Sequence[float | None] | Mapping[str, float] | None

# The entry of a mapping that stands for all joints that it does not name.
OTHERS = "*"

# Joints without position limits may go this far to either side of their rest position: half a turn
# keeps cables whole. Sliding joints may have an end stop anywhere (m).
_HALF_TURN, _SHORT_WAY = np.pi, 0.1

# What is assumed of sizes without limits: in so many seconds a joint gets to the size before, and
# at most this of turning and of sliding joints; and how that is told. Descriptions have no
# accelerations. Full speed after half a second is a lively motion of any arm: 4.4 rad/s² on the
# Panda, whose maker allows 7.5 to 20; capped where speeds are high. The full acceleration after a
# tenth of a second is far above the period of an arm's own oscillations.
_USUAL = {
    "velocity": (1.0, (2.0, 0.25), "{amount} is assumed"),
    "acceleration": (
        0.5,
        (5.0, 2.0),
        "full speed after {seconds:g} s, at most {amount}, is assumed",
    ),
    "jerk": (0.1, (np.inf, np.inf), "the full acceleration after {seconds:g} s is assumed"),
}
_UNCHECKED = "they are not checked"

# The joints rest at zero where that is this part of the range or more away from its ends, in the
# middle otherwise.
_FROM_ENDS = 0.1
# Stands for infinity there, rad or m: any number far beyond the joints' ranges will do.
_UNBOUNDED = 1e3

# Larger values are degrees of turning joints, two turns and 8 turns a second (rad, rad/s), and mm
# of sliding ones (m, m/s).
_SLIPS = {
    "lower": (4.0 * np.pi, 20.0),
    "upper": (4.0 * np.pi, 20.0),
    "velocity": (50.0, 20.0),
}

# Described limits of turning joints beyond these limit nothing: in example-robot-data real ones
# come to 52 rad/s, two turns, and 17 times the torque that holds the whole robot at its reach (a
# hand); numbers that stand for none begin at 100 rad/s, three turns and 77 times.
_FASTEST, _WIDEST, _STRONGEST = 20.0 * np.pi, 6.0 * np.pi, 40.0

# Limits are the same where they differ by less than this share: files round them.
_SAME = 1e-3

# Gravity takes at most this share of the torque limits at rest, where such a position is found
# among those drawn: a reserve for friction, and some torque for the motion, are left.
_EASY, _DRAWN = 0.7, 1000


@dataclass(eq=False)
class Narrowing:
    """The way from given limits and a description to those of the joints, told on the way.

    Attributes
    ----------
    robot : RobotModel
        On a fixed base.
    given : mapping
        Values by kind of limit, one for each of `KINDS`.
    share : float
        Share of the description's limits that is used.
    override : bool
        Whether given values hold where they are wider than the description's, too.
    assume : bool
        Whether missing limits are assumed, and the robot must be able to stand at rest.

    Raises
    ------
    ModelError
        When the base floats.
    """

    robot: RobotModel
    given: Mapping[str, Values]
    share: float
    override: bool
    assume: bool

    def __post_init__(self) -> None:
        require_fixed_robot(self.robot, "limits")
        self._names, self._n = self.robot.joint_names, self.robot.n
        self._sliding = self.robot.slides
        self._told: list[str] = []
        self._sources: dict[str, tuple[str, ...]] = {}

    def limits(self, rest: ArrayLike | None) -> JointLimits:
        """Return the joints' limits; see `Limits.of`.

        Parameters
        ----------
        rest : array_like, shape (n,), optional
            Position at rest.

        Raises
        ------
        DataError
            When limits contradict each other or what they are for.
        """
        where, names = "rest position", f": {', '.join(self._names)}"
        start = None if rest is None else shaped(rest, where, (self._n,), names)
        lower, upper = self._range(np.zeros(self._n) if start is None else start)
        found: dict[str, Any] = {"lower": lower, "upper": upper}
        before = np.full(self._n, np.inf)
        for kind, (seconds, most, words) in _USUAL.items():
            values = self._size(kind)
            missing = np.isnan(values)
            amounts = (f"{amount:g} {unit_of(kind, k)}" for k, amount in enumerate(most))
            self._missing(
                kind, missing, *(words.format(amount=each, seconds=seconds) for each in amounts)
            )
            most_of_all = np.where(self._sliding, *most[::-1]) * self.robot.gears
            usual = np.minimum(before / seconds, most_of_all)
            before = found[kind] = np.where(missing, usual if self.assume else np.inf, values)
        torque = self._size("torque")
        self._tell(np.isnan(torque), f"no torque limits; {_UNCHECKED}")
        self._tell_empty(upper - lower, found["velocity"], torque)
        if self.share < 1.0 and any(DESCRIBED in each for each in self._sources.values()):
            self._told.append(
                f"of the description's position ranges, speeds and torques {100 * self.share:g} % "
                "are used, since controllers stop the arm at their limits."
            )
        limits = JointLimits(
            joint_names=self._names,
            sliding=tuple(self._sliding.tolist()),
            rest=_usual_rest(lower, upper) if start is None else start,
            torque=np.where(np.isnan(torque), np.inf, torque),
            sources=self._sources,
            assumed=tuple(self._told),
            **found,
        )
        return _standing(self.robot, limits, given=rest is not None) if self.assume else limits

    def _range(self, about: Array) -> tuple[Array, Array]:
        """Return the lower and upper limits of the positions."""
        low, high = self.robot.position_limits.T
        wrong = np.flatnonzero(~(low < high))
        if wrong.size and not self.override:
            j = wrong[0]
            raise DataError(
                f"limits: the description of '{self.robot.name}' has joint '{self._names[j]}' from "
                f"{low[j]:g} to {high[j]:g}; mend it, or give both with override."
            )
        real = np.isfinite(low) & (low < high)
        low, high = _within_mimics(self.robot, *np.where(real, (low, high), np.nan))
        # NaN where an end is missing: then the other is used as it stands.
        spare = np.nan_to_num(0.5 * (1.0 - self.share) * (high - low))
        lower = self._merged("lower", low + spare, low)
        upper = self._merged("upper", high - spare, high)
        usual = np.where(self._sliding, _SHORT_WAY, _HALF_TURN) * self.robot.gears
        way = usual if self.assume else np.inf
        no_lower, no_upper = ~np.isfinite(lower), ~np.isfinite(upper)
        lower, upper = (
            np.where(no_lower, np.where(no_upper, about - way, upper - 2.0 * way), lower),
            np.where(no_upper, np.where(no_lower, about + way, lower + 2.0 * way), upper),
        )
        words = (
            "to either side of the rest position is assumed, since cables and end stops are not "
            "known"
        )
        amounts = "half a turn", f"{_SHORT_WAY:g} m"
        self._missing("position", no_lower | no_upper, *(f"{each} {words}" for each in amounts))
        for kind, missing in (("lower", no_lower), ("upper", no_upper)):
            self._mark(kind, missing)
        for j in np.flatnonzero(~(lower < upper)):
            sides = [self._sources[kind][j] for kind in ("lower", "upper")]
            given = sides == [GIVEN, GIVEN]
            remedy = "exchange them" if given else "give limits that overlap the description's"
            raise DataError(
                f"limits: joint '{self._names[j]}': lower {lower[j]:g} ({sides[0]}) is not below "
                f"upper {upper[j]:g} ({sides[1]}) {unit_of('lower', self._sliding[j])}; {remedy}."
            )
        return lower, upper

    def _size(self, kind: str) -> Array:
        """Return the limits (n,) of a size that are given or described, NaN where neither is."""
        limits = {"velocity": self.robot.velocity_limits, "torque": self.robot.effort_limits}
        described = limits.get(kind, np.full(self._n, np.inf))
        described = np.where(np.isfinite(described), described, np.nan)
        return self._merged(kind, self.share * described, described)

    def _merged(self, kind: str, used: Array, described: Array) -> Array:
        """Return the tighter of the given limits and the description's, NaN where neither is.

        `used` is the share of the described limits that is used.
        """
        given = self._values(kind)
        tighter = np.fmax if kind == "lower" else np.fmin
        beyond = described > given if kind == "lower" else given > described
        wider = beyond & (np.abs(given - described) > _SAME * np.abs(described))
        words = f"{kind} limits beyond the description's"
        if self.override:
            values = np.where(np.isnan(given), used, given)
            self._tell(wider, f"{words}, which they override")
        else:
            values = np.where(np.isnan(given), used, tighter(given, described))
            self._tell(wider & np.isfinite(given), f"{words}; the description's hold")
        own = ~np.isnan(given) & (~beyond | self.override)
        sources = np.where(own, GIVEN, np.where(np.isnan(described), NONE, DESCRIBED))
        self._sources[kind] = tuple(sources.tolist())
        return values

    def _values(self, kind: str) -> Array:
        """Return the given values (n,) of a kind, NaN where none is given."""
        values: Any = self.given[kind]
        if isinstance(values, Mapping):
            unknown = [name for name in values if name not in self._names and name != OTHERS]
            if unknown:
                raise DataError(
                    f"limits: {kind}: '{self.robot.name}' has no joint '{unknown[0]}'; its joints "
                    f"are {', '.join(self._names)}."
                )
            each = [values.get(name, values.get(OTHERS)) for name in self._names]
        elif values is None or is_number(values):
            each = [values] * self._n
        else:
            each = list(values)
        if len(each) != self._n:
            raise DataError(
                f"limits: {kind} has {len(each)} values, '{self.robot.name}' has {self._n} "
                f"joints: {', '.join(self._names)}."
            )
        given = np.array(each, dtype=np.float64)
        self._check_units(kind, given)
        return given

    def _check_units(self, kind: str, given: Array) -> None:
        """Raise `DataError` when given values look like degrees or mm."""
        most = np.where(self._sliding, *_SLIPS.get(kind, (np.inf, np.inf))[::-1])
        for j in np.flatnonzero(np.isfinite(given) & (np.abs(given) > most)):
            unit = unit_of(kind, self._sliding[j])
            slip, factor = ("mm", 1e-3) if self._sliding[j] else ("degrees", np.pi / 180.0)
            raise DataError(
                f"limits: joint '{self._names[j]}': {kind} is {given[j]:g} {unit}, which looks "
                f"like {slip}; give {given[j] * factor:.4g} {unit}."
            )

    def _missing(self, kind: str, where: Mask, turning: str, slides: str) -> None:
        """Tell what is assumed of turning joints, and what of sliding ones, or that nothing is."""
        if kind in self._sources:
            self._mark(kind, where)
        if not self.assume:
            turning = slides = _UNCHECKED
        for words in dict.fromkeys((turning, slides)):
            alike = where & np.where(self._sliding, slides == words, turning == words)
            geared = self.robot.gears > 1.0
            self._tell(alike & ~geared, f"no {kind} limits; {words}")
            times = ", times the gear before a joint" if self.assume else ""
            self._tell(alike & geared, f"no {kind} limits; {words}{times}")

    def _mark(self, kind: str, where: Mask) -> None:
        """Note the joints whose limits are assumed, or none."""
        source = ASSUMED if self.assume else NONE
        self._sources[kind] = tuple(np.where(where, source, self._sources[kind]).tolist())

    def _tell_empty(self, width: Array, velocity: Array, torque: Array) -> None:
        """Tell which limits of the description are so wide that they limit nothing."""
        robot, mass = self.robot, self.robot.prior[:, 0]
        own = np.linalg.norm(robot.prior[:, 1:4], axis=1)
        length = robot.reach + np.max(own / np.where(mass > 0.0, mass, np.inf), initial=0.0)
        holding = float(mass.sum() * np.linalg.norm(robot.gravity) * length)
        most = _STRONGEST * holding if holding > 0.0 else np.inf
        for kinds, what, size, limit, unit in (
            (("lower", "upper"), "ranges of positions", width / robot.gears, _WIDEST, "rad"),
            (("velocity",), "velocity limits", velocity / robot.gears, _FASTEST, "rad/s"),
            (("torque",), "torque limits", torque * robot.gears, most, "N·m"),
        ):
            described = np.all(np.array([self._sources[k] for k in kinds]) == DESCRIBED, axis=0)
            # Infinity is told as none.
            beyond = np.isfinite(size) & (size > limit) & ~self._sliding
            self._tell(
                described & beyond,
                f"{what} in the description that limit nothing (more than {limit:.3g} {unit}); "
                "give the real ones",
            )

    def _tell(self, where: Mask, words: str) -> None:
        """Add a sentence about the joints for which something holds."""
        joints = np.flatnonzero(where)
        if joints.size == 0:
            return
        if joints.size == self._n and self._n > 1:
            self._told.append(f"all joints have {words}.")
        else:
            names = ", ".join(self._names[j] for j in joints)
            verb = "has" if joints.size == 1 else "have"
            self._told.append(f"{names} {verb} {words}.")


def _within_mimics(robot: RobotModel, low: Array, high: Array) -> tuple[Array, Array]:
    """Return limits (n,) narrowed to those of the joints that follow others; NaN for none."""
    model, low, high = robot.pin_model, low.copy(), high.copy()
    # Whose limits are those of the coordinates already.
    seated, shared = {joint for joint, _ in robot.seats().values()}, []
    for i in range(1, model.njoints):
        joint = model.joints[i]
        row = robot.expansion[joint.idx_v]
        alone = np.count_nonzero(row) == 1
        if model.names[i] in seated or joint.nq != 1:
            continue
        ends = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        column = int(np.argmax(np.abs(row)))
        factor = row[column]
        if factor == 0.0 or not -_UNBOUNDED < ends[0] < ends[1] < _UNBOUNDED:
            continue
        if not alone:
            shared.append((row, ends[0] - robot.offset[joint.idx_v], ends[1] - ends[0]))
            continue
        own = np.sort((np.array(ends) - robot.offset[joint.idx_v]) / factor)
        narrowed = np.fmax(low[column], own[0]), np.fmin(high[column], own[1])
        # Limits of followers that leave nothing are placeholders.
        if narrowed[0] < narrowed[1]:
            low[column], high[column] = narrowed
    if shared:
        # Of motors that move joints together a cube about the middle, in which all of these stay.
        rows, least, ranges = map(np.array, zip(*shared, strict=True))
        middle = np.linalg.pinv(rows) @ (least + 0.5 * ranges)
        room = 0.5 * ranges - np.abs(rows @ middle - least - 0.5 * ranges)
        reach = float(np.min(room / np.abs(rows).sum(axis=1)))
        motors = np.any(rows != 0.0, axis=0)
        if reach > 0.0:
            low[motors] = np.fmax(low, middle - reach)[motors]
            high[motors] = np.fmin(high, middle + reach)[motors]
    return low, high


def _usual_rest(lower: Array, upper: Array) -> Array:
    """Return zero, or the middle where zero is outside of the limits or near them."""
    low, high = np.maximum(lower, -_UNBOUNDED), np.minimum(upper, _UNBOUNDED)
    edge = _FROM_ENDS * (high - low)
    inside = (low + edge <= 0.0) & (high - edge >= 0.0)
    return np.where(inside, 0.0, 0.5 * (low + high))


def _standing(robot: RobotModel, limits: JointLimits, *, given: bool) -> JointLimits:
    """Return limits with a rest position that the motors hold: as given, or the nearest easy one.

    Raises
    ------
    DataError
        When a given one is outside of the limits, or they hold none.
    """
    rest, names, tried = limits.rest, limits.joint_names, limits.rest[None]
    width = limits.upper - limits.lower
    for j in np.flatnonzero((rest < limits.lower) | (rest > limits.upper)):
        unit = unit_of("lower", limits.sliding[j])
        below = rest[j] < limits.lower[j]
        side, limit = ("below", limits.lower[j]) if below else ("above", limits.upper[j])
        raise DataError(
            f"limits: joint '{names[j]}': the rest position {rest[j]:.6g} {unit} is {side} the "
            f"limit of {limit:.6g} {unit}; start elsewhere, or widen the limit."
        )
    if not given:
        drawn = limits.lower + width * generator(0).uniform(0.05, 0.95, (_DRAWN, limits.n))
        # From the usual position on, ever farther towards each drawn one.
        shares = np.linspace(0.0, 1.0, _DRAWN)[:, None]
        tried = np.vstack([rest, rest + shares * (drawn - rest), drawn])
    still = np.zeros_like(tried)
    # What gravity needs, in shares of the torque limits.
    loads = np.abs(robot.described_efforts(tried, still, still)) / limits.torque
    load = loads.max(axis=1)
    easy = load <= (1.0 if given else _EASY)
    if easy[0]:
        return limits
    away = np.abs((tried - rest) / width).sum(axis=1)
    best = int(np.argmin(np.where(easy, away, np.inf) if easy.any() else load))
    if load[best] > 1.0:
        worst = int(np.argmax(loads[best]))
        unit, source = unit_of("torque", limits.sliding[worst]), limits.sources["torque"][worst]
        where = "the rest position" if given else f"the best of {len(tried)} positions"
        larger = "a larger limit" + (" with override = true" if source == DESCRIBED else "")
        remedy = f"another rest position, or {larger}" if given else f"{larger}, or a rest position"
        raise DataError(
            f"limits: joint '{names[worst]}': gravity alone needs "
            f"{load[best] * limits.torque[worst]:.4g} {unit} at {where}, the torque limit is "
            f"{limits.torque[worst]:.4g} {unit} ({source}); give {remedy}."
        )
    told = (
        "the rest position is one that the motors hold easily: at the usual one "
        f"{100.0 * _EASY:.0f} % of the torque limit of {names[int(np.argmax(loads[0]))]} are not "
        "enough."
    )
    return replace(limits, rest=frozen(tried[best]), assumed=(*limits.assumed, told))
