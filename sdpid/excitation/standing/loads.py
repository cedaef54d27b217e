"""What a planned motion asks of motors and feet: torques, and forces of the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.standing.stance import Stance, StanceStates

# Moments on a sole count as forces at this share of its width: half of the half width.
_LEVER = 0.25


@dataclass(frozen=True, eq=False)
class Loads:
    """Torques and forces of the ground along a motion.

    Attributes
    ----------
    torque : ndarray, shape (K, joints)
        Torques of the joints without friction, N·m.
    wrenches : ndarray, shape (K, c, 3) or (K, c, 6)
        Forces on the robot at balls, or forces and moments about soles' frames; world axes.
    """

    torque: Array
    wrenches: Array


def loads(stance: Stance, bodies: Array, states: StanceStates, grip: float) -> Loads:
    """Return the torques and forces of a motion.

    Of the forces that carry the motion those are taken whose weighted sum of squares is least:
    forces along the ground count as normal forces of theirs over `grip`. A controller that asks
    for these torques gets these forces, and they are centered in the friction cones.

    Parameters
    ----------
    stance : Stance
        The robot on its feet.
    bodies : ndarray, shape (links, 10)
        The bodies that a controller believes.
    states : StanceStates
        K states.
    grip : float
        Coefficient of friction.
    """
    poses = states.poses
    effort = stance.robot.efforts_of_bodies(
        bodies, poses.configuration, states.velocity, states.acceleration
    )
    rows = 6 if stance.legs.flat else 3
    J = stance.at_contacts(poses.jacobians)[:, :, :rows]
    k, c = J.shape[:2]
    size = np.array([grip, grip, 1.0])
    if stance.legs.sole is not None:
        lever = _LEVER * float((stance.legs.sole[1] - stance.legs.sole[0]).min())
        size = np.concatenate([size, lever * np.array([1.0, 1.0, grip])])
    scaled = (J * size[:, None]).reshape(k, c * rows, -1)
    A = scaled[:, :, :6]
    shares = np.linalg.solve(np.swapaxes(A, 1, 2) @ A, effort[:, :6, None])
    force = A @ shares
    torque = effort[:, 6:] - (np.swapaxes(scaled, 1, 2)[:, 6:] @ force)[:, :, 0]
    return Loads(torque, force.reshape(k, c, rows) * size)
