"""What a base's orientation says of its turning, and what speaks for and against it."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.recording.floating.base import BaseMotion
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.contacts.jacobians import frame_places
from sdpid.robot.model.model import RobotModel

# Rows at which places of feet are looked at.
_ROWS = 200
# Rates below this (rad/s, rms) are noise of the orientation.
LEAST_RATE = 0.05
GRAVITY = 9.80665
# Means over this time (s) make rates of noisy orientations comparable.
WINDOW = 0.02


def window_steps(step: float) -> int:
    """Return the samples of a window."""
    return max(1, round(WINDOW / step))


def readings(base: BaseMotion) -> dict[str, Array]:
    """Return quaternions x, y, z, w by how they may have been meant."""
    found = {"as given": np.asarray(base.orientation)}
    found["in the order w x y z"] = np.roll(found["as given"], -1, axis=1)
    inverse = np.array([-1.0, -1.0, -1.0, 1.0])
    for name in ("as given", "in the order w x y z"):
        key = "the inverse" if name == "as given" else f"the inverse, {name}"
        found[key] = found[name] * inverse
    return found


def turn_rates(quaternions: Array, step: float) -> Array:
    """Return the mean angular velocity of each window in the base's axes, (windows, 3), rad/s."""
    from scipy.spatial.transform import Rotation

    width = window_steps(step)
    turns = Rotation.from_quat(quaternions[::width])
    rates: Array = (turns[:-1].inv() * turns[1:]).as_rotvec() / (width * step)
    return rates


def window_means(table: Array, step: float) -> Array:
    """Return the means over the windows of `turn_rates`, (windows, columns)."""
    width = window_steps(step)
    count = (len(table) - 1) // width
    sums = np.add.reduceat(np.asarray(table)[: count * width], np.arange(0, count * width, width))
    return np.asarray(sums / width)


def unexplained(measured: Array, wanted: Array) -> float:
    """Return the share of a signal's mean square that another one does not explain."""
    power = float(np.mean(measured**2))
    return float(np.mean((measured - wanted) ** 2)) / power if power > 0.0 else 0.0


def signed_axes() -> list[Array]:
    """Return the 48 matrices that exchange axes and turn signs, the unit matrix first."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            found.append(matrix)
    return found


def axes_in_words(matrix: Array) -> str:
    """Return which measured axis is which of the base: ``x, y, z are -y, x, z``."""
    names = []
    for row in matrix:
        axis = int(np.abs(row).argmax())
        names.append(f"{'-' if row[axis] < 0.0 else ''}{'xyz'[axis]}")
    return f"x, y, z are {', '.join(names)}"


def evidence(log: Recording, quaternions: Array, feet: Array | None) -> dict[str, float]:
    """Return how badly an orientation agrees with what else was measured; only what there is.

    ``"rates"`` is the share of the measured angular velocity that it leaves unexplained, ``"tilt"``
    the angle between the mean specific force and the world's upward axis, rad, ``"above"`` the
    share of feet that are down and above the base's origin, of all times. Feet are places in the
    base of those that are down (`feet_in_base`), one a row, with the row of the recording in front.
    """
    from scipy.spatial.transform import Rotation

    base, found = log.base, {}
    assert base is not None
    wanted = turn_rates(quaternions, log.step)
    sensed, force = base.sensed("gyroscope"), base.sensed("accelerometer")
    turned = base.angular_velocity
    if turned is not None and base.velocity_frame == "world":
        turned = Rotation.from_quat(quaternions).inv().apply(np.array(turned))
    means = [window_means(each, log.step) for each in (sensed, turned) if each is not None]
    # Of a base that hardly turns rates say nothing.
    turning = [each for each in means if np.sqrt(np.mean(each**2)) >= LEAST_RATE]
    if turning:
        found["rates"] = min(unexplained(each, wanted) for each in turning)
    if force is not None:
        mean = Rotation.from_quat(quaternions).apply(force).mean(axis=0)
        size = float(np.linalg.norm(mean))
        if size:  # Zeros point nowhere.
            found["tilt"] = float(np.arccos(np.clip(mean[2] / size, -1.0, 1.0)))
    if feet is not None:
        turns = Rotation.from_quat(quaternions[feet[:, 0].astype(np.intp)])
        found["above"] = float(np.mean(turns.apply(feet[:, 1:])[:, 2] > 0.0))
    return found


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
