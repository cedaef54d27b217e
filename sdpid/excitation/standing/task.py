"""What a motion of a standing robot is asked for, resolved and checked before the search."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, generator
from sdpid.errors import DataError, ModelError
from sdpid.estimation.prior.prior import Prior
from sdpid.excitation.criterion.belief import nominal_bodies, prior_information
from sdpid.excitation.criterion.criterion import Criterion, Objective
from sdpid.excitation.criterion.noise import LASTING, ExpectedNoise, Given
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.limits.joint_limits import NONE, JointLimits
from sdpid.excitation.limits.limits import Limits
from sdpid.excitation.search.search import Search
from sdpid.excitation.search.space import SplineSpace
from sdpid.excitation.search.starts import usual_states
from sdpid.excitation.standing.held import Held
from sdpid.excitation.standing.plan import StandingPlan
from sdpid.excitation.standing.rows import StandingRows
from sdpid.excitation.standing.stance import RATE_HZ, Stance
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.legs import find_legs
from sdpid.robot.model.model import RobotModel

# Share of the description's limits that is used, and what is kept of torques for friction, which
# descriptions seldom have.
_SHARE, _RESERVE = 0.95, 0.2
# The base sways by this share of its height where nothing else is said: on balls, and on soles.
_SWAY, _SWAY_ON_SOLES = 0.25, 0.1
# It speeds up by at most this share of gravity along the ground, and as much at its height about
# it; and reaches that within this time, s: motors follow.
_ACCELERATION, _RISE = 0.4, 0.1
# Joints beside the legs use this share of their range at most, about where they stand, rad.
_FREE = 0.5
# The longest motion that is searched, s.
_LONGEST = 60.0
# Legs that are bent as usual have determinants of 0.03 (six joints) to 0.65 (three) times the
# product of their columns' lengths; less than this is a knee that is bent by a degree or less.
_STRAIGHT = 1e-3
# Random motions from which usual efforts are taken.
_USUAL = 5
# Standard deviation of the base's rows, as a share of the weight: `estimation` has as much.
_WEIGHT_SHARE = 1e-3
# Steps of a refined start, as a share of those of one from a random start: four times the
# intervals would make a motion finer than what the criterion looks at. Of 10 s of a Solo12 the
# first ten steps bring a mean log of -15.62 to -15.92, the next twenty nothing, and 15 steps with
# twice the intervals -16.05.
_REFINING = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class StandingRequest:
    """The arguments of `design_standing`; the robot is loaded, and friction terms are chosen."""

    robot: RobotModel
    duration: float
    limits: Limits | None
    sway: float | None
    tilt: float
    grip: float
    load: float
    friction: tuple[str | FrictionTerm, ...]
    prior: Prior | None
    previous: tuple[StandingPlan, ...]
    noise: Given
    standing: Sequence[float] | None
    feet: Sequence[str] | None
    starts: int
    steps: int
    time_limit: float | None
    seed: int
    progress: bool | None


@dataclass(frozen=True, kw_only=True, eq=False)
class StandingTask:
    """A design, ready to be searched.

    Attributes
    ----------
    search : Search
        What is searched, without an end.
    held : Held
        Limits of joints, motors and feet.
    rows : StandingRows
        What a sample tells, signs as given.
    values : ndarray, shape (b,)
        What the base parameters are taken to be.
    notes : tuple of str
        What was assumed.
    """

    search: Search
    held: Held
    rows: StandingRows
    values: Array
    notes: tuple[str, ...]

    @classmethod
    def of(cls, request: StandingRequest) -> StandingTask:
        """Resolve and check what is asked for.

        Raises
        ------
        SdpidError
            As `design_standing`.
        """
        robot, grip = request.robot, request.grip
        _check(request)
        legs = find_legs(robot, feet=request.feet, standing=request.standing)
        if not robot.direct:
            raise ModelError(
                f"excitation of '{robot.name}': motions of standing robots are those of joints; "
                "plan without its transmission."
            )
        if not np.all(robot.prior[:, 0] >= 0.0) or not robot.prior[:, 0].sum() > 0.0:
            raise ModelError(
                f"excitation of '{robot.name}': the description has no masses, so that nobody "
                "knows what its feet bear; give it some."
            )
        sway = request.sway
        if sway is None:
            sway = (_SWAY_ON_SOLES if legs.flat else _SWAY) * legs.height
        if not 0.0 < sway < legs.height:
            raise DataError(
                f"sway: is {sway:g} m; give more than 0 and less than the base's height above the "
                f"feet, {legs.height:.3g} m."
            )
        stance = Stance(legs)
        _require_bent(stance)
        bodies, assumed = nominal_bodies(robot)
        joints = _joints(robot, request.limits, legs.standing)
        held = Held(stance=stance, joints=joints, bodies=bodies, grip=grip, load=0.0)
        held = replace(held, load=request.load * held.weight)
        _require_stance(held)
        coordinates = _coordinates(stance, joints, sway, request.tilt)
        space = SplineSpace.of(stance.n, request.duration)
        still = np.zeros(space.n)
        whole, rng = held.rows(space, share=1.0), generator(request.seed)
        homes = [still] * _USUAL
        usual = usual_states(space, coordinates, homes, rng, whole.hold, start=still)
        torque, _ = held.loads(stance.at(*usual))
        effort = np.sqrt(np.mean(torque**2, axis=0))
        expected = ExpectedNoise.of(robot.joint_names[6:], request.noise, effort, RATE_HZ)
        force = LASTING * (_WEIGHT_SHARE * held.weight * len(legs.frames)) ** 2
        base = np.repeat([force, force * robot.reach**2], 3)
        regressor = BaseRows.of(robot, request.friction)
        rows = StandingRows(
            stance=stance,
            regressor=regressor,
            spread=np.concatenate([base, expected.density]),
        )
        efforts = np.concatenate([np.zeros(6), effort])
        known = prior_information(regressor, request.prior or True, efforts)
        for plan in request.previous:
            if plan.base.names != regressor.base.names:
                raise DataError(
                    f"previous: a plan of {len(plan.base.names)} base parameters, this one has "
                    f"{rows.count}, or others; plan for the same robot and friction terms."
                )
            known = known + plan.information
        criterion = Criterion(
            rows=replace(rows, regressor=regressor.smooth()),
            objective=Objective(kind="D"),
            rates=np.ones(stance.n),
            known=known,
        )
        search = Search(
            space=space,
            criterion=criterion,
            limits=coordinates,
            inequalities=held,
            name=robot.name,
            start=still,
            steps=request.steps,
            refining_steps=math.ceil(_REFINING * request.steps),
            levels=1,
        )
        theta = np.concatenate([bodies.ravel(), np.zeros(len(regressor.friction.parameters))])
        return cls(
            search=search,
            held=held,
            rows=rows,
            values=regressor.base.matrix @ theta,
            notes=(*joints.assumed, *assumed, *expected.notes),
        )


def _check(request: StandingRequest) -> None:
    """Refuse numbers out of range."""
    for name, low, high, unit in (
        ("duration", 1.0, _LONGEST, " s"),
        ("tilt", 0.0, 1.0, " rad"),
        ("grip", 0.0, 10.0, ""),
        ("load", 0.0, 0.9, ""),
    ):
        value = getattr(request, name)
        if not (low < value <= high or value == low == 1.0):
            raise DataError(
                f"{name}: is {value:g}{unit}; give more than {low:g} and at most {high:g}{unit}."
            )


def _joints(robot: RobotModel, limits: Limits | None, standing: Array) -> JointLimits:
    """Return the limits of the joints, which a held base has as well."""
    import pinocchio as pin

    model = robot.pin_model
    held = RobotModel.from_pinocchio(pin.buildReducedModel(model, [1], pin.neutral(model)))
    found = (limits or Limits()).of(held, standing, share=_SHARE, assume=False)
    told = f"{100.0 * _RESERVE:g} % of every torque limit are kept for friction."
    kept = [note for note in found.assumed if "acceleration" not in note and "jerk" not in note]
    if np.isfinite(found.torque).any():
        kept.append(told)
    return replace(found, torque=(1.0 - _RESERVE) * found.torque, assumed=tuple(kept))


def _require_bent(stance: Stance) -> None:
    """Refuse a stance on straight legs, along which no joint moves the base."""
    bent = stance.bent
    if bent.min() < _STRAIGHT:
        raise DataError(
            f"excitation of '{stance.robot.name}': standing, the leg of "
            f"'{stance.legs.frames[int(bent.argmin())]}' is straight: its Jacobian's determinant "
            f"is {bent.min():.2g} of the product of its columns' lengths, at least {_STRAIGHT:g} "
            "is needed; bend its knee (standing=)."
        )


def _require_stance(held: Held) -> None:
    """Refuse a stance that is beyond limits before anything moves."""
    still = np.zeros((1, held.stance.n))
    states = held.stance.states(held.stance.standing, still, still)
    for kind, subject, unit, values, low, high in held.quantities(states):
        value = float(values[0])
        if not low <= value <= high:
            limit = low if value < low else high
            raise DataError(
                f"excitation of '{held.stance.robot.name}': standing still, {kind} of {subject} is "
                f"{value:.4g} {unit}, the limit is {limit:.4g} {unit}; give another stance "
                "(standing=), or wider limits."
            )


def _coordinates(stance: Stance, joints: JointLimits, sway: float, tilt: float) -> JointLimits:
    """Return the limits of the base's motion, then those of the joints beside the legs."""
    legs = stance.legs
    free = legs.free
    size = np.repeat([sway, tilt], 3)
    gravity = float(np.linalg.norm(stance.robot.gravity)) * _ACCELERATION
    most = np.repeat([gravity, gravity / legs.height], 3)
    lower, upper = joints.lower[free], joints.upper[free]
    room = np.minimum(legs.standing[free] - lower, upper - legs.standing[free])
    room = np.minimum(room, _FREE)
    # As fast as half a second from rest to the limit of speed, or to 2 rad/s.
    speed = np.minimum(joints.velocity[free], 2.0)
    none = (NONE,) * stance.n
    return JointLimits(
        joint_names=stance.names,
        sliding=(True,) * 3 + (False,) * (stance.n - 3),
        rest=np.zeros(stance.n),
        lower=np.concatenate([-size, -room]),
        upper=np.concatenate([size, room]),
        velocity=np.concatenate([np.full(6, np.inf), speed]),
        acceleration=np.concatenate([most, 2.0 * speed]),
        jerk=np.concatenate([most, 2.0 * speed]) / _RISE,
        torque=np.full(stance.n, np.inf),
        sources=dict.fromkeys(("lower", "upper", "velocity", "torque"), none),
    )
