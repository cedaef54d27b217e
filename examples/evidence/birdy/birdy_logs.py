"""Logs of the benchmark's closed loop: a controller at 5 kHz that differentiates noisy encoders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from birdy_robots import Benchmark

import sdpid
from sdpid._common.arrays import Array
from sdpid.robot.model.dynamics import RobotDynamics

# Where the encoders' noise goes: through the controller into the motion, as in the benchmark, or
# into the log only.
NOISES = ("fed_back", "sensor_only")

# Samples that are cut off at either end of the log, once it is filtered.
CUT = 50


@dataclass(frozen=True, eq=False)
class Motion:
    """A desired motion and what the true robot makes of it without noise, at the log's rate.

    Attributes
    ----------
    wanted : ndarray, shape (3, N, 6)
        Desired positions, velocities and accelerations.
    position, effort : ndarray, shape (N, 6)
        Of the true robot without noise.
    """

    wanted: Array
    position: Array
    effort: Array

    @classmethod
    def of(cls, benchmark: Benchmark, wanted: Array) -> Motion:
        """Simulate the true robot."""
        position, effort = simulated(benchmark, benchmark.model(benchmark.theta), wanted)
        return cls(wanted, position, effort)


def simulated(
    benchmark: Benchmark,
    model: RobotDynamics,
    wanted: Array,
    encoder: Array | None = None,
    rng: np.random.Generator | None = None,
) -> tuple[Array, Array]:
    """Return positions that encoders show and efforts, (N, 6), fewer where the motion diverges.

    The encoders' noise goes through the controller; without any it differentiates all the same.
    """
    found = sdpid.simulate_closed_loop(
        model,
        tuple(wanted),
        benchmark.controller,
        rate_hz=benchmark.sample_hz,
        control_hz=benchmark.rate_hz,
        position_noise=encoder,
        differenced=True,
        seed=0 if rng is None else rng,
    )
    return found.measured, found.effort


def log(benchmark: Benchmark, motion: Motion, level: str, noise: str, seed: int) -> sdpid.Recording:
    """Return the log of a run."""
    rng = np.random.default_rng([seed, 29])
    encoder, sensor = benchmark.noise(level)
    position, effort = motion.position, motion.effort
    if noise == "fed_back":
        model = benchmark.model(benchmark.theta)
        position, effort = simulated(benchmark, model, motion.wanted, encoder, rng)
    else:
        position = position + encoder * rng.standard_normal(position.shape)
    return sdpid.Recording(
        time=np.arange(len(position)) / benchmark.sample_hz,
        position=position,
        effort=effort + sensor * rng.standard_normal(effort.shape),
        joint_names=benchmark.robot.joint_names,
        reference=motion.wanted[0],
    )
