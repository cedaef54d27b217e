"""`check_trajectory`: whether a motion holds its limits at every instant, and where it does not."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid._common.tables import Shown, Table, plain
from sdpid.errors import DataError
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.geometry.obstacles import Obstacle
from sdpid.excitation.limits.joint_limits import JointLimits, unit_of
from sdpid.excitation.limits.limits import Limits
from sdpid.excitation.limits.measures import (
    CurveMeasure,
    DistanceMeasure,
    Extremes,
    MotionMeasure,
    ToolMeasure,
    ToolSpeedWithin,
    TorqueMeasure,
    extremes,
    with_tolerance,
)
from sdpid.excitation.limits.torque import TorqueModel
from sdpid.experiment.trajectory.curve import Curve
from sdpid.experiment.trajectory.reading import read_trajectory, sampled_curve
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel

# What is taken for a motion.
Motion = Trajectory | Curve | str | os.PathLike[str] | Mapping[str, Any]


def curves_of(robot: RobotModel, motion: Motion) -> tuple[tuple[float, Curve], ...]:
    """Return the distinct curves of a motion with their starts in s, joints in the robot's order.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    motion : Trajectory, Curve, path, mapping or data frame
        A file as for `read_trajectory`; a mapping or data frame has ``time`` and ``position``
        (K, n) or columns ``position_<joint>``, and may have velocities and accelerations.

    Raises
    ------
    DataError
        When it is none of these, or its joints are not the robot's.
    """
    if isinstance(motion, str | os.PathLike):
        motion = read_trajectory(motion, robot.joint_names)
    if isinstance(motion, Trajectory):
        order = _order(robot, motion.joint_names)
        return tuple((start, _reordered(curve, order)) for start, curve in motion.curves())
    curve: Curve
    if hasattr(motion, "enclose") and hasattr(motion, "breaks"):
        curve = motion  # type: ignore[assignment]
    elif hasattr(motion, "keys") and hasattr(motion, "__getitem__"):
        curve = sampled_curve(motion, robot.joint_names)
    else:
        raise DataError(
            f"motion: got {type(motion).__name__}; give a Trajectory, a file, or columns time, "
            "position_<joint>, …."
        )
    if curve.n != robot.n:
        raise DataError(
            f"motion: {curve.n} joints, '{robot.name}' has {robot.n}: "
            f"{', '.join(robot.joint_names)}."
        )
    return ((0.0, curve),)


def _order(robot: RobotModel, names: Sequence[str]) -> Indices:
    """Return the places of the robot's joints among names."""
    if sorted(names) != sorted(robot.joint_names):
        raise DataError(
            f"motion: its joints are {', '.join(names)}, those of '{robot.name}' "
            f"{', '.join(robot.joint_names)}; rename them."
        )
    return np.array([list(names).index(name) for name in robot.joint_names])


def _reordered(curve: Curve, order: Indices) -> Curve:
    if np.array_equal(order, np.arange(len(order))):
        return curve
    return _Reordered(curve, order, curve.n, curve.duration, curve.breaks)


@dataclass(frozen=True, eq=False)
class _Reordered:
    """A curve with its joints in another order."""

    curve: Curve
    order: Indices
    n: int
    duration: float
    breaks: Array

    def evaluate(self, time: Any, *, derivative: int = 0) -> Array:
        return self.curve.evaluate(time, derivative=derivative)[:, self.order]

    def enclose(self, edges: Any, *, derivative: int = 0) -> tuple[Array, Array]:
        lower, upper = self.curve.enclose(edges, derivative=derivative)
        return lower[:, self.order], upper[:, self.order]


Verdict = Literal["held", "broken", "undecided"]

# The distinct curves of a motion, each from its start, s.
Curves = Sequence[tuple[float, Curve]]

# Bounds are refined until they are this share of their limit from what is reached, and distances
# until they are this many m from it.
_RESOLUTION, _DISTANCE_RESOLUTION = 2e-3, 1e-3

