"""Design a motion of a robot that stands, which shows its parameters."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, generator
from sdpid.errors import DataError, ModelError
from sdpid.estimation.prior.prior import Prior
from sdpid.excitation.criterion.belief import (
    LASTING,
    ExpectedNoise,
    Given,
    nominal_bodies,
    prior_information,
)
from sdpid.excitation.criterion.criterion import Criterion, Objective
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.limits.joint_limits import NONE, JointLimits
from sdpid.excitation.limits.limits import Limits
from sdpid.excitation.plan.plan import settings_of
from sdpid.excitation.search.search import Search, designed, require_search
from sdpid.excitation.search.space import SplineSpace, usual_states
from sdpid.excitation.standing.held import Held
from sdpid.excitation.standing.plan import StandingPlan
from sdpid.excitation.standing.stance import RATE_HZ, Stance, StandingRows
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.legs import find_legs
from sdpid.robot.model.load import load_robot
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
    def of(cls, request: SimpleNamespace) -> StandingTask:
        """Resolve and check what is asked for.

        Parameters
        ----------
        request : SimpleNamespace
            The arguments of `design_standing` by name; the robot is loaded, friction terms chosen.

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


def _check(request: SimpleNamespace) -> None:
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
    kept = [note for note in found.assumed if "acceleration" not in note and "jerk" not in note]
    if np.isfinite(found.torque).any():
        kept.append(f"{100.0 * _RESERVE:g} % of every torque limit are kept for friction.")
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


# Friction terms of a plan, where none are named.
FRICTION = ("coulomb", "viscous", "rotor_inertia")
# Starts of the search, and steps of one.
STARTS, STEPS = 1, 30
# Of a time limit, what is kept for the check, at most seconds and this share.
_KEPT_SECONDS, _KEPT_SHARE = 5.0, 0.2
# Samples a second at which the information of the motion that is found is summed.
_INFORMED_HZ = 50.0


