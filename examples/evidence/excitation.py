"""Design excitations and compare them with those of others, and see whether limits are kept.

* ``plans``: tasks that others have published. Each plan of `sdpid.design_excitation` is scored like
  the published excitations, the paper's and the best of random Fourier series in the same time
  (`excitation_baselines.py`).
* ``robots``: many robots, with all defaults: 20 s of motion within the limits of the description.
* ``bounds``: how much larger the bounds of a curve are than what it reaches between the samples.
  Random closed splines of 36 intervals over 20 s, at rest at their ends, and Fourier series of ten
  random harmonics: the largest control point of each derivative after its knots were halved some
  times, and the bound of `enclose` over short cells, beside the largest value on a fine grid.

Limits are looked at by an independent check at 10 kHz and by Coal with the description's meshes on
a fine grid (`dense_check.py`), or with the assumed shapes where it has none.

    python examples/evidence/excitation.py --parts plans --data DATA --out results

The folder DATA (or SDPID_DATA) is described in docs/evidence/data.md; without it some robots are
left out. All rows take some twenty minutes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from data_sets import folders
from dense_check import (
    FINE_HZ,
    KINDS,
    RATE_HZ,
    Geometry,
    Reached,
    States,
    curve_states,
    distances_reached,
    efforts,
    efforts_reached,
    joints_reached,
    least_reached,
    left_of,
    states_of,
)
from excitation_baselines import SCORE_HZ, Bounds, Columns, UrMotion, best_random, lwr_peer
from study import Rows, Study

import sdpid
from sdpid.excitation.geometry.obstacles import table
from sdpid.experiment.trajectory.curve import Curve, Spline
from sdpid.experiment.trajectory.fourier import FourierSeries

FRICTION = ("coulomb", "viscous", "offset")

# Sides and thickness of the slab that stands for a table in the independent check, m.
SLAB = (10.0, 10.0, 1.0)

HEADER = (
    *("robot", "limits", "motion", "seconds", "columns", "cond", "log_det"),
    *(*KINDS, "broken", "collisions"),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """A task: some motions for it that are compared.

    Attributes
    ----------
    name, limits : str
        What is written into the table.
    robot : RobotModel
        The robot.
    bounds : Bounds
        Limits of the joints.
    duration : float
        Of the motion, s.
    columns : Columns
        What motions are scored over.
    arguments : dict
        Of `design_excitation`, beside duration and limits.
    seconds : tuple of float
        What the searches may take.
    jerk : float
        Limit of every joint's jerk, rad/s³: none unless it is stated.
    clearance : float or None
        Least distance between links, and from the table that stands under the arm then, m.
    package_dirs : tuple of Path
        Where meshes are.
    published : dict
        Motions that others have made, and that their limits are looked at on.
    """

    name: str
    limits: str
    robot: sdpid.RobotModel
    bounds: Bounds
    duration: float
    columns: Columns
    arguments: dict[str, Any]
    seconds: tuple[float, ...] = (10.0,)
    jerk: float = np.inf
    clearance: float | None = None
    package_dirs: tuple[Path, ...] = ()
    published: dict[str, tuple[States, States]] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.name}, {self.limits}, {self.columns.count} columns"

    def row(
        self, motion: str, scored: States, reached: Iterable[Reached], seconds: float | None = None
    ) -> tuple[object, ...]:
        """Return the row of a motion: scored on one grid, its limits looked at on another."""
        least, *broken = left_of(reached)
        score = self.columns.count, *self.columns.score(scored)
        return self.name, self.limits, motion, seconds, *score, *least, *broken

    def rows(self, dense_hz: float, *, quick: bool) -> Rows:
        """Yield the rows of all motions, and of plans."""
        names = self.robot.joint_names
        for motion, (scored, dense) in self.published.items():
            yield self.row(motion, scored, self.bounds.reached(names, dense))
        most = 0.5 if quick else max(self.seconds)
        series, count = best_random(self.columns, self.bounds, self.duration, most)
        scored, dense = (curve_states(series, self.duration, hz) for hz in (SCORE_HZ, dense_hz))
        reached = self.bounds.reached(names, dense)
        yield self.row(f"best of {count} random", scored, reached, most)
        for limit in self.seconds:
            start = time.perf_counter()
            plan = self.plan(starts=1) if quick else self.plan(time_limit=limit)
            seconds = time.perf_counter() - start
            curve = plan.trajectory
            scored = curve_states(curve.series, curve.period, SCORE_HZ)
            objective = self.arguments.get("objective", "mixed")
            reached = reached_by(
                plan, self.robot, dense_hz, self.package_dirs, self.clearance is not None
            )
            yield self.row(f"sdpid, {objective}, limit {limit:g} s", scored, reached, seconds)

    def plan(self, **how: Any) -> Any:
        """Return a plan."""
        bounds = {key: values.tolist() for key, values in vars(self.bounds).items()}
        return sdpid.design_excitation(
            self.robot,
            duration=self.duration,
            # Others went to the ends of the description's ranges.
            limits=sdpid.Limits(**bounds, jerk=self.jerk, clearance=self.clearance, share=1.0),
            obstacles=() if self.clearance is None else (table(),),
            collisions=self.clearance is not None,
            package_dirs=self.package_dirs,
            **{"time_limit": None, **how, **self.arguments},
        )


def reached_by(
    plan: Any,
    robot: sdpid.RobotModel,
    dense_hz: float = RATE_HZ,
    package_dirs: Sequence[Path] = (),
    on_table: bool = False,
) -> list[Reached]:
    """Return what a plan reaches of its limits, found without `sdpid.excitation`."""
    states, limits = states_of(plan.trajectory, dense_hz), plan.joint_limits
    kinds = ("lower", "upper", "velocity", "acceleration", "jerk")
    found = list(
        joints_reached(robot.joint_names, states, **{kind: getattr(limits, kind) for kind in kinds})
    )
    found += efforts_reached(robot.joint_names, states.time, efforts(robot, states), limits.torque)
    if plan.collision is None or limits.clearance is None:
        return found
    pairs = [(pair.first, pair.second) for pair in plan.collision.pairs]
    # Links that are built closer to each other than the clearance are asked for less.
    asked = dict(zip(pairs, plan.collision.clearances(limits.clearance).tolist(), strict=True))
    if "<collision" not in (robot.urdf or ""):
        return found + assumed_distances(plan, states, asked)
    geometry = Geometry(robot, package_dirs)
    if on_table:
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * SLAB[2]]))
        geometry.add("table", coal.Box(*SLAB), place)
    return found + distances_reached(geometry, states, asked)


def assumed_distances(
    plan: Any, states: States, asked: dict[tuple[str, str], float]
) -> list[Reached]:
    """Return the least distances of the shapes that stand for those a description lacks."""
    every = max(1, round(1.0 / FINE_HZ / np.median(np.diff(states.time))))
    distances = plan.collision.distances(states.position[::every])
    time = states.time[::every]
    return [
        least_reached(pair, clearance, values, time)
        for (pair, clearance), values in zip(asked.items(), distances.T, strict=True)
    ]


def ur10e_cases(data: Path) -> Iterator[Case]:
    """Yield the tasks of the UR10e: 20 s, 58 columns."""
    folder = data / "ur10e_innopolis"
    robot = sdpid.load_robot(folder / "ur10e.urdf")
    peer = UrMotion.read(folder / "optimal_trajectories" / "ptrnSrch_N10T20QR.mat")
    friction = {"friction": (*FRICTION, "rotor_inertia")}
    by_cond = {**friction, "objective": "condition"}
    columns = Columns(robot, rotors=True, friction=True)
    known: dict[str, Any] = {"robot": robot, "columns": columns, "name": "UR10e"}
    states = (curve_states(peer, peer.duration, hz) for hz in (SCORE_HZ, RATE_HZ))
    yield Case(
        **known,
        limits="of N10T20QR",
        bounds=peer.bounds,
        duration=peer.duration,
        arguments=by_cond,
        seconds=(10.0, 60.0),
        published={"published": tuple(states)},
    )
    ends = np.radians([[-180, 180], [-180, 0], [-100, 100], [-180, 0], [-90, 90], [-90, 90]])
    known["bounds"] = Bounds(
        lower=ends[:, 0],
        upper=ends[:, 1],
        velocity=peer.bounds.velocity,
        acceleration=np.array([2.0, 1.0, 1.0, 1.0, 1.0, 2.5]),
    )
    known["duration"] = 20.0
    yield Case(**known, limits="tight", arguments=by_cond, seconds=(10.0, 60.0))
    yield Case(
        **known,
        limits="tight, table, 30 mm",
        arguments=friction,
        seconds=(30.0,),
        clearance=0.03,
        package_dirs=(folder,),
    )


def lwr_cases(data: Path) -> Iterator[Case]:
    """Yield the tasks of the LWR 4+: 12 s, 43 and 64 columns, the peer's peak accelerations."""
    folder = data / "kuka_lwr4plus"
    robot = sdpid.load_robot(folder / "kuka_lwr4.urdf")
    peer = lwr_peer(folder / "flobaroid_excitation.npz")
    peak = np.abs(peer.acceleration).max(axis=0)
    for friction in (False, True):
        yield Case(
            name="LWR 4+",
            limits="peer's acceleration",
            robot=robot,
            bounds=Bounds.of(robot, acceleration=peak),
            duration=12.0,
            columns=Columns(robot, rotors=False, friction=friction),
            arguments={"friction": FRICTION if friction else (), "objective": "condition"},
            published={"published": (peer, peer)},
        )