# A jump of a derivative counts as a change within this time, s: a cycle of a fast controller. Jumps
# that a limit allows within it are those of rounded samples.
_CYCLE = 1e-3
# An arm that is slower than this is at rest, rad/s or m/s.
_AT_REST = 1e-3


@dataclass(frozen=True, kw_only=True)
class LimitRow:
    """One limit, and what a motion comes to.

    Attributes
    ----------
    kind : str
        ``"position"``, ``"velocity"``, ``"acceleration"``, ``"jerk"``, ``"torque"``,
        ``"tool speed"`` or ``"distance"``.
    subject : str
        The joint, the frame, or the pair as ``first – second``.
    side : {"upper", "lower"}
        Whether the limit is the most or the least that is allowed.
    limit : float
        The limit.
    worst : float
        A bound that holds at every instant.
    reached : float
        The most extreme value that was evaluated, and `time` where, s from the motion's start.
    slack : float
        What is left between `worst` and the limit; negative where it is not held, or not known to
        be.
    unit : str
        Unit of these.
    verdict : {"held", "broken", "undecided"}
        Held at every instant (to 1e-9 of the limit), broken at `time`, or undecided: then `reached`
        is within the limit and `worst` is not.
    """

    kind: str
    subject: str
    side: Literal["upper", "lower"]
    limit: float
    worst: float
    reached: float
    time: float
    slack: float
    unit: str
    verdict: Verdict

    @classmethod
    def of(
        cls, sign: float, limit: float, worst: float, reached: float, allowed: float, **of: Any
    ) -> LimitRow:
        """Build from values times a sign, which makes limits upper ones; held up to `allowed`."""
        verdict: Verdict = "broken" if reached > allowed else "undecided"
        return cls(
            side="lower" if sign < 0.0 else "upper",
            limit=sign * limit,
            worst=sign * worst,
            reached=sign * reached,
            slack=limit - worst,
            verdict="held" if worst <= allowed else verdict,
            **of,
        )

    @property
    def excess(self) -> float:
        """How far the limit is broken at `time`; zero where it is not."""
        beyond = self.reached - self.limit
        return max(0.0, beyond if self.side == "upper" else -beyond)

    def sentence(self) -> str:
        """Return what is wrong, or that nothing is, in words."""
        what = f"{self.subject}: {self.kind}"
        side = "above" if self.side == "upper" else "below"
        if self.verdict == "broken":
            return (
                f"{what} {self.reached:.6g} {self.unit} at {self.time:.4f} s is "
                f"{self.excess:.3g} {self.unit} {side} the limit of {self.limit:.6g} {self.unit}."
            )
        if self.verdict == "undecided":
            return (
                f"{what} may be {-self.slack:.3g} {self.unit} {side} the limit of "
                f"{self.limit:.6g} {self.unit} near {self.time:.4f} s: the bound does not decide."
            )
        return f"{what} holds the limit of {self.limit:.6g} {self.unit} by {self.slack:.3g}."