def design_standing(
    robot: RobotModel | str | os.PathLike[str],
    *,
    duration: float = 10.0,
    limits: Limits | None = None,
    sway: float | None = None,
    tilt: float = 0.35,
    grip: float = 0.5,
    load: float = 0.3,
    friction: Iterable[str | FrictionTerm] | None = None,
    prior: Prior | None = None,
    previous: StandingPlan | Sequence[StandingPlan] = (),
    noise: Given = None,
    standing: Sequence[float] | None = None,
    feet: Sequence[str] | None = None,
    starts: int = STARTS,
    steps: int = STEPS,
    time_limit: float | None = None,
    seed: int = 0,
    progress: bool | None = None,
) -> StandingPlan:
    """Design a motion of a robot on legs that stands, which shows its parameters.

    The base moves along splines of fifth degree, from rest to rest; the feet stay where they are,
    and joints beside the legs move as well. What is made large is the information that rows carry
    which no force of the ground enters, together with what a prior believes (log det). Forces
    stay in their friction cones, and every foot bears some weight; of all forces that carry a
    motion these are the centered ones.

    Parameters
    ----------
    robot : RobotModel, str or path
        A robot on legs, as `simulate_legged` takes it: anything that `load_robot` takes.
    duration : float, optional
        Duration of the motion, s.
    limits : Limits, optional
        Limits that narrow the description's, of which 95 % are used; of torques 20 % are kept for
        friction. Accelerations and jerks of joints are not limited.
    sway : float, optional
        The base moves by at most this much along each axis, m; by default a quarter of its height
        on balls, and a tenth on soles.
    tilt : float, optional
        It turns by at most this much about each axis, rad.
    grip : float, optional
        Coefficient of friction of the ground that may be used. The same robots used up to 0.19
        more than planned.
    load : float, optional
        Least normal force of a foot, as a share of what it bears when the robot stands. Of a
        Solo12 whose links are 15 % off, feet bore up to 0.17 less than planned (three seeds).
    friction : iterable of str or FrictionTerm, optional
        Friction terms of the model; by default Coulomb, viscous and rotor inertia.
    prior : Prior, optional
        What is known of the links before the run; by default that of `identify`.
    previous : StandingPlan or sequence of them, optional
        Plans that are run beside this one, such as those of other stances: this one asks for what
        they leave open. They need the same friction terms.
    noise : float, sequence, mapping or ExpectedNoise, optional
        Standard deviation of the efforts' white noise at 500 Hz, N·m; by default what is usual on
        real robots.
    standing : array_like, shape (joints,), optional
        Joint positions in which the robot stands, rad; by default knees are bent. They say where
        the feet are.
    feet : sequence of str, optional
        Frames at the feet; by default links with 'sole' or 'foot' in their names.
    starts : int, optional
        Number of random starts of the search; the best is refined.
    steps : int, optional
        Largest number of steps from one start; refining takes half of them at most.
    time_limit : float, optional
        Seconds that search and check may take; without, the same arguments give the same plan.
    seed : int, optional
        Seed of everything that is random.
    progress : bool, optional
        Show a progress bar; by default on a terminal.

    Returns
    -------
    StandingPlan

    Raises
    ------
    ModelError
        When the robot has no feet, other legs than are supported, or no masses.
    DataError
        When a number is out of range, or the robot cannot even stand within its limits.
    InfeasibleError
        When no motion is found that moves and holds all limits.
    MissingExtraError
        When CasADi is not installed (extra ``excite``).

    Examples
    --------
    >>> standing = sdpid.design_standing("solo12", duration=2.0, steps=2)
    >>> standing.limits.ok, standing.motion
    (True, WholeBodyMotion(12 joints, 4 feet, 2 s))
    """
    # All arguments: this has to come first.
    given = dict(locals())
    require_search(time_limit, starts=starts, steps=steps)
    if not isinstance(robot, RobotModel):
        robot = load_robot(robot, root="free_flyer")
    given |= {"robot": robot, "friction": FRICTION if friction is None else tuple(friction)}
    given["previous"] = _plans(previous)
    began, asked = time.monotonic(), SimpleNamespace(**given)
    task = StandingTask.of(asked)
    search, kept = task.search, (_KEPT_SECONDS, _KEPT_SHARE)
    homes = [np.zeros(search.space.n)] * starts
    (best, check), _, stopped = designed(search, homes, generator(seed), asked, began, kept)
    notes = [*task.notes]
    if stopped:
        notes.append("the search was ended early: this is the best motion that it had found.")
    known = search.criterion.known
    curve = best.space.curve(best.x)
    grid = best.space.grid(rate=_INFORMED_HZ)
    W = task.rows.rows(*(curve.evaluate(grid, derivative=order) for order in range(3)))
    flat = W.reshape(-1, W.shape[2])
    information = curve.duration / len(grid) * (flat.T @ flat)
    before, after = (_deviations(each) for each in (known, known + information))
    # Not the stance of the search, which keeps all states that it looked at last.
    held = replace(task.held, stance=replace(task.held.stance))
    return StandingPlan(
        stance=held.stance,
        curve=curve,
        limits=check,
        held=held,
        base=task.rows.regressor.base,
        values=task.values,
        standard_errors=after,
        before=before,
        information=information,
        known=known,
        spread=task.rows.spread,
        notes=tuple(notes),
        settings=settings_of(given, robot=robot.name, prior=None, previous=None, progress=None),
    )


def _plans(previous: Any) -> tuple[StandingPlan, ...]:
    """Return earlier plans as a tuple; None is none."""
    plans = previous if isinstance(previous, list | tuple) else (previous,)
    if previous is None:
        return ()
    for each in plans:
        if not isinstance(each, StandingPlan):
            raise DataError(
                f"previous: is or holds {each!r:.80}; give what design_standing returned, one "
                "plan or several."
            )
    return tuple(plans)


def _deviations(information: Array) -> Array:
    """Return standard errors (b,) of an information that leaves nothing open."""
    size = np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information / np.outer(size, size))
    return np.asarray(np.sqrt(np.diag(inverse)) / size)
