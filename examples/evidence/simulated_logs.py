"""Simulate logs of robots whose every parameter is known: what an estimate is compared with.

A smooth motion that never repeats itself drives a robot whose inertias are those of its
description, perturbed consistently. The efforts are those of inverse dynamics at the exact states,
plus friction, offsets and noise; positions are measured by encoders. On request the base is
tilted, friction grows with load or falls with speed, and rotors add inertia. The same seed gives
the same log.

UR10, Panda and Denso come with the package's dependencies; the LWR 4+ is read from the folder
of docs/evidence/data.md, named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.problem import Problem
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.robot.consistent import raise_second_moments
from sdpid.robot.friction.term import smooth_sign
from sdpid.robot.inertia import from_pseudo_inertia, pseudo_inertia

ROBOTS = ("ur10", "panda", "lwr4", "denso")

# Second moments about the center of mass of every link, at least mass times the square of this
# (m): descriptions hold needles and points, which no robot has for links.
RADIUS = 0.02

# Sinusoids of a joint, and their frequencies, Hz.
SINUSOIDS, SLOWEST, FASTEST = 6, 0.04, 0.5
# Joints use this part of their range and of their speed limit, and never more than these
# (rad, rad/s, rad/s²).
PART, WIDEST, TOP_SPEED, TOP_ACCELERATION = 0.9, 2.0, 2.0, 8.0


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What a simulated log is like.

    Attributes
    ----------
    robot : str
        One of `ROBOTS`.
    rate_hz, duration : float
        Samples a second; length in s.
    perturbed : float
        Standard deviation of the logarithms by which pseudo-inertias differ from the
        description's; 0 for the description itself.
    width : float
        Width of the sign of Coulomb friction, rad/s; 0 is the exact sign.
    noise : float
        Standard deviation of the efforts' noise, as a share of each joint's usual effort.
    memory : float
        Time constant of that noise, s; 0 is white.
    quantum, encoder_noise : float
        Resolution of the encoders and standard deviation of their noise, rad.
    tilt_deg : float
        Angle between the base and the vertical, degrees; its direction is drawn.
    load : float
        Coulomb friction per N·m of the rigid body's effort.
    rotor : float
        Inertia of each rotor, as a share of the largest inertia that its joint moves.
    stribeck : float
        Friction at standstill beyond Coulomb friction, as a share of that.
    """

    robot: str
    rate_hz: float = 200.0
    duration: float = 40.0
    perturbed: float = 0.15
    width: float = 0.01
    noise: float = 0.01
    memory: float = 0.0
    quantum: float = 2.0**-19
    encoder_noise: float = 1e-6
    tilt_deg: float = 0.0
    load: float = 0.0
    rotor: float = 0.0
    stribeck: float = 0.0


