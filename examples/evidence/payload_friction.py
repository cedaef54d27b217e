"""What may differ between two recordings whose payload is looked for? Judged where it is known.

Friction changes between a run without and a run with a payload: by nothing, a tenth or three
tenths at every joint, up or down. `sdpid.identify_payload` takes friction as common but for
offsets, or lets every term differ. Counted are errors and how often 95 %
intervals hold the truth, over simulated arms. Of a real UR10e only the mass is known.

    python examples/evidence/payload_friction.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from drive_gains import MASS, PAIRS, PUBLISHED, read
from simulated_logs import Truth, drawn, log_of, other_log

import sdpid
from sdpid._common.tables import Table
from sdpid.experiment.preparation.prepare import default_friction, samples_of
from sdpid.robot.inertia import theta_from_physical

ROBOTS = ("ur10", "panda", "denso")
LOADS = (0.5, 3.0)  # kg
CHANGES = (0.0, 0.1, 0.3)
# What may differ between the runs.
RULES = {
    "common": ("offset",),
    "own": ("coulomb", "viscous", "sigmoid", "stribeck", "asymmetric_coulomb", "load", "offset"),
}
DURATION, RATE = 40.0, 200.0
EACH = ("robot", "load_kg", "change", "arm", "separate", "mass_error_percent", "com_error_mm")
EACH += ("mass_held", "com_held", "half_width_mm", "cost", "parameters")


def main() -> int:
    """Count errors and coverage, and weigh the real load."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", default=os.environ.get("SDPID_DATA"), help="public records")
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--seeds", type=int, default=5, help="arms of each robot and case")
    parser.add_argument("--quick", action="store_true", help="one arm, no real one")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    seeds, robots = (1, ROBOTS[:1]) if options.quick else (options.seeds, ROBOTS)
    rows: list[tuple[object, ...]] = []
    for seed in range(seeds):
        for robot in robots:
            for load in LOADS:
                for change in CHANGES:
                    rows += one(robot, load, change, seed)
    Table(EACH, tuple(rows)).write(options.out / "payload_friction_each.csv")
    summary(rows).write(options.out / "payload_friction.csv")
    if options.data is not None and not options.quick:
        real(Path(options.data) / "ur10e_innopolis", options.out)
    return 0


def one(robot: str, load: float, change: float, seed: int) -> list[tuple[object, ...]]:
    """Return what each rule finds on one arm."""
    usual = drawn(robot, seed)
    conditions = replace(usual, rate_hz=RATE, duration=DURATION, perturbed=0.15)
    bare, truth = log_of(conditions, seed)
    rng = np.random.default_rng([seed, ROBOTS.index(robot), round(10 * load), round(10 * change)])
    center = rng.uniform([-0.05, -0.05, 0.0], [0.05, 0.05, 0.15])
    body = theta_from_physical(load, center, load * np.diag([0.004, 0.004, 0.002]))
    inertias = np.array(truth.inertias)
    inertias[-1] += np.asarray(body).ravel()
    ways = 1.0 + change * rng.choice([-1.0, 1.0], (2, truth.robot.n))
    changed: Truth = replace(
        truth, inertias=inertias, coulomb=ways[0] * truth.coulomb, viscous=ways[1] * truth.viscous
    )
    loaded = other_log(changed, seed)
    terms = default_friction(loaded)
    both = [samples_of(truth.robot, log) for log in (loaded, bare)]
    rows = []
    for name, separate in RULES.items():
        found = sdpid.identify_payload(truth.robot, *both, friction=terms, separate=separate)
        off = np.asarray(found.com) - center
        held = (found.lower[1:4] <= center) & (center <= found.upper[1:4])
        rows.append(
            (
                *(robot, load, change, seed, name),
                100.0 * (found.mass / load - 1.0),
                1e3 * float(np.linalg.norm(off)),
                int(found.lower[0] <= load <= found.upper[0]),
                int(held.sum()),
                1e3 * float(np.mean(found.upper[1:4] - found.lower[1:4]) / 2.0),
                found.cost,
                2 * truth.robot.n,
            )
        )
        print(*rows[-1], flush=True)
    return rows


def summary(rows: list[tuple[object, ...]]) -> Table:
    """Return errors and coverage of each case and rule, over arms."""
    header = ("load_kg", "change", "separate", "arms", "mass_error_percent", "com_error_mm")
    header += ("worst_com_mm", "mass_held_percent", "com_held_percent", "half_width_mm")
    out: list[tuple[object, ...]] = []
    for load in LOADS:
        for change in CHANGES:
            for rule in RULES:
                own = [row for row in rows if (row[1], row[2], row[4]) == (load, change, rule)]
                if not own:
                    continue
                each = np.array([row[5:] for row in own], dtype=np.float64)
                errors = float(np.median(np.abs(each[:, 0]))), float(np.median(each[:, 1]))
                held = 100.0 * float(each[:, 2].mean()), 100.0 * float(each[:, 3].mean() / 3.0)
                worst, width = float(each[:, 1].max()), float(np.median(each[:, 4]))
                out.append((load, change, rule, len(own), *errors, worst, *held, width))
    return Table(header, tuple(out))


def real(folder: Path, out: Path) -> None:
    """Weigh the load of a UR10e in two pairs, by published gains."""
    robot = sdpid.load_robot(folder / "ur10e.urdf")
    rows: list[tuple[object, ...]] = []
    for pair, names in PAIRS.items():
        bare, loaded = (read(robot, folder, name, out) for name in names)
        for source, gains in PUBLISHED.items():
            for name, separate in RULES.items():
                found = sdpid.identify_payload(
                    robot, loaded, bare, gains=list(gains), separate=separate
                )
                ends = float(found.lower[0]), float(found.upper[0])
                center = (1e3 * x for x in found.com.tolist())
                rows.append((pair, source, name, found.mass, *ends, *center, found.cost))
                print(*rows[-1], flush=True)
    header = ("pair", "gains", "separate", "mass_kg", "lower_kg", "upper_kg", "x_mm", "y_mm")
    Table((*header, "z_mm", "cost"), tuple(rows)).write(out / "payload_friction_real.csv")
    print(f"the load weighs {MASS} kg")


if __name__ == "__main__":
    sys.exit(main())
