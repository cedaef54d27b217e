"""From a motion that holds its limits on a grid to one that holds them at every instant."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
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
# What is kept of a distance beyond the clearance while it is held on the grid, at most, m: more
# would close ways that the arm can take, and what is missing is mended.
_MOST_MARGIN = 0.01
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
# Shares of a motion's way from standing still that are tried: nearly all of it first, which costs
# little of what it shows, and less where no search mends it.
_NEARLY = (1.0, 0.998, 0.99, 0.98, 0.95, 0.9)
# A sound motion whose objective exceeds what the search found by more than this is searched again.
_WORSE = 0.1
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
    margin: float = field(init=False, default=0.0)
    share: float = _SHARE
    joints: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        task = self.task
        near = task.usual_torque > _NEAR * task.torque.allowed(task.limits.torque)
        self.joints |= {
            name for name, is_near in zip(task.limits.joint_names, near, strict=True) if is_near
        }
        if task.collision is not None and task.collision.searched.pairs:
            # At acceleration a and distance r from the axis an arm dips by a·r·dt²/8 at most
            # between two instants.
            swing = np.max(task.collision.searched.reach * task.limits.acceleration)
            self.margin = float(min(swing / (8.0 * _RATE_HZ**2), _MOST_MARGIN))

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


def checked(task: Task, candidate: Candidate, share: float = 1.0) -> tuple[Array, LimitCheck]:
    """Return a share of a motion's way from standing still (N,), and its check at every instant."""
    x = _part(candidate, share)
    check = check_trajectory(
        task.robot,
        task.trajectory(candidate.space.curve(x)),
        task.limits,
        collision=task.collision or False,
        torque=task.torque,
    )
    return x, check


def mend(
    task: Task, search: Search, found: Sequence[Candidate], inequalities: Inequalities
) -> tuple[Candidate, LimitCheck]:
    """Return the best motion that holds all limits at every instant, and the check that says so.

    The motions found, the best first, are taken as they are or a little smaller; where that costs
    too much, the search goes on from the best of them with wider margins.

    Raises
    ------
    InfeasibleError
        When none is found: it names the limits in the way.
    """
    _require_motion(task, found[0])
    sound: list[tuple[Candidate, LimitCheck]] = []
    for candidate in found:
        if sound and (
            _objective(sound[0]) <= candidate.value or time.monotonic() > search.deadline
        ):
            break
        sound = sorted([*sound, *_smaller(task, search, candidate, _NEARLY)], key=_objective)
    if not sound or _objective(sound[0]) > found[0].value + _WORSE:
        again = _searched_again(task, search, found[0], inequalities)
        # What a search could not mend is only made much smaller where nothing else is sound.
        shares = (1.0,) if sound else (1.0, *_SHRINKS)
        sound = sorted([*sound, *_smaller(task, search, again, shares)], key=_objective)
    if sound:
        return sound[0]
    check = checked(task, again, _SHRINKS[-1])[1]
    broken = "; ".join(
        f"{row.kind} of {row.subject} by {-row.slack:.3g} {row.unit} at {row.time:.2f} s"
        for row in check.rows
        if row.verdict != "held"
    )
    raise InfeasibleError(
        f"excitation of '{task.robot.name}': no motion was found that holds every limit. Even one "
        f"of a tenth of the size breaks: {broken}. Widen these limits, or give another start."
    )


def _objective(sound: tuple[Candidate, LimitCheck]) -> float:
    return sound[0].value


def _smaller(
    task: Task, search: Search, candidate: Candidate, shares: Iterable[float]
) -> Iterator[tuple[Candidate, LimitCheck]]:
    """Yield the largest of some shares of a motion that holds all limits, with its check."""
    for share in shares:
        x, check = checked(task, candidate, share)
        if check.ok:
            if share < 1.0:
                value = search.on(candidate.space).value_and_gradient(x)[0]
                status = f"shrunk to {100.0 * share:g} %"
                candidate = replace(candidate, x=x, value=value, status=status)
            yield candidate, check
            return


def _searched_again(
    task: Task, search: Search, candidate: Candidate, inequalities: Inequalities
) -> Candidate:
    """Return what a search finds from a motion with margins as wide as its checks ask for."""
    for _ in range(_ROUNDS):
        check = checked(task, candidate)[1]
        if check.ok:
            break
        inequalities.learn(check)
        rows = inequalities.rows(candidate.space)
        start = shrunk(candidate, rows)
        candidate, stopped = search.on(candidate.space).improve(
            start, rows, number=candidate.start, most_steps=_STEPS, near=True
        )
        if stopped:
            break
    return candidate


def _require_motion(task: Task, candidate: Candidate) -> None:
    """Refuse a candidate that stands still: no start moved, or none was searched in time."""
    space = candidate.space
    if np.ptp(space.curve(candidate.x).evaluate(space.grid()), axis=0).max() > _STILL:
        return
    check = checked(task, candidate)[1]
    nearest = min(check.rows, key=lambda row: row.slack / (abs(row.limit) or 1.0))
    raise InfeasibleError(
        f"excitation of '{task.robot.name}': no motion was found, the arm stands still. Nearest to "
        f"its limit is {nearest.kind} of {nearest.subject} ({nearest.slack:.3g} {nearest.unit} "
        "left). Give the search more time, another start, or wider limits."
    )


def shrunk(candidate: Candidate, rows: InstantRows | None) -> Array:
    """Return a motion (N,) as large as may be, on the way to standing still, that holds rows."""
    for share in 0.85 ** np.arange(30):
        moved = _part(candidate, share)
        if rows is None or np.min(rows.values(moved)) > 0.0:
            return moved
    return _part(candidate, 0.0)


def _part(candidate: Candidate, share: float) -> Array:
    """Return a share of a motion's way (N,) from standing still where it begins."""
    space, x = candidate.space, candidate.x
    still = space.standing(space.first @ space.coefficients(x))
    return np.asarray(still + share * (x - still))
