"""What a planned motion of a standing robot brings, beside one that sways and a random one.

Solo12, Go1 and A1 in MuJoCo, their links 15 % off the description, stand on all feet and move their
base; that alone is identified, and judged on a walk. Terms of friction are known, not their sizes.

* ``planned``: `sdpid.design_standing` with the description;
* ``sway``: sines of the base in all six directions, up to 2 Hz (the plant's ``stand``);
* ``random``: where the search for the plan starts, a random motion within all limits, one step on.

    python examples/evidence/legged_excitation.py --seeds 3 --out results
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from legged import Walker
from study import Study, grouped

import sdpid
from sdpid.experiment.plant.legged.simulate import simulate_legged
from sdpid.experiment.trajectory.whole_body import WholeBodyMotion

ROBOTS = ("solo12", "go1", "a1")
# Steps of the search; None for the motion that no search made.
MOTIONS: dict[str, int | None] = {"planned": 30, "sway": None, "random": 1}
CELL = ("robot", "motion", "seed", "joints", "base_force", "mass", "description_joints")
COLUMNS = (
    "robot", "motion", "seeds", "joints_percent", "joints_worst_percent",
    "base_force_n", "base_force_worst_n", "mass_percent", "mass_worst_percent",
    "description_joints_percent",
)  # fmt: skip


def cell(walker: Walker, steps: int | None) -> list[object]:
    """Return errors on the walk of what a stand identifies, and those of the description."""
    motion: str | WholeBodyMotion = "stand"
    if steps is not None:
        # The plan knows the description alone; its seed is that of the robot.
        motion = sdpid.design_standing(
            walker.robot,
            duration=walker.seconds,
            steps=steps,
            seed=walker.seed,
            progress=False,
        ).motion
    run = simulate_legged(
        walker.robot,
        motion,
        theta=walker.theta,
        duration=walker.seconds,
        seed=10 * walker.seed,
        friction=walker.law,
    )
    result = walker.identify([run.recording])
    return [*walker.judged(result.estimate), walker.described[0]]


def main() -> None:
    """Write the table: medians and worst of all seeds."""
    study = Study(
        __doc__,
        quick={"seeds": 1, "seconds": 3.0, "robots": ["solo12"], "most": 4},
        seeds=3,
        seconds=10.0,
        robots=[*ROBOTS],
        most=(max(filter(None, MOTIONS.values())), "steps of a search"),
    )

    def cells(case: tuple[int, str, str]) -> Iterator[tuple[object, ...]]:
        seed, name, motion = case
        steps = MOTIONS[motion]
        walker = Walker(name, seed, study.seconds)
        yield name, motion, seed, *cell(walker, steps and min(steps, study.most))

    # Seed by seed, so that what is there after an interruption is about all robots.
    cases = itertools.product(range(study.seeds), study.robots, MOTIONS)
    found = study.rows("cells.csv", CELL, cases, cells)
    rows = []
    for key, own in grouped(found, "robot", "motion"):
        sizes = (own[each] for each in CELL[3:6])
        ends = (value for each in sizes for value in (np.median(each), each.max()))
        rows.append((*key, len(own["seed"]), *ends, np.median(own[CELL[6]])))
    study.write("legged_excitation.csv", COLUMNS, rows)


if __name__ == "__main__":
    main()