def panda_case() -> Case:
    """Return the seven axes with meshes, above a table, with limits of torque and jerk."""
    robot = sdpid.load_robot("panda_description/panda")
    return Case(
        name="Panda with hand",
        limits="table, 30 mm, 5 rad/s², 100 rad/s³",
        robot=robot,
        bounds=Bounds.of(robot, acceleration=5.0),
        duration=20.0,
        columns=Columns(robot, rotors=False, friction=True),
        arguments={"friction": FRICTION},
        seconds=(30.0,),
        jerk=100.0,
        clearance=0.03,
    )


def denso_case() -> Case:
    """Return the Denso, its Table II with the peak acceleration of the paper's motion."""
    robot = sdpid.load_robot("denso_vp6242")
    paper = sdpid.paper_excitation("denso_vp6242", 0, period=20.0, periods=1)
    states = curve_states(paper.series, 20.0, SCORE_HZ)
    lower, upper = paper.position_range.T
    bounds = Bounds(
        lower=lower,
        upper=upper,
        velocity=paper.velocity_limit,
        acceleration=np.abs(states_of(paper).acceleration).max(axis=0),
    )
    return Case(
        name="Denso",
        limits="Table II",
        robot=robot,
        bounds=bounds,
        duration=20.0,
        columns=Columns(robot, rotors=False, friction=True),
        arguments={"friction": FRICTION},
        published={"the paper's, one period of 20 s": (states, states)},
    )


