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

import argparse
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dense_check import RATE_HZ, Reached
from excitation import reached_by
from excitation_baselines import KINDS, slack_of

import sdpid
from sdpid._common.tables import Table

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
OF_THE_DATA = ("LWR 4+", "TX40", "Gen3")

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


def run(name: str, source: str | Path, table: bool, options: argparse.Namespace) -> dict[str, Any]:
    """Design for one robot and return the row of the table."""
    from sdpid.excitation.geometry.obstacles import table as table_at

    robot = sdpid.load_robot(source)
    start = time.perf_counter()
    row: dict[str, Any] = {"robot": name, "joints": robot.n, "table": "yes" if table else "no"}
    try:
        plan = sdpid.design_excitation(
            robot,
            duration=options.duration,
            limits=sdpid.Limits(clearance=options.clearance),
            obstacles=(table_at(),) if table else (),
            time_limit=None if options.quick else options.seconds,
            starts=1,
            seed=options.seed,
        )
    except sdpid.errors.SdpidError as error:
        print(f"{name}: no plan, {error}", flush=True)
        return row
    row["seconds"] = time.perf_counter() - start
    reached = reached_by(plan, robot, 1e3 if options.quick else RATE_HZ, (), table)
    apart = [each for each in reached if each.kind == "distance"]
    row |= {"cond": plan.condition_number, "log_det": plan.log_det}
    row |= {
        kind: min((slack_of(r) for r in reached if r.kind == kind), default=None) for kind in KINDS
    }
    row |= {
        "pairs": len(apart),
        "shapes": "description's" if robot.urdf and "<collision" in robot.urdf else "assumed",
        "broken": sum(not each.held for each in reached if each.kind != "distance"),
        "collisions": sum(not each.held for each in apart),
        "optimistic": optimistic(plan, reached),
        "stated": "held" if plan.limits.ok else "not held",
    }
    return row


def main() -> int:
    """Design and check a plan for every robot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--robot", action="append", choices=tuple(ROBOTS), help="default: all")
    parser.add_argument("--duration", type=float, default=20.0, help="s")
    parser.add_argument("--seconds", type=float, default=30.0, help="of each search")
    parser.add_argument("--clearance", type=float, default=0.02, help="m")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="the Denso")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.quick:
        options.robot, options.duration = ["Denso"], 5.0
    rows: list[dict[str, Any]] = []
    for name in options.robot or ROBOTS:
        source, table = ROBOTS[name]
        if name in OF_THE_DATA and options.data is None:
            print(f"{name}: left out, name the folder of the data by --data or SDPID_DATA.")
            continue
        path = options.data / source if name in OF_THE_DATA else source
        rows.append(run(name, path, table, options))
        keys = dict.fromkeys(key for row in rows for key in row)
        found = Table.of_columns({key: [row.get(key) for row in rows] for key in keys})
        found.write(options.out / "excitation_robots.csv")
        print(found.text(3), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
