"""What a design is asked for, resolved and checked before the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Literal, TypeAlias, get_args

import numpy as np

from sdpid._common.arrays import Array, generator, real_array
from sdpid.errors import DataError
from sdpid.estimation.information import Excitation
from sdpid.excitation.criterion.belief import (
    EarlierInformation,
    earlier_information,
    nominal_bodies,
    prior_information,
)
from sdpid.excitation.criterion.criterion import Criterion, Objective, ObjectiveKind
from sdpid.excitation.criterion.noise import ExpectedNoise
from sdpid.excitation.criterion.purpose import Purpose, purpose_of
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.design.arm import RATE_HZ, ArmInequalities
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.limits.limits import Limits
from sdpid.excitation.limits.torque import TorqueModel
from sdpid.excitation.search.search import Search
from sdpid.excitation.search.space import FourierSpace, Space, SplineSpace
from sdpid.excitation.search.starts import usual_states
from sdpid.robot.model.arms import require_fixed_robot
from sdpid.robot.model.model import RobotModel

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
