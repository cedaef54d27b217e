"""Estimate every robot of example-robot-data from poor data, with default settings.

Every robot of example-robot-data, on a fixed and on a floating base, moves a little and slowly
about a random posture. Its true inertias are those of its description, repaired where they could
not exist and perturbed, with friction added and noise of 1 % of each joint's effort. The
parameters are estimated with the default prior; nothing is tuned to a robot.

    python examples/evidence/every_robot.py --out results
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from study import Rows, Study, grouped

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.prior.prior import repaired
from sdpid.robot.description.catalog import example_robots
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import from_pseudo_inertia, pseudo_inertia

QUICK = (
    "asr_twodof_description/TwoDofs",
    "finger_edu_description/finger_edu",
    "solo_description/solo",
    "so_arm_description/so101",
)

FRICTION = ("coulomb", "viscous")
SAMPLES, DURATION = 400, 20.0  # s
SLOWEST, FASTEST = 0.05, 0.3  # Hz
AMPLITUDE = 0.2  # rad, m of a floating base
SLIDE = 0.05  # m, of prismatic joints
SPREAD = 0.1  # of the entries that perturb a pseudo-inertia, which is of order one in its own units
NOISE = 0.01

# The six efforts of a floating base are known when nothing touches the robot, else hidden.
BASES = ("fixed base", "floating", "floating, base effort hidden")


def sinusoids(rng: np.random.Generator, amplitude: Array) -> tuple[Array, Array, Array]:
    """Return value, first and second derivative, (K, n) each, of one or two sines a column."""
    t = np.linspace(0.0, DURATION, SAMPLES)[:, None]
    out = np.zeros((3, SAMPLES, len(amplitude)))
    second = rng.random(len(amplitude)) < 0.5
    for share in (np.ones(len(amplitude)), 0.5 * second):
        w = 2.0 * np.pi * rng.uniform(SLOWEST, FASTEST, len(amplitude))
        phase = w * t + rng.uniform(0.0, 2.0 * np.pi, len(amplitude))
        size = share * amplitude
        out += size * np.sin(phase), size * w * np.cos(phase), -size * w**2 * np.sin(phase)
    return out[0], out[1], out[2]


def motion(robot: sdpid.RobotModel, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations about a random posture."""
    model = robot.pin_model
    sliding = {
        model.names[i]
        for i in range(1, model.njoints)
        if model.joints[i].shortname().startswith("JointModelP")
    }
    amplitude = np.array([SLIDE if name in sliding else AMPLITUDE for name in robot.joint_names])
    limits = np.clip(robot.position_limits, -np.pi, np.pi)
    center = rng.uniform(limits.min(axis=1), limits.max(axis=1))
    x, v, a = sinusoids(rng, amplitude)
    x += center
    if not robot.free_flyer:
        return x, v, a
    quaternion, v[:, :6], a[:, :6] = floating(x[:, :6], v[:, :6], a[:, :6])
    q = np.empty((len(x), model.nq))
    q[:, :3], q[:, 3:7] = x[:, :3], quaternion
    angles = x @ robot.expansion.T
    for joint in list(model.joints)[2:]:
        angle = angles[:, joint.idx_v]
        if joint.nq == 2:
            q[:, joint.idx_q], q[:, joint.idx_q + 1] = np.cos(angle), np.sin(angle)
        else:
            q[:, joint.idx_q] = angle
    return q, v, a


