"""Design excitations for tasks that others have published, and compare: the table of the docs.

Each plan of `sdpid.design_excitation` is scored like the published excitations, the paper's and
the best of random Fourier series in the same time (`excitation_baselines.py`), and its limits are
looked at by an independent check at 10 kHz and by Coal with the description's meshes on a fine
grid (`dense_check.py`). `goal` and `hope` are the numbers that the project set itself, (cond) or
(cond, log det).

    python examples/evidence/excitation.py --data DATA --out results

The folder DATA (or SDPID_DATA) is described in docs/evidence/data.md; without it the Denso and the
Panda are left. All rows take some ten minutes.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from dense_check import (
    FINE_HZ,
    RATE_HZ,
    Geometry,
    Reached,
    States,
    curve_states,
    distances_reached,
    efforts,
    efforts_reached,
    joints_reached,
    states_of,
)
from excitation_baselines import (
    SCORE_HZ,
    Bounds,
    Columns,
    Row,
    Task,
    UrMotion,
    denso_task,
    lwr_peer,
    lwr_task,
    random_row,
    row_of,
)

import sdpid
from sdpid._common.tables import Table

FRICTION = ("coulomb", "viscous", "offset")

# Sides and thickness of the slab that stands for a table in the independent check, m.
SLAB = (10.0, 10.0, 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One row of the table.

    Attributes
    ----------
    name, limits : str
        What is written into the table.
    robot : RobotModel
        The robot.
    task : Task
        Limits of the joints and duration.
    columns : Columns
        What the plan is scored over.
    arguments : dict
        Of `design_excitation`, beside duration and limits.
    jerk : float
        Limit of every joint's jerk, rad/s³: none unless it is stated.
    clearance : float or None
        Least distance between links, and from the table, m; None: not looked at.
    table : bool
        Whether a table stands under the arm.
    package_dirs : tuple of Path
        Where meshes are.
    seconds : float
        What the search may take.
    goal, hope : tuple of float
        Numbers to reach: cond, or cond and log det.
    """

    name: str
    limits: str
    robot: sdpid.RobotModel
    task: Task
    columns: Columns
    seconds: float
    arguments: dict[str, Any] = field(default_factory=dict)
    jerk: float = np.inf
    clearance: float | None = None
    table: bool = False
    package_dirs: tuple[Path, ...] = ()
    goal: tuple[float, ...] = ()
    hope: tuple[float, ...] = ()

    @property
    def title(self) -> str:
        """What was asked of the search."""
        objective = self.arguments.get("objective", "mixed")
        if "starts" in self.arguments:
            return f"sdpid, {objective}, {self.arguments['starts']} start"
        return f"sdpid, {objective}, {self.seconds:g} s"


def design(case: Case, seed: int = 0) -> tuple[Any, float]:
    """Return the plan of a case, and what it took in s."""
    from sdpid.excitation.geometry.obstacles import table

    bounds = {key: values.tolist() for key, values in vars(case.task.bounds).items()}
    start = time.perf_counter()
    plan = sdpid.design_excitation(
        case.robot,
        duration=case.task.duration,
        # Others went to the ends of the description's ranges.
        limits=sdpid.Limits(**bounds, jerk=case.jerk, clearance=case.clearance, share=1.0),
        obstacles=(table(),) if case.table else (),
        collisions=case.clearance is not None,
        package_dirs=case.package_dirs,
        # A given number of starts takes as long as it takes.
        time_limit=None if "starts" in case.arguments else case.seconds,
        seed=seed,
        **case.arguments,
    )
    return plan, time.perf_counter() - start


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


def row(case: Case, dense_hz: float, seed: int = 0) -> tuple[Row, Any]:
    """Design one plan and return its row, and the plan."""
    plan, seconds = design(case, seed)
    reached = reached_by(plan, case.robot, dense_hz, case.package_dirs, case.table)
    scored = curve_states(plan.trajectory.series, plan.trajectory.period, SCORE_HZ)
    return (
        row_of(case.name, case.limits, case.title, case.columns, scored, reached, seconds),
        plan,
    )


