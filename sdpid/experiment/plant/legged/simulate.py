"""`simulate_legged`: what sensors record of a robot on legs with known parameters."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Indices, frozen, generator, real_array
from sdpid._common.tables import Shown
from sdpid.errors import DataError
from sdpid.experiment.plant.legged.model import MotorGears, run_plan
from sdpid.experiment.plant.legged.motions import LEAD, follow, plan_motion
from sdpid.experiment.plant.legged.truth import DryFriction, TrueMotion, changed_parameters
from sdpid.experiment.recording.floating import BaseMotion, Contacts, Imu
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
    log = record(legs, time, truth, sensors, held=plan.held, rng=rng)
    wanted, _ = plan.joints(np.asarray(log.time) + LEAD)
    log = replace(log, reference=motors.positions(wanted), joint_names=robot.joint_names[6:])
    return LeggedRun(recording=log, theta=values, motion=truth.after(before), friction=friction)


# What may come late.
CHANNELS = ("joints", "effort", "base", "imu", "contacts")


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensors:
    """Sensors of a robot on legs. Noise is white and given by its rms in a sample.

    Attributes
    ----------
    joint_noise, joint_resolution : float
        Noise of joint positions and the step of their encoders, rad.
    effort_noise : float
        Noise of torques, as a share of the rms of all of them.
    effort_gain : float
        Measured over true torque.
    position_noise, orientation_noise : float
        Of the base's pose, m and rad: by default those of a motion capture system.
    imu : bool
        Whether there is one.
    gyroscope_noise, accelerometer_noise : float
        rad/s and m/s².
    imu_translation : tuple of 3 floats
        Where it sits in the base link, m.
    imu_rotation : tuple of 3 floats
        Its axes there, as a rotation vector, rad.
    forces : bool
        Whether the contacts' forces are recorded.
    force_noise, force_gain : float
        Noise of forces as a share of the rms of all, and measured over true force.
    flag_threshold : float
        A foot is said to be down where its vertical force exceeds this, N; 0 for true flags.
    delays : mapping of str to float
        Seconds by which a channel is late: 'joints', 'effort', 'base', 'imu' or 'contacts'.

    Raises
    ------
    DataError
        When a delayed channel is unknown, or a delay is negative.

    Examples
    --------
    >>> from sdpid.experiment.plant.legged.simulate import Sensors
    >>> late = Sensors(imu=False, delays={"effort": 0.002})
    >>> quadruped = sdpid.load_robot("solo12", root="free_flyer")
    >>> sdpid.simulate_legged(quadruped, "hang", duration=0.1, sensors=late).recording.base
    BaseMotion(100 samples, position, orientation)
    """

    joint_noise: float = 5e-5
    joint_resolution: float = 1e-4
    effort_noise: float = 0.01
    effort_gain: float = 1.0
    position_noise: float = 3e-4
    orientation_noise: float = 5e-4
    imu: bool = True
    gyroscope_noise: float = 2e-3
    accelerometer_noise: float = 0.03
    imu_translation: tuple[float, float, float] = (0.05, -0.02, 0.03)
    imu_rotation: tuple[float, float, float] = (0.0, 0.0, 0.5)
    forces: bool = False
    force_noise: float = 0.01
    force_gain: float = 1.0
    flag_threshold: float = 0.0
    delays: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        unknown = sorted(set(self.delays) - set(CHANNELS))
        if unknown:
            raise DataError(f"delays: no channel {unknown[0]!r}; there are {', '.join(CHANNELS)}.")
        if any(not delay >= 0.0 for delay in self.delays.values()):
            raise DataError(f"delays: {dict(self.delays)}; they are in s and not negative.")

    @classmethod
    def exact(cls) -> Sensors:
        """Return sensors without noise, with forces."""
        without = ("_noise", "_resolution")
        names = [each.name for each in fields(cls) if each.name.endswith(without)]
        nothing: dict[str, Any] = dict.fromkeys(names, 0.0)
        return cls(**nothing, forces=True)

    @property
    def longest_delay(self) -> float:
        """The longest of the delays, s."""
        return max(self.delays.values(), default=0.0)


def record(
    legs: Legs,
    time: Array,
    motion: TrueMotion,
    sensors: Sensors,
    *,
    held: bool,
    rng: np.random.Generator,
) -> Recording:
    """Return what the sensors make of a motion.

    Samples at negative times are there for delayed channels, and are not recorded.

    Returns
    -------
    Recording
    """
    from scipy.spatial.transform import Rotation

    step = float(time[1] - time[0])
    kept = np.flatnonzero(time >= -0.5 * step)

    def noisy(values: Array, rms: float) -> Array:
        return np.asarray(values + rms * rng.normal(size=values.shape))

    def late(channel: str) -> Indices:
        return np.asarray(kept - round(sensors.delays.get(channel, 0.0) / step))

    def rms(values: Array) -> float:
        return float(np.sqrt(np.mean(values**2)))

    def imu() -> Imu:
        # An inertial sensor off the base's origin.
        rows, arm = late("imu"), np.array(sensors.imu_translation)
        velocity, acceleration = motion.velocity[rows], motion.acceleration[rows]
        turning, axes = velocity[:, 3:6], Rotation.from_rotvec(sensors.imu_rotation)
        up = Rotation.from_quat(q[rows, 3:7]).inv().apply(-legs.robot.gravity)
        # From components of the velocity in turning axes to the acceleration of the origin.
        origin = acceleration[:, :3] + np.cross(turning, velocity[:, :3])
        spun = np.cross(acceleration[:, 3:6], arm) + np.cross(turning, np.cross(turning, arm))
        return Imu(
            gyroscope=noisy(axes.inv().apply(turning), sensors.gyroscope_noise),
            accelerometer=noisy(axes.inv().apply(origin + spun + up), sensors.accelerometer_noise),
            translation=arm,
            rotation=axes.as_matrix(),
        )

    q, torque = motion.position, sensors.effort_gain * motion.effort[:, 6:]
    joints = noisy(q[late("joints"), 7:], sensors.joint_noise)
    if sensors.joint_resolution:
        joints = np.round(joints / sensors.joint_resolution) * sensors.joint_resolution
    effort = noisy(torque[late("effort")], sensors.effort_noise * rms(torque))
    base = late("base")
    turned = Rotation.from_rotvec(noisy(np.zeros((len(base), 3)), sensors.orientation_noise))
    measured = BaseMotion(
        orientation=(turned * Rotation.from_quat(q[base, 3:7])).as_quat(),
        position=noisy(q[base, :3], sensors.position_noise),
        imu=imu() if sensors.imu else None,
    )
    wrenches = sensors.force_gain * motion.wrenches[late("contacts")]
    scale = sensors.force_noise * rms(wrenches)
    down = motion.down[late("contacts")]
    if sensors.flag_threshold > 0.0 and not held:
        down = wrenches[:, :, 2] > sensors.flag_threshold
    touched = noisy(wrenches, scale) if sensors.forces else None
    contacts = Contacts(
        frames=(legs.robot.link_names[0],) if held else legs.frames,
        kind=("plane",) if held or legs.flat else ("point",),
        down=down,
        forces=None if held or legs.flat or touched is None else touched[:, :, :3],
        wrenches=touched if held or legs.flat else None,
        offset=np.array([0.0, 0.0, 0.0 if held else -legs.radius]),
    )
    return Recording(
        time=time[kept],
        position=joints,
        effort=effort,
        joint_names=legs.robot.joint_names[6:],
        base=measured,
        contacts=contacts,
    )