@dataclass(frozen=True, kw_only=True, repr=False)
class LimitCheck(Shown):
    """The limits of a motion, checked at every instant.

    Attributes
    ----------
    rows : tuple of LimitRow
        One a limit; there is none for limits that do not exist.
    notes : tuple of str
        What was assumed or not checked: sentences.
    left_out : tuple of (str, str, str)
        Pairs of bodies whose distance is not checked, and why.

    Examples
    --------
    >>> plan.limits.ok, plan.limits.broken
    (True, ())
    >>> row = plan.limits.least("velocity")
    >>> row.limit, row.unit, row.verdict
    (1.5, 'rad/s', 'held')
    """

    rows: tuple[LimitRow, ...]
    notes: tuple[str, ...] = ()
    left_out: tuple[tuple[str, str, str], ...] = ()

    _facts = ("ok", "rows", "broken")

    @property
    def ok(self) -> bool:
        """Whether every limit is held at every instant."""
        return all(row.verdict == "held" for row in self.rows)

    @property
    def broken(self) -> tuple[LimitRow, ...]:
        """The rows that are not held, broken ones first, the largest excess first."""
        wrong = [row for row in self.rows if row.verdict != "held"]
        return tuple(sorted(wrong, key=_gravity))

    def least(self, kind: str) -> LimitRow | None:
        """Return the row of a kind with the least slack, as a share of its limit."""
        rows = [row for row in self.rows if row.kind == kind]
        return min(rows, key=lambda row: row.slack / (abs(row.limit) or 1.0), default=None)

    @property
    def nearest(self) -> tuple[LimitRow, ...]:
        """The row of each kind with the least slack, see `least`."""
        kinds = dict.fromkeys(row.kind for row in self.rows)
        return tuple(row for kind in kinds if (row := self.least(kind)) is not None)

    def sentences(self) -> tuple[str, ...]:
        """Return one sentence for each limit that is not held."""
        return tuple(row.sentence() for row in self.broken)

    def table(self) -> Table:
        """Return all rows."""
        names = [each.name for each in fields(LimitRow)]
        columns = {name: [getattr(row, name) for row in self.rows] for name in names}
        return Table.of_columns(columns, {"time": ".4f"})

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"ok": self.ok, **plain(self)}

    def _tables(self) -> Iterator[Table]:
        yield self.table()


def _gravity(row: LimitRow) -> tuple[bool, float]:
    share = row.excess / (abs(row.limit) or 1.0)
    return row.verdict != "broken", -share


def check_trajectory(
    robot: RobotModel | str | os.PathLike[str],
    trajectory: Motion,
    limits: Limits | JointLimits | str | os.PathLike[str] | None = None,
    *,
    obstacles: Iterable[Obstacle] = (),
    package_dirs: Iterable[str | os.PathLike[str]] = (),
    collision: CollisionModel | bool | None = None,
    torque: TorqueModel | None = None,
    estimate: Any = None,
    spread: float = 0.0,
) -> LimitCheck:
    """Check whether a motion holds a robot's limits at every instant.

    Positions, velocities, accelerations and jerks are bounded by the curve itself (control points
    of its pieces, or bounds on a further derivative), torques and the speed of the tool by bounds
    on their first and second derivatives, distances by a bound on their rate. Cells of time on
    which a bound does not decide are cut in half until it does, or an instant is found at which the
    limit is broken. Connections and rest count as well as the periods. A jump of a derivative
    between the pieces of a curve counts as a change within 1 ms.

    Parameters
    ----------
    robot : RobotModel, str or path
        On a fixed base: anything that `load_robot` takes.
    trajectory : Trajectory, path, mapping, data frame or Curve
        The motion, of any tool; see `sdpid.excitation.limits.check.curves_of`.
    limits : Limits, JointLimits or path of a TOML file, optional
        By default those of the description.
    obstacles : iterable of Plane, Box, Mesh, optional
        What the arm must keep clear of.
    package_dirs : iterable of paths, optional
        Folders in which the description's meshes are looked up.
    collision : CollisionModel or bool, optional
        The pairs whose distances are checked, in place of those of the description and the
        obstacles; False for none.
    torque : TorqueModel, optional
        By default ``TorqueModel.of(robot, estimate, spread=spread)``.
    estimate : Estimate or RobotDynamics, optional
        In place of the description's links and friction.
    spread : float, optional
        How many standard deviations of the parameters the torques must allow for.

    Returns
    -------
    LimitCheck

    Raises
    ------
    DataError
        When the motion or the limits are not understood, or are not of this robot.
    ModelError
        When the base floats, or a mesh cannot be read.

    Examples
    --------
    >>> check = sdpid.check_trajectory(robot, motion, sdpid.Limits(velocity=2.0))
    >>> check.ok
    False
    >>> print(check.sentences()[0])
    joint_6: velocity 2.8... rad/s at 12.9... s is 0.8... rad/s above the limit of 2 rad/s.
    """
    if not isinstance(robot, RobotModel):
        robot = load_robot(robot)
    curves = curves_of(robot, trajectory)
    start = curves[0][1].evaluate(np.zeros(1))[0]
    joints = _joint_limits(robot, limits, start)
    notes = [*joints.assumed, *_in_motion(joints, curves)]
    rows = [*_motion_rows(curves, joints)]
    if np.any(np.isfinite(joints.torque)):
        model = torque or TorqueModel.of(robot, estimate, spread=spread)
        notes += model.notes
        if model.known:
            allowed = model.allowed(joints.torque)
            rows += _joint_rows("torque", joints, curves, TorqueMeasure(model), allowed)
    tool = ToolSpeedWithin.of(robot, joints)
    if tool is not None:
        frames = [robot.pin_model.frames[index] for index in tool.frames]
        names = [(str(frame.name), "m/s") for frame in frames]
        rows += _rows(
            "tool speed", names, curves, ToolMeasure(tool), np.full(len(names), tool.speed)
        )
    left_out: tuple[tuple[str, str, str], ...] = ()
    if collision is not False:
        clearance = joints.clearance or 0.0
        if not isinstance(collision, CollisionModel):
            lower, upper = _range(joints, curves)
            collision = CollisionModel.of(
                robot,
                obstacles,
                package_dirs=package_dirs,
                near=start,
                free_rest=False,
                lower=lower,
                upper=upper,
                clearance=clearance,
            )
        notes += [*collision.assumed, *collision.closer(clearance)]
        left_out = collision.left_out
        names = [(f"{pair.first} – {pair.second}", "m") for pair in collision.pairs]
        least = -collision.clearances(clearance)
        measure = DistanceMeasure(collision)
        rows += _rows("distance", names, curves, measure, least, _DISTANCE_RESOLUTION, lower=True)
    return LimitCheck(rows=tuple(rows), notes=tuple(dict.fromkeys(notes)), left_out=left_out)


