"""The published excitations of a UR10e break their own limits: by as much as a dense grid says."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.experiment.trajectory.curve import Curve
from sdpid.experiment.trajectory.fourier import FourierSeries
from sdpid.experiment.trajectory.sampled import SampledCurve


@dataclass(frozen=True, eq=False)
class Sum:
    """The sum of two curves of the same duration."""

    first: Curve
    second: Curve

    @property
    def n(self) -> int:
        return self.first.n

    @property
    def duration(self) -> float:
        return self.first.duration

    @property
    def breaks(self) -> Array:
        return np.union1d(self.first.breaks, self.second.breaks)

    def evaluate(self, time: Any, *, derivative: int = 0) -> Array:
        parts = self.first, self.second
        return np.asarray(sum(part.evaluate(time, derivative=derivative) for part in parts))

    def enclose(self, edges: Any, *, derivative: int = 0) -> tuple[Array, Array]:
        bounds = [part.enclose(edges, derivative=derivative) for part in (self.first, self.second)]
        return bounds[0][0] + bounds[1][0], bounds[0][1] + bounds[1][1]


def published(path: Path) -> tuple[Sum, sdpid.Limits]:
    """Return a motion of the data, a Fourier series and a polynomial, and its limits."""
    from scipy.io import loadmat

    data = loadmat(path, squeeze_me=True)
    given = {
        key: np.asarray(data["traj_par"][key].item(), dtype=np.float64)
        for key in ("T", "q_min", "q_max", "qd_max", "q2d_max")
    }
    a, b, T = data["a"], data["b"], float(given["T"])
    harmonics = np.tile(np.arange(1, a.shape[1] + 1), (6, 1))
    series = FourierSeries(
        period=T,
        center=np.zeros(6),
        harmonics=harmonics,
        amplitudes=np.hypot(a, b) / (2.0 * np.pi * harmonics / T),
        phases=np.arctan2(-b, a),
    )
    # A quintic is that which has its states at both ends.
    ends = np.array([0.0, T])
    powers = np.polynomial.polynomial
    states = [powers.polyval(ends, powers.polyder(data["c_pol"].T, k)).T for k in range(3)]
    quintic = SampledCurve(
        time=ends, position=states[0], velocity=states[1], acceleration=states[2]
    )
    limits = sdpid.Limits(
        lower=given["q_min"].tolist(),
        upper=given["q_max"].tolist(),
        velocity=given["qd_max"].tolist(),
        acceleration=given["q2d_max"].tolist(),
        override=True,
    )
    return Sum(series, quintic), limits


# Position, rad beyond the limit, and share of the limit of acceleration, as the data's README says.
@pytest.mark.parametrize(
    ("name", "beyond", "share"),
    [
        ("N5T20QR", 0.0007, 0.99),
        ("N7T25QR", 0.005, 1.004),
        ("N8T20QR", 0.027, 1.02),
        ("N10T20QR", 0.028, 1.14),
        ("N12T20QR", 0.019, 1.21),
        ("ga_N7T25", 0.025, 1.04),
    ],
)
def test_broken_limits_are_named(data_folder: Path, name: str, beyond: float, share: float) -> None:
    folder = data_folder / "ur10e_innopolis"
    (path,) = folder.glob(f"optimal_trajectories/*{name}*.mat")
    robot = sdpid.load_robot(folder / "ur10e.urdf")
    curve, limits = published(path)
    check = sdpid.check_trajectory(robot, curve, limits, collision=False)
    excess = max(row.excess for row in check.rows if row.kind == "position")
    assert excess == pytest.approx(beyond, rel=0.1, abs=6e-4)
    rows = [row for row in check.rows if row.kind == "acceleration"]
    assert max(row.reached / row.limit for row in rows) == pytest.approx(share, abs=6e-3)
    assert {row.verdict for row in check.rows} <= {"held", "broken"}
    time = np.linspace(0.0, curve.duration, 20_001)
    for order, kind in enumerate(("velocity", "acceleration"), 1):
        dense = np.abs(curve.evaluate(time, derivative=order)).max(axis=0)
        worst = [row.worst for row in check.rows if row.kind == kind]
        assert np.all(dense <= np.array(worst) * (1.0 + 1e-9))
