"""Robots, logs, problems and results that many tests share, made once a process.

First those of random arms and of the arm of `runs`, then the files that the pages of the
documentation speak of: a six-axis arm and its logs.
"""

import atexit
import shutil
import tempfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.problem import Problem
from sdpid.robot.friction.term import FrictionTerm
from sdpid.workflow.result import Identification
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.data import FRICTION, flat_links, make_samples, random_theta
from tests.helpers.motions import sines
from tests.helpers.runs import arm, recorded

RATE = 100.0
SECONDS = 10.0
LOAD = 2.0
# N·m/A, of the logs of currents.
GAINS = (13.0, 12.0, 10.0, 10.5, 10.0, 10.5)
ASIDE = 0.2

# Of each joint: origin in m and rad in the parent's frame, and its limits.
_JOINTS = (
    ((0.0, 0.0, 0.16), (0.0, 0.0, 0.0), 2.8, 3.0, 150.0),
    ((0.0, 0.12, 0.0), (-np.pi / 2, 0.0, 0.0), 2.0, 3.0, 150.0),
    ((0.0, -0.42, -0.02), (0.0, 0.0, 0.0), 2.4, 3.0, 150.0),
    ((0.0, -0.38, 0.0), (0.0, 0.0, 0.0), 2.8, 3.5, 30.0),
    ((0.0, 0.0, 0.1), (np.pi / 2, 0.0, 0.0), 2.8, 3.5, 30.0),
    ((0.0, 0.0, 0.1), (-np.pi / 2, 0.0, 0.0), 2.8, 3.5, 30.0),
)
# Of each link: mass in kg, center of mass, and half the sides of a box of its inertia, m.
_LINKS = (
    (3.7, (0.0, 0.02, -0.02), (0.06, 0.06, 0.07)),
    (8.1, (0.0, -0.21, 0.11), (0.05, 0.22, 0.05)),
    (2.9, (0.0, -0.17, 0.02), (0.04, 0.2, 0.04)),
    (1.2, (0.0, 0.0, 0.02), (0.05, 0.05, 0.05)),
    (1.2, (0.0, 0.0, 0.02), (0.05, 0.05, 0.05)),
    (0.4, (0.0, 0.0, -0.03), (0.035, 0.035, 0.03)),
)
# Capsules are cylinders here: radius, length and center along y, m; none where links lie close.
_SHAPES = {1: (0.05, 0.36, -0.21), 2: (0.045, 0.3, -0.19)}
# Coulomb and viscous friction and offset of each joint.
_FRICTION = ((6.0, 9.0, 0.3), (7.0, 10.0, -0.2), (5.0, 7.0, 0.2), (1.5, 2.0, 0.1), (1.3, 1.8, 0.0),
             (1.0, 1.5, -0.1))  # fmt: skip
_NOISE = (0.5, 0.6, 0.4, 0.1, 0.1, 0.08)


def samples(
    robot: sdpid.RobotModel,
    seed: int = 0,
    *,
    flat: bool = False,
    friction: Iterable[str | FrictionTerm] = FRICTION,
    **fields: Any,
) -> tuple[sdpid.Samples, Array]:
    """Return samples at random states, and the parameters that made them.

    Flat links are single point masses: noise makes bodies of them that cannot exist.
    """
    rng = np.random.default_rng(seed)
    theta = random_theta(robot, rng, friction)
    if flat:
        theta[: 10 * robot.n_links] = flat_links(rng, robot.n_links).ravel()
    return make_samples(robot, theta, rng, friction=friction, **fields), theta


def problem(
    robot: sdpid.RobotModel,
    seed: int = 0,
    *,
    flat: bool = False,
    noise: float | Array = 0.0,
    count: int = 60,
    **options: Any,
) -> Problem:
    """Return the problem of samples at random states."""
    made, _ = samples(robot, seed, flat=flat, noise=noise, count=count)
    return sdpid.build_problem(robot, made, **options)


def gauss_markov(estimate: Any, **options: Any) -> Any:
    """Return the intervals in closed form of all base parameters."""
    names = estimate.problem.base.names
    return sdpid.confidence_intervals(estimate, method="gauss_markov", parameters=names, **options)


@cache
def result(seed: int = 1, validation: int | None = None, **options: Any) -> Identification:
    """Return what `identify` finds of the arm of `runs` by a log, without intervals."""
    others = {} if validation is None else {"validation": recorded(validation)}
    return sdpid.identify(arm(), recorded(seed), intervals=False, **others, **options)


@cache
def _written(seed: int, **options: Any) -> Path:
    made = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    (made / "arm.urdf").write_text(ARM_URDF, encoding="utf-8")
    recorded(seed).to_csv(made / "run.csv")
    found = sdpid.identify(made / "arm.urdf", made / "run.csv", intervals=False, **options)
    found.save(made / "results", figures=False)
    return made


