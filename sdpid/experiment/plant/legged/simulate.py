"""`simulate_legged`: what a robot on legs with known parameters records of itself."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, generator, real_array
from sdpid._common.tables import Shown
from sdpid.errors import DataError
from sdpid.experiment.plant.legged.model import MotorGears, run_plan
from sdpid.experiment.plant.legged.motions import LEAD, follow, plan_motion
from sdpid.experiment.plant.legged.sensors import Sensors, record
from sdpid.experiment.plant.legged.truth import DryFriction, TrueMotion, changed_parameters
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.trajectory.whole_body import WholeBodyMotion
from sdpid.robot.legs import Legs, find_legs
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel

_RATES = (500.0, 5000.0)
# Length of a recording where nothing else is said, s.
_SECONDS = 10.0


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LeggedRun(Shown):
    """A recording of a simulated robot on legs, and what is true of it.

    Attributes
    ----------
    recording : Recording
        What the sensors measured, and the planned joint positions as its reference.
    theta : ndarray, shape (10·links + 3·joints,)
        True parameters: of the links, then Coulomb friction, viscous friction and rotor inertia
        of all joints.
    motion : TrueMotion
        The motion without sensors: positions, velocities, accelerations, torques, friction and
        contact wrenches at the recorded instants.
    friction : DryFriction
        The law that dry friction follows; its size is Coulomb friction in theta.

    Examples
    --------
    >>> quadruped = sdpid.load_robot("solo12", root="free_flyer")
    >>> sdpid.simulate_legged(quadruped, "stand", duration=0.1).motion.wrenches.shape
    (100, 4, 6)
    """

    recording: Recording
    theta: Array
    motion: TrueMotion
    friction: DryFriction

    _facts = ("recording",)


def simulate_legged(
    robot: RobotModel | str | os.PathLike[str],
    motion: str | WholeBodyMotion = "stand",
    *,
    theta: ArrayLike | None = None,
    duration: float | None = None,
    seed: int | np.random.Generator = 0,
    sensors: Sensors | None = None,
    legs: Legs | None = None,
    friction: DryFriction | None = None,
    rate_hz: float = 1000.0,
) -> LeggedRun:
    """Let a simulated quadruped or humanoid stand, trot, step, walk or hang, and record it.

    A quadruped stands on balls at the ends of legs of three joints, a humanoid on soles of legs of
    six, both on level ground. Its motors follow planned joint positions with proportional and
    derivative feedback, and carry the weight that the description gives; its joints have dry and
    viscous friction and rotor inertia. MuJoCo integrates it by a Runge-Kutta method of fourth
    order. Of contacts sensors record flags, and forces of balls or wrenches of soles.

    Parameters
    ----------
    robot : RobotModel, name or path
        A robot on a floating base: ``"go1"``, ``"talos_reduced"``, or
        ``load_robot("go1", root="free_flyer")``. Its kinematics are the true ones; its inertias
        are what the controller believes.
    motion : {"stand", "trot", "step", "walk", "hang"} or WholeBodyMotion, optional
        Stand with a swaying base, trot in place (quadrupeds), lift one foot after the other in
        place, walk forward, or move all joints with the base held in the air. Joints beside the
        legs swing in all of them. A planned motion, such as that of `design_standing`, is followed
        with its own torques.
    theta : array_like, shape (10·links + 3·joints,), optional
        True parameters, as `changed_parameters` returns them; by default those of seed 0, which
        are 15 % off the description.
    duration : float, optional
        Length of the recording, s; by default 10, or that of the planned motion.
    seed : int or numpy.random.Generator, optional
        The motion's phases and the sensors' noise.
    sensors : Sensors, optional
        Noise, resolution, delays and which sensors there are.
    legs : Legs, optional
        By default `find_legs`.
    friction : DryFriction, optional
        The law of dry friction; by default Coulomb friction with a sign 0.02 rad/s wide.
    rate_hz : float, optional
        Samples a second, and steps of the integrator.

    Returns
    -------
    LeggedRun

    Raises
    ------
    DataError
        When the motion is unknown, theta has another length, or the robot falls.
    ModelError
        When the robot has a fixed base or other legs, or theta belongs to no real robot.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).

    Examples
    --------
    >>> run = sdpid.simulate_legged("solo12", "trot", duration=0.5)
    >>> run.recording.contacts
    Contacts(500 samples, 4 points, flags)
    >>> run.theta.shape, run.motion.acceleration.shape
    ((166,), (500, 18))
    """
    if not isinstance(robot, RobotModel):
        robot = load_robot(robot, root="free_flyer")
    rng = generator(seed)
    sensors = Sensors() if sensors is None else sensors
    legs = find_legs(robot) if legs is None else legs
    friction = DryFriction() if friction is None else friction
    if theta is None:
        theta = changed_parameters(robot, legs=legs)
    values = frozen(real_array(theta, "theta", ndim=1))
    size = 10 * robot.n_links + 3 * legs.n_joints
    if len(values) != size:
        raise DataError(
            f"theta: {len(values)} numbers, expected {size}: 10 a link, then Coulomb friction, "
            "viscous friction and rotor inertia of every joint or motor; see changed_parameters."
        )
    if not _RATES[0] <= rate_hz <= _RATES[1]:
        raise DataError(
            f"rate_hz: {rate_hz:g}, limits {_RATES[0]:g} and {_RATES[1]:g}: feet on the ground "
            "need short steps."
        )
    if duration is not None and not duration * rate_hz >= 2.0:
        raise DataError(f"duration: {duration:g} s, the least is two samples.")
    before = round(sensors.longest_delay * rate_hz)
    if before > LEAD * rate_hz:
        raise DataError(f"delays: {sensors.longest_delay:g} s, the limit is {LEAD:g} s.")
    if isinstance(motion, WholeBodyMotion):
        plan = follow(legs, motion, duration)
    else:
        plan = plan_motion(
            legs, motion, duration=_SECONDS if duration is None else duration, rng=rng
        )
    motors = MotorGears.of(robot)
    time, truth = run_plan(
        legs, motors, plan, values, friction=friction, rate_hz=rate_hz, before=before
    )
    log = record(legs, time, truth, sensors, gravity=robot.gravity, held=plan.held, rng=rng)
    wanted, _ = plan.joints(np.asarray(log.time) + LEAD)
    log = replace(log, reference=motors.positions(wanted), joint_names=robot.joint_names[6:])
    return LeggedRun(recording=log, theta=values, motion=truth.after(before), friction=friction)