def floating(x: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
    """Return quaternions, and body velocities and accelerations, of x y z roll pitch yaw."""
    turn = Rotation.from_euler("ZYX", x[:, :2:-1])
    (c, b, _), (dc, db, da), (ddc, ddb, dda) = x[:, 3:].T, v[:, 3:].T, a[:, 3:].T
    sb, cb, sc, cc = np.sin(b), np.cos(b), np.sin(c), np.cos(c)
    spin = np.column_stack((dc - da * sb, db * cc + da * cb * sc, da * cb * cc - db * sc))
    rate = np.column_stack(
        (
            ddc - dda * sb - da * db * cb,
            ddb * cc - db * dc * sc + dda * cb * sc + da * (dc * cb * cc - db * sb * sc),
            dda * cb * cc - da * (db * sb * cc + dc * cb * sc) - ddb * sc - db * dc * cc,
        )
    )
    linear = turn.inv().apply(v[:, :3])
    # Pinocchio's acceleration is the rate of the velocity's own coordinates in the body.
    change = turn.inv().apply(a[:, :3]) - np.cross(spin, linear)
    return turn.as_quat(), np.hstack((linear, spin)), np.hstack((change, rate))


def true_bodies(robot: sdpid.RobotModel, rng: np.random.Generator) -> Array:
    """Return the description's inertias, repaired and then perturbed, shape (links, 10)."""
    bodies = repaired(robot.prior)[0]
    for i in np.flatnonzero(bodies[:, 0] > 0.0):
        L = np.linalg.cholesky(pseudo_inertia(bodies[i]))
        L = L @ (np.eye(4) + SPREAD * rng.standard_normal((4, 4)))
        bodies[i] = from_pseudo_inertia(L @ L.T)
    return bodies


def measure(robot: sdpid.RobotModel, base: str, seed: int) -> sdpid.Samples:
    """Return samples of a robot that moves a little."""
    rng = np.random.default_rng(seed)
    q, v, a = motion(robot, rng)
    effort = robot.inverse_dynamics(true_bodies(robot, rng), q, v, a)
    columns = FrictionModel.from_terms(FRICTION, robot.joint_names, first=robot.n_base).columns(
        v, a
    )
    rms = np.sqrt(np.mean(effort**2, axis=0))
    rms = np.maximum(rms, 1e-3 * rms.max())
    # Each friction term takes 2 to 15 % of its joint's effort.
    size = np.sqrt(np.mean(columns**2, axis=0))
    joint = size.argmax(axis=0)
    friction = rng.uniform(0.02, 0.15, len(joint)) * rms[joint] / size.max(axis=0, initial=1e-9)
    effort = effort + columns @ friction
    effort = effort + NOISE * rms * rng.standard_normal(effort.shape)
    mask = np.ones(effort.shape, dtype=bool)
    mask[:, : robot.n_base] = base == "floating"
    return sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort, mask=mask)


def proven(robot: sdpid.RobotModel, samples: sdpid.Samples) -> tuple[str, float | None]:
    """Estimate with default settings and the default prior; return what came of it, and the gap."""
    try:
        problem = sdpid.build_problem(
            robot,
            samples,
            friction=FRICTION,
            weighting="residual",
            constraints=sdpid.Constraints.of_size(robot),
            prior=sdpid.Prior(),
        )
        certificate = sdpid.certify(sdpid.solve_sdp(problem))
    except sdpid.errors.SdpidError as error:
        return SHORT.get(type(error).__name__, type(error).__name__), None
    return "certified" if certificate.passed else "not certified", certificate.gap


def rows(seed: int, name: str, base: str) -> Rows:
    """Yield what comes of a robot on a base."""
    try:
        robot = sdpid.load_robot(name, root=None if base == BASES[0] else "free_flyer")
    except sdpid.errors.ModelError:
        yield None, "cannot be loaded", None
        return
    if base != BASES[-1] or robot.n > robot.n_base:  # a rigid body with nothing measured
        yield robot.n, *proven(robot, measure(robot, base, seed))


# How an error reads in the table.
SHORT = {"IdentifiabilityError": "not identifiable", "SolverError": "no proof"}


def shown(found: Sequence[dict[str, Any]]) -> Rows:
    """Yield a line a robot: the proven gap, or what happened, by base."""
    for (name,), own in grouped(found, "robot"):
        joints = next((each for each in own["joints"] if each is not None), "")
        kinds = zip(own["base"], own["status"], own["gap"], strict=True)
        cells = {
            base: f"{max(gap, 0.0):.0e}" if status == "certified" else status
            for base, status, gap in kinds
        }
        yield name, joints, *(cells.get(base, "–") for base in BASES)


def main() -> None:
    """Run every robot and write the table."""
    study = Study(
        __doc__,
        quick={"robots": [*QUICK]},
        robots=([*example_robots()], "those of example-robot-data"),
        seed=0,
    )
    header = ("robot", "base", "joints", "status", "gap")
    rows_of = partial(rows, study.seed)
    found = study.rows("every_robot.csv", header, rows_of, study.robots, BASES)
    study.write("gaps.csv", ("robot", "joints", *BASES), shown(found))


if __name__ == "__main__":
    main()
