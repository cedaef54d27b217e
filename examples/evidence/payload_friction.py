"""What may differ between two recordings whose payload is looked for? Judged where it is known.

Friction changes between a run without and a run with a payload: by nothing, a tenth or three
tenths at every joint, up or down. `sdpid.identify_payload` takes friction as common but for
offsets, or lets every term differ. Counted are errors and how often 95 %
intervals hold the truth, over simulated arms. Of a real UR10e only the mass is known.

    python examples/evidence/payload_friction.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from drive_gains import MASS, PAIRS, PUBLISHED, read
from simulated_logs import Truth, drawn, log_of, other_log
from study import Study, grouped

import sdpid
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


def one(robot: str, load: float, change: float, seed: int) -> Iterator[tuple[object, ...]]:
    """Yield what each rule finds on one arm."""
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
    for name, separate in RULES.items():
        found = sdpid.identify_payload(truth.robot, *both, friction=terms, separate=separate)
        off = np.asarray(found.com) - center
        held = (found.lower[1:4] <= center) & (center <= found.upper[1:4])
        yield (
            *(robot, load, change, seed, name),
            100.0 * (found.mass / load - 1.0),
            1e3 * np.linalg.norm(off),
            found.lower[0] <= load <= found.upper[0],
            held.sum(),
            1e3 * np.mean(found.upper[1:4] - found.lower[1:4]) / 2.0,
            found.cost,
            2 * truth.robot.n,
        )


PAIRED = tuple(itertools.product(PAIRS, PUBLISHED))


def real(folder: Path, out: Path, pair: str, source: str) -> Iterator[tuple[object, ...]]:
    """Yield the mass of the load of a UR10e in a pair of recordings, by published gains."""
    robot = sdpid.load_robot(folder / "ur10e.urdf")
    bare, loaded = (read(robot, folder, name, out) for name in PAIRS[pair])
    gains = list(PUBLISHED[source])
    for name, separate in RULES.items():
        found = sdpid.identify_payload(robot, loaded, bare, gains=gains, separate=separate)
        center = 1e3 * np.asarray(found.com)
        yield (
            pair,
            source,
            name,
            found.mass,
            *found.lower[:1],
            *found.upper[:1],
            *center,
            found.cost,
        )


def main() -> None:
    """Count errors and coverage, and weigh the real load."""
    study = Study(
        __doc__,
        data=True,
        quick={"seeds": 1, "robots": [*ROBOTS[:1]], "pairs": 0},
        seeds=(5, "arms of each robot and case"),
        robots=[*ROBOTS],
        pairs=(len(PAIRED), "pairs of real recordings and gains"),
    )
    cases = itertools.product(study.robots, LOADS, CHANGES, range(study.seeds))
    found = study.rows("payload_friction_each.csv", EACH, cases, lambda case: one(*case))
    rows = []
    for key, own in grouped(found, "load_kg", "change", "separate"):
        mass, com, mass_held, com_held, width = (own[name] for name in EACH[5:10])
        rows.append((
            *key, len(mass), np.median(np.abs(mass)), np.median(com), com.max(),
            100.0 * mass_held.mean(), 100.0 * com_held.mean() / 3.0, np.median(width),
        ))  # fmt: skip
    header = ("load_kg", "change", "separate", "arms", "mass_error_percent", "com_error_mm")
    header += ("worst_com_mm", "mass_held_percent", "com_held_percent", "half_width_mm")
    study.write("payload_friction.csv", header, rows)
    folder = study.data / "ur10e_innopolis"
    header = ("pair", "gains", "separate", "mass_kg", "lower_kg", "upper_kg", "x_mm", "y_mm")
    pairs = PAIRED[: study.pairs if folder.is_dir() else 0]
    file, columns = "payload_friction_real.csv", (*header, "z_mm", "cost")
    study.rows(file, columns, pairs, lambda case: real(folder, study.out, *case))
    print(f"the load weighs {MASS} kg")


if __name__ == "__main__":
    main()
