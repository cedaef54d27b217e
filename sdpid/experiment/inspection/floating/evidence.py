"""What speaks for and against an orientation of a base: rates, gravity, feet below it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.floating.turning import (
    turn_rates,
    unexplained,
    window_means,
)
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.contacts.jacobians import frame_places
from sdpid.robot.model.model import RobotModel

# Rows at which places of feet are looked at.
_ROWS = 200
# Rates below this (rad/s, rms) are noise of the orientation.
LEAST_RATE = 0.05


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """How well an orientation agrees with what else was measured; None where nothing was.

    Attributes
    ----------
    rates : float or None
        Share of the measured angular velocity that the orientation leaves unexplained.
    tilt : float or None
        Angle between the mean specific force and the world's upward axis, rad.
    above : float or None
        Share of the feet that are down and above the base's origin, of all times.
    """

    rates: float | None
    tilt: float | None
    above: float | None = None

    @classmethod
    def of(cls, log: Recording, quaternions: Array, feet: Array | None = None) -> Evidence:
        """Compare an orientation with gyroscope, angular velocity, accelerometer and feet.

        Feet are places in the base of those that are down (`feet_in_base`), one a row, with the
        row of the recording in front.
        """
        from scipy.spatial.transform import Rotation

        base = log.base
        assert base is not None
        wanted = turn_rates(quaternions, log.step)
        shares = []
        sensed, force = base.sensed("gyroscope"), base.sensed("accelerometer")
        if sensed is not None:
            shares.append(_rates(sensed, wanted, log.step))
        if base.angular_velocity is not None:
            turned = base.angular_velocity
            if base.velocity_frame == "world":
                turned = Rotation.from_quat(quaternions).inv().apply(np.array(turned))
            shares.append(_rates(turned, wanted, log.step))
        known = [share for share in shares if share is not None]
        tilt = None
        if force is not None:
            mean = Rotation.from_quat(quaternions).apply(force).mean(axis=0)
            size = float(np.linalg.norm(mean))
            # Zeros point nowhere.
            tilt = float(np.arccos(np.clip(mean[2] / size, -1.0, 1.0))) if size else None
        above = None
        if feet is not None:
            turns = Rotation.from_quat(quaternions[feet[:, 0].astype(np.intp)])
            above = float(np.mean(turns.apply(feet[:, 1:])[:, 2] > 0.0))
        return cls(rates=min(known) if known else None, tilt=tilt, above=above)


def feet_in_base(log: Recording, robot: RobotModel | None) -> Array | None:
    """Return rows of the recording and places (x, y, z) in the base of feet that are down."""
    contacts = log.contacts
    if robot is None or contacts is None or contacts.down is None or not robot.free_flyer:
        return None
    rows = np.unique(np.linspace(0, log.n_samples - 1, _ROWS).astype(np.intp))
    q = np.zeros((len(rows), robot.pin_model.nq))
    q[:, 6] = 1.0
    if q.shape[1] != 7 + log.n:
        return None
    q[:, 7:] = log.position[rows]
    down = contacts.down[rows]
    if not down.any():
        return None
    numbers = np.broadcast_to(rows[:, None], down.shape)[down]
    return np.column_stack([numbers, frame_places(robot, q, contacts.frames)[down]])


def _rates(measured: Array, wanted: Array, step: float) -> float | None:
    """Return the share that is unexplained, None where the base hardly turns."""
    means = window_means(measured, step)
    if np.sqrt(np.mean(means**2)) < LEAST_RATE:
        return None
    return unexplained(means, wanted)
