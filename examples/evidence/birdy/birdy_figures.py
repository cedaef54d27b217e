"""Logs of the benchmark's closed loop, and its figures of merit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from birdy_robots import Benchmark

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import RowSource
from sdpid.robot.model.dynamics import RobotDynamics

# Torques are compared at about as many instants of the desired motion.
INSTANTS = 500

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
    """Return the log of a run.

    The encoders' noise goes through the controller into the motion, as in the benchmark (fed
    back), or into the log only.
    """
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


@dataclass(frozen=True, eq=False)
class Figures:
    """Figures of merit of base parameters on one desired motion.

    Attributes
    ----------
    benchmark : Benchmark
        The robot.
    motion : Motion
        The motion.
    W : ndarray, shape (…, 6, b)
        Regressor of the desired motion.
    """

    benchmark: Benchmark
    motion: Motion
    W: Array

    @classmethod
    def of(cls, benchmark: Benchmark, motion: Motion) -> Figures:
        """Compute the regressor."""
        q, v, a = motion.wanted[:, :: max(1, motion.wanted.shape[1] // INSTANTS)]
        samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=0.0 * q)
        rows = RowSource(benchmark.robot, benchmark.terms, benchmark.base, samples)
        return cls(benchmark, motion, rows.regressor(slice(None)))

    def parameters(self, base: Array) -> float:
        """Return ‖error‖ / ‖truth‖ of the base parameters in %."""
        truth = self.benchmark.truth
        return 100.0 * float(np.linalg.norm(base - truth) / np.linalg.norm(truth))

    def mean_of_parameters(self, base: Array) -> float:
        """Return the benchmark's mean relative error, 2·|error| / (|truth| + |found|), in %."""
        truth = self.benchmark.truth
        size = np.abs(truth) + np.abs(base)
        share = np.divide(np.abs(base - truth), size, out=np.zeros_like(size), where=size > 0.0)
        return 200.0 * float(np.mean(share))

    def torques(self, base: Array) -> float:
        """Return the mean over the instants of ‖error‖ / ‖torque‖ in %."""
        true = np.linalg.norm(self.W @ self.benchmark.truth, axis=1)
        missed = np.linalg.norm(self.W @ (base - self.benchmark.truth), axis=1)
        return 100.0 * float(np.mean(missed / true))

    def positions(self, base: Array, theta: Array | None) -> float | None:
        """Return the mean over the instants of ‖error‖ / ‖position‖ in %; None where it diverges.

        Of a continuous controller without noise, for the truth as well. Parameters that no bodies
        have do as well as any others of the same base parameters, as long as the mass matrix is
        positive definite.
        """
        if theta is None:
            B = self.benchmark.base.matrix
            theta = self.benchmark.theta + np.linalg.lstsq(B, base - self.benchmark.truth)[0]
        true, position = self._true_position, self._position(theta)
        if len(position) < len(true):
            return None
        size = np.linalg.norm(true, axis=1)
        return 100.0 * float(np.mean(np.linalg.norm(position - true, axis=1) / size))

    @cached_property
    def _true_position(self) -> Array:
        return self._position(self.benchmark.theta)

    def _position(self, theta: Array) -> Array:
        """Return simulated positions (N, 6), fewer where the motion diverges."""
        own = self.benchmark
        wanted = tuple(self.motion.wanted)
        return sdpid.simulate_closed_loop(
            own.model(theta), wanted, own.controller, rate_hz=own.sample_hz
        ).position
