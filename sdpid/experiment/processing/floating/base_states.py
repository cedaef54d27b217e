"""Turn of a base, its angular velocity and accelerations, from an IMU, a twist or a pose.

The base's own velocity is never needed: seen from a frame that moves along with it at one instant,
all accelerations are the same (Galilei). In that frame it is zero, and the spatial acceleration of
Pinocchio is the classical one. What is filtered is the specific force (acceleration less gravity,
which is what an accelerometer measures) and the angular velocity, both in body axes.
"""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.processing.filters import Weights
from sdpid.experiment.processing.floating.on_grid import OnGrid
from sdpid.experiment.processing.floating.quieter import angle_noise, quieter, white_noise
from sdpid.experiment.processing.floating.rotations import body_rate, into_body, unit
from sdpid.experiment.processing.settings import BaseSource
from sdpid.experiment.recording.floating.base import BaseMotion


def base_states(
    base: BaseMotion, on_grid: OnGrid, gravity: Array, wanted: BaseSource = "auto"
) -> tuple[Array, Array, Array, str]:
    """Return the filtered states of a base at the kept samples, in body axes.

    Parameters
    ----------
    base : BaseMotion
        As it was recorded.
    on_grid : OnGrid
        Grid, filter and window.
    gravity : (3,) ndarray
        In world axes, m/s².
    wanted : {"auto", "imu", "twist", "pose"}
        What accelerations are from. ``"auto"`` takes the IMU where there is one, else what has the
        less noise of velocities and pose; the angular and the linear part each by itself.

    Returns
    -------
    (K, 7) ndarray
        Position in m, zero where it was not recorded; quaternion x, y, z, w, base to world.
    (K, 6) ndarray
        Velocity: linear, which is zero, and angular in rad/s.
    (K, 6) ndarray
        Acceleration: linear in m/s², angular in rad/s².
    str
        What they are from.

    Raises
    ------
    DataError
        When what is wanted was not recorded.
    """
    raw = unit(on_grid.read(base.orientation))
    orientation = unit(on_grid.filtered(raw))
    source, rate = _angular(base, on_grid, raw, wanted)
    linear_source, force = _specific_force(base, on_grid, orientation, rate, gravity, wanted)
    smooth_rate = on_grid.filtered(rate)
    acceleration = on_grid.filtered(force) + into_body(orientation, gravity)
    place = np.zeros((len(raw), 3))
    if base.position is not None:
        place = on_grid.filtered(on_grid.read(base.position))
    states = (
        np.hstack([place, orientation]),
        np.hstack([np.zeros_like(smooth_rate), smooth_rate]),
        np.hstack([acceleration, on_grid.rate(smooth_rate)]),
    )
    position, velocity, both = (on_grid.kept(each) for each in states)
    note = f"accelerations of the base: linear from {linear_source}, angular from {source}"
    return position, velocity, both, note


def _angular(
    base: BaseMotion, on_grid: OnGrid, raw: Array, wanted: BaseSource
) -> tuple[str, Array]:
    """Return the source and the angular velocity (M, 3) in body axes, not filtered."""
    imu = base.imu
    if wanted in ("auto", "imu") and imu is not None and imu.gyroscope is not None:
        return "the gyroscope", on_grid.read(imu.gyroscope) @ np.asarray(imu.rotation).T
    told = ""
    if wanted in ("auto", "imu", "twist") and base.angular_velocity is not None:
        rate = on_grid.read(base.angular_velocity)
        chosen = True
        if wanted != "twist":
            chosen, told = quieter(on_grid, rate, angle_noise(raw), "rad/s²")
        if chosen:
            if base.velocity_frame == "world":
                rate = into_body(raw, rate)
            return f"the recorded angular velocity{told}", rate
    if wanted == "twist":
        raise DataError(
            "base_motion: is 'twist', and the recording has no angular velocity of the base; use "
            "'pose' or 'auto'."
        )
    stencil = on_grid.chain.stencil
    assert isinstance(stencil, Weights)  # a record with a base has no periods
    return f"the orientation{told}", body_rate(raw, stencil.first, on_grid.grid.step)


def _specific_force(
    base: BaseMotion,
    on_grid: OnGrid,
    orientation: Array,
    rate: Array,
    gravity: Array,
    wanted: BaseSource,
) -> tuple[str, Array]:
    """Return the source and the specific force (M, 3) at the base's origin, not filtered."""
    imu = base.imu
    if wanted in ("auto", "imu") and imu is not None and imu.accelerometer is not None:
        lever = np.asarray(imu.translation)
        measured = on_grid.read(imu.accelerometer) @ np.asarray(imu.rotation).T
        turning = np.cross(rate, np.cross(rate, lever))
        return "the accelerometer", measured - np.cross(on_grid.rate(rate), lever) - turning
    if wanted == "imu":
        raise DataError(
            "base_motion: is 'imu', and the recording has no accelerometer; give base.imu, or use "
            "'twist', 'pose' or 'auto'."
        )
    told = ""
    if wanted in ("auto", "twist") and base.linear_velocity is not None:
        velocity = on_grid.read(base.linear_velocity)
        chosen = True
        if wanted == "auto" and base.position is not None:
            place = white_noise(on_grid.read(base.position))
            chosen, told = quieter(on_grid, velocity, place, "m/s²")
        if chosen:
            source = f"the recorded linear velocity{told}"
            if base.velocity_frame == "base":
                own = on_grid.rate(velocity) + np.cross(rate, velocity)
                return source, own - into_body(orientation, gravity)
            return source, into_body(orientation, on_grid.rate(velocity) - gravity)
    if wanted == "twist" or base.position is None:
        lacks = "linear velocity" if wanted == "twist" else "accelerometer, velocity or position"
        raise DataError(
            f"base_motion: is '{wanted}', and the recording has no {lacks} of the base; its linear "
            "acceleration is not known. Record one of them."
        )
    position = on_grid.read(base.position)
    return f"the position{told}", into_body(orientation, on_grid.second(position) - gravity)
