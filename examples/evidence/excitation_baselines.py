"""Motions that others have published, or that are drawn at random, and how they are scored.

The score is the unscaled condition number of the stacked regressor, and the log determinant of
W^T·W/K, on a grid of 0.01 s over the columns of the data's READMEs: base columns (with rotor
inertias where stated) from Pinocchio's regressor, and sign(v), v and 1 for each joint.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from dense_check import Reached, States, curve_states, joints_reached
from numpy.polynomial import polynomial
from scipy.io import loadmat

import sdpid
from sdpid._common.arrays import Array
from sdpid.experiment.trajectory.fourier import FourierSeries

# The grid of the score, Hz; states and tolerance by which independent columns are found.
SCORE_HZ, STATES, INDEPENDENT = 100.0, 600, 1e-6

# Random motions: harmonics of a joint, the grid on which they are scaled, and what of each limit
# is left for what happens between its instants.
HARMONICS, SCALING_HZ, LEFT = 10, 200.0, 0.99


@dataclass(frozen=True, kw_only=True, eq=False)
class Bounds:
    """Limits of every joint, (n,) each; infinite where there are none."""

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def of(cls, robot: sdpid.RobotModel, acceleration: float | Array = np.inf) -> Bounds:
        """Return the limits of a description, with one of acceleration."""
        lower, upper = robot.position_limits.T
        return cls(
            lower=lower,
            upper=upper,
            velocity=robot.velocity_limits,
            acceleration=np.full(robot.n, acceleration),
        )

    def reached(self, names: Sequence[str], states: States) -> list[Reached]:
        """Return what a motion reaches of these limits."""
        none = np.full(len(names), np.inf)
        return list(joints_reached(names, states, jerk=none, **vars(self)))


class Columns:
    """The columns over which motions of a robot are scored.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    rotors : bool
        Whether rotor inertias are among the parameters.
    friction : bool
        Whether sign(v), v and 1 of every joint are.
    """

    def __init__(self, robot: sdpid.RobotModel, *, rotors: bool, friction: bool) -> None:
        self.robot, self.rotors, self.friction = robot, rotors, friction
        rng = np.random.default_rng(0)
        position = rng.uniform(-3.0, 3.0, (STATES, robot.n))
        v, a = rng.standard_normal((2, STATES, robot.n))
        self.kept = _independent(self._inertial(position, v, a).reshape(STATES * robot.n, -1))

    @property
    def count(self) -> int:
        """Number of columns."""
        return len(self.kept) + (3 * self.robot.n if self.friction else 0)

    def _inertial(self, position: Array, v: Array, a: Array) -> Array:
        """Return the regressor of the links, and of the rotors, (K, n, p)."""
        model, gears = self.robot.pin_model, self.robot.expansion
        data = model.createData()
        states = zip(self.robot.configuration(position), v @ gears.T, a @ gears.T, strict=True)
        Y = np.array([pin.computeJointTorqueRegressor(model, data, *each) for each in states])
        Y = np.einsum("mn,kmp->knp", gears, Y)
        return np.concatenate([Y, _diagonals(a)], axis=2) if self.rotors else Y

    def matrix(self, states: States) -> Array:
        """Return the stacked regressor W, (K·n, columns)."""
        v = states.velocity
        W = self._inertial(states.position, v, states.acceleration)[:, :, self.kept]
        if self.friction:
            W = np.concatenate([W, *map(_diagonals, (np.sign(v), v, np.ones_like(v)))], axis=2)
        return W.reshape(-1, W.shape[2])

    def score(self, states: States) -> tuple[float, float]:
        """Return cond(W), unscaled, and log det(W^T·W/K)."""
        values = np.linalg.svd(self.matrix(states), compute_uv=False)
        log_det = 2.0 * float(np.sum(np.log(values))) - len(values) * np.log(len(states.time))
        return float(values[0] / values[-1]), log_det


def _diagonals(values: Array) -> Array:
    """Return diagonal matrices (K, n, n) of rows (K, n)."""
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]))


def _independent(W: Array) -> Array:
    """Return the columns that are independent of those before them."""
    kept: list[int] = []
    Q = np.zeros((len(W), 0))
    for j, length in enumerate(np.linalg.norm(W, axis=0)):
        column = W[:, j] / max(length, np.finfo(float).tiny)
        for _ in range(2):  # once more for rounding
            column = column - Q @ (Q.T @ column)
        rest = np.linalg.norm(column)
        if length > INDEPENDENT and rest > INDEPENDENT:
            kept.append(j)
            Q = np.column_stack([Q, column / rest])
    return np.array(kept)


@dataclass(frozen=True, eq=False)
class UrMotion:
    """An excitation of shamilmamedov/dynamic_calibration: Fourier series and a polynomial.

    `a`, `b` (6, N) are the cosine and sine coefficients of the velocity, `polynomial` (6, 6) those
    of 1, t, …, t⁵.
    """

    a: Array
    b: Array
    polynomial: Array
    duration: float
    bounds: Bounds

    @classmethod
    def read(cls, path: Path) -> UrMotion:
        """Read a ``.mat`` file with the limits that it was made for."""
        data = loadmat(path, squeeze_me=True)
        names = {
            "lower": "q_min",
            "upper": "q_max",
            "velocity": "qd_max",
            "acceleration": "q2d_max",
        }
        given = {
            name: np.asarray(data["traj_par"][key].item(), dtype=np.float64)
            for name, key in names.items()
        }
        duration = float(data["traj_par"]["T"].item())
        return cls(data["a"], data["b"], data["c_pol"].T, duration, Bounds(**given))

    def evaluate(self, time: Array, *, derivative: int = 0) -> Array:
        """Return a derivative of the positions, (K, 6)."""
        rate = 2.0 * np.pi / self.duration * np.arange(1, self.a.shape[1] + 1)
        # The velocity is the real part of (a - i·b)·exp(i·rate·t).
        waves = np.exp(1j * np.outer(time, rate)) * (1j * rate) ** (derivative - 1)
        of_time = polynomial.polyval(time, polynomial.polyder(self.polynomial, derivative)).T
        return np.asarray(np.real(waves @ (self.a - 1j * self.b).T) + of_time)


def lwr_peer(path: Path) -> States:
    """Return the states of FloBaRoID's excitation, as published on its grid."""
    data = np.load(path)
    v, a = data["velocity"], data["acceleration"]
    return States(data["time"], data["position"], v, a, np.gradient(a, data["time"], axis=0))


