"""What an arm's motion is checked against, and what of it a search holds on a grid of instants."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.limits.check import LimitCheck, check_trajectory
from sdpid.excitation.limits.inequalities import ToolSpeedWithin, TorqueWithin
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.limits.torque import TorqueModel
from sdpid.excitation.search.inequalities import InstantRows, KeptDistance, StateInequality
from sdpid.excitation.search.space import Space
from sdpid.experiment.trajectory.curve import Curve
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.model.model import RobotModel

# Samples a second of a plan's trajectory.
RATE_HZ = 500.0
# Instants a second at which distances, torques and tool speeds are held during the search.
_GRID_HZ = 8.0
# What is kept of a distance beyond the clearance while it is held on the grid, at most, m: more
# would close ways that the arm can take, and what is missing is mended.
_MOST_MARGIN = 0.01
# Torques and tool speeds are held to this share of their limits on the grid.
_SHARE = 0.97
# A margin grows by this much more than what was missing.
_BEYOND = 1.5
# Where a motion may begin, random positions are drawn from this share of each joint's range, about
# its middle, and as many are looked at.
_DRAWN_SHARE, _DRAWN = 0.6, 200
# There it keeps this more than the clearance, m, and uses this share of the torque limits at most:
# a motion needs room about it.
_ROOM, _TORQUE = 0.03, 0.8


@dataclass(kw_only=True, eq=False)
class ArmInequalities:
    """The limits of an arm.

    Attributes
    ----------
    robot : RobotModel
        The robot.
    limits : JointLimits
        Limits of its joints.
    collision : CollisionModel or None
        Pairs that must not touch; None where collisions are left out.
    torque : TorqueModel
        The torques of its motions.
    joints : set of str
        Whose torques a search holds: those that random motions bring near their limits, and
        those that a check found beyond.
    periods : int
        How often a motion is run.
    margin : float
        What is kept of distances beyond the clearance, m.
    share : float
        Share of torque and tool speed that is used.
    """

    robot: RobotModel
    limits: JointLimits
    collision: CollisionModel | None
    torque: TorqueModel
    joints: set[str]
    periods: int
    margin: float = field(init=False, default=0.0)
    share: float = field(init=False, default=_SHARE)

    def __post_init__(self) -> None:
        if self.collision is not None and self.collision.searched.pairs:
            # At acceleration a and distance r from the axis an arm dips by a·r·dt²/8 at most
            # between two instants.
            swing = np.max(self.collision.searched.reach * self.limits.acceleration)
            self.margin = float(min(swing / (8.0 * _GRID_HZ**2), _MOST_MARGIN))

    @property
    def clearance(self) -> float:
        """The distance that is kept between bodies, m."""
        return self.limits.clearance or 0.0

    def trajectory(self, curve: Curve) -> Trajectory:
        """Return the trajectory of a motion."""
        limits, duration = self.limits, curve.duration
        return Trajectory(
            joint_names=self.robot.joint_names,
            series=curve,
            # Whole samples: the rate differs from the usual one by less than a sample a period.
            rate_hz=max(2, round(duration * RATE_HZ)) / duration,
            periods=self.periods,
            rest=0.0,
            connection=0.0,
            position_range=np.stack([limits.lower, limits.upper], axis=1),
            velocity_limit=limits.velocity,
        )

    def check(self, curve: Curve) -> LimitCheck:
        """Return what a motion comes to beside its limits, at every instant."""
        return check_trajectory(
            self.robot,
            self.trajectory(curve),
            self.limits,
            collision=self.collision or False,
            torque=self.torque,
        )

    def rows(self, space: Space) -> InstantRows | None:
        """Return the rows that a search among motions holds; None where there are none."""
        time = space.grid(rate=_GRID_HZ)
        parts = [(inequality, time) for inequality in self._parts()]
        return InstantRows(space=space, parts=parts) if parts else None

    def _parts(self) -> Iterator[StateInequality]:
        if self.collision is not None and self.collision.searched.pairs:
            yield KeptDistance(
                collision=self.collision.searched, clearance=self.clearance, margin=self.margin
            )
        limits = self.limits
        held = [name in self.joints for name in limits.joint_names]
        used = replace(
            limits,
            torque=np.where(held, self.share * limits.torque, np.inf),
            tool_speed=limits.tool_speed and self.share * limits.tool_speed,
        )
        if np.isfinite(used.torque).any():
            yield TorqueWithin(model=self.torque, limits=used)
        speed = ToolSpeedWithin.of(self.robot, used)
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

    def homes(self, start: Array | None, rng: np.random.Generator) -> Iterator[Array]:
        """Yield positions (n,) at which motions begin: the one given; else the rest position first.

        Then others that are free and easily held; where nothing is, the rest position again.
        """
        while start is not None:
            yield start
        rest = self.limits.rest if self.collision is None else self.collision.rest
        yield rest
        middle = 0.5 * (self.limits.lower + self.limits.upper)
        half = 0.5 * _DRAWN_SHARE * (self.limits.upper - self.limits.lower)
        while True:
            drawn = middle + half * rng.uniform(-1.0, 1.0, (_DRAWN, self.robot.n))
            yield next(iter(drawn[self._free(drawn)]), rest)

    def _free(self, q: Array) -> Array:
        """Return which positions (K, n) are free and easily held."""
        still = np.zeros_like(q)
        allowed = _TORQUE * self.torque.allowed(self.limits.torque)
        good = np.all(np.abs(self.torque.torque(q, still, still)) <= allowed, axis=1)
        if self.collision is not None and self.collision.pairs:
            distances = self.collision.distances(q[good])
            wanted = self.collision.clearances(self.clearance, _ROOM)
            good[good] = np.all(distances >= wanted, axis=1)
        return np.asarray(good)
