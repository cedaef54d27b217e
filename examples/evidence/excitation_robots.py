"""Plan for many robots with all defaults, and look whether any limit is broken.

Every robot gets 20 s of motion within the limits of its description. Plans are looked at at 10 kHz
and by Coal on a fine grid with the description's meshes (`dense_check.py`), or with the assumed
shapes where it has none. `optimistic` counts limits of which the plan states more slack than the
grid finds: the plan's bounds hold at every instant, so there may be none.

    python examples/evidence/excitation_robots.py --data DATA --out results

LWR 4+, TX40 and Gen3 are in the folder DATA (or SDPID_DATA), described in docs/evidence/data.md;
the others come with the package's dependencies.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

from data_sets import folders
from dense_check import KINDS, RATE_HZ, Reached, left_of
from excitation import reached_by
from study import Study

import sdpid

# What load_robot takes, and whether a table stands under the arm.
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
OF_THE_DATA = {
    "LWR 4+": "kuka_lwr4plus",
    "TX40": "staubli_tx40",
    "Gen3": "kinova_gen3_dynamapp",
}
# Least distance, m, and what each search may take, s.
CLEARANCE, SECONDS = 0.02, 30.0
HEADER = (
    *("robot", "joints", "table", "seconds", "cond", "log_det", *KINDS, "pairs", "shapes"),
    *("broken", "collisions", "optimistic", "stated"),
)

# Two ways of rounding the same number, relative to it and absolute.
ROUNDING = 1e-9


def optimistic(plan: Any, reached: Sequence[Reached]) -> int:
    """Return how many limits have less slack on the grid than the plan states."""
    stated: dict[tuple[str, str], float] = {}
    for row in plan.limits.rows:
        key = row.kind, row.subject
        stated[key] = min(row.slack, stated.get(key, row.slack))
    found: dict[tuple[str, str], tuple[float, float]] = {}
    for each in reached:
        key = each.kind, each.subject
        found[key] = min((each.slack, abs(each.limit)), found.get(key, (each.slack, 0.0)))
    return sum(
        slack < stated[key] - ROUNDING * (1.0 + size)
        for key, (slack, size) in found.items()
        if key in stated
    )


def rows(name: str, study: Study) -> Iterator[tuple[object, ...]]:
    """Design for one robot and yield the row of the table."""
    from sdpid.excitation.geometry.obstacles import table as table_at

    source, table = ROBOTS[name]
    robot = sdpid.load_robot(study.data / source if name in OF_THE_DATA else source)
    known = name, robot.n, "yes" if table else "no"
    start = time.perf_counter()
    try:
        plan = sdpid.design_excitation(
            robot,
            duration=study.duration,
            limits=sdpid.Limits(clearance=CLEARANCE),
            obstacles=(table_at(),) if table else (),
            time_limit=None if study.quick else SECONDS,
            starts=1,
        )
    except sdpid.errors.SdpidError as error:
        print(f"{name}: no plan, {error}", flush=True)
        yield *known, *(None,) * (len(HEADER) - len(known))
        return
    seconds = time.perf_counter() - start
    reached = reached_by(plan, robot, 1e3 if study.quick else RATE_HZ, (), table)
    least, broken, collisions = left_of(reached)
    yield (
        *(*known, seconds, plan.condition_number, plan.log_det, *least),
        sum(each.kind == "distance" for each in reached),
        "description's" if robot.urdf and "<collision" in robot.urdf else "assumed",
        *(broken, collisions, optimistic(plan, reached)),
        "held" if plan.limits.ok else "not held",
    )


def main() -> None:
    """Design and check a plan for every robot."""
    quick = {"robots": ["Denso"], "duration": 5.0}
    study = Study(__doc__, data=True, quick=quick, robots=[*ROBOTS], duration=(20.0, "s"))
    there = {name for name, _ in folders(study.data, OF_THE_DATA.values())}
    names = [name for name in study.robots if OF_THE_DATA.get(name) in {None, *there}]
    study.rows("excitation_robots.csv", HEADER, names, lambda name: rows(name, study), digits=3)


if __name__ == "__main__":
    main()
