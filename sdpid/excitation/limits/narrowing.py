"""Narrow the limits of a robot's description to given ones, and tell what is assumed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Mask, is_number, real_array
from sdpid.errors import DataError
from sdpid.excitation.limits.joint_limits import (
    ASSUMED,
    DESCRIBED,
    GIVEN,
    NONE,
    JointLimits,
    unit_of,
)
from sdpid.excitation.limits.resting import able_to_rest, check_rest
from sdpid.robot.model.arms import require_fixed_robot
from sdpid.robot.model.coordinates import sliding
from sdpid.robot.model.model import RobotModel

# A value for all joints, one a joint in the robot's order (None for none), or values by joint.
Values = float | Sequence[float | None] | Mapping[str, float] | None

KINDS = ("lower", "upper", "velocity", "acceleration", "jerk", "torque")
# The entry of a mapping that stands for all joints that it does not name.
OTHERS = "*"

# Joints without position limits may go this far to either side of their rest position: half a turn
# keeps cables whole. Sliding joints may have an end stop anywhere (m).
_HALF_TURN, _SHORT_WAY = np.pi, 0.1
# Joints without a speed limit, rad/s and m/s.
_SPEED, _SLIDING_SPEED = 2.0, 0.25
# Descriptions have no accelerations. Full speed after half a second is a lively motion of any arm:
# 4.4 rad/s² on the Panda, whose maker allows 7.5 to 20; capped where speeds are high, rad/s², m/s².
_SECONDS_TO_FULL_SPEED = 0.5
_ACCELERATION, _SLIDING_ACCELERATION = 5.0, 2.0
# The full acceleration after this time (s): far above the period of an arm's own oscillations.
_SECONDS_TO_FULL_ACCELERATION = 0.1

# The joints rest at zero where that is this part of the range or more away from its ends, in the
# middle otherwise.
_FROM_ENDS = 0.1
# Stands for infinity there, rad or m: any number far beyond the joints' ranges will do.
_UNBOUNDED = 1e3


# Larger values of turning joints are degrees: two turns, 8 turns a second (rad, rad/s). Of sliding
# joints they are mm (m, m/s).
_DEGREES = {"lower": 4.0 * np.pi, "upper": 4.0 * np.pi, "velocity": 50.0}
_MILLIMETERS = {"lower": 20.0, "upper": 20.0, "velocity": 20.0}

# Described limits of turning joints beyond these limit nothing: in example-robot-data real ones
# come to 52 rad/s, two turns, and 17 times the torque that holds the whole robot at its reach (a
# hand); numbers that stand for none begin at 100 rad/s, three turns and 77 times.
_FASTEST, _WIDEST, _STRONGEST = 20.0 * np.pi, 6.0 * np.pi, 40.0

# Limits are the same where they differ by less than this share: files round them.
_SAME = 1e-3


def narrow(
    robot: RobotModel,
    given: Mapping[str, Values],
    rest: ArrayLike | None,
    *,
    share: float,
    override: bool,
    assume: bool,
) -> JointLimits:
    """Return the limits of a robot's joints; see `Limits.of`.

    Parameters
    ----------
    robot : RobotModel
        On a fixed base.
    given : mapping
        Values by kind of limit, one for each of `KINDS`.
    rest : array_like, shape (n,), optional
        Position at rest.
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
    DataError
        When limits contradict each other or what they are for.
    """
    found = _Narrowing(robot, given, share, override, assume).limits(rest)
    if not assume:
        return found
    if rest is None:
        return able_to_rest(robot, found)
    check_rest(robot, found)
    return found


class _Narrowing:
    """The way from given limits and a description to those of the joints, told on the way."""

    def __init__(
        self,
        robot: RobotModel,
        given: Mapping[str, Values],
        share: float,
        override: bool,
        assume: bool,
    ) -> None:
        require_fixed_robot(robot, "limits")
        self.robot, self.given, self.share, self.override = robot, given, share, override
        self.assume = assume
        self.names, self.n = robot.joint_names, robot.n
        self.sliding = sliding(robot.pin_model, robot.joint_names)
        self.told: list[str] = []
        self.sources: dict[str, tuple[str, ...]] = {}

    def limits(self, rest: ArrayLike | None) -> JointLimits:
        """Return the joints' limits."""
        start = self._start(rest)
        lower, upper = self._range(start)
        position = np.where(np.isnan(start), _usual_rest(lower, upper), start)
        robot = self.robot
        speeds, torques = (
            np.where(np.isfinite(limit), limit, np.nan)
            for limit in (robot.velocity_limits, robot.effort_limits)
        )
        velocity = self._filled(
            "velocity",
            self._merged("velocity", self.share * speeds, speeds),
            np.where(self.sliding, _SLIDING_SPEED, _SPEED),
            "{} is assumed",
            (f"{_SPEED:g} rad/s", f"{_SLIDING_SPEED:g} m/s"),
        )
        none = np.full(self.n, np.nan)
        most = np.where(self.sliding, _SLIDING_ACCELERATION, _ACCELERATION)
        acceleration = self._filled(
            "acceleration",
            self._merged("acceleration", none, none),
            np.minimum(velocity / _SECONDS_TO_FULL_SPEED, most),
            f"full speed after {_SECONDS_TO_FULL_SPEED:g} s, at most {{}}, is assumed",
            (f"{_ACCELERATION:g} rad/s²", f"{_SLIDING_ACCELERATION:g} m/s²"),
        )
        jerk = self._filled(
            "jerk",
            self._merged("jerk", none, none),
            acceleration / _SECONDS_TO_FULL_ACCELERATION,
            f"the full acceleration after {_SECONDS_TO_FULL_ACCELERATION:g} s is assumed",
        )
        torque = self._merged("torque", self.share * torques, torques)
        self._tell(np.isnan(torque), "no torque limits; they are not checked")
        self._tell_empty(upper - lower, velocity, torque)
        if self.share < 1.0 and any(DESCRIBED in each for each in self.sources.values()):
            self.told.append(
                f"of the description's position ranges, speeds and torques {100 * self.share:g} % "
                "are used, since controllers stop the arm at their limits."
            )
        return JointLimits(
            joint_names=self.names,
            sliding=tuple(bool(slides) for slides in self.sliding),
            rest=position,
            lower=lower,
            upper=upper,
            velocity=velocity,
            acceleration=acceleration,
            jerk=jerk,
            torque=np.where(np.isnan(torque), np.inf, torque),
            sources=self.sources,
            assumed=tuple(self.told),
        )

    def _start(self, rest: ArrayLike | None) -> Array:
        """Return the given rest position (n,), NaN where none is given."""
        if rest is None:
            return np.full(self.n, np.nan)
        values = real_array(rest, "rest position", ndim=1)
        if values.shape != (self.n,):
            raise DataError(
                f"rest position: {values.size} values, '{self.robot.name}' has {self.n} joints: "
                f"{', '.join(self.names)}."
            )
        return values

    def _range(self, start: Array) -> tuple[Array, Array]:
        """Return the lower and upper limits of the positions."""
        low, high = self.robot.position_limits.T
        wrong = np.flatnonzero(~(low < high))
        if wrong.size and not self.override:
            j = wrong[0]
            raise DataError(
                f"limits: the description of '{self.robot.name}' has joint '{self.names[j]}' from "
                f"{low[j]:g} to {high[j]:g}; mend it, or give both with override."
            )
        real = np.isfinite(low) & (low < high)
        low, high = _within_mimics(
            self.robot, np.where(real, low, np.nan), np.where(real, high, np.nan)
        )
        # NaN where an end is missing: then the other is used as it stands.
        spare = np.nan_to_num(0.5 * (1.0 - self.share) * (high - low))
        lower = self._merged("lower", low + spare, low)
        upper = self._merged("upper", high - spare, high)
        way = np.where(self.sliding, _SHORT_WAY, _HALF_TURN)
        if not self.assume:
            way = np.full(self.n, np.inf)
        about = np.where(np.isnan(start), 0.0, start)
        no_lower, no_upper = ~np.isfinite(lower), ~np.isfinite(upper)
        lower, upper = (
            np.where(no_lower, np.where(no_upper, about - way, upper - 2.0 * way), lower),
            np.where(no_upper, np.where(no_lower, about + way, lower + 2.0 * way), upper),
        )
        self._assume(
            "position",
            no_lower | no_upper,
            "{} to either side of the rest position is assumed, since cables and end stops are not "
            "known",
            ("half a turn", f"{_SHORT_WAY:g} m"),
        )
        source = ASSUMED if self.assume else NONE
        for missing, kind in ((no_lower, "lower"), (no_upper, "upper")):
            self._mark(kind, missing, source)
        for j in np.flatnonzero(~(lower < upper)):
            sides = [self.sources[kind][j] for kind in ("lower", "upper")]
            given = sides == [GIVEN, GIVEN]
            remedy = "exchange them" if given else "give limits that overlap the description's"
            raise DataError(
                f"limits: joint '{self.names[j]}': lower {lower[j]:g} ({sides[0]}) is not below "
                f"upper {upper[j]:g} ({sides[1]}) {unit_of('lower', self.sliding[j])}; {remedy}."
            )
        return lower, upper

    def _merged(self, kind: str, used: Array, described: Array) -> Array:
        """Return the tighter of the given limits and the description's, NaN where neither is.

        `used` is the share of the described limits that is used.
        """
        given = self._values(kind)
        self._check_units(kind, given)
        tighter = np.fmax if kind == "lower" else np.fmin
        beyond = np.sign(described - given) if kind == "lower" else np.sign(given - described)
        wider = (beyond > 0.0) & (np.abs(given - described) > _SAME * np.abs(described))
        if self.override:
            values = np.where(np.isnan(given), used, given)
            self._tell(wider, f"{kind} limits beyond the description's, which they override")
        else:
            values = np.where(np.isnan(given), used, tighter(given, described))
            self._tell(
                wider & np.isfinite(given),
                f"{kind} limits beyond the description's; the description's hold",
            )
        own = ~np.isnan(given) & (~(beyond > 0.0) | self.override)
        sources = np.where(own, GIVEN, np.where(np.isnan(described), NONE, DESCRIBED))
        self.sources[kind] = tuple(sources.tolist())
        return values

    def _filled(
        self,
        kind: str,
        values: Array,
        usual: Array,
        words: str,
        amounts: tuple[str, str] = ("", ""),
    ) -> Array:
        """Return sizes with what is assumed where there are none."""
        missing = np.isnan(values)
        self._assume(kind, missing, words, amounts)
        return np.where(missing, usual if self.assume else np.inf, values)

    def _values(self, kind: str) -> Array:
        """Return the given values (n,) of a kind, NaN where none is given."""
        values = self.given[kind]
        if values is None:
            return np.full(self.n, np.nan)
        if isinstance(values, Mapping):
            unknown = [name for name in values if name not in self.names and name != OTHERS]
            if unknown:
                raise DataError(
                    f"limits: {kind}: '{self.robot.name}' has no joint '{unknown[0]}'; its joints "
                    f"are {', '.join(self.names)}."
                )
            each = [values.get(name, values.get(OTHERS)) for name in self.names]
        else:
            each = [values] * self.n if is_number(values) else list(values)  # type: ignore[arg-type]
        if len(each) != self.n:
            raise DataError(
                f"limits: {kind} has {len(each)} values, '{self.robot.name}' has {self.n} "
                f"joints: {', '.join(self.names)}."
            )
        return np.array([np.nan if value is None else value for value in each], dtype=np.float64)

    def _check_units(self, kind: str, given: Array) -> None:
        """Raise `DataError` when given values look like degrees or mm."""
        if kind not in _DEGREES:
            return
        most = np.where(self.sliding, _MILLIMETERS[kind], _DEGREES[kind])
        for j in np.flatnonzero(np.isfinite(given) & (np.abs(given) > most)):
            unit = unit_of(kind, self.sliding[j])
            slip = "mm" if self.sliding[j] else "degrees"
            factor = 1e-3 if self.sliding[j] else np.pi / 180.0
            raise DataError(
                f"limits: joint '{self.names[j]}': {kind} is {given[j]:g} {unit}, which looks like "
                f"{slip}; give {given[j] * factor:.4g} {unit}."
            )

    def _mark(self, kind: str, where: Mask, source: str) -> None:
        """Note the source of some joints' limits."""
        old = self.sources[kind]
        self.sources[kind] = tuple(
            source if here else before for before, here in zip(old, where, strict=True)
        )

    def _assume(self, kind: str, where: Mask, words: str, amounts: tuple[str, str]) -> None:
        """Tell what is assumed of turning joints, and what of sliding ones, or that nothing is."""
        if kind in self.sources:
            self._mark(kind, where, ASSUMED if self.assume else NONE)
        if not self.assume:
            self._tell(where, f"no {kind} limits; they are not checked")
        elif "{}" not in words:
            self._tell(where, f"no {kind} limits; {words}")
        else:
            for joints, amount in zip((~self.sliding, self.sliding), amounts, strict=True):
                self._tell(where & joints, f"no {kind} limits; {words.format(amount)}")

    def _tell_empty(self, width: Array, velocity: Array, torque: Array) -> None:
        """Tell which limits of the description are so wide that they limit nothing."""
        robot, mass = self.robot, self.robot.prior[:, 0]
        own = np.linalg.norm(robot.prior[:, 1:4], axis=1)
        length = robot.reach + np.max(own / np.where(mass > 0.0, mass, np.inf), initial=0.0)
        holding = float(mass.sum() * np.linalg.norm(robot.gravity) * length)
        most = _STRONGEST * holding if holding > 0.0 else np.inf
        for kinds, what, size, limit, unit in (
            (("lower", "upper"), "ranges of positions", width, _WIDEST, "rad"),
            (("velocity",), "velocity limits", velocity, _FASTEST, "rad/s"),
            (("torque",), "torque limits", torque, most, "N·m"),
        ):
            described = np.all(np.array([self.sources[k] for k in kinds]) == DESCRIBED, axis=0)
            # Infinity is told as none.
            beyond = np.isfinite(size) & (size > limit) & ~self.sliding
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
        if joints.size == self.n and self.n > 1:
            self.told.append(f"all joints have {words}.")
        else:
            names = ", ".join(self.names[j] for j in joints)
            verb = "has" if joints.size == 1 else "have"
            self.told.append(f"{names} {verb} {words}.")


