"""Trajectories of every kind that a plan may have."""

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.trajectory.curve import Spline
from sdpid.experiment.trajectory.fourier import FourierSeries
from sdpid.experiment.trajectory.trajectory import Trajectory


def spline_motion(
    joint_names: tuple[str, ...],
    seed: int = 0,
    *,
    duration: float = 4.0,
    closed: bool = True,
    size: float = 0.5,
    rate_hz: float = 200.0,
    periods: int = 1,
    rest: float = 0.0,
) -> Trajectory:
    """Return a random spline that starts and ends at rest."""
    n = len(joint_names)
    free = size * np.random.default_rng(seed).standard_normal((8, n))
    return Trajectory(
        joint_names=joint_names,
        series=Spline.from_free(free, duration, closed=closed),
        rate_hz=rate_hz,
        periods=periods,
        rest=rest,
        connection=0.0,
        position_range=np.tile([-np.pi, np.pi], (n, 1)),
        velocity_limit=np.full(n, 8.0),
    )


def fourier_motion(joint_names: tuple[str, ...], seed: int = 0, *, periods: int = 2) -> Trajectory:
    """Return a random Fourier series, with connections and rests."""
    n, rng = len(joint_names), np.random.default_rng(seed)
    series = FourierSeries(
        period=5.0,
        center=0.1 * rng.standard_normal(n),
        harmonics=np.tile([1, 2, 4], (n, 1)),
        amplitudes=0.2 * rng.standard_normal((n, 3)),
        phases=rng.uniform(0.0, 6.0, (n, 3)),
    )
    return Trajectory(
        joint_names=joint_names,
        series=series,
        rate_hz=100.0,
        periods=periods,
        rest=0.5,
        connection=1.0,
        position_range=np.tile([-np.pi, np.pi], (n, 1)),
        velocity_limit=np.full(n, 8.0),
    )


def sines(
    time: Array, rates: Array, phases: Array, size: float | Array = 1.0
) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations (K, n) of sums of sines, each (S, n)."""
    angle = rates * time[:, None, None] + phases
    q, v = (size * np.sin(angle)).sum(axis=1), (size * rates * np.cos(angle)).sum(axis=1)
    return q, v, -(size * rates**2 * np.sin(angle)).sum(axis=1)


def slow_motion(count: int, rate_hz: float = 25.0) -> tuple[Array, Array, Array]:
    """Return states (count, 2) of a slow motion of two joints that does not repeat itself."""
    time = np.arange(count) / rate_hz
    omega = np.array([[0.9, 1.3], [2.1, 3.1], [4.3, 3.7]])
    waves = np.exp(1j * (time[:, None, None] * omega + [0.3, 1.2]))
    q, v, a = (np.real(waves * (1j * omega) ** k / omega).sum(axis=1) for k in range(3))
    return q, v, a
