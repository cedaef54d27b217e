"""`check_trajectory`: whether a motion holds its limits at every instant, and where it does not."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Shown, Table, plain
from sdpid.errors import DataError
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.geometry.obstacles import Obstacle
from sdpid.excitation.limits.extremes import CurveMeasure, Extremes, extremes, with_tolerance
from sdpid.excitation.limits.joins import in_motion, jumps_of, range_of
from sdpid.excitation.limits.joint_limits import JointLimits, unit_of
from sdpid.excitation.limits.limits import Limits
from sdpid.excitation.limits.measures import (
    DistanceMeasure,
    PositionMeasure,
    RateMeasure,
    ToolMeasure,
    TorqueMeasure,
)
from sdpid.excitation.limits.motions import Motion, curves_of
from sdpid.excitation.limits.tool import tool_frames
from sdpid.excitation.limits.torque import TorqueModel
from sdpid.experiment.trajectory.curve import Curve
from sdpid.robot.model.coordinates import sliding
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel

Verdict = Literal["held", "broken", "undecided"]

# Bounds are refined until they are this share of their limit from what is reached, and distances
# until they are this many m from it.
_RESOLUTION, _DISTANCE_RESOLUTION = 2e-3, 1e-3

# Derivatives of the positions that have limits.
_RATES = {1: "velocity", 2: "acceleration", 3: "jerk"}


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

    def sentences(self) -> tuple[str, ...]:
        """Return one sentence for each limit that is not held."""
        return tuple(row.sentence() for row in self.broken)

    def table(self) -> Table:
        """Return all rows."""
        names = ("kind", "subject", "side", "limit", "worst", "reached", "time", "slack", "unit")
        columns = {name: [getattr(row, name) for row in self.rows] for name in names}
        columns["verdict"] = [row.verdict for row in self.rows]
        return Table.of_columns(columns, {"time": ".4f"})

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "ok": self.ok,
            "rows": plain(self.rows),
            "notes": plain(self.notes),
            "left_out": plain(self.left_out),
        }

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
        The motion, of any tool; see `sdpid.excitation.limits.motions.curves_of`.
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
    notes = [*joints.assumed, *in_motion(joints, curves)]
    rows = [*_motion_rows(curves, joints)]
    if np.any(np.isfinite(joints.torque)):
        model = torque or TorqueModel.of(robot, estimate, spread=spread)
        notes += model.notes
        if model.known:
            allowed = model.allowed(joints.torque)
            rows += _joint_rows(
                "torque", joints, curves, TorqueMeasure(model), allowed, _RESOLUTION * allowed
            )
    if joints.tool_speed is not None:
        frames = tool_frames(robot, joints.tool)
        limit = np.full(len(frames), joints.tool_speed)
        found = _along(curves, ToolMeasure(robot, frames), limit, _RESOLUTION * limit)
        names = [str(robot.pin_model.frames[index].name) for index in frames]
        rows += _rows("tool speed", names, limit, found, ["m/s"] * len(frames))
    left_out: tuple[tuple[str, str, str], ...] = ()
    if collision is not False:
        clearance = joints.clearance or 0.0
        if not isinstance(collision, CollisionModel):
            lower, upper = range_of(joints, curves, sliding(robot.pin_model, robot.joint_names))
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
        rows += _distance_rows(curves, collision, clearance)
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


def _motion_rows(curves: Sequence[tuple[float, Curve]], limits: JointLimits) -> list[LimitRow]:
    """Return the rows of positions, velocities, accelerations and jerks."""
    rows = []
    for sign, limit in ((1.0, limits.upper), (-1.0, limits.lower)):
        width = np.nan_to_num(limits.upper - limits.lower, posinf=np.pi)
        rows += _joint_rows(
            "position", limits, curves, PositionMeasure(sign), sign * limit, _RESOLUTION * width
        )
    for order, kind in _RATES.items():
        bound: Array = getattr(limits, kind)
        jumps = jumps_of(curves, order - 1)
        rows += _joint_rows(
            kind, limits, curves, RateMeasure(order), bound, _RESOLUTION * bound, jumps
        )
    return rows


def _joint_rows(
    kind: str,
    joints: JointLimits,
    curves: Sequence[tuple[float, Curve]],
    measure: CurveMeasure,
    limits: Array,
    resolution: Array,
    jumps: tuple[Array, Array] | None = None,
) -> list[LimitRow]:
    """Return the rows of n functions, one a joint, of which there are limits; jumps count too."""
    kept = np.flatnonzero(np.isfinite(limits))
    if not kept.size:
        return []
    found = _along(curves, measure, limits, np.where(np.isfinite(limits), resolution, np.inf))
    if jumps is not None:
        rate, time = jumps
        found = Extremes(
            np.maximum(found.worst, rate),
            np.maximum(found.reached, rate),
            np.where(rate > found.reached, time, found.time),
        )
    part = Extremes(found.worst[kept], found.reached[kept], found.time[kept])
    units = [unit_of(kind, joints.sliding[j]) for j in kept]
    mirrored = isinstance(measure, PositionMeasure) and measure.sign < 0.0
    names = [joints.joint_names[j] for j in kept]
    return _rows(kind, names, limits[kept], part, units, mirrored=mirrored)


def _distance_rows(
    curves: Sequence[tuple[float, Curve]], collision: CollisionModel, clearance: float
) -> list[LimitRow]:
    """Return the rows of distances."""
    if not collision.pairs:
        return []
    limit = -collision.clearances(clearance)
    resolution = np.full(len(limit), _DISTANCE_RESOLUTION)
    found = _along(curves, DistanceMeasure(collision), limit, resolution)
    names = [f"{pair.first} – {pair.second}" for pair in collision.pairs]
    return _rows("distance", names, limit, found, ["m"] * len(names), mirrored=True)


def _along(
    curves: Sequence[tuple[float, Curve]], measure: CurveMeasure, limits: Array, resolution: Array
) -> Extremes:
    """Return the extremes over all curves of a motion, at its own time."""
    whole: Extremes | None = None
    for start, curve in curves:
        found = extremes(curve, measure, limits, resolution)
        when = found.time + start
        if whole is not None:
            further = found.reached > whole.reached
            when = np.where(further, when, whole.time)
            found = Extremes(
                np.maximum(found.worst, whole.worst), np.maximum(found.reached, whole.reached), when
            )
        whole = Extremes(found.worst, found.reached, when)
    if whole is None:
        raise DataError("motion: it has no parts.")
    return whole


def _rows(
    kind: str,
    subjects: Sequence[str],
    limits: Array,
    found: Extremes,
    units: Sequence[str],
    *,
    mirrored: bool = False,
) -> list[LimitRow]:
    """Return one row a function; mirrored ones are limited from below, with the sign changed."""
    sign = -1.0 if mirrored else 1.0
    rows = []
    for j, subject in enumerate(subjects):
        limit, worst, reached = (float(x[j]) for x in (limits, found.worst, found.reached))
        allowed = float(with_tolerance(limit))
        verdict: Verdict = "undecided"
        if worst <= allowed:
            verdict = "held"
        elif reached > allowed:
            verdict = "broken"
        rows.append(
            LimitRow(
                kind=kind,
                subject=subject,
                side="lower" if mirrored else "upper",
                limit=sign * limit,
                worst=sign * worst,
                reached=sign * reached,
                time=float(found.time[j]),
                slack=limit - worst,
                unit=units[j],
                verdict=verdict,
            )
        )
    return rows