# What load_robot takes of a robot, and whether a table stands under the arm.
ROBOTS = {
    "UR10": ("ur10_robot", True),
    "Panda with hand": ("panda_description/panda", True),
    "Baxter": ("baxter_description/baxter", False),
    "TIAGo": ("tiago_description/tiago_no_hand", False),
    "TIAGo Pro": ("tiago_pro_description/tiago_pro", False),
    "Denso": ("denso_vp6242", True),
    "LWR 4+": ("kuka_lwr4plus/kuka_lwr4.urdf", True),
    "TX40": ("staubli_tx40/tx40.urdf", True),
    "Gen3": ("kinova_gen3_dynamapp/gen3.urdf", True),
}
# Least distance, m, and what each search may take, s.
CLEARANCE, SECONDS = 0.02, 30.0
OF_ROBOTS = ("robot", "joints", "seconds", "cond", "pairs", "shapes", *KINDS)


def planned(study: Study, name: str) -> Rows:
    """Design for one robot and yield the row of the table."""
    source, on_table = ROBOTS[name]
    robot = sdpid.load_robot(study.data / source if source.endswith(".urdf") else source)
    start = time.perf_counter()
    try:
        plan = sdpid.design_excitation(
            robot,
            duration=study.duration,
            limits=sdpid.Limits(clearance=CLEARANCE),
            obstacles=(table(),) if on_table else (),
            time_limit=None if study.quick else SECONDS,
            starts=1,
        )
    except sdpid.errors.SdpidError as error:
        print(f"{name}: no plan, {error}", flush=True)
        yield name, robot.n, *(None,) * (len(OF_ROBOTS) - 2)
        return
    seconds = time.perf_counter() - start
    reached = reached_by(plan, robot, 1e3 if study.quick else RATE_HZ, (), on_table)
    pairs = sum(each.kind == "distance" for each in reached)
    shapes = "description's" if robot.urdf and "<collision" in robot.urdf else "assumed"
    yield name, robot.n, seconds, plan.condition_number, pairs, shapes, *left_of(reached)[0]