def _joint_limits(
    robot: RobotModel, limits: Limits | JointLimits | str | os.PathLike[str] | None, start: Array
) -> JointLimits:
    """Return the limits of the joints, whatever they are given as."""
    if isinstance(limits, JointLimits):
        if limits.joint_names != robot.joint_names:
            raise DataError(
                f"limits: they are of the joints {', '.join(limits.joint_names)}, '{robot.name}' "
                f"has {', '.join(robot.joint_names)}."
            )
        return limits
    if limits is None:
        limits = Limits()
    elif not isinstance(limits, Limits):
        limits = Limits.from_toml(limits)
    return limits.of(robot, start, assume=False)


def _in_motion(joints: JointLimits, curves: Curves) -> list[str]:
    """Return a sentence for each end at which the arm is not at rest: its limits are not known."""
    (_, first), (_, last) = curves[0], curves[-1]
    told = []
    for verb, curve, time in (("starts", first, 0.0), ("ends", last, last.duration)):
        speed, change = (
            np.abs(curve.evaluate(np.array([time]), derivative=order)[0]) for order in (1, 2)
        )
        moving, jolted = speed > _AT_REST, change > _CYCLE * joints.jerk
        for what, where in (("in motion", moving), ("with a jolt from rest", jolted & ~moving)):
            if where.any():
                names = ", ".join(joints.joint_names[j] for j in np.flatnonzero(where))
                told.append(
                    f"the motion {verb} {what} ({names}): the way from or to rest is no part of it "
                    "and is not checked."
                )
    return told


