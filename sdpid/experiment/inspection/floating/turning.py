"""How fast a base turns by its orientations, beside what was measured of it."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.recording.floating.base import BaseMotion

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
