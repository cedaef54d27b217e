"""What a planned motion of a standing robot brings, beside one that sways and a random one.

Solo12, Go1 and A1 in MuJoCo, their links 15 % off the description, stand on all feet and move their
base; that alone is identified, and judged on a walk. Terms of friction are known, not their sizes.

* ``planned``: `sdpid.design_standing` with the description;
* ``sway``: sines of the base in all six directions, up to 2 Hz (the plant's ``stand``);
* ``random``: where the search for the plan starts, a random motion within all limits, one step on.

    python examples/evidence/legged_excitation.py --seeds 3 --out results

``--keep folder`` keeps what each seed gave, and goes on from there.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from legged import Walker, kept

import sdpid
from sdpid._common.tables import Table
from sdpid.experiment.plant.legged.simulate import simulate_legged
from sdpid.experiment.trajectory.whole_body import WholeBodyMotion

ROBOTS = ("solo12", "go1", "a1")
# Steps of the search; None for the motion that no search made.
MOTIONS: dict[str, int | None] = {"planned": 30, "sway": None, "random": 1}
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
    result = sdpid.identify(
        walker.robot,
        run.recording,
        friction=walker.friction,
        effects="none",
        intervals=False,
    )
    joints, force, _ = walker.errors(walker.predicted(result.problem, result.estimate.base))
    mass = abs(walker.mass_error(result.estimate.theta))
    return [joints, force, mass, walker.described[0]]


def rows(
    seeds: int, seconds: float, robots: Sequence[str], most: int | None, folder: Path | None
) -> Iterator[tuple[object, ...]]:
    """Yield a row for each robot and motion: median and worst of all seeds."""
    found: dict[tuple[str, str], list[list[object]]] = {}
    # Seed by seed, so that what is there after an interruption is about all robots.
    for seed in range(seeds):
        for name in robots:
            walker = Walker(name, seed, seconds)
            for motion, steps in MOTIONS.items():
                fewer = steps if steps is None or most is None else min(steps, most)
                row = kept(folder, f"{name}_{seed}_{motion}", partial(cell, walker, fewer))
                print(name, seed, motion, *row, flush=True)
                found.setdefault((name, motion), []).append(row)
    for (name, motion), each in found.items():
        joints, force, mass, described = np.array(each, dtype=float).T
        yield (
            name, motion, len(each),
            *(value for column in (joints, force, mass)
              for value in (float(np.median(column)), float(column.max()))),
            float(np.median(described)),
        )  # fmt: skip


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=ROBOTS)
    parser.add_argument("--keep", type=Path, help="folder for what each seed gave, to go on from")
    parser.add_argument("--quick", action="store_true", help="one robot, one seed, few steps")
    parser.add_argument("--out", type=Path, default=Path("results"))
    chosen = parser.parse_args()
    robots, most = tuple(chosen.robots), None
    if chosen.quick:
        chosen.seeds, chosen.seconds, robots, most = 1, 3.0, ("solo12",), 4
    chosen.out.mkdir(parents=True, exist_ok=True)
    if chosen.keep is not None:
        chosen.keep.mkdir(parents=True, exist_ok=True)
    lines = tuple(rows(chosen.seeds, chosen.seconds, robots, most, chosen.keep))
    Table(COLUMNS, lines).write(chosen.out / "legged_excitation.csv")


if __name__ == "__main__":
    main()
