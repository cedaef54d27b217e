"""What sensors make of a motion: noise, resolution, thresholds and delays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.errors import DataError
from sdpid.experiment.plant.legged.truth import TrueMotion
from sdpid.experiment.recording.floating import BaseMotion, Contacts, Imu
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.legs import Legs

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
    >>> from sdpid.experiment.plant.legged.sensors import Sensors
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
    gravity: Array,
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

    q, torque = motion.position, sensors.effort_gain * motion.effort[:, 6:]
    joints = noisy(q[late("joints"), 7:], sensors.joint_noise)
    if sensors.joint_resolution:
        joints = np.round(joints / sensors.joint_resolution) * sensors.joint_resolution
    effort = noisy(torque[late("effort")], sensors.effort_noise * _rms(torque))
    base = late("base")
    turned = Rotation.from_rotvec(noisy(np.zeros((len(base), 3)), sensors.orientation_noise))
    measured = BaseMotion(
        orientation=(turned * Rotation.from_quat(q[base, 3:7])).as_quat(),
        position=noisy(q[base, :3], sensors.position_noise),
        imu=_imu(motion, late("imu"), sensors, gravity, noisy) if sensors.imu else None,
    )
    wrenches = sensors.force_gain * motion.wrenches[late("contacts")]
    scale = sensors.force_noise * _rms(wrenches)
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


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _imu(
    motion: TrueMotion,
    rows: Indices,
    sensors: Sensors,
    gravity: Array,
    noisy: Callable[[Array, float], Array],
) -> Imu:
    """Return what an inertial sensor off the base's origin measures."""
    from scipy.spatial.transform import Rotation

    velocity, acceleration = motion.velocity[rows], motion.acceleration[rows]
    turning, spinning = velocity[:, 3:6], acceleration[:, 3:6]
    arm = np.array(sensors.imu_translation)
    axes = Rotation.from_rotvec(sensors.imu_rotation)
    up = Rotation.from_quat(motion.position[rows, 3:7]).inv().apply(-gravity)
    # From components of the velocity in turning axes to the acceleration of the origin.
    origin = acceleration[:, :3] + np.cross(turning, velocity[:, :3])
    force = origin + np.cross(spinning, arm) + np.cross(turning, np.cross(turning, arm)) + up
    return Imu(
        gyroscope=noisy(axes.inv().apply(turning), sensors.gyroscope_noise),
        accelerometer=noisy(axes.inv().apply(force), sensors.accelerometer_noise),
        translation=arm,
        rotation=axes.as_matrix(),
    )
