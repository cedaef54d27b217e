"""The motion of a plan as a table of samples."""

from __future__ import annotations

import os

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Table
from sdpid.experiment.trajectory.trajectory import Trajectory


def whole_motion(trajectory: Trajectory) -> tuple[Array, Array]:
    """Return a whole trajectory sample by sample, its last instant included.

    Parameters
    ----------
    trajectory : Trajectory
        Sampled at its own rate.

    Returns
    -------
    time : ndarray, shape (K,)
        From zero to the end, s.
    states : ndarray, shape (3, K, n)
        Positions, velocities and accelerations, rad (m where a joint slides) and s.
    """
    _, last = trajectory.curves()[-1]
    end = np.array([last.duration])
    ends = [last.evaluate(end, derivative=order) for order in range(3)]
    states = np.concatenate([np.stack(trajectory.sample()), np.stack(ends)], axis=1)
    return np.arange(trajectory.n_samples + 1) / trajectory.rate_hz, states


def motion_columns(trajectory: Trajectory) -> dict[str, Array]:
    """Return time, positions, velocities and accelerations of a whole trajectory, by column.

    Parameters
    ----------
    trajectory : Trajectory
        Sampled at its own rate, its last instant included.

    Returns
    -------
    dict of str to ndarray, shape (K,)
        ``time`` in s from zero, and ``position_<joint>``, ``velocity_<joint>`` and
        ``acceleration_<joint>`` in rad (m where a joint slides) and s, quantity by quantity.
    """
    time, states = whole_motion(trajectory)
    columns = {"time": time}
    quantities = ("position", "velocity", "acceleration")
    for quantity, values in zip(quantities, states, strict=True):
        for name, column in zip(trajectory.joint_names, values.T, strict=True):
            columns[f"{quantity}_{name}"] = column
    return columns


def write_motion_csv(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write the columns of `motion_columns` as CSV with all digits."""
    Table.of_columns({k: v.tolist() for k, v in motion_columns(trajectory).items()}).write(path)