def ur10e_cases(data: Path) -> Iterator[Case]:
    """Yield the tasks of the UR10e: 20 s, 58 columns."""
    folder = data / "ur10e_innopolis"
    robot = sdpid.load_robot(folder / "ur10e.urdf")
    peer = UrMotion.read(folder / "optimal_trajectories" / "ptrnSrch_N10T20QR.mat")
    columns = Columns(robot, rotors=True, friction=True)
    friction = {"friction": (*FRICTION, "rotor_inertia")}
    by_cond = {**friction, "objective": "condition"}
    known: dict[str, Any] = {"robot": robot, "columns": columns, "name": "UR10e"}
    task = Task(peer.bounds, peer.duration)
    for seconds in (10.0, 60.0):
        yield Case(
            **known,
            limits="of N10T20QR",
            task=task,
            arguments=by_cond,
            seconds=seconds,
            goal=(45.0,),
            hope=(33.0,),
        )
    ends = np.radians([[-180, 180], [-180, 0], [-100, 100], [-180, 0], [-90, 90], [-90, 90]])
    tight = Bounds(
        lower=ends[:, 0],
        upper=ends[:, 1],
        velocity=peer.bounds.velocity,
        acceleration=np.array([2.0, 1.0, 1.0, 1.0, 1.0, 2.5]),
    )
    for seconds in (10.0, 60.0):
        yield Case(
            **known,
            limits="tight",
            task=Task(tight, 20.0),
            arguments=by_cond,
            seconds=seconds,
            goal=(50.0,),
            hope=(37.0,),
        )
    yield Case(
        **known,
        limits="tight, table, 30 mm",
        task=Task(tight, 20.0),
        arguments=friction,
        seconds=30.0,
        clearance=0.03,
        table=True,
        package_dirs=(folder,),
        goal=(65.0, 80.0),
        hope=(52.0, 88.0),
    )


def lwr_cases(data: Path) -> Iterator[Case]:
    """Yield the tasks of the LWR 4+: 12 s, 43 and 64 columns."""
    folder = data / "kuka_lwr4plus"
    robot = sdpid.load_robot(folder / "kuka_lwr4.urdf")
    task = lwr_task(robot, lwr_peer(folder / "flobaroid_excitation.npz"))
    for friction, goal, hope in ((False, 12.0, 7.5), (True, 50.0, 27.0)):
        yield Case(
            name="LWR 4+",
            limits="peer's acceleration",
            robot=robot,
            task=task,
            columns=Columns(robot, rotors=False, friction=friction),
            arguments={"friction": FRICTION if friction else (), "objective": "condition"},
            seconds=10.0,
            goal=(goal,),
            hope=(hope,),
        )


def panda_case() -> Case:
    """Return the seven axes with meshes, above a table, with limits of torque and jerk."""
    robot = sdpid.load_robot("panda_description/panda")
    return Case(
        name="Panda with hand",
        limits="table, 30 mm, 5 rad/s², 100 rad/s³",
        robot=robot,
        task=Task(Bounds.of(robot, acceleration=5.0), 20.0),
        columns=Columns(robot, rotors=False, friction=True),
        arguments={"friction": FRICTION},
        seconds=30.0,
        jerk=100.0,
        clearance=0.03,
        table=True,
    )


def denso_case() -> Case:
    """Return the Denso under the limits of the paper's excitation."""
    robot, task, _ = denso_task()
    return Case(
        name="Denso",
        limits="Table II",
        robot=robot,
        task=task,
        columns=Columns(robot, rotors=False, friction=True),
        arguments={"friction": FRICTION},
        seconds=10.0,
    )


def table_of(rows: Sequence[tuple[Row, Case | None]]) -> Table:
    """Return the rows as a table, with the numbers to reach."""
    columns: dict[str, list[object]] = {
        key: [vars(row)[key] for row, _ in rows] for key in vars(rows[0][0])
    }
    for key in ("goal", "hope"):
        columns[key] = [
            ", ".join(f"{x:g}" for x in getattr(case, key, ())) or None for _, case in rows
        ]
    return Table.of_columns(columns)


def main() -> int:
    """Design, score and check every row."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--only", help="rows of one robot, such as UR10e")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="one plan of the Denso")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    cases = [denso_case()]
    if not options.quick:
        cases.append(panda_case())
        if options.data is None:
            print("UR10e and LWR 4+ are left out: name the data's folder by --data or SDPID_DATA.")
        else:
            cases += [*ur10e_cases(options.data), *lwr_cases(options.data)]
    rows: list[tuple[Row, Case | None]] = []
    for case in cases:
        if options.only not in (None, case.name):
            continue
        if options.quick:
            arguments = {**case.arguments, "starts": 1}
            case = Case(**{**vars(case), "seconds": 2.0, "arguments": arguments})
        dense_hz = 1e3 if options.quick else RATE_HZ
        rows.append((row(case, dense_hz, options.seed)[0], case))
        last = rows[-2][1] if len(rows) > 1 else None
        if last is None or (last.limits, last.columns) != (case.limits, case.columns):
            around = case.name, case.limits, case.robot, case.columns, case.task
            rows.append((random_row(*around, case.seconds, dense_hz), None))
        table_of(rows).write(options.out / "excitation.csv")
        print(table_of(rows[-2:]).text(4), flush=True)
    print(table_of(rows).text(4))
    return 0


if __name__ == "__main__":
    sys.exit(main())
