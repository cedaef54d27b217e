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
from dataclasses import replace
from functools import partial

import numpy as np
from drive_gains import MASS, PAIRS, PUBLISHED, Runs
from simulated_logs import Truth, drawn, log_of, other_log
from study import Rows, Study

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
EACH = (
    *("robot", "load_kg", "change", "arm", "separate", "mass_error", "com_mm", "mass_held"),
    *("com_held", "half_width_mm"),
)


def one(robot: str, load: float, change: float, seed: int) -> Rows:
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
        held = (found.lower[1:4] <= center) & (center <= found.upper[1:4])
        yield (
            *(robot, load, change, seed, name, abs(100.0 * (found.mass / load - 1.0))),
            1e3 * np.linalg.norm(np.asarray(found.com) - center),
            found.lower[0] <= load <= found.upper[0],
            held.mean(),
            1e3 * np.mean(found.upper[1:4] - found.lower[1:4]) / 2.0,
        )


def real(runs: Runs, pair: str, source: str) -> Rows:
    """Yield the mass of the load of a UR10e in a pair of recordings, by published gains."""
    bare, loaded = runs.pairs[pair]
    gains = list(PUBLISHED[source])
    for name, separate in RULES.items():
        found = sdpid.identify_payload(runs.robot, loaded, bare, gains=gains, separate=separate)
        ends = found.lower[0], found.upper[0]
        yield name, found.mass, *ends, *(1e3 * np.asarray(found.com)), found.cost


def main() -> None:
    """Count errors and coverage, and weigh the real load."""
    pairs = [*itertools.product(PAIRS, PUBLISHED)]
    study = Study(
        __doc__,
        data=True,
        quick={"seeds": 1, "robots": [*ROBOTS[:1]], "pairs": 0},
        seeds=(5, "arms of each robot and case"),
        robots=[*ROBOTS],
        pairs=(len(pairs), "pairs of real recordings and gains"),
    )
    axes = study.robots, LOADS, CHANGES, range(study.seeds)
    found = study.rows("payload_friction_each.csv", EACH, one, *axes)
    columns = {
        "arms": "count mass_error",
        "mass_error_percent": "median mass_error",
        "com_error_mm": "median com_mm",
        "worst_com_mm": "max com_mm",
        "mass_held_percent": "percent mass_held",
        "com_held_percent": "percent com_held",
        "half_width_mm": "median half_width_mm",
    }
    study.summary("payload_friction.csv", found, ("load_kg", "change", "separate"), columns)
    runs = Runs(study.data / "ur10e_innopolis", study.out)
    header = ("pair", "gains", "separate", "mass_kg", "lower_kg", "upper_kg", "x_mm", "y_mm")
    wanted = pairs[: study.pairs if runs.folder.is_dir() else 0]
    file, columns = "payload_friction_real.csv", (*header, "z_mm", "cost")
    study.rows(file, columns, partial(real, runs), wanted)
    print(f"the load weighs {MASS} kg")


if __name__ == "__main__":
    main()
