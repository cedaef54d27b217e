"""A surgical robot's master, with spring, cable and parallelogram, on a run that was held out.

    python examples/evidence/dvrk.py --train one.npz --test FILE --json
    python examples/evidence/dvrk.py --train one.npz --scs --out results

Errors are in percent of the effort without the cable's torque, of seven motors, over the first 2000
rows after 200, below 5.65 Hz. Terms are chosen on the training file alone, by blocks of time.
Kinematics and the cable are those of Wang et al., RA-L 4(4), 2019.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

import sdpid
from sdpid import friction as terms
from sdpid._common.tables import Table

# Joint, the joint it hangs on, and Khalil's a, alpha, d, theta at zero.
TABLE: tuple[tuple[str, str | None, float, float, float, float], ...] = (
    ("1", None, 0.0, 0.0, -0.2154, 0.0),
    ("2", "1", 0.0, -np.pi / 2, 0.0, np.pi / 2),
    ("3", "2", 0.2794, 0.0, 0.0, np.pi / 2),
    ("bar", "1", 0.0, -np.pi / 2, 0.0, np.pi),
    ("rod", "bar", 0.1, 0.0, 0.0, -np.pi / 2),
    ("4", "3", 0.3645, -np.pi / 2, 0.151, 0.0),
    ("5", "4", 0.0, np.pi / 2, 0.0, 0.0),
    ("6", "5", 0.0, -np.pi / 2, 0.0, np.pi / 2),
    ("7", "6", 0.0, -np.pi / 2, 0.0, np.pi),
)
# Joints by the motors that move them; the parallelogram's bars follow motors 2 and 3.
RATIO = 0.6697
MOVED: dict[str, dict[int, float]] = {
    "1": {1: 1.0},
    "2": {2: 1.0},
    "3": {2: -1.0, 3: 1.0},
    "bar": {3: 1.0},
    "rod": {2: 1.0, 3: -1.0},
    "4": {2: RATIO, 3: -RATIO, 4: 1.0},
    "5": {5: 1.0},
    "6": {6: 1.0},
    "7": {7: 1.0},
}
MOTORS = tuple(f"motor_{k}" for k in range(1, 8))
JOINTS = tuple(f"joint_{k}" for k in range(1, 8))
CABLE = (0.0004877, -0.0037149, 0.0067497, 0.008519, -0.0201475, -0.025265, 0.048095, 0.00255)
PROCESSING = {"cutoff_hz": 5.65, "order": 6, "decimation": 5, "velocity": "differentiated"}
LIMITS = sdpid.Constraints(mass_max=20.0, theta_max=20.0, friction_max=1e3)
# Width of signs, rad/s; ways after which elements of hysteresis slip, rad.
WIDTH, SLIPS = 0.1, (0.02, 0.05, 0.1, 0.2)
# A group of terms lowers the error on blocks of time that are left out by this share.
WORTH, BLOCKS = 0.01, 3
FIRST, COUNT = 200, 2000
# Seconds that SCS has; what is said of a solver.
PATIENCE, SOLVED = 600.0, ("solver", "seconds", "status", "gap", "violation")


def urdf() -> str:
    """Return the tree of joints without inertias."""
    parts = ['<robot name="dvrk_mtm"><link name="base"/>']
    for name, parent, a, alpha, d, theta in TABLE:
        x, z = (
            np.array(
                [[1, 0, 0], [0, np.cos(alpha), -np.sin(alpha)], [0, np.sin(alpha), np.cos(alpha)]]
            ),
            (
                np.array(
                    [
                        [np.cos(theta), -np.sin(theta), 0],
                        [np.sin(theta), np.cos(theta), 0],
                        [0, 0, 1],
                    ]
                )
            ),
        )
        place = np.array([a, 0.0, 0.0]) + x @ np.array([0.0, 0.0, d])
        R = x @ z
        pitch = np.arcsin(np.clip(-R[2, 0], -1.0, 1.0))
        if abs(R[2, 0]) < 1.0 - 1e-9:
            roll, yaw = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0])
        else:
            roll, yaw = np.arctan2(-R[1, 2], R[1, 1]), 0.0
        parts.append(
            f'<link name="link_{name}"/><joint name="joint_{name}" type="continuous">'
            f'<parent link="{"base" if parent is None else f"link_{parent}"}"/>'
            f'<child link="link_{name}"/><axis xyz="0 0 1"/>'
            f'<origin xyz="{place[0]} {place[1]} {place[2]}" rpy="{roll} {pitch} {yaw}"/></joint>'
        )
    return "".join([*parts, "</robot>"])


def load() -> sdpid.RobotModel:
    """Return the robot behind its transmission."""
    rows = {
        f"joint_{joint}": {f"motor_{k}": factor for k, factor in row.items()}
        for joint, row in MOVED.items()
    }
    return sdpid.load_robot(urdf(), transmission={"joints": rows})


def spring(q: np.ndarray) -> np.ndarray:
    """Return the lever of joint 5's spring, whose effort is stiffness times this."""
    r, h, rest, zero = 0.0075, 0.1035, 0.0613, np.radians(23.0)
    angle = np.pi + zero - q
    length = np.sqrt(r**2 + h**2 - 2.0 * r * h * np.cos(angle))
    return -(length - rest) * r * h * np.sin(angle) / length


