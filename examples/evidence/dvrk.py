"""A surgical robot's master, with spring, cable and parallelogram, on a run that was held out.

    python examples/evidence/dvrk.py --train one.npz --test FILE --json
    python examples/evidence/dvrk.py --train one.npz --scs --out results

Errors are in percent of the effort without the cable's torque, of seven motors, over the first 2000
rows after 200, below 5.65 Hz: at the times that the recorded speeds show, and at the stated ones.
Terms are chosen on the training file alone, by blocks of time. Where the motion repeats, a block is
left out of every repetition. Kinematics and the cable are those of Wang et al., RA-L 4(4), 2019.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize, minimize_scalar
from scipy.signal import butter, sosfiltfilt

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
# Axes of motors 3 and 4 that are no joint of the arm beside them.
SHAFTS = ("joint_bar", "motor_4")
CABLE = (0.0004877, -0.0037149, 0.0067497, 0.008519, -0.0201475, -0.025265, 0.048095, 0.00255)
PROCESSING = {"cutoff_hz": 5.65, "order": 6, "decimation": 5, "velocity": "differentiated"}
LIMITS = sdpid.Constraints(mass_max=20.0, theta_max=20.0, friction_max=1e3)
# Width of signs, rad/s; ways after which elements of hysteresis slip, rad.
WIDTH, SLIPS = 0.1, (0.02, 0.05, 0.1, 0.2)
# A group of terms lowers the error on blocks of time that are left out by this share; every third
# block at once. A motion repeats where positions come back to this share of their variance.
WORTH, BLOCKS, FOLDS, REPEATS = 0.01, 12, 3, 0.1
# Cut-offs, Hz, of a motor's predicted efforts: faster accelerations may be of forces that its
# effort does not answer.
SLOWER = (4.5, 3.5, 2.5)
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


@dataclass(frozen=True)
class GearFriction(terms.LoadFriction):
    """Friction of one motor that grows with what it carries: links, and the spring of joint 5."""

    motor: int = 1
    stiffness: float = 0.0

    def parameters(self, joint_names: Sequence[str]) -> tuple[terms.TermParameter, ...]:
        """Return the share of the load."""
        return (super().parameters(joint_names)[self.motor - 1],)

    def columns_in(self, motion: Any, joint_names: Sequence[str]) -> np.ndarray:
        """Return the size of the load times the sign of the motor's velocity."""
        j, rates = self.motor - 1, (motion.velocity, motion.acceleration)
        load = motion.robot.efforts_of_bodies(np.array(self.bodies), motion.position, *rates)[:, j]
        if self.motor == 5:
            load = load + self.stiffness * spring(motion.position[:, j])
        found = np.zeros((*motion.velocity.shape, 1))
        found[:, j, 0] = np.abs(load) * motion.filtered(self.sign, ("load", self.width))[:, j]
        return found


def groups(samples: sdpid.Samples, estimate: sdpid.Estimate) -> dict[str, list[Any]]:
    """Return what may be chosen; loads are those of an estimate."""
    found: dict[str, list[Any]] = {
        f"friction of {shaft}": [
            terms.AtJoints(terms.Coulomb(width=WIDTH), (shaft,)),
            terms.AtJoints(terms.Viscous(), (shaft,)),
        ]
        for shaft in SHAFTS
    }
    links = estimate.theta[: 10 * estimate.problem.robot.n_links].reshape(-1, 10)
    carried = {
        "bodies": tuple(map(tuple, links.tolist())),
        "stiffness": estimate.named()["K_joint_5"],
        "width": WIDTH,
    }
    for joint in (*JOINTS, *SHAFTS):
        found[f"hysteresis of {joint}"] = [terms.Hysteresis(joint, SLIPS)]
    # Cables through the wrist pull like springs.
    for joint in JOINTS[3:]:
        found[f"stiffness of {joint}"] = [
            terms.PositionTerm(np.copy, "k", joint=joint, unit="N.m/rad", nonnegative=True)
        ]
    turned = samples.position[:, 1] - samples.position[:, 2]

    def powers(q: np.ndarray) -> np.ndarray:
        q = np.clip(q, turned.min(), turned.max())
        return np.stack([q, q**2, q**3], axis=1)

    rod = terms.PositionTerm(powers, "rod", joint="joint_rod", count=3)
    wrist = [GearFriction(motor=k, **carried) for k in (5, 6)]
    return {**found, "angle of the rod": [rod], "load friction of the wrist": wrist}