def folder(target: Path, seed: int = 1, **options: Any) -> Path:
    """Return a folder that gets arm.urdf, run.csv and the results of `identify`, to be changed."""
    return Path(shutil.copytree(_written(seed, **options), target, dirs_exist_ok=True))


def arm_urdf(factors: Array) -> str:
    """Return the arm's description, its bodies' masses and inertias multiplied link by link."""
    parts = ['<robot name="arm">', '  <link name="base_link"/>']
    for k, ((mass, com, half), by) in enumerate(zip(_LINKS, factors, strict=True)):
        m = mass * by
        xx, yy, zz = (m / 3.0 * (sum(x * x for x in half) - half[axis] ** 2) for axis in range(3))
        parts.append(
            f'  <link name="link_{k + 1}">\n'
            f'    <inertial><origin xyz="{com[0]} {com[1]} {com[2]}"/><mass value="{m:.6g}"/>\n'
            f'      <inertia ixx="{xx:.6g}" ixy="0" ixz="0" iyy="{yy:.6g}" iyz="0" izz="{zz:.6g}"/>'
            "</inertial>"
        )
        if k in _SHAPES:
            radius, length, y = _SHAPES[k]
            shape = (
                f'<origin xyz="0 {y} {com[2]}" rpy="1.5707963267949 0 0"/>'
                f'<geometry><cylinder radius="{radius}" length="{length}"/></geometry>'
            )
            parts.append(f"    <visual>{shape}</visual>\n    <collision>{shape}</collision>")
        parts.append("  </link>")
    parts.append('  <link name="tool0"/>')
    for k, (xyz, rpy, angle, speed, torque) in enumerate(_JOINTS):
        parent = f"link_{k}" if k else "base_link"
        parts.append(
            f'  <joint name="joint_{k + 1}" type="revolute">\n'
            f'    <parent link="{parent}"/><child link="link_{k + 1}"/>\n'
            f'    <origin xyz="{xyz[0]} {xyz[1]} {xyz[2]}" rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/>'
            '<axis xyz="0 0 1"/>\n'
            f'    <limit lower="{-angle}" upper="{angle}" velocity="{speed}" effort="{torque}"/>\n'
            "  </joint>"
        )
    parts.append(
        '  <joint name="flange" type="fixed"><parent link="link_6"/><child link="tool0"/>'
        '<origin xyz="0 0 0.05"/></joint>\n</robot>\n'
    )
    return "\n".join(parts)


def arm_log(seed: int, load: float = 0.0, gains: tuple[float, ...] | None = None) -> str:
    """Return a log of the true arm as CSV; the motion and the noise depend on the seed.

    With gains, N·m/A, it holds currents in place of torques.
    """
    robot = sdpid.load_robot(arm_urdf(np.ones(len(_LINKS))))
    rng = np.random.default_rng(seed)
    t = np.arange(round(SECONDS * RATE)) / RATE
    w = 2.0 * np.pi * rng.uniform(0.05, 0.45, (5, robot.n))
    size = rng.uniform(0.15, 0.4, w.shape)
    q, v, a = sines(t, w, rng.uniform(0.0, 2.0 * np.pi, w.shape), size)
    theta = robot.prior.copy()
    # The load: a cube of 12 cm whose center stands 8 cm off the tool's frame; where it is to show
    # gains, also off the last axis.
    r, x, inertia = 0.05 + 0.08, ASIDE if gains else 0.0, load * 0.12**2 / 6.0
    Ixx, Iyy, Izz = (inertia + load * square for square in (r**2, r**2 + x**2, x**2))
    theta[-1] += [load, load * x, 0.0, load * r, Ixx, 0.0, Iyy, -load * r * x, 0.0, Izz]
    coulomb, viscous, offset = np.array(_FRICTION).T
    effort = robot.inverse_dynamics(theta, q, v, a)
    effort += coulomb * np.tanh(v / 0.01) + viscous * v + offset
    effort += np.array(_NOISE) * rng.standard_normal(q.shape)
    q = q + 2e-5 * rng.standard_normal(q.shape)
    what = "effort" if gains is None else "current"
    effort /= 1.0 if gains is None else np.array(gains)
    names = ["time", *(f"{name}_{k + 1}" for name in ("position", what) for k in range(robot.n))]
    rows = (",".join(f"{x:.6f}" for x in row) for row in np.column_stack([t, q, effort]))
    return "\n".join([",".join(names), *rows]) + "\n"


def write_world(folder: Path) -> None:
    """Write a description that is 15 % off, two logs, the first motion loaded, and currents."""
    files = {
        "arm.urdf": arm_urdf(np.array([1.15, 0.85, 1.15, 0.85, 1.15, 0.85])),
        "run.csv": arm_log(1),
        "other.csv": arm_log(2),
        "loaded.csv": arm_log(1, LOAD),
        "currents.csv": arm_log(1, 0.0, GAINS),
        "currents_loaded.csv": arm_log(1, LOAD, GAINS),
    }
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
