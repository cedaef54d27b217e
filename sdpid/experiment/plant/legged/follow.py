"""A planned motion of a whole robot as what the plant follows."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
from sdpid.experiment.plant.legged.paths import LEAD, Plan
from sdpid.experiment.trajectory.whole_body import WholeBodyMotion
from sdpid.robot.legs.legs import Legs


def follow(legs: Legs, motion: WholeBodyMotion, duration: float | None) -> Plan:
    """Return the plan of a motion; the robot stands in its first pose for a while before.

    Parameters
    ----------
    legs : Legs
        The robot.
    motion : WholeBodyMotion
        What it shall do.
    duration : float, optional
        Seconds of it; by default all.

    Raises
    ------
    DataError
        When the motion is of other joints or feet, or shorter.
    """
    from scipy.interpolate import make_interp_spline
    from scipy.spatial.transform import Rotation

    joints, feet = legs.robot.joint_names[6:], legs.frames
    if motion.joint_names != joints or motion.frames != feet:
        raise DataError(
            f"motion: of {len(motion.joint_names)} joints and feet {', '.join(motion.frames)}; "
            f"'{legs.robot.name}' has {len(joints)} joints and feet {', '.join(feet)}, in this "
            "order."
        )
    length = motion.duration if duration is None else duration
    if not length <= motion.duration:
        raise DataError(f"duration: {length:g} s, the motion ends after {motion.duration:g} s.")
    turn = Rotation.from_quat(motion.base_orientation).as_rotvec()
    position, effort, place, turned = (
        make_interp_spline(motion.time, values, k=3)
        for values in (motion.position, motion.effort, motion.base_position, turn)
    )
    slope = position.derivative()

    def at(t: Array) -> Array:
        return np.clip(t - LEAD, 0.0, motion.duration)

    def wanted(t: Array) -> tuple[Array, Array]:
        return position(at(t)), slope(at(t)) * (t > LEAD)[:, None]

    def base(t: Array) -> tuple[Array, Array]:
        return place(at(t)), turned(at(t))

    def down(t: Array) -> Mask:
        return motion.down[np.minimum(np.searchsorted(motion.time, at(t)), len(motion.time) - 1)]

    return Plan(wanted, base, down, False, length, lambda t: np.asarray(effort(at(t))))
