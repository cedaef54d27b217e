"""BIRDy's benchmark of estimators, rebuilt: two simulated arms whose controllers see noise.

Leboutet, Roux, Janot, Guadarrama-Olvera and Cheng (Applied Sciences 2021, doi 10.3390/app11094303;
github.com/TUM-ICS/BIRDy, MIT) compare estimators on simulated arms of Stäubli (TX40, with and
without the coupling of its wrist) and Mitsubishi (RV2SQ). The numbers are theirs; plant and
estimators are this package's. A run is a motion of 10 s, a log with noise of its own, and a start.

    python examples/evidence/birdy/birdy.py --runs 100 --out results
    python examples/evidence/birdy/birdy.py --runs 1300 --out results     # as many as the benchmark

Every run is written to results/runs at once. Started again, the study goes on where it was, and
adds methods or runs that are asked for now; several processes may share the work, one a robot or
one a group of methods. `--runs 0` only makes the tables.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import astuple, dataclass, fields
from functools import cache
from pathlib import Path

import numpy as np
from birdy_figures import Figures
from birdy_logs import NOISES, Motion, log
from birdy_methods import GROUPS, Result, group_methods, solved
from birdy_motion import motion
from birdy_robots import NOISE, ROBOTS, SPREAD, STARTS, Benchmark

from sdpid._common.files import atomic_write_text
from sdpid._common.tables import Table
from sdpid.robot.model import regressor_kernel

# Motions, which runs take in turn; starts are taken in turn too.
MOTIONS = 10

# One run of so many has what takes long, unless `--every` says otherwise: simulated positions, IV
# and DIDIM without masks, output error, robust costs and `sdpid.identify`.
SELDOM = 4

MAIN = ("lowPosition", "standard", "highPosition")

# What the small form does.
QUICK = ["direct", "instrumental", "didim"]


@dataclass(frozen=True)
class Cell:
    """Runs that differ by chance only."""

    robot: str
    noise: str
    level: str

    @property
    def file(self) -> str:
        """Name of the file of its runs."""
        return f"{self.robot}_{self.noise}_{self.level}.csv"


@dataclass(frozen=True)
class Row:
    """One method in one run; figures in %, None where there is none."""

    run: int
    processing: str
    method: str
    error: float | None
    mean_relative: float | None
    torque: float | None
    position: float | None
    diverged: int
    seconds: float
    iterations: int
    simulations: int
    note: str


# Levels of noise of each robot, where noise is fed back and where it is not.
LEVELS = {
    "tx40_uncoupled": {"fed_back": tuple(NOISE), "sensor_only": MAIN},
    "tx40": {"fed_back": ("standard",)},
    "tx40_smooth": {"fed_back": MAIN, "sensor_only": MAIN},
    "rv2sq": {"fed_back": tuple(NOISE)},
    "rv2sq_slow": {"fed_back": ("standard",)},
}


def cells() -> Iterator[Cell]:
    """Yield the cells."""
    for robot, noises in LEVELS.items():
        for noise, levels in noises.items():
            for level in levels:
                yield Cell(robot, noise, level)


@cache
def prepared(robot: str, number: int, folder: Path) -> tuple[Benchmark, Figures]:
    """Return a robot, and one of its motions with what is compared on it."""
    benchmark = Benchmark.of(robot)
    true = Motion.of(benchmark, motion(benchmark, number, folder))
    return benchmark, Figures.of(benchmark, true)


def run(
    cell: Cell, number: int, wanted: list[tuple[str, str]], folder: Path, seldom: int
) -> list[Row]:
    """Return the rows of a run; `wanted` are processings and methods."""
    benchmark, figures = prepared(cell.robot, number % MOTIONS, folder)
    record = log(benchmark, figures.motion, cell.level, cell.noise, number)
    start = benchmark.start(number)
    rows = []
    for found in solved(benchmark, record, start, wanted):
        positions = number % seldom == 0 and cell.level in MAIN
        rows.append(judged(figures, found, number, positions=positions))
    return rows


def judged(figures: Figures, found: Result, number: int, *, positions: bool) -> Row:
    """Return what a result is worth."""
    own = number, found.processing, found.method
    effort = found.seconds, found.iterations, found.simulations, found.note
    if found.base is None:
        return Row(*own, None, None, None, None, 0, *effort)
    position = figures.positions(found.base, found.theta) if positions else None
    return Row(
        *own,
        figures.parameters(found.base),
        figures.mean_of_parameters(found.base),
        figures.torques(found.base),
        position,
        int(positions and position is None),
        *effort,
    )


def plan(cell: Cell, number: int, groups: list[str], seldom: int) -> list[tuple[str, str]]:
    """Return processings and methods of a run."""
    wanted = []
    for group in groups:
        for processing, method in group_methods(group):
            if cell.level not in MAIN:
                # Other levels differ little from these.
                planned = processing != "unfiltered" and method in ("WLS", "PC-WLS")
            elif group == "direct":
                planned = True
            elif group in ("instrumental", "didim"):
                planned = processing == "masked" or number % seldom == 0
            else:
                planned = number % seldom == 0
            if planned:
                wanted.append((processing, method))
    return wanted


def read(path: Path) -> list[dict[str, str]]:
    """Return the rows of a file of runs, none where there is no file."""
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def append(path: Path, rows: list[Row]) -> None:
    """Add rows to a file of runs in one write, so that several processes may."""
    names = [field.name for field in fields(Row)]
    new = not path.is_file()
    lines = [names] if new else []
    lines += [["" if value is None else value for value in astuple(row)] for row in rows]
    with path.open("a", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(lines)


# What others are compared with on the same runs, of which they may have fewer.
COMPARED = ("masked", "PC-WLS")

COLUMNS = ("error", "mean_relative", "torque", "position", "seconds", "iterations", "simulations")
KEYS = ("robot", "noise", "level", "processing", "method")
HEADER = (*KEYS, "runs", "failed", "diverged", "masked_pc_wls", *COLUMNS)


def summary(folder: Path) -> Table:
    """Return medians over the runs of every cell, processing and method."""
    rows = []
    for cell in cells():
        found = defaultdict(list)
        for row in read(folder / cell.file):
            found[row["processing"], row["method"]].append(row)
        for (processing, method), own in sorted(found.items()):
            values = []
            for column in COLUMNS:
                known = [float(row[column]) for row in own if row[column] and row["error"]]
                values.append(float(np.median(known)) if known else None)
            failed = sum(not row["error"] for row in own)
            diverged = sum(int(row["diverged"]) for row in own)
            key = cell.robot, cell.noise, cell.level, processing, method
            done = {row["run"] for row in own if row["error"]}
            others = [row for row in found.get(COMPARED, ()) if row["run"] in done]
            same = [float(row["error"]) for row in others if row["error"]]
            beside = float(np.median(same)) if same else None
            rows.append((*key, len(own), failed, diverged, beside, *values))
    return Table(HEADER, tuple(rows))


def errors(table: Table) -> Table:
    """Return the errors of base parameters, with a column for each level of noise.

    Runs are the fewest of the main levels.
    """
    place, count = table.header.index("error"), table.header.index("runs")
    rows: dict[tuple[object, ...], dict[object, tuple[object, ...]]] = defaultdict(dict)
    for row in table.rows:
        robot, noise, level, processing, method = row[:5]
        rows[robot, noise, processing, method][level] = row
    lines = []
    for key, found in rows.items():
        runs = min((row[count] for level, row in found.items() if level in MAIN), default=None)
        values = [found[level][place] if level in found else None for level in NOISE]
        lines.append((*key, runs, *values))
    return Table(("robot", "noise", "processing", "method", "runs", *NOISE), tuple(lines))


def main() -> int:
    """Do what is missing of every run, and write the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--runs", type=int, default=100, help="runs a cell")
    parser.add_argument("--robot", action="append", choices=ROBOTS, help="default all")
    parser.add_argument("--methods", action="append", choices=GROUPS, help="default all")
    parser.add_argument("--only", action="append", help="a method, such as PC-DIDIM; default all")
    parser.add_argument("--noise", action="append", choices=NOISES, help="default both")
    parser.add_argument("--level", action="append", choices=tuple(NOISE), help="default all")
    parser.add_argument("--every", type=int, default=SELDOM, help="runs to one of what takes long")
    parser.add_argument("--quick", action="store_true", help="one run of one cell")
    options = parser.parse_args()
    # Thousands of small logs are worth compiling for, one is not.
    regressor_kernel.WORTH = 0
    folder = options.out / "runs"
    folder.mkdir(parents=True, exist_ok=True)
    chosen = [
        cell
        for cell in cells()
        if cell.robot in (options.robot or ROBOTS)
        and cell.noise in (options.noise or NOISES)
        and cell.level in (options.level or NOISE)
    ]
    if options.quick:
        chosen = [Cell("tx40_uncoupled", "fed_back", "lowPosition")]
    groups = options.methods or (QUICK if options.quick else list(GROUPS))
    done = {
        (cell, int(row["run"]), row["processing"], row["method"])
        for cell in chosen
        for row in read(folder / cell.file)
    }
    for number in range(1 if options.quick else options.runs):
        for cell in chosen:
            wanted = [
                key
                for key in plan(cell, number, groups, options.every)
                if (cell, number, *key) not in done
                if not options.only or key[1] in options.only
            ]
            if wanted:
                rows = run(cell, number, wanted, options.out / "motions", options.every)
                append(folder / cell.file, rows)
    table = summary(folder)
    table.write(options.out / "figures.csv")
    errors(table).write(options.out / "errors.csv")
    spread = f"{STARTS} starts of {100.0 * SPREAD:.0f} %, {MOTIONS} motions\n\n"
    atomic_write_text(options.out / "figures.txt", spread + table.text() + "\n")
    print(f"{len(table.rows)} medians in {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
