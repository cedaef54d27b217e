"""The benchmark's excitation: Fourier series that start at rest, by cond(W) + 100/σ_min."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
from birdy_robots import Benchmark

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import RowSource
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import structural_base

DURATION, HARMONICS = 10.0, 20

# Instants at which the criterion, the tip and torques are looked at.
INSTANTS = 200
# Part of the limits that a motion may use, and of a limit of torque, which noise needs too.
PART, TORQUE_PART = 0.95, 0.7
# Least height of the tip, m.
HEIGHT = 0.3

# Random motions at first, then changes of the best one.
DRAWN, CHANGED = 150, 450
# How much of the way to another motion a change goes: at first, and at least.
FIRST_STEP, LAST_STEP = 0.3, 0.03

# What a motion costs that breaks a limit, times by how much: more than any that does not.
REFUSED = 1e9


def motion(benchmark: Benchmark, number: int, cache: Path | None = None) -> Array:
    """Return desired positions, velocities and accelerations (3, N, 6) at the log's rate.

    Motions are kept in the folder `cache`, where one is given.
    """
    name = benchmark.robot.name.partition("_")[0]
    kept = cache / f"{name}_{number}.npy" if cache is not None else None
    if kept is not None and kept.is_file():
        coefficients = np.load(kept)
    else:
        coefficients = _searched(benchmark, np.random.default_rng([number, 4]))
        if kept is not None:
            kept.parent.mkdir(parents=True, exist_ok=True)
            np.save(kept, coefficients)
    time = np.arange(int(DURATION * benchmark.sample_hz)) / benchmark.sample_hz
    return evaluated(coefficients, time)


def evaluated(coefficients: Array, time: Array) -> Array:
    """Return positions, velocities and accelerations (3, K, 6).

    Coefficients (6, 1 + 2·HARMONICS): the middle, then cosines and sines of the velocity.
    """
    omega = _omega()
    phase = time[:, None] * omega
    sine, cosine = np.sin(phase), np.cos(phase)
    a, b = coefficients[:, 1 : 1 + HARMONICS].T, coefficients[:, 1 + HARMONICS :].T
    position = coefficients[:, 0] + sine @ (a / omega[:, None]) - cosine @ (b / omega[:, None])
    velocity = cosine @ a + sine @ b
    acceleration = cosine @ (b * omega[:, None]) - sine @ (a * omega[:, None])
    return np.stack([position, velocity, acceleration])


def _searched(benchmark: Benchmark, rng: np.random.Generator) -> Array:
    """Return the coefficients of the best motion found: random ones, then changes of the best."""
    # Without the coupling of the TX40, so that it moves alike with and without.
    terms = FrictionModel.from_terms(benchmark.friction[:3], benchmark.robot.joint_names)
    base = structural_base(benchmark.robot, terms)
    theta = benchmark.theta[: base.matrix.shape[1]]

    def cost(coefficients: Array) -> float:
        time = np.arange(INSTANTS) * (DURATION / INSTANTS)
        q, v, a = evaluated(coefficients, time)
        missing = HEIGHT - _lowest(benchmark.robot.pin_model, q)
        if missing > 0.0:
            return REFUSED * (1.0 + missing)
        still = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=0.0 * q)
        W = RowSource(benchmark.robot, terms, base, still).regressor(slice(None))
        if benchmark.torque is not None:
            effort = np.abs(W @ (base.matrix @ theta)).max(axis=0)
            beyond = float(np.max(effort / (TORQUE_PART * benchmark.torque)))
            if beyond > 1.0:
                return REFUSED * beyond
        singular = np.linalg.svd(W.reshape(-1, W.shape[-1]), compute_uv=False)
        return float(singular[0] / singular[-1] + 100.0 / singular[-1])

    drawn = [_drawn(benchmark, rng) for _ in range(DRAWN)]
    best = min(drawn, key=cost)
    score, step = cost(best), FIRST_STEP
    for _ in range(CHANGED):
        candidate = _within(benchmark, best + step * (_drawn(benchmark, rng) - best))
        found = cost(candidate)
        if found < score:
            best, score, step = candidate, found, min(FIRST_STEP, 1.5 * step)
        else:
            step = max(LAST_STEP, 0.97 * step)
    if score >= REFUSED:
        raise RuntimeError(f"no motion of {benchmark.robot.name} keeps its limits; draw more")
    return best


def _drawn(benchmark: Benchmark, rng: np.random.Generator) -> Array:
    """Return random coefficients within the limits: velocities or accelerations alike, or between.

    The velocities of all harmonics alike make fast motions, their accelerations wide ones.
    """
    n = benchmark.robot.n
    low, high = benchmark.position
    middle = rng.uniform(low + 0.3 * (high - low), high - 0.3 * (high - low))
    # Beyond every limit, and scaled into them; joints that move less help to keep the tip up.
    shape = 1e3 * rng.standard_normal((n, 2, HARMONICS)) / _omega() ** rng.uniform()
    full = _within(benchmark, np.column_stack([middle, shape.reshape(n, -1)]))
    full[:, 1:] *= rng.uniform(0.3, 1.0, n)[:, None]
    return full


def _within(benchmark: Benchmark, coefficients: Array) -> Array:
    """Return the motion at rest at the start, made smaller where it leaves the joints' limits."""
    omega = _omega()
    a, b = coefficients[:, 1 : 1 + HARMONICS], coefficients[:, 1 + HARMONICS :]
    # At rest: the sums of a (velocity) and of omega·b (acceleration) vanish.
    a = a - a.mean(axis=1, keepdims=True)
    b = b - (b @ omega)[:, None] * omega / (omega @ omega)
    shape = np.column_stack([np.zeros(len(a)), a, b])
    q, v, acceleration = evaluated(shape, np.arange(4 * INSTANTS) * (DURATION / (4 * INSTANTS)))
    low, high = benchmark.position
    allowed = PART * np.min(
        [
            (high - low) / np.ptp(q, axis=0),
            benchmark.velocity / np.abs(v).max(axis=0),
            benchmark.acceleration / np.abs(acceleration).max(axis=0),
        ],
        axis=0,
    )
    smaller = np.minimum(1.0, allowed)
    shape *= smaller[:, None]
    q = q * smaller
    edge = 0.25 * (1.0 - PART) * (high - low)
    shape[:, 0] = np.clip(
        coefficients[:, 0], low + edge - q.min(axis=0), high - edge - q.max(axis=0)
    )
    return shape


def _omega() -> Array:
    return 2.0 * math.pi / DURATION * np.arange(1, HARMONICS + 1)


def _lowest(model: pin.Model, positions: Array) -> float:
    """Return the least height of the last joint, m."""
    data = model.createData()
    heights = []
    for q in positions:
        pin.forwardKinematics(model, data, q)
        heights.append(data.oMi[model.njoints - 1].translation[2])
    return float(min(heights))
