"""Design excitations for tasks that others have published, and compare: the table of the docs.

Each plan of `sdpid.design_excitation` is scored like the published excitations, the paper's and
the best of random Fourier series in the same time (`excitation_baselines.py`), and its limits are
looked at by an independent check at 10 kHz and by Coal with the description's meshes on a fine
grid (`dense_check.py`).

    python examples/evidence/excitation.py --data DATA --out results

The folder DATA (or SDPID_DATA) is described in docs/evidence/data.md; without it the Denso and the
Panda are left. All rows take some ten minutes.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
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
    left_of,
    states_of,
)
from excitation_baselines import SCORE_HZ, Bounds, Columns, UrMotion, best_random, lwr_peer
from study import Study

import sdpid

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

    def rows(self, dense_hz: float, *, quick: bool) -> Iterator[tuple[object, ...]]:
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
        from sdpid.excitation.geometry.obstacles import table

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
    table: bool = False,
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
    if table:
        add_table(geometry)
    return found + distances_reached(geometry, states, asked)


def assumed_distances(
    plan: Any, states: States, asked: dict[tuple[str, str], float]
) -> list[Reached]:
    """Return the least distances of the shapes that stand for those a description lacks."""
    every = max(1, round(1.0 / FINE_HZ / np.median(np.diff(states.time))))
    distances = plan.collision.distances(states.position[::every])
    rows = []
    for (pair, clearance), values in zip(asked.items(), distances.T, strict=True):
        k = int(np.argmin(values))
        rows.append(
            Reached(
                kind="distance",
                subject=" – ".join(pair),
                limit=clearance,
                reached=float(values[k]),
                slack=float(values[k]) - clearance,
                time=float(states.time[::every][k]),
            )
        )
    return rows


def add_table(geometry: Geometry) -> None:
    """Add a table under the arm."""
    import coal
    import pinocchio as pin

    place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * SLAB[2]]))
    geometry.add("table", coal.Box(*SLAB), place)


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


def main() -> None:
    """Design, score and check every row."""
    study = Study(__doc__, data=True)
    cases = [denso_case()]
    if not study.quick:
        cases.append(panda_case())
        of_sets = {"ur10e_innopolis": ur10e_cases, "kuka_lwr4plus": lwr_cases}
        for name, _ in folders(study.data, of_sets):
            cases += of_sets[name](study.data)
    dense_hz = 1e3 if study.quick else RATE_HZ
    rows_of = partial(Case.rows, dense_hz=dense_hz, quick=study.quick)
    study.rows("excitation.csv", HEADER, cases, rows_of)


if __name__ == "__main__":
    main()
