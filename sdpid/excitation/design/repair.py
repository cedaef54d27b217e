"""From a motion that holds its limits on a grid to one that holds them at every instant."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
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
# Rounds of search, check, and a wider margin; of steps of a search in one.
_ROUNDS, _STEPS = 6, 60
# Torques are held from the first step on where more than this share of drawn states are beyond
# their limits; speeds and accelerations without a limit are taken to be this (rad/s, rad/s²).
_OFTEN, _DRAWN, _FASTEST = 0.01, 500, 10.0
# A margin grows by this much more than what was missing.
_BEYOND = 1.5
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
    kinds : set of str
        Which limits the search holds: distances and those that are likely to stand in the way,
        others once one was broken.
    """

    task: Task
    margin: float = _MARGIN
    share: float = _SHARE
    kinds: set[str] = field(default_factory=lambda: {"distance", "tool speed"})

    def __post_init__(self) -> None:
        if _torque_is_likely(self.task):
            self.kinds.add("torque")

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
        used = replace(
            task.limits,
            torque=self.share * task.limits.torque,
            tool_speed=task.limits.tool_speed and self.share * task.limits.tool_speed,
        )
        if "torque" in self.kinds:
            yield TorqueWithin(model=task.torque, limits=used)
        speed = ToolSpeedWithin.of(task.robot, used) if "tool speed" in self.kinds else None
        if speed is not None:
            yield speed

    def learn(self, check: LimitCheck) -> None:
        """Hold the kinds that a check found broken, and widen margins of those that were held."""
        wrong = [row for row in check.rows if row.verdict != "held"]
        missing = max((-row.slack for row in wrong if row.kind == "distance"), default=0.0)
        if missing:
            self.margin += _BEYOND * max(missing, 1e-4)
        rates = [row for row in wrong if row.kind in self.kinds and row.kind != "distance"]
        if rates:
            over = max(-row.slack / row.limit for row in rates)
            self.share /= 1.0 + _BEYOND * max(over, 1e-3)
        self.kinds |= {row.kind for row in wrong}


def _torque_is_likely(task: Task) -> bool:
    """Return whether torques of random states within the limits are often beyond theirs."""
    limits, n = task.limits, task.robot.n
    rng = np.random.default_rng(0)
    q = limits.lower + (limits.upper - limits.lower) * rng.uniform(size=(_DRAWN, n))
    v, a = (
        np.minimum(limit, _FASTEST) * rng.uniform(-1.0, 1.0, (_DRAWN, n))
        for limit in (limits.velocity, limits.acceleration)
    )
    torque = np.abs(task.torque.torque(q, v, a)) + task.torque.spread(q, v, a)
    beyond = np.any(torque > task.torque.allowed(limits.torque), axis=1)
    return bool(np.mean(beyond) > _OFTEN)


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
    DataError
        When none is found: it names the limits in the way.
    """
    check = checked(task, candidate.x)
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
    raise DataError(
        f"excitation of '{task.robot.name}': no motion was found that holds every limit. Even one "
        f"of a tenth of the size breaks: {broken}. Widen these limits, or give another start."
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