def random_motion(bounds: Bounds, duration: float, rng: np.random.Generator) -> FourierSeries:
    """Draw a Fourier series that fills the first limit that each joint meets."""
    n = len(bounds.lower)
    harmonics = np.tile(np.arange(1, HARMONICS + 1), (n, 1))
    series = FourierSeries(
        period=duration,
        center=np.zeros(n),
        harmonics=harmonics,
        amplitudes=rng.standard_exponential(harmonics.shape) / harmonics ** rng.uniform(0.5, 1.5),
        phases=rng.uniform(0.0, 2.0 * np.pi, harmonics.shape),
    )
    states = [series.one_period(round(SCALING_HZ * duration), derivative=k) for k in range(3)]
    low, high = states[0].min(axis=0), states[0].max(axis=0)
    room = bounds.upper - bounds.lower
    peaks = [high - low, *(np.abs(values).max(axis=0) for values in states[1:])]
    limits = (room, bounds.velocity, bounds.acceleration)
    size = LEFT * np.min([limit / peak for limit, peak in zip(limits, peaks, strict=True)], axis=0)
    at = np.where(np.isfinite(room), bounds.lower - size * low, 0.0)
    free = np.where(np.isfinite(room), room - size * (high - low), 0.0)
    return FourierSeries(
        period=duration,
        center=at + free * rng.uniform(0.005, 0.995, n),
        harmonics=harmonics,
        amplitudes=series.amplitudes * size[:, None],
        phases=series.phases,
    )


def best_random(
    columns: Columns, bounds: Bounds, duration: float, seconds: float, seed: int = 0
) -> tuple[FourierSeries, int]:
    """Return the best random motion by cond(W) that is found in some time, and how many were."""
    rng = np.random.default_rng(seed)
    best, found, count = np.inf, None, 0
    end = time.perf_counter() + seconds
    while found is None or time.perf_counter() < end:
        series = random_motion(bounds, duration, rng)
        score, _ = columns.score(curve_states(series, duration, 10.0))
        count += 1
        if score < best:
            best, found = score, series
    return found, count