def _range(joints: JointLimits, curves: Curves) -> tuple[Array, Array]:
    """Return the positions (n,), least and largest, that limits allow or the motion comes to.

    Joints that turn without limits stay so: the little that a motion uses of their turn would not
    show which pairs overlap by the coarseness of their shapes.
    """
    whole = [curve.enclose(np.array([0.0, curve.duration])) for _, curve in curves]
    lower = np.min([low[0] for low, _ in whole], axis=0)
    upper = np.max([high[0] for _, high in whole], axis=0)
    turning = ~np.array(joints.sliding)
    return (
        np.where(np.isfinite(joints.lower) | turning, np.minimum(joints.lower, lower), lower),
        np.where(np.isfinite(joints.upper) | turning, np.maximum(joints.upper, upper), upper),
    )


def _motion_rows(curves: Curves, joints: JointLimits) -> Iterator[LimitRow]:
    """Yield the rows of positions, velocities, accelerations and jerks."""
    # Of each joint's range, but of half a turn where there is none.
    resolution = _RESOLUTION * np.nan_to_num(joints.upper - joints.lower, posinf=np.pi)
    for sign, limit in ((1.0, joints.upper), (-1.0, joints.lower)):
        measure = MotionMeasure(0, (sign,))
        yield from _joint_rows(
            "position", joints, curves, measure, sign * limit, resolution, lower=sign < 0.0
        )
    for order, kind in enumerate(("velocity", "acceleration", "jerk"), 1):
        jumps = _jumps(curves, order - 1)
        limit = getattr(joints, kind)
        yield from _joint_rows(kind, joints, curves, MotionMeasure(order), limit, jumps=jumps)


def _jumps(curves: Curves, derivative: int) -> Iterator[Extremes]:
    """Yield the largest jumps (n,) of a derivative at the breaks of each curve, as rates."""
    for start, curve in curves:
        inner = np.asarray(curve.breaks)[1:-1]
        if len(inner):
            before = curve.evaluate(np.nextafter(inner, -np.inf), derivative=derivative)
            after = curve.evaluate(inner, derivative=derivative)
            rates = np.abs(after - before) / _CYCLE
            largest = rates.max(axis=0)
            yield largest, largest, start + inner[rates.argmax(axis=0)]


def _joint_rows(
    kind: str,
    joints: JointLimits,
    curves: Curves,
    measure: CurveMeasure,
    limits: Array,
    resolution: Array | None = None,
    **more: Any,
) -> Iterator[LimitRow]:
    """Yield the rows of n functions, one a joint."""
    units = (unit_of(kind, slides) for slides in joints.sliding)
    names = list(zip(joints.joint_names, units, strict=True))
    return _rows(kind, names, curves, measure, limits, resolution, **more)


def _rows(
    kind: str,
    names: Sequence[tuple[str, str]],
    curves: Curves,
    measure: CurveMeasure,
    limits: Array,
    resolution: Array | float | None = None,
    *,
    lower: bool = False,
    jumps: Iterable[Extremes] = (),
) -> Iterator[LimitRow]:
    """Yield one row for each function, named with its unit, that has a limit.

    Lower limits are limits of functions with the sign changed. What jumps come to counts, too.
    """
    limited = np.isfinite(limits)
    if not limited.any():
        return
    resolution = np.where(
        limited, _RESOLUTION * limits if resolution is None else resolution, np.inf
    )
    parts = []
    for start, curve in curves:
        worst, reached, time = extremes(curve, measure, limits, resolution)
        parts.append((worst, reached, time + start))
    worst, reached, time = (np.stack(part) for part in zip(*parts, *jumps, strict=True))
    first, sign = reached.argmax(axis=0), -1.0 if lower else 1.0
    allowed = with_tolerance(limits)
    for j, (subject, unit) in enumerate(names):
        if not limited[j]:
            continue
        limit, most, found = float(limits[j]), float(worst[:, j].max()), float(reached[first[j], j])
        of = {"kind": kind, "subject": subject, "unit": unit, "time": float(time[first[j], j])}
        yield LimitRow.of(sign, limit, most, found, allowed[j], **of)