def percent(missed: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Return errors in percent of efforts, motor by motor."""
    return 100.0 * np.linalg.norm(missed, axis=0) / np.linalg.norm(effort, axis=0)


def without_cable(samples: sdpid.Samples) -> np.ndarray:
    """Return efforts without that of the cable."""
    directions = np.array([0.0, RATIO, -RATIO, 1.0, 0.0, 0.0, 0.0])
    return samples.effort - cable(samples.position @ directions)[:, None] * directions


def formulated(
    robot: sdpid.RobotModel, samples: sdpid.Samples, friction: list[Any], base: Any = None
) -> sdpid.Problem:
    """Return the problem in which every motor's error counts as a share of its effort.

    Base parameters of the same robot and terms need not be found again.
    """
    return sdpid.build_problem(
        robot,
        replace(samples, covariance=np.diag(samples.effort.var(axis=0))),
        friction=friction,
        constraints=LIMITS,
        base=base,
    )


def blocks(samples: sdpid.Samples) -> list[np.ndarray]:
    """Return samples that are left out together, in every repetition of the motion."""
    count = samples.n_samples
    way = (samples.position - samples.position.mean(axis=0)) / samples.position.std(axis=0)
    lags = np.arange(count // 4, count - count // 8)
    apart = [np.mean((way[lag:] - way[:-lag]) ** 2) for lag in lags]
    period = lags[np.argmin(apart)] if min(apart) < REPEATS else count
    block = np.arange(count) % period * BLOCKS // period
    return [block % FOLDS == k for k in range(FOLDS)]


def left_out(
    robot: sdpid.RobotModel, samples: sdpid.Samples, friction: list[Any]
) -> tuple[np.ndarray, float]:
    """Return efforts predicted by fits without their block of time, and their mean error."""
    found, base = np.empty_like(samples.effort), None
    for block in blocks(samples):
        kept = replace(samples, mask=samples.used & ~block[:, None])
        problem = formulated(robot, kept, friction, base)
        base = problem.base
        found[block] = problem.predict(sdpid.solve_wls(problem).base, samples)[block]
    return found, float(percent(samples.effort - found, without_cable(samples)).mean())


def upright(robot: sdpid.RobotModel, samples: sdpid.Samples) -> sdpid.RobotModel:
    """Return the robot under the gravity whose direction explains the samples best."""

    def tilted(x: np.ndarray) -> sdpid.RobotModel:
        direction = np.array([x[0], x[1], -1.0])
        return robot.with_gravity(9.81 * direction / np.linalg.norm(direction))

    # Base parameters are the same under any gravity that is askew.
    start = np.array([[1e-3, 1e-3], [0.03, 1e-3], [1e-3, 0.03]])
    base = formulated(tilted(start[0]), samples, always()).base

    def cost(x: np.ndarray) -> float:
        return float(sdpid.solve_wls(formulated(tilted(x), samples, always(), base)).cost)

    options = {"initial_simplex": start, "xatol": 1e-3, "maxfev": 30}
    return tilted(minimize(cost, start[0], method="Nelder-Mead", options=options).x)


def shifted(samples: sdpid.Samples, zero: float) -> sdpid.Samples:
    """Return samples with another zero of motor 5, rad."""
    position = samples.position + zero * (np.arange(len(MOTORS)) == 4)
    return replace(samples, position=position)


def zero_of_motor_5(robot: sdpid.RobotModel, samples: sdpid.Samples, friction: list[Any]) -> float:
    """Return the zero of motor 5 that explains the samples best, rad."""
    base = formulated(robot, samples, friction).base

    def cost(zero: float) -> float:
        problem = formulated(robot, shifted(samples, zero), friction, base)
        return float(sdpid.solve_wls(problem).cost)

    options = {"xatol": 1e-3, "maxiter": 12}
    return float(minimize_scalar(cost, bounds=(-0.2, 0.2), method="bounded", options=options).x)


def slowed(
    effort: np.ndarray, samples: sdpid.Samples, cutoffs: Sequence[float | None]
) -> np.ndarray:
    """Return predicted efforts of which each motor's has passed its low-pass, if any."""
    found, rate = effort.copy(), 1.0 / (samples.time[1] - samples.time[0])
    for j, cutoff in enumerate(cutoffs):
        if cutoff is not None:
            sections = butter(4, cutoff, fs=rate, output="sos")
            found[:, j] = sosfiltfilt(sections, effort[:, j])
    return found


@dataclass
class Choice:
    """What blocks of time keep, and the errors that were compared."""

    robot: sdpid.RobotModel
    zero: float
    friction: list[Any]
    names: list[str]
    cutoffs: list[float | None]
    errors: dict[str, float]


def chosen(robot: sdpid.RobotModel, samples: sdpid.Samples) -> Choice:
    """Return gravity, terms and cut-offs that blocks of time keep."""
    friction, names = always(), []
    predicted, error = left_out(robot, samples, friction)
    errors = {"the paper's terms": error}

    def better(name: str, found: tuple[np.ndarray, float]) -> bool:
        nonlocal predicted, error
        errors[name] = found[1]
        if found[1] >= (1.0 - WORTH) * error:
            return False
        (predicted, error), _ = found, names.append(name)
        return True

    free = upright(robot, samples)
    if better("direction of gravity", left_out(free, samples, friction)):
        robot = free
    estimate = sdpid.solve_sdp(formulated(robot, samples, friction))
    for name, group in groups(samples, estimate).items():
        if better(name, left_out(robot, samples, [*friction, *group])):
            friction = [*friction, *group]
    zero = zero_of_motor_5(robot, samples, friction)
    if not better("zero of motor_5", left_out(robot, shifted(samples, zero), friction)):
        zero = 0.0
    cutoffs: list[float | None] = []
    for j in range(len(MOTORS)):
        tried = {}
        for cutoff in (None, *SLOWER):
            alone: list[float | None] = [None] * len(MOTORS)
            alone[j] = cutoff
            missed = samples.effort - slowed(predicted, samples, alone)
            tried[cutoff] = float(np.linalg.norm(missed[:, j]))
        best = min(tried, key=lambda each: tried[each])
        cutoffs.append(best if tried[best] < (1.0 - WORTH) * tried[None] else None)
    return Choice(robot, zero, friction, names, cutoffs, errors)


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
    choice = chosen(robot, sdpid.process(log, {**PROCESSING, "decimation": 10}))
    trained = shifted(sdpid.process(log, PROCESSING), choice.zero)
    problem = formulated(choice.robot, trained, choice.friction)
    estimate = sdpid.solve_sdp(problem)
    certificate = sdpid.certify(estimate)
    rows = test.rows(slice(0, FIRST + COUNT + 300))
    as_read = {**PROCESSING, "decimation": 1, "reversal_time": None, "trim_s": 0.0}
    samples = sdpid.process(rows, as_read)
    predicted = problem.predict(estimate.base, shifted(samples, choice.zero))
    predicted = slowed(predicted, samples, choice.cutoffs)
    # Without speeds nothing tells other times than the stated ones.
    stated = sdpid.process(replace(rows, velocity=None), as_read)
    at_stated = np.stack(
        [np.interp(stated.time, samples.time, each) for each in predicted.T], axis=1
    )
    part = slice(FIRST, FIRST + COUNT)
    errors, errors_stated = (
        percent((each.effort - effort)[part], without_cable(each)[part]).tolist()
        for each, effort in ((samples, predicted), (stated, at_stated))
    )
    result: dict[str, Any] = {
        "errors_percent": errors,
        "errors_percent_at_stated_times": errors_stated,
        "chosen": choice.names,
        "cutoffs_hz": choice.cutoffs,
        "gravity": choice.robot.gravity.tolist(),
        "zero_of_motor_5": choice.zero,
        "left_out_percent": choice.errors,
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