def always() -> list[terms.FrictionTerm]:
    """Return the terms of the paper."""
    return [
        terms.AtJoints(terms.Coulomb(width=WIDTH), JOINTS),
        terms.AtJoints(terms.Viscous(), JOINTS),
        terms.AtJoints(terms.Offset(), JOINTS[1:]),
        terms.AtJoints(terms.RotorInertia(), MOTORS[3:4]),
        terms.PositionTerm(spring, "K", joint="joint_5", unit="N/m", nonnegative=True),
        terms.PositionTerm(cable, "cable", joint="joint_4", value=1.0),
    ]


def cable(q: np.ndarray) -> np.ndarray:
    """Return the torque of joint 4's cable."""
    return np.polyval(CABLE, q)


def powers(q: np.ndarray) -> np.ndarray:
    """Return powers of a position."""
    return np.stack([q, q**2, q**3], axis=1)


def groups() -> dict[str, terms.FrictionTerm]:
    """Return what may be chosen."""
    found: dict[str, terms.FrictionTerm] = {
        f"hysteresis of {joint}": terms.Hysteresis(joint, SLIPS) for joint in JOINTS
    }
    rod = terms.PositionTerm(powers, "rod", joint="joint_rod", count=3)
    return {**found, "angle of the rod": rod}


def percent(missed: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Return errors in percent of efforts, motor by motor."""
    return 100.0 * np.linalg.norm(missed, axis=0) / np.linalg.norm(effort, axis=0)


def left_out(robot: sdpid.RobotModel, samples: sdpid.Samples, friction: list[Any]) -> float:
    """Return the mean error on blocks of time that are left out."""
    ends = np.linspace(0, samples.n_samples, BLOCKS + 1).astype(int)
    found = []
    for low, high in pairwise(ends.tolist()):
        kept = [
            samples.between(*each)
            for each in ((0, low), (high, samples.n_samples))
            if each[1] > each[0]
        ]
        problem = sdpid.build_problem(
            robot,
            sdpid.Samples.join(kept),
            friction=friction,
            constraints=LIMITS,
            weighting="residual",
        )
        held = samples.between(low, high)
        missed = held.effort - problem.predict(sdpid.solve_wls(problem).base, held)
        found.append(percent(missed, held.effort).mean())
    return float(np.mean(found))


def upright(robot: sdpid.RobotModel, samples: sdpid.Samples) -> sdpid.RobotModel:
    """Return the robot under the gravity whose direction explains the samples best."""
    weights = 1.0 / samples.effort.std(axis=0)

    def tilted(x: np.ndarray) -> sdpid.RobotModel:
        direction = np.array([x[0], x[1], -1.0])
        return robot.with_gravity(9.81 * direction / np.linalg.norm(direction))

    def cost(x: np.ndarray) -> float:
        problem = sdpid.build_problem(
            tilted(x), samples, friction=always(), constraints=LIMITS, weighting="residual"
        )
        missed = samples.effort - problem.predict(sdpid.solve_wls(problem).base)
        return float(np.sum((missed * weights) ** 2))

    start = np.array([[0.0, 0.0], [0.03, 0.0], [0.0, 0.03]])
    options = {"initial_simplex": start, "xatol": 1e-3, "maxfev": 30}
    return tilted(minimize(cost, start[0], method="Nelder-Mead", options=options).x)


def chosen(
    robot: sdpid.RobotModel, samples: sdpid.Samples
) -> tuple[sdpid.RobotModel, list[Any], dict[str, float]]:
    """Return gravity and terms that blocks of time keep, and the errors that were compared."""
    friction = always()
    error = left_out(robot, samples, friction)
    errors = {"the paper's terms": error}
    free = upright(robot, samples)
    errors["direction of gravity"] = left_out(free, samples, friction)
    if errors["direction of gravity"] < (1.0 - WORTH) * error:
        robot, error = free, errors["direction of gravity"]
    for name, term in groups().items():
        errors[name] = left_out(robot, samples, [*friction, term])
        if errors[name] < (1.0 - WORTH) * error:
            friction, error = [*friction, term], errors[name]
    return robot, friction, errors


def timed(function: Callable[[], Any]) -> tuple[Any, float]:
    """Return a result and the seconds it took."""
    begin = time.perf_counter()
    return function(), time.perf_counter() - begin


def beside_scs(problem: Any) -> list[dict[str, Any]]:
    """Return what SCS makes of the same program, through CVXPY, beside ours."""
    ours, seconds = timed(lambda: sdpid.solve_sdp(problem))
    certificate = sdpid.certify(ours)
    program, theta = sdpid.to_cvxpy(problem)
    _, other = timed(lambda: program.solve(solver="SCS", time_limit_secs=PATIENCE))
    theirs = problem.cost_of(theta.value)
    found = [
        ("Clarabel", seconds, ours.status, certificate.gap, ours.violation),
        (
            *("SCS", other, program.status),
            (theirs - certificate.lower_bound) / certificate.lower_bound,
            problem.feasible.violation(theta.value),
        ),
    ]
    return [dict(zip(SOLVED, each, strict=True)) for each in found]


def main() -> None:
    """Train, test and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--train", type=Path, required=True)
    parser.add_argument("--test", type=Path, help="default: the later half of the training file")
    parser.add_argument("--scs", action="store_true", help="solve by SCS too, which takes minutes")
    parser.add_argument("--out", type=Path, help="folder for the tables")
    parser.add_argument("--json", action="store_true", help="one JSON object only")
    asked = parser.parse_args()
    begin = time.perf_counter()
    robot = load()
    log = replace(sdpid.read_recording(asked.train), joint_names=MOTORS)
    if asked.test is None:
        half = log.n_samples // 2
        log, test = log.rows(slice(0, half)), log.rows(slice(half, None))
    else:
        test = replace(sdpid.read_recording(asked.test), joint_names=MOTORS)
    coarse = sdpid.process(log, {**PROCESSING, "decimation": 10})
    robot, friction, errors = chosen(robot, coarse)
    found = sdpid.identify(
        robot,
        log,
        friction=friction,
        processing=PROCESSING,
        constraints=LIMITS,
        effects="load",
        intervals=False,
    )
    problem = found.estimate.problem
    rows = test.rows(slice(0, FIRST + COUNT + 300))
    samples = sdpid.process(
        rows, {**PROCESSING, "decimation": 1, "reversal_time": None, "trim_s": 0.0}
    )
    part = slice(FIRST, FIRST + COUNT)
    missed = (samples.effort - problem.predict(found.estimate.base, samples))[part]
    pulled = samples.position[part] @ np.array([0.0, RATIO, -RATIO, 1.0, 0.0, 0.0, 0.0])
    directions = np.array([0.0, RATIO, -RATIO, 1.0, 0.0, 0.0, 0.0])
    effort = samples.effort[part] - cable(pulled)[:, None] * directions
    certificate = sdpid.certify(found.estimate)
    result: dict[str, Any] = {
        "errors_percent": percent(missed, effort).tolist(),
        "chosen": [*(n for n, t in groups().items() if t in friction)],
        "gravity": robot.gravity.tolist(),
        "effects": [each.name for each in problem.origin.effects if each.chosen],
        "left_out_percent": errors,
        "gap": certificate.gap,
        "seconds": time.perf_counter() - begin,
    }
    tables = {"dvrk.csv": Table(("motor", "error, %"), (*enumerate(result["errors_percent"], 1),))}
    if asked.scs:
        result["solvers"] = beside_scs(problem)
        rows = tuple(tuple(each.values()) for each in result["solvers"])
        tables["dvrk_solvers.csv"] = Table(SOLVED, rows)
    if asked.out is not None:
        asked.out.mkdir(parents=True, exist_ok=True)
        for name, table in tables.items():
            table.write(asked.out / name)
    print(json.dumps(result, indent=None if asked.json else 2))


if __name__ == "__main__":
    main()
