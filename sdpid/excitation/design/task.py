"""Resolve and check the arguments of an arm's design, and hold its motion to limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Literal, TypeAlias, get_args

import numpy as np

from sdpid._common.arrays import Array, generator, real_array
from sdpid.errors import DataError
from sdpid.estimation.information import Excitation
from sdpid.excitation.criterion.belief import (
    EarlierInformation,
    ExpectedNoise,
    earlier_information,
    nominal_bodies,
    prior_information,
)
from sdpid.excitation.criterion.criterion import Criterion, Objective, ObjectiveKind
from sdpid.excitation.criterion.purpose import Purpose, purpose_of
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.limits.check import LimitCheck, check_trajectory
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.limits.limits import Limits
from sdpid.excitation.limits.measures import ToolSpeedWithin, TorqueWithin
from sdpid.excitation.limits.torque import TorqueModel
from sdpid.excitation.search.search import Search
from sdpid.excitation.search.space import (
    FourierSpace,
    InstantRows,
    KeptDistance,
    Space,
    SplineSpace,
    StateInequality,
    usual_states,
)
from sdpid.experiment.trajectory.curve import Curve
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.model.arms import require_fixed_robot
from sdpid.robot.model.model import RobotModel

# Samples a second of a plan's trajectory.
RATE_HZ = 500.0
# Instants a second at which distances, torques and tool speeds are held during the search.
_GRID_HZ = 8.0
# What is kept of a distance beyond the clearance while it is held on the grid, at most, m: more
# would close ways that the arm can take, and what is missing is mended.
_MOST_MARGIN = 0.01
# Torques and tool speeds are held to this share of their limits on the grid.
_GRID_SHARE = 0.97
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
    share: float = field(init=False, default=_GRID_SHARE)

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


Motion = Literal["spline", "fourier", "postures", "one_by_one"]

# What each kind of motion is, and when to take it.
MOTIONS: dict[str, str] = {
    "spline": "splines of fifth degree, at rest at both ends; they show most in a given time, "
    "friction included",
    "fourier": "Fourier series, at rest where a period begins; for controllers that want them: "
    "within the same limits they show less than splines",
    "postures": "from posture to posture, each held for a while; for robots that are read out at "
    "rest, to know gravity",
    "one_by_one": "one joint at a time, the others at rest; for friction where joints disturb each "
    "other: it shows little else",
}

# Longer motions are not searched, s: with thousands of free numbers a step takes seconds, and a
# shorter motion tells as much when it is repeated.
_LONGEST = 120.0
# A joint's torque is held from the start where random motions use this share of its limit: each
# joint adds two rows an instant, and most never come near.
_NEAR = 0.5
# Highest frequency of a Fourier series, Hz, and least number of harmonics.
_HIGHEST_HZ, _FEWEST_HARMONICS = 0.6, 5
# Distance that is kept where nothing else is said, m.
CLEARANCE = 0.03
# Share of the description's limits that is used where nothing else is said.
_SHARE = 0.95
# A free number of a joint stands for half of its range, rad (m), and for this at most: only what is
# smaller, such as the fingers of a gripper, is not moved at all beside the rest.
_LARGEST = 1.0
# Directions that random motions show by less than this share of the best do not count for a
# condition number: no motion shows them nearly as well (the mass of fingers beside the arm's, what
# a lever of some millimeters tells apart), so that they would rule it. They count for log det.
_HARDLY = 0.01
# Random motions from which usual efforts are taken.
_USUAL = 20

# The arguments of `design_excitation` by name; friction terms are chosen.
Request: TypeAlias = SimpleNamespace


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """A design, ready to be searched.

    Attributes
    ----------
    search : Search
        What is searched, without an end.
    held : ArmInequalities
        All limits.
    rows : BaseRows
        The regressor of the base parameters, signs as given.
    noise : ExpectedNoise
        Of the efforts.
    earlier : EarlierInformation or None
        That of earlier runs.
    notes : tuple of str
        What was assumed.
    """

    search: Search
    held: ArmInequalities
    rows: BaseRows
    noise: ExpectedNoise
    earlier: EarlierInformation | None
    notes: tuple[str, ...]

    @classmethod
    def of(cls, robot: RobotModel, request: Request) -> Task:
        """Resolve and check what is asked for of a robot.

        Raises
        ------
        SdpidError
            As `design_excitation`.
        """
        _check(robot, request)
        begin = None if request.start is None else real_array(request.start, "start", ndim=1)
        joints = (request.limits or Limits()).of(robot, begin, share=_SHARE)
        if joints.clearance is None:
            joints = replace(joints, clearance=CLEARANCE)
        _check_duration(joints, request.duration, request.motion)
        notes = [*joints.assumed]
        collision = None
        if request.collisions:
            collision = CollisionModel.of(
                robot,
                request.obstacles,
                package_dirs=request.package_dirs,
                rest=begin,
                near=joints.rest,
                lower=joints.lower,
                upper=joints.upper,
                clearance=joints.clearance or 0.0,
                seed=request.seed,
            )
            notes += collision.assumed
            if not collision.pairs:
                notes.append("no pair of bodies can touch: distances are not limited.")
        half = 0.5 * (joints.upper - joints.lower)
        sizes = np.where(half > 0.0, np.minimum(half, _LARGEST), _LARGEST)
        space = _space(robot.n, request).sized(sizes)
        rows = BaseRows.of(robot, request.friction)
        rng = generator(request.seed)
        shares = (rng.uniform(0.25, 0.75, robot.n) for _ in range(_USUAL))
        around = (joints.lower + share * (joints.upper - joints.lower) for share in shares)
        usual = usual_states(space, joints, around, rng)
        bodies, assumed = nominal_bodies(robot)
        notes += assumed
        effort = np.sqrt(np.mean(robot.inverse_dynamics(bodies, *usual) ** 2, axis=0))
        noise, earlier = request.noise, None
        if request.previous is not None:
            earlier = earlier_information(rows, request.previous)
            notes += earlier.notes
            noise = earlier.noise if noise is None else noise
        expected = ExpectedNoise.of(robot.joint_names, noise, effort, RATE_HZ)
        notes += expected.notes
        known = prior_information(rows, request.prior, effort)
        if earlier is not None:
            known = known + earlier.information
        states = None if request.predict is None else request.predict.sample()
        purpose = purpose_of(request.purpose, rows, motion=states)
        torque = TorqueModel.of(robot, spread=request.torque_spread)
        notes += torque.notes
        largest = (np.abs(torque.torque(*usual)) + torque.spread(*usual)).max(axis=0)
        near = np.flatnonzero(largest > _NEAR * torque.allowed(joints.torque))
        held = ArmInequalities(
            robot=robot,
            limits=joints,
            collision=collision,
            torque=torque,
            joints={joints.joint_names[j] for j in near},
            periods=request.periods,
        )
        search = Search(
            space=space,
            criterion=_criterion(rows, purpose, request.objective, expected, known, earlier, usual),
            limits=joints,
            inequalities=held,
            name=robot.name,
            start=begin,
        )
        return cls(
            search=search,
            held=held,
            rows=rows,
            noise=expected,
            earlier=earlier,
            notes=tuple(notes),
        )


def _check(robot: RobotModel, request: Request) -> None:
    """Refuse numbers out of range, and motions that contradict themselves."""
    duration, motion, periods = request.duration, request.motion, request.periods
    require_fixed_robot(
        robot,
        "excitation",
        instead="Of a robot that stands, sdpid.design_standing (sdpid excite --stand) plans it.",
    )
    if not (np.isfinite(duration) and duration > 0.0):
        raise DataError(f"duration: is {duration}; give a positive time in s.")
    if duration > _LONGEST:
        raise DataError(
            f"duration: is {duration:g} s, at most {_LONGEST:g} s are searched; repeat a shorter "
            "motion (periods)."
        )
    if motion not in get_args(Motion):
        raise DataError(f"motion: is {motion!r}; use one of {', '.join(get_args(Motion))}.")
    if int(periods) != periods or periods < 1:
        raise DataError(f"periods: is {periods}; give a whole number from 1.")
    if not request.closed and periods > 1:
        raise DataError(
            f"periods: are {periods}, but an open motion ends elsewhere than it begins; leave "
            "closed=False out, or run it once."
        )
    if motion == "fourier" and not request.closed:
        raise DataError("motion: Fourier series are closed; leave closed=False out.")
    if request.harmonics is not None and motion != "fourier":
        raise DataError(f"harmonics: are of Fourier series; the motion is {motion!r}.")


def _check_duration(limits: JointLimits, duration: float, motion: str) -> None:
    """Refuse a duration in which some joint cannot move by a tenth of its range and back."""
    least = limits.shortest_duration()
    needed = float(least.sum() if motion == "one_by_one" else least.max())
    if duration < needed:
        j = int(np.argmax(least))
        raise DataError(
            f"duration: {duration:g} s is too short for the limits: {limits.joint_names[j]} takes "
            f"{least[j]:.3g} s to travel a tenth of its range and back (speed "
            f"{limits.velocity[j]:.3g}, acceleration {limits.acceleration[j]:.3g}, jerk "
            f"{limits.jerk[j]:.3g}); give at least {np.ceil(10.0 * needed) / 10.0:g} s, or higher "
            "limits."
        )


def _space(n: int, request: Request) -> Space:
    duration = request.duration
    if request.motion == "fourier":
        usual = max(_FEWEST_HARMONICS, round(_HIGHEST_HZ * duration))
        harmonics = usual if request.harmonics is None else request.harmonics
        return FourierSpace.of(n, duration, harmonics)
    if request.motion == "postures":
        return SplineSpace.postures(n, duration)
    if request.motion == "one_by_one":
        return SplineSpace.one_by_one(n, duration)
    return SplineSpace.of(n, duration, closed=request.closed)


def _criterion(
    rows: BaseRows,
    purpose: Purpose,
    objective: ObjectiveKind | None,
    noise: ExpectedNoise,
    known: Array,
    earlier: EarlierInformation | None,
    usual: Sequence[Array],
) -> Criterion:
    """Return what is made small: by default what fits the purpose."""
    smooth = rows.smooth(usual[1])
    whole = purpose.name == "all"
    kind = objective or ("mixed" if whole else "V" if purpose.kind == "sum" else "D")
    if kind == "mixed":
        # The data are to show every parameter by themselves: descriptions can be wrong.
        known = np.zeros_like(known) if earlier is None else np.array(earlier.information)
    W = smooth.rows(*usual)
    excitation = Excitation.of(W.reshape(-1, rows.count), rows.base.names)
    size = excitation.column_norms / np.sqrt(len(W))
    scale = 1.0 / np.where(size > 0.0, size, 1.0)
    values = excitation.singular_values
    functionals = None if whole else purpose.functionals
    if whole and kind == "V":
        # Mean variance of the efforts of usual motions, each joint in units of its noise.
        weighted = (W / noise.deviation[:, None]).reshape(-1, rows.count)
        functionals = np.linalg.qr(weighted, mode="r") / np.sqrt(len(W))
    return Criterion(
        rows=smooth,
        objective=Objective(
            kind=kind,
            functionals=functionals,
            scale=scale if whole else None,
            shown=excitation.directions[values > _HARDLY * values[0]].T if whole else None,
        ),
        rates=1.0 / noise.density,
        known=known,
        directions=None if whole else np.array(purpose.directions),
    )
