"""From a motion that holds its limits on a grid to one that holds them at every instant."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import InfeasibleError
from sdpid.excitation.design.task import Task
from sdpid.excitation.limits.check import LimitCheck, check_trajectory
from sdpid.excitation.limits.inequalities import ToolSpeedWithin, TorqueWithin
from sdpid.excitation.search.inequalities import InstantRows, KeptDistance, StateInequality
from sdpid.excitation.search.search import Candidate, Search
from sdpid.excitation.search.space import Space

# Instants a second at which distances, torques and tool speeds are held during the search.
_RATE_HZ = 8.0
# What is kept of a distance beyond the clearance while it is held on the grid, m: an arm that
# turns at 2 rad/s² about a meter away dips by 4 mm between instants 0.125 s apart.
_MARGIN = 4e-3
# Torques and tool speeds are held to this share of their limits on the grid.
_SHARE = 0.97
# A joint's torque is held from the start where random motions use this share of its limit: each
# joint adds two rows an instant, and most never come near.
_NEAR = 0.5
# Rounds of search, check, and a wider margin; of steps of a search in one.
_ROUNDS, _STEPS = 6, 60
# A margin grows by this much more than what was missing.
_BEYOND = 1.5
# An arm whose joints move by less than this stands still, rad (m).
_STILL = 1e-6
# Shares of a motion's way from standing still that are tried where no search mends it.
_SHRINKS = (0.98, 0.95, 0.9, 0.8, 0.65, 0.5, 0.3, 0.1)


@dataclass(eq=False)
class Inequalities:
    """The nonlinear limits of a task, as a search holds them on a grid.

    Attributes
    ----------
    task : Task
        The design.
    margin : float
        What is kept of distances beyond the clearance, m.
    share : float
        Share of torque and tool speed that is used.
    joints : set of str
        Whose torques the search holds: those that random motions bring near their limits, and
        those that a check found beyond.
    """

    task: Task
    margin: float = _MARGIN
    share: float = _SHARE
    joints: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        task = self.task
        near = task.usual_torque > _NEAR * task.torque.allowed(task.limits.torque)
        self.joints |= {
            name for name, is_near in zip(task.limits.joint_names, near, strict=True) if is_near
        }

    def rows(self, space: Space) -> InstantRows | None:
        """Return the rows that a search among motions holds; None where there are none."""
        time = space.grid(rate=_RATE_HZ)
        parts = [(inequality, time) for inequality in self._parts()]
        return InstantRows(space=space, parts=parts) if parts else None

    def _parts(self) -> Iterator[StateInequality]:
        task = self.task
        if task.collision is not None and task.collision.searched.pairs:
            yield KeptDistance(
                collision=task.collision.searched, clearance=task.clearance, margin=self.margin
            )
        held = [name in self.joints for name in task.limits.joint_names]
        used = replace(
            task.limits,
            torque=np.where(held, self.share * task.limits.torque, np.inf),
            tool_speed=task.limits.tool_speed and self.share * task.limits.tool_speed,
        )
        if np.isfinite(used.torque).any():
            yield TorqueWithin(model=task.torque, limits=used)
        speed = ToolSpeedWithin.of(task.robot, used)
        if speed is not None:
            yield speed

    def learn(self, check: LimitCheck) -> None:
        """Hold the torques that a check found broken, and widen margins of what was held."""
        wrong = [row for row in check.rows if row.verdict != "held"]
        missing = max((-row.slack for row in wrong if row.kind == "distance"), default=0.0)
        if missing:
            self.margin += _BEYOND * max(missing, 1e-4)
        rates = [row for row in wrong if row.kind == "tool speed" or row.subject in self.joints]
        if rates:
            over = max(-row.slack / row.limit for row in rates)
            self.share /= 1.0 + _BEYOND * max(over, 1e-3)
        self.joints |= {row.subject for row in wrong if row.kind == "torque"}


def checked(task: Task, x: Array) -> LimitCheck:
    """Return the check of a motion (N,) at every instant."""
    return check_trajectory(
        task.robot,
        task.trajectory(x),
        task.limits,
        collision=task.collision or False,
        torque=task.torque,
    )


def mend(
    task: Task, search: Search, candidate: Candidate, inequalities: Inequalities
) -> tuple[Candidate, LimitCheck]:
    """Return a motion that holds all limits at every instant, and the check that says so.

    Raises
    ------
    InfeasibleError
        When none is found: it names the limits in the way.
    """
    check = checked(task, candidate.x)
    _require_motion(task, candidate, check)
    for _ in range(_ROUNDS):
        if check.ok:
            return candidate, check
        inequalities.learn(check)
        rows = inequalities.rows(task.space)
        start = shrunk(task, candidate.x, rows)
        candidate, stopped = search.improve(start, rows, number=candidate.start, most_steps=_STEPS)
        check = checked(task, candidate.x)
        if stopped:
            break
    if check.ok:
        return candidate, check
    still = task.space.standing(_first(task, candidate.x))
    for share in _SHRINKS:
        x = still + share * (candidate.x - still)
        check = checked(task, x)
        if check.ok:
            value = search.value_and_gradient(x)[0]
            return (
                replace(candidate, x=x, value=value, status=f"shrunk to {100.0 * share:g} %"),
                check,
            )
    broken = "; ".join(
        f"{row.kind} of {row.subject} by {-row.slack:.3g} {row.unit} at {row.time:.2f} s"
        for row in check.rows
        if row.verdict != "held"
    )
    raise InfeasibleError(
        f"excitation of '{task.robot.name}': no motion was found that holds every limit. Even one "
        f"of a tenth of the size breaks: {broken}. Widen these limits, or give another start."
    )


def _require_motion(task: Task, candidate: Candidate, check: LimitCheck) -> None:
    """Refuse a candidate that stands still: no start moved, or none was searched in time."""
    if np.ptp(task.space.curve(candidate.x).evaluate(task.space.grid()), axis=0).max() > _STILL:
        return
    nearest = min(check.rows, key=lambda row: row.slack / (abs(row.limit) or 1.0))
    raise InfeasibleError(
        f"excitation of '{task.robot.name}': no motion was found, the arm stands still. Nearest to "
        f"its limit is {nearest.kind} of {nearest.subject} ({nearest.slack:.3g} {nearest.unit} "
        "left). Give the search more time, another start, or wider limits."
    )


def shrunk(task: Task, x: Array, rows: InstantRows | None) -> Array:
    """Return a motion (N,) as large as may be, on the way to standing still, that holds rows."""
    if rows is None:
        return x
    still = task.space.standing(_first(task, x))
    for share in (1.0, *0.85 ** np.arange(1, 30)):
        moved = still + share * (x - still)
        if np.min(rows.values(moved)) > 0.0:
            return np.asarray(moved)
    return still


def _first(task: Task, x: Array) -> Array:
    """Return the position (n,) at which a motion begins."""
    return np.asarray((task.space.basis(np.zeros(1), 0) @ task.space.coefficients(x))[0])
