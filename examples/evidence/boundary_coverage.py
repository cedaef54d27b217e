"""Count how often intervals hold a truth that lies on the boundary of what is possible.

Every draw adds white noise to the exact efforts of one motion, identifies, and asks for the 95 %
profile interval of every base and standard parameter. Reported is the worst parameter of each
case, beside the average.

    python examples/evidence/boundary_coverage.py --out results --draws 200
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from study import Study, grouped

import sdpid
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.robot.inertia import (
    Consistency,
    complement,
    physical_parameters,
    point_masses,
    second_moment_from_inertia,
    theta_from_physical,
)
from sdpid.robot.model.base_parameters import BaseParameters

# Margin of the Denso on its boundary, kg·m².
MARGIN = 0.02

# Corners of a cube.
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1.0)])


@dataclass(frozen=True)
class Case:
    """One robot whose true parameters are known, and how it is measured."""

    robot: sdpid.RobotModel
    theta: np.ndarray
    constraints: sdpid.Constraints
    consistency: Consistency = "pseudo_inertia"
    noise: float = 0.5
    count: int = 200


def arm(last: np.ndarray, mass_max: float = 1.0, noise: float = 0.5) -> Case:
    """Return a two-link arm with crossing axes whose last link is given, (10,)."""
    rows = [{"r": 0.2}, {"alpha": np.pi / 2}]
    robot = sdpid.RobotModel.from_mdh(rows, name="arm")
    first = body(0.1, [0.1, 0.05, 0.0])
    theta = np.concatenate([first, last, [0.5, 0.4, 0.8, 0.6]])
    return Case(robot, theta, sdpid.Constraints(mass_max=mass_max), noise=noise)


def body(size: float, center: list[float]) -> np.ndarray:
    """Return eight points in the corners of a cube, 1 kg in all, (10,)."""
    return np.asarray(point_masses(np.full(8, 0.125), size * CUBE + np.array(center)))


def along(direction: list[float], start: list[float], length: float = 0.3) -> np.ndarray:
    """Return a thin rod of 1 kg, (10,)."""
    steps = np.linspace(0.0, length, 20)[:, None]
    unit = np.array(direction) / np.linalg.norm(direction)
    return np.asarray(point_masses(np.full(20, 0.05), np.array(start) + steps * unit))


def plate() -> np.ndarray:
    """Return a flat rectangle of 1 kg across no axis, (10,)."""
    sides = np.array([[0.3, 0.0, 0.1], [0.0, 0.2, 0.1]])
    grid = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)]) / 2.0
    return np.asarray(point_masses(np.full(9, 1.0 / 9.0), grid @ sides + [0.1, 0.05, 0.05]))


def on_the_margin(center: list[float], inertia: list[float]) -> Case:
    """Return an arm whose last link's 6×6 spatial inertia has exactly the margin asked for."""
    last = theta_from_physical(1.0, np.array(center), np.diag(inertia))
    limits = sdpid.Constraints(mass_max=1.0, margin=min(inertia))
    return replace(arm(last), constraints=limits, consistency="spatial_inertia")


def denso(*, boundary: bool) -> Case:
    """Return the Denso: its own links, or three plates and three rods on a margin."""
    robot = sdpid.load_robot("denso_vp6242")
    theta = np.array(true_parameters("denso_vp6242"))
    if not boundary:
        return Case(robot, theta, sdpid.Constraints(), noise=0.5, count=400)
    links = theta[:60].reshape(6, 10)
    mass, com, inertia = physical_parameters(links)
    for i in range(6):
        values, vectors = np.linalg.eigh(second_moment_from_inertia(inertia[i]))
        if i == 5:
            com[i, :2], vectors = 0.0, np.eye(3)
        kept = values * [0.0, float(i < 3), 1.0]
        inertia[i] = complement((vectors * kept) @ vectors.T + MARGIN * np.eye(3))
    theta[:60] = theta_from_physical(mass, com, inertia).ravel()
    return Case(robot, theta, sdpid.Constraints(margin=MARGIN), noise=0.5, count=400)