def drawn(robot: str, seed: int) -> Conditions:
    """Return conditions drawn from the range of ordinary logs, without any special effect."""
    rng = np.random.default_rng([seed, ROBOTS.index(robot), 0])
    return Conditions(
        robot=robot,
        rate_hz=float(rng.choice([100.0, 125.0, 200.0, 250.0, 500.0, 1000.0])),
        duration=float(rng.uniform(25.0, 60.0)),
        width=float(rng.choice([0.0, 0.005, 0.01, 0.02, 0.05])),
        noise=float(np.exp(rng.uniform(*np.log([0.003, 0.02])))),
        memory=float(rng.choice([0.0, rng.uniform(0.002, 0.02)])),
        quantum=float(2.0 ** -rng.integers(17, 21)),
        encoder_noise=float(np.exp(rng.uniform(*np.log([1e-6, 1e-5])))),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """The parameters that a log was simulated with.

    Attributes
    ----------
    robot : RobotModel
        The robot as its user has it: the base upright, the description's inertias.
    conditions : Conditions
        What the log is like.
    inertias : ndarray, shape (links, 10)
        Inertial parameters of the links.
    coulomb, viscous, offset, rotor : ndarray, shape (n,)
        Coulomb friction (N·m), viscous friction (N·m·s/rad), offset (N·m) and rotor inertia
        (kg·m²).
    peak, peak_speed : ndarray, shape (n,)
        Friction at standstill beyond Coulomb friction (N·m), and the speed at which it has
        fallen to 1/e (rad/s).
    tilt : ndarray, shape (2,)
        Angles by which gravity is turned about the base's x and y axes, rad.
    noise : ndarray, shape (n,)
        Standard deviation of the efforts' noise, N·m.
    top_speed : ndarray, shape (n,)
        Largest speed of the motion, rad/s.
    """

    robot: sdpid.RobotModel
    conditions: Conditions
    inertias: Array
    coulomb: Array
    viscous: Array
    offset: Array
    rotor: Array
    peak: Array
    peak_speed: Array
    tilt: Array
    noise: Array
    top_speed: Array

    def friction(self, velocity: Array) -> Array:
        """Return friction without load and offset, N·m, at velocities (..., n) in rad/s."""
        falling = self.peak * np.exp(-((velocity / self.peak_speed) ** 2))
        sign = smooth_sign(velocity, self.conditions.width, 0.0)
        return np.asarray((self.coulomb + falling) * sign + self.viscous * velocity)

    def effort(self, q: Array, v: Array, a: Array) -> Array:
        """Return efforts without noise (K, n) at states (K, n)."""
        tilted = with_gravity(self.robot, turned(self.robot.gravity, self.tilt))
        rigid = tilted.inverse_dynamics(self.inertias, q, v, a)
        load = self.conditions.load * np.abs(rigid)
        sign = smooth_sign(v, self.conditions.width, 0.0)
        return np.asarray(rigid + self.friction(v) + load * sign + self.offset + self.rotor * a)

    def theta(self, problem: Problem) -> Array:
        """Return the parameters of a problem: NaN for those that the simulation does not have.

        Beside a term of the same shape, such as a sigmoid, Coulomb friction has no truth of its
        own: what counts is the curve (see `friction`).
        """
        known = {"Fs": self.coulomb, "Fv": self.viscous, "Fo": self.offset, "Ia": self.rotor}
        known["Fl"] = np.full(self.robot.n, self.conditions.load)
        symbols = [p.name.rstrip("0123456789") for p in problem.friction.parameters]
        if {"Fsg", "Fst"} & set(symbols):
            del known["Fs"]
        angles = dict(zip(("Gx", "Gy"), self.tilt, strict=True))
        tail = []
        for symbol, parameter in zip(symbols, problem.friction.parameters, strict=True):
            if symbol in known:
                tail.append(known[symbol][parameter.joint])
            elif symbol.endswith("_"):  # of a coupling of two joints
                tail.append(0.0)
            else:
                tail.append(angles.get(symbol, math.nan))
        return np.concatenate([self.inertias.ravel(), tail])


def described(robot: str) -> sdpid.RobotModel:
    """Return a robot as its user loads it."""
    if robot == "lwr4":
        path = Path(os.environ["SDPID_DATA"]) / "kuka_lwr4plus" / "kuka_lwr4.urdf"
        return sdpid.load_robot(path)
    if robot != "panda":
        return sdpid.load_robot({"ur10": "ur10_robot", "denso": "denso_vp6242"}[robot])
    whole = sdpid.load_robot("panda_description/panda").pin_model
    fingers = [i for i, name in enumerate(whole.names) if "finger" in name]
    arm = pin.buildReducedModel(whole, fingers, pin.neutral(whole))
    return sdpid.RobotModel.from_pinocchio(arm)


def with_gravity(robot: sdpid.RobotModel, gravity: Array) -> sdpid.RobotModel:
    """Return the robot in another direction of gravity."""
    return sdpid.RobotModel.from_pinocchio(robot.pin_model, gravity=gravity.tolist())


def log_of(conditions: Conditions, seed: int) -> tuple[sdpid.Recording, Truth]:
    """Simulate a log, and return it with the parameters behind it.

    Two seeds differ in the robot's parameters, its motion and its noise. `other_log` repeats the
    robot with another motion.
    """
    rng = np.random.default_rng([seed, ROBOTS.index(conditions.robot), 1])
    robot = described(conditions.robot)
    inertias = perturbed(_described_inertias(conditions.robot, robot), conditions.perturbed, rng)
    time, q, v, a = motion(robot, conditions, rng)
    rigid = robot.inverse_dynamics(inertias, q, v, a)
    rms = np.sqrt(np.mean(rigid**2, axis=0))
    # Wrists have friction out of proportion to what they carry.
    usual = np.sqrt(rms * rms.max())
    coulomb = rng.uniform(0.05, 0.2, robot.n) * usual
    viscous = rng.uniform(0.5, 1.5, robot.n) * coulomb
    offset = 0.3 * coulomb * rng.standard_normal(robot.n)
    moved = [np.diag(robot.mass_matrix(inertias, q[k])) for k in range(0, len(q), len(q) // 50)]
    heading = rng.uniform(0.0, 2.0 * math.pi)
    truth = Truth(
        robot=robot,
        conditions=conditions,
        inertias=inertias,
        coulomb=coulomb,
        viscous=viscous,
        offset=offset,
        rotor=conditions.rotor * np.max(moved, axis=0),
        peak=conditions.stribeck * coulomb,
        peak_speed=rng.uniform(0.05, 0.15, robot.n),
        tilt=math.radians(conditions.tilt_deg) * np.array([math.cos(heading), math.sin(heading)]),
        noise=conditions.noise * usual,
        top_speed=np.abs(v).max(axis=0),
    )
    return _measured(truth, time, q, v, a, rng), truth


def other_log(truth: Truth, seed: int) -> sdpid.Recording:
    """Simulate the same robot on another motion."""
    rng = np.random.default_rng([seed, ROBOTS.index(truth.conditions.robot), 2])
    return _measured(truth, *motion(truth.robot, truth.conditions, rng), rng)


def motion(
    robot: sdpid.RobotModel, conditions: Conditions, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array]:
    """Return times (K,), positions, velocities and accelerations (K, n) of a smooth motion.

    Every joint gets sinusoids whose frequencies have no common period, scaled to the first limit
    that is met; it starts and ends anywhere, in full motion.
    """
    n = robot.n
    time = np.arange(round(conditions.duration * conditions.rate_hz)) / conditions.rate_hz
    low, high = robot.position_limits.T
    limited = np.isfinite(low) & np.isfinite(high) & (high > low)
    low, high = np.where(limited, low, -WIDEST), np.where(limited, high, WIDEST)
    center, half = 0.5 * (low + high), np.minimum(PART * 0.5 * (high - low), WIDEST)
    speed = robot.velocity_limits
    speed = np.minimum(np.where(speed > 0.0, PART * speed, TOP_SPEED), TOP_SPEED)
    omega = 2.0 * math.pi * rng.uniform(SLOWEST, FASTEST, (SINUSOIDS, n))
    phase = rng.uniform(0.0, 2.0 * math.pi, (SINUSOIDS, n))
    amplitude = rng.uniform(0.3, 1.0, (SINUSOIDS, n)) / np.sqrt(omega)
    waves = np.exp(1j * (time[:, None, None] * omega + phase))
    series = [np.real(waves * amplitude * (1j * omega) ** k).sum(axis=1) for k in range(3)]
    peaks = [np.abs(each).max(axis=0) for each in series]
    limits = (half, speed * rng.uniform(0.6, 1.0, n), np.full(n, TOP_ACCELERATION))
    size = np.min([limit / peak for limit, peak in zip(limits, peaks, strict=True)], axis=0)
    q, v, a = (size * each for each in series)
    return time, center + q, v, a


def _measured(
    truth: Truth, time: Array, q: Array, v: Array, a: Array, rng: np.random.Generator
) -> sdpid.Recording:
    """Return what encoders and current sensors say of a motion."""
    conditions = truth.conditions
    memory = conditions.rate_hz * conditions.memory
    kept = math.exp(-1.0 / memory) if memory > 0.0 else 0.0
    effort = truth.effort(q, v, a) + truth.noise * colored(q.shape, kept, rng)
    seen = q + conditions.encoder_noise * rng.standard_normal(q.shape)
    return sdpid.Recording(
        time=time,
        position=np.round(seen / conditions.quantum) * conditions.quantum,
        effort=effort,
        joint_names=truth.robot.joint_names,
    )


def colored(shape: tuple[int, ...], kept: float, rng: np.random.Generator) -> Array:
    """Return noise of unit variance of which a share is kept from sample to sample."""
    white = rng.standard_normal(shape)
    white[1:] *= math.sqrt(1.0 - kept**2)
    return np.asarray(lfilter([1.0], [1.0, -kept], white, axis=0))


def _described_inertias(name: str, robot: sdpid.RobotModel) -> Array:
    """Return the inertias (links, 10) that a simulated robot is perturbed from."""
    bodies = np.array(robot.prior)
    if name == "denso":  # its description has none
        bodies = true_parameters("denso_vp6242")[: bodies.size].reshape(-1, 10)
    return np.asarray(raise_second_moments(bodies, RADIUS**2 * bodies[:, 0]))


def perturbed(bodies: Array, size: float, rng: np.random.Generator) -> Array:
    """Return bodies whose pseudo-inertias are L·exp(S)·L^T of P = L·L^T, S symmetric."""
    root = np.linalg.cholesky(pseudo_inertia(bodies))
    S = size * rng.standard_normal((len(bodies), 4, 4))
    S = 0.5 * (S + np.swapaxes(S, 1, 2))
    return from_pseudo_inertia(root @ expm(S) @ np.swapaxes(root, 1, 2))


def turned(gravity: Array, angles: Array) -> Array:
    """Return gravity turned by angles (2,) about the base's x and y axes, rad."""
    return np.asarray(Rotation.from_rotvec([*angles, 0.0]).apply(gravity))


def there() -> tuple[str, ...]:
    """Return the robots whose descriptions are there, and say which are not."""
    if "SDPID_DATA" in os.environ:
        return ROBOTS
    print("lwr4: skipped, SDPID_DATA is not set; docs/evidence/data.md says where it comes from")
    return tuple(name for name in ROBOTS if name != "lwr4")