def _within_mimics(robot: RobotModel, low: Array, high: Array) -> tuple[Array, Array]:
    """Return limits (n,) narrowed to those of the joints that follow others; NaN for none."""
    model, low, high = robot.pin_model, low.copy(), high.copy()
    for i in range(1, model.njoints):
        joint = model.joints[i]
        if model.names[i] in robot.joint_names or joint.nq != 1:
            continue
        ends = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        column = int(np.argmax(np.abs(robot.expansion[joint.idx_v])))
        factor = robot.expansion[joint.idx_v, column]
        if factor == 0.0 or not -_UNBOUNDED < ends[0] < ends[1] < _UNBOUNDED:
            continue
        own = np.sort((np.array(ends) - robot.offset[joint.idx_v]) / factor)
        narrowed = np.fmax(low[column], own[0]), np.fmin(high[column], own[1])
        # Limits of followers that leave nothing are placeholders.
        if narrowed[0] < narrowed[1]:
            low[column], high[column] = narrowed
    return low, high


def _usual_rest(lower: Array, upper: Array) -> Array:
    """Return zero, or the middle where zero is outside of the limits or near them."""
    low, high = np.maximum(lower, -_UNBOUNDED), np.minimum(upper, _UNBOUNDED)
    edge = _FROM_ENDS * (high - low)
    inside = (low + edge <= 0.0) & (high - edge >= 0.0)
    return np.where(inside, 0.0, 0.5 * (low + high))
