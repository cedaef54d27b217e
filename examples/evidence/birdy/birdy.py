"""BIRDy's benchmark of estimators, rebuilt: two simulated arms whose controllers see noise.

Leboutet, Roux, Janot, Guadarrama-Olvera and Cheng (Applied Sciences 2021, doi 10.3390/app11094303;
github.com/TUM-ICS/BIRDy, MIT) compare estimators on simulated arms of Stäubli (TX40, with and
without the coupling of its wrist) and Mitsubishi (RV2SQ). The numbers are theirs; plant and
estimators are this package's. A run is a motion of 10 s, a log with noise of its own, and a start:
motions and starts are taken in turn.

    python examples/evidence/birdy/birdy.py --runs 100 --out results
    python examples/evidence/birdy/birdy.py --runs 1300 --out results     # as many as the benchmark
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from birdy_figures import Figures, Motion, log
from birdy_methods import GROUPS, Result, group_methods, solved
from birdy_motion import motion
from birdy_robots import NOISE, Benchmark

sys.path.append(str(Path(__file__).resolve().parents[1]))

from study import Study, grouped

from sdpid.robot.model import regressor_kernel

# Motions, which runs take in turn; starts are taken in turn too.
MOTIONS = 10

# One run of so many has what takes long: simulated positions, IV and DIDIM without masks, output
# error, robust costs and `sdpid.identify`.
SELDOM = 4

MAIN = ("lowPosition", "standard", "highPosition")

# Levels of noise of each robot, where noise is fed back and where it is not. The TX40 without the
# coupling of its wrist, with it, and without it but with the sign of Coulomb friction that the
# source has, tanh(100·v), in place of the exact one; the RV2SQ, which has no coupling, and the
# same with logs of half the rate.
LEVELS = {
    "tx40_uncoupled": {"fed_back": tuple(NOISE), "sensor_only": MAIN},
    "tx40": {"fed_back": ("standard",)},
    "tx40_smooth": {"fed_back": MAIN, "sensor_only": MAIN},
    "rv2sq": {"fed_back": tuple(NOISE)},
    "rv2sq_slow": {"fed_back": ("standard",)},
}
# Robots, where noise goes, and its level: runs of one cell differ by chance only.
Cell = tuple[str, str, str]
CELLS: list[Cell] = [
    (robot, noise, level)
    for robot, noises in LEVELS.items()
    for noise, levels in noises.items()
    for level in levels
]
FIGURES = ("error", "mean_relative", "torque", "position", "seconds", "iterations", "simulations")
KEYS = ("robot", "noise", "level", "processing", "method")
# Of one method in one run; figures in %, None where there is none.
COLUMNS = (*KEYS, "run", *FIGURES, "diverged", "note")
HEADER = (*KEYS, "runs", "failed", "diverged", "masked_pc_wls", *FIGURES)


@cache
def prepared(robot: str, number: int, folder: Path) -> tuple[Benchmark, Figures]:
    """Return a robot, and one of its motions with what is compared on it."""
    benchmark = Benchmark.of(robot)
    true = Motion.of(benchmark, motion(benchmark, number, folder))
    return benchmark, Figures.of(benchmark, true)


def run(
    cell: Cell, number: int, groups: Sequence[str], folder: Path
) -> Iterator[tuple[object, ...]]:
    """Yield the rows of a run."""
    robot, noise, level = cell
    benchmark, figures = prepared(robot, number % MOTIONS, folder)
    record = log(benchmark, figures.motion, level, noise, number)
    positions = number % SELDOM == 0 and level in MAIN
    for found in solved(benchmark, record, benchmark.start(number), plan(level, number, groups)):
        known = *cell, found.processing, found.method, number
        yield *known, *judged(figures, found, positions=positions), found.note


def judged(figures: Figures, found: Result, *, positions: bool) -> tuple[object, ...]:
    """Return what a result is worth, and whether its simulation diverges."""
    effort = found.seconds, found.iterations, found.simulations
    if found.base is None:
        return *(None,) * 4, *effort, False
    position = figures.positions(found.base, found.theta) if positions else None
    errors = (figures.parameters, figures.mean_of_parameters, figures.torques)
    shares = (error(found.base) for error in errors)
    return *shares, position, *effort, positions and position is None


def plan(level: str, number: int, groups: Sequence[str]) -> list[tuple[str, str]]:
    """Return processings and methods of a run."""
    wanted = []
    for group in groups:
        for processing, method in group_methods(group):
            if level not in MAIN:
                # Other levels differ little from these.
                planned = processing != "unfiltered" and method in ("WLS", "PC-WLS")
            elif group == "direct":
                planned = True
            elif group in ("instrumental", "didim"):
                planned = processing == "masked" or number % SELDOM == 0
            else:
                planned = number % SELDOM == 0
            if planned:
                wanted.append((processing, method))
    return wanted


def summary(found: Sequence[dict[str, Any]]) -> Iterator[tuple[object, ...]]:
    """Yield medians over the runs of every cell, processing and method.

    Beside them stands the error of the masked PC-WLS of the same runs.
    """
    groups = dict(grouped(found, *KEYS))
    for key in sorted(groups, key=lambda key: (CELLS.index(key[:3]), key)):
        own, beside = groups[key], groups.get((*key[:3], "masked", "PC-WLS"))
        known = ~np.isnan(own["error"].astype(float))
        figures = (middle(own[name][known]) for name in FIGURES)
        same = beside and middle(beside["error"][np.isin(beside["run"], own["run"][known])])
        counts = len(known), int((~known).sum()), int(own["diverged"].sum())
        yield *key, *counts, same, *figures


def middle(values: np.ndarray) -> float | None:
    """Return the median of what is known."""
    values = values.astype(float)
    values = values[~np.isnan(values)]
    return float(np.median(values)) if len(values) else None


def errors(rows: Sequence[dict[str, Any]]) -> Iterator[tuple[object, ...]]:
    """Yield the errors of base parameters, with a column for each level of noise.

    Runs are the fewest of the main levels.
    """
    names = (*KEYS[:2], *KEYS[3:])
    for key, own in grouped(rows, *names):
        of = dict(zip(own["level"], zip(own["runs"], own["error"], strict=True), strict=True))
        runs = min((int(of[level][0]) for level in MAIN if level in of), default=None)
        yield *key, runs, *(of[level][1] if level in of else None for level in NOISE)


def main() -> None:
    """Do all runs, and write the tables."""
    study = Study(
        __doc__,
        quick={"runs": 1, "cells": 1, "methods": ["direct", "instrumental", "didim"]},
        runs=(100, "runs a cell"),
        cells=len(CELLS),
        methods=[*GROUPS],
        jobs=1,
    )
    # Thousands of small logs are worth compiling for, one is not.
    regressor_kernel.WORTH = 0
    folder = study.out / "motions"
    found = study.rows(
        "runs.csv",
        COLUMNS,
        itertools.product(range(study.runs), CELLS[: study.cells]),
        lambda case: run(case[1], case[0], study.methods, folder),
        jobs=study.jobs,
    )
    medians = [dict(zip(HEADER, each, strict=True)) for each in summary(found)]
    study.write("figures.csv", HEADER, (each.values() for each in medians))
    header = (*KEYS[:2], *KEYS[3:], "runs", *NOISE)
    study.write("errors.csv", header, errors(medians))


if __name__ == "__main__":
    main()
