"""The motion of a plan as numbers: a table of samples, and the coefficients of its curves."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid._common.files import atomic_path, atomic_write_text
from sdpid._common.tables import Table, json_text
from sdpid.experiment.trajectory.fourier import FourierSeries
from sdpid.experiment.trajectory.trajectory import Trajectory

_FOURIER = "center + sum over h of amplitude_h * sin(2*pi*harmonic_h*t/period + phase_h)"
_SPLINE = "sum over i of control_point_i * B_i(t), B_i the B-splines of this degree on these knots"


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


def write_motion_parquet(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write the columns of `motion_columns` as Parquet (extra ``io``)."""
    pa = require("pyarrow", extra="io")
    table = pa.table(motion_columns(trajectory))
    with atomic_path(path) as temporary:
        require("pyarrow.parquet", extra="io").write_table(table, temporary, compression="zstd")


def write_coefficients(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write what a trajectory is made of as JSON, so that it can be evaluated anywhere."""
    lasting = {name: getattr(trajectory, name) for name in ("rest", "connection", "periods")}
    content = {
        "joint_names": trajectory.joint_names,
        **_coefficients(trajectory.series),
        **lasting,
        "rate_hz": trajectory.rate_hz,
    }
    atomic_write_text(Path(path), json_text(content) + "\n")


def _coefficients(curve: Any) -> dict[str, Any]:
    """Return the numbers of a curve, an entry a joint where they differ between joints."""
    if isinstance(curve, FourierSeries):
        names = ("period", "center", "harmonics", "amplitudes", "phases")
        return {"kind": "fourier", "formula": _FOURIER, **{n: getattr(curve, n) for n in names}}
    return {
        "kind": "b-spline",
        "formula": _SPLINE,
        "duration": curve.duration,
        "degree": curve.degree,
        "knots": curve.knots,
        "control_points": curve.control_points.T,
    }