def plans(study: Study) -> None:
    """Design, score and check for the tasks of others."""
    cases = [denso_case()]
    if not study.quick:
        cases.append(panda_case())
        of_sets = {"ur10e_innopolis": ur10e_cases, "kuka_lwr4plus": lwr_cases}
        for name, _ in folders(study.data, of_sets):
            cases += of_sets[name](study.data)
    dense_hz = 1e3 if study.quick else RATE_HZ
    rows_of = partial(Case.rows, dense_hz=dense_hz, quick=study.quick)
    study.rows("excitation.csv", HEADER, rows_of, cases)


def robots(study: Study) -> None:
    """Design and check a plan for every robot."""
    of_data = {
        name: source.split("/")[0] for name, (source, _) in ROBOTS.items() if ".urdf" in source
    }
    there = {name for name, _ in folders(study.data, of_data.values())}
    names = [name for name in study.robots if of_data.get(name) in {None, *there}]
    study.rows("excitation_robots.csv", OF_ROBOTS, partial(planned, study), names, digits=3)


DURATION, FREE, JOINTS, HARMONICS = 20.0, 35, 3, 10
DERIVATIVES = ("position", "velocity", "acceleration", "jerk")
ORDERS = range(len(DERIVATIVES))
TIME = np.linspace(0.0, DURATION, 20_001)


def random_spline(rng: np.random.Generator) -> Spline:
    """Return a spline that is at rest at its ends, which are the same."""
    return Spline.from_free(rng.uniform(-1.0, 1.0, (FREE, JOINTS)), DURATION)


def random_series(rng: np.random.Generator) -> FourierSeries:
    """Return a series whose harmonics move equally fast in the mean."""
    harmonics = np.tile(np.arange(1, HARMONICS + 1), (JOINTS, 1))
    return FourierSeries(
        period=DURATION,
        center=np.zeros(JOINTS),
        harmonics=harmonics,
        amplitudes=rng.uniform(0.0, 1.0, harmonics.shape) / harmonics,
        phases=rng.uniform(0.0, 2.0 * np.pi, harmonics.shape),
    )


def enclosed(curve: Curve, order: int, cell: float) -> np.ndarray:
    """Return the bound (n,) of a derivative's size over all cells."""
    edges = np.linspace(0.0, DURATION, round(DURATION / cell) + 1)
    lower, upper = curve.enclose(edges, derivative=order)
    return np.asarray(np.maximum(-lower, upper).max(axis=0))


def controlled(curve: Spline, order: int, halvings: int) -> np.ndarray:
    """Return the size (n,) of the largest control point of a derivative."""
    matrix = Spline.control_matrix(len(curve.control_points), DURATION, order, halvings)
    return np.asarray(np.abs(matrix @ curve.control_points).max(axis=0))


WAYS: dict[str, tuple[Callable[..., Curve], Callable[..., np.ndarray], float]] = {
    "control points, one halving": (random_spline, controlled, 1),
    "two halvings": (random_spline, controlled, 2),
    "three halvings": (random_spline, controlled, 3),
    "enclose, cells of 0.1 s": (random_spline, enclosed, 0.1),
    "enclose, cells of 0.02 s": (random_spline, enclosed, 0.02),
    "enclose of a Fourier series, cells of 0.1 s": (random_series, enclosed, 0.1),
}


def excess(name: str, seed: int) -> Rows:
    """Yield by how much the bounds of a curve exceed what it reaches, %."""
    make, bound, size = WAYS[name]
    curve = make(np.random.default_rng(seed))
    reached = [np.abs(curve.evaluate(TIME, derivative=k)).max(axis=0) for k in ORDERS]
    shares = np.array([bound(curve, k, size) for k in ORDERS]) / np.array(reached) - 1.0
    yield 100.0 * shares.mean(axis=1)


def bounds(study: Study) -> None:
    """Measure how much too large bounds between the samples are."""
    title = "excess over the true extreme, %"
    header = (title, "curve", *DERIVATIVES)
    found = study.rows("curves.csv", header, excess, WAYS, range(study.curves))
    columns = {name: f"mean {name}" for name in DERIVATIVES}
    study.summary("curve_bounds.csv", found, (title,), columns)


def main() -> None:
    """Write the tables that are asked for."""
    parts = {"plans": plans, "robots": robots, "bounds": bounds}
    study = Study(
        __doc__,
        data=True,
        quick={"robots": ["Denso"], "duration": 5.0, "curves": 2},
        parts=[*parts],
        robots=[*ROBOTS],
        duration=(20.0, "of the motion of robots, s"),
        curves=(20, "of each kind of bounds"),
    )
    for part in study.parts:
        parts[part](study)


if __name__ == "__main__":
    main()
