"""The limits of an arm that are no linear functions of its motion, held on a grid of instants."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from sdpid.excitation.design.task import Task
from sdpid.excitation.limits.check import LimitCheck
from sdpid.excitation.limits.inequalities import ToolSpeedWithin, TorqueWithin
from sdpid.excitation.search.inequalities import InstantRows, KeptDistance, StateInequality
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
# A margin grows by this much more than what was missing.
_BEYOND = 1.5


@dataclass(eq=False)
class ArmInequalities:
    """The nonlinear limits of an arm, as a search holds them on a grid.

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
        wrong = check.broken
        missing = max((-row.slack for row in wrong if row.kind == "distance"), default=0.0)
        if missing:
            self.margin += _BEYOND * max(missing, 1e-4)
        rates = [row for row in wrong if row.kind == "tool speed" or row.subject in self.joints]
        if rates:
            over = max(-row.slack / row.limit for row in rates)
            self.share /= 1.0 + _BEYOND * max(over, 1e-3)
        self.joints |= {row.subject for row in wrong if row.kind == "torque"}