CASES: dict[str, Callable[[], Case]] = {
    "inside": lambda: arm(body(0.1, [0.1, 0.0, 0.05]), 20.0, noise=0.1),
    "near": lambda: arm(body(0.1, [0.1, 0.0, 0.05]), 20.0),
    "thin": lambda: arm(body(0.03, [0.1, 0.0, 0.05])),
    "rod on the axis": lambda: arm(along([0, 0, 1], [0, 0, 0])),
    "rod on the axis, any mass": lambda: arm(along([0, 0, 1], [0, 0, 0]), 20.0),
    "rod off the axis": lambda: arm(along([1, 0.3, 0.2], [0.05, 0.02, 0.0])),
    "rod beside the axis": lambda: arm(along([0, 0, 1], [0.1, 0.05, 0])),
    "plate": lambda: arm(plate()),
    "point": lambda: arm(point_masses(np.ones(1), np.array([[0.1, 0.05, 0.15]]))),
    "6x6 on the margin": lambda: on_the_margin([0.1, 0.05, 0.02], [0.005, 0.03, 0.02]),
    "6x6 at its apex": lambda: on_the_margin([0.0, 0.0, 0.15], [0.005, 0.005, 0.005]),
    "denso inside": lambda: denso(boundary=False),
    "denso on the boundary": lambda: denso(boundary=True),
}


def measured(case: Case) -> tuple[dict[str, np.ndarray], np.ndarray, BaseParameters]:
    """Return the motion of a case, its exact efforts (K, n), and the base parameters."""
    rng = np.random.default_rng(20)
    shape = (case.count, case.robot.n)
    # Ranges of positions, velocities and accelerations, rad and s.
    ranges = {"position": np.pi, "velocity": 3.0, "acceleration": 10.0}
    motion = {name: rng.uniform(-most, most, shape) for name, most in ranges.items()}
    samples = sdpid.Samples(**motion, effort=np.ones(shape))
    problem = sdpid.build_problem(case.robot, samples)
    return motion, problem.predict(problem.base_of(case.theta)), problem.base


def drawn(name: str, seed: int) -> Iterator[tuple[object, ...]]:
    """Yield of each parameter whether its interval holds the truth, and its width."""
    case = CASES[name]()
    motion, exact, base = measured(case)
    names = (*base.names, *base.theta_names)
    truth = dict(zip(names, [*(base.matrix @ case.theta), *case.theta], strict=True))
    noise = case.noise * np.random.default_rng(seed).standard_normal(exact.shape)
    problem = sdpid.build_problem(
        case.robot,
        sdpid.Samples(**motion, effort=exact + noise, block=4),
        base=base,
        constraints=case.constraints,
        consistency=case.consistency,
    )
    estimate = sdpid.solve_sdp(problem)
    begin = time.perf_counter()
    found = sdpid.confidence_intervals(estimate, method="profile", n_jobs=1)
    seconds = time.perf_counter() - begin
    held = found.contains([truth[each] for each in found.names])
    for parameter, inside, width in zip(found.names, held, found.width, strict=True):
        yield name, parameter, inside, width, seconds


def main() -> None:
    """Run the draws, and list of each case the parameters that are held least often."""
    study = Study(
        __doc__,
        quick={"draws": 1, "cases": ["inside"]},
        draws=200,
        cases=[*CASES],
    )
    found = study.rows(
        "draws.csv",
        ("case", "parameter", "held", "width", "seconds"),
        itertools.product(study.cases, range(study.draws)),
        lambda case: drawn(*case),
    )
    rows = []
    for (name,), own in grouped(found, "case"):
        parameters = list(dict.fromkeys(own["parameter"]))
        of = [own["parameter"] == each for each in parameters]
        share = np.array([100.0 * own["held"][each].mean() for each in of])
        order = np.argsort(share, kind="stable")
        listed = ", ".join(f"{parameters[i]} {share[i]:.1f}" for i in order[:6])
        width = np.median(own["width"][of[order[0]]])
        rows.append((name, study.draws, listed, share.mean(), width, own["seconds"].mean()))
    header = ("case", "draws", "held_least_percent", "mean_percent", "width_of_first", "seconds")
    study.write("boundary_coverage.csv", header, rows)


if __name__ == "__main__":
    main()
