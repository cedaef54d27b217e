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

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from birdy_methods import GROUPS, Run
from birdy_motion import motion
from birdy_robots import NOISE, Benchmark

sys.path.append(str(Path(__file__).resolve().parents[1]))

from study import Rows, Study, grouped, known

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import RowSource
from sdpid.robot.model import regressor_kernel

# Motions, which runs take in turn; starts are taken in turn too.
MOTIONS = 10

# One run of so many has what takes long: simulated positions, IV and DIDIM without masks, output
# error, robust costs and `sdpid.identify`.
SELDOM = 4

# Torques are compared at about as many instants of the desired motion.
INSTANTS = 500

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
CELLS = [
    (robot, noise, level)
    for robot, noises in LEVELS.items()
    for noise, levels in noises.items()
    for level in levels
]
FIGURES = ("error", "torque", "position", "seconds", "iterations", "simulations")
KEYS = ("robot", "noise", "level", "processing", "method")
# Of one method in one run; figures in %, None where there is none.
COLUMNS = (*KEYS, "run", *FIGURES, "diverged", "note")


@dataclass(frozen=True, eq=False)
class Motion:
    """A desired motion, what the true robot makes of it, and figures of merit on it.

    Attributes
    ----------
    benchmark : Benchmark
        The robot.
    wanted : ndarray, shape (3, N, 6)
        Desired positions, velocities and accelerations, at the log's rate.
    """

    benchmark: Benchmark
    wanted: Array

    def _simulated(self, theta: Array, **how: Any) -> Any:
        """Return the motion of a robot; fewer samples where it diverges."""
        own = self.benchmark
        return sdpid.simulate_closed_loop(
            own.model(theta), tuple(self.wanted), own.controller, rate_hz=own.sample_hz, **how
        )

    def _seen(self, encoder: Array | None = None, rng: Any = 0) -> Any:
        """Return the true robot's motion, the encoders' noise going through the controller.

        The controller differentiates what it sees, without any noise too.
        """
        how = {"control_hz": self.benchmark.rate_hz, "differenced": True}
        return self._simulated(self.benchmark.theta, position_noise=encoder, seed=rng, **how)

    @cached_property
    def clean(self) -> Any:
        """The true robot's motion without noise."""
        return self._seen()

    def log(self, level: str, noise: str, seed: int) -> sdpid.Recording:
        """Return the log of a run.

        The encoders' noise goes through the controller into the motion, as in the benchmark (fed
        back), or into the log only.
        """
        rng = np.random.default_rng([seed, 29])
        encoder, sensor = self.benchmark.noise(level)
        moved = self._seen(encoder, rng) if noise == "fed_back" else self.clean
        position = moved.measured
        if noise != "fed_back":
            position = position + encoder * rng.standard_normal(position.shape)
        return sdpid.Recording(
            time=np.arange(len(position)) / self.benchmark.sample_hz,
            position=position,
            effort=moved.effort + sensor * rng.standard_normal(position.shape),
            joint_names=self.benchmark.robot.joint_names,
            reference=self.wanted[0],
        )

    @cached_property
    def regressor(self) -> Array:
        """The regressor of the desired motion, (…, 6, b)."""
        own = self.benchmark
        q, v, a = self.wanted[:, :: max(1, self.wanted.shape[1] // INSTANTS)]
        samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=0.0 * q)
        return RowSource(own.robot, own.terms, own.base, samples).regressor(slice(None))

    def error(self, base: Array) -> float:
        """Return ‖error‖ / ‖truth‖ of the base parameters in %."""
        truth = self.benchmark.truth
        return 100.0 * float(np.linalg.norm(base - truth) / np.linalg.norm(truth))

    def torques(self, base: Array) -> float:
        """Return the mean over the instants of ‖error‖ / ‖torque‖ in %."""
        true = np.linalg.norm(self.regressor @ self.benchmark.truth, axis=1)
        missed = np.linalg.norm(self.regressor @ (base - self.benchmark.truth), axis=1)
        return 100.0 * float(np.mean(missed / true))

    def positions(self, base: Array, theta: Array | None) -> float | None:
        """Return the mean over the instants of ‖error‖ / ‖position‖ in %; None where it diverges.

        Of a continuous controller without noise, for the truth as well. Parameters that no bodies
        have do as well as any others of the same base parameters, as long as the mass matrix is
        positive definite.
        """
        if theta is None:
            B = self.benchmark.base.matrix
            theta = self.benchmark.theta + np.linalg.lstsq(B, base - self.benchmark.truth)[0]
        true, position = self._true_position, self._simulated(theta).position
        if len(position) < len(true):
            return None
        size = np.linalg.norm(true, axis=1)
        return 100.0 * float(np.mean(np.linalg.norm(position - true, axis=1) / size))

    @cached_property
    def _true_position(self) -> Array:
        return self._simulated(self.benchmark.theta).position


@cache
def prepared(robot: str, number: int, folder: Path) -> Motion:
    """Return one of the motions of a robot."""
    benchmark = Benchmark(robot)
    return Motion(benchmark, motion(benchmark, number, folder))


def rows(
    groups: Sequence[str], folder: Path, number: int, robot: str, noise: str, level: str
) -> Rows:
    """Yield the rows of a run."""
    own = prepared(robot, number % MOTIONS, folder)
    log, start = own.log(level, noise, number), own.benchmark.start(number)
    simulated = number % SELDOM == 0 and level in MAIN
    for found in Run(own.benchmark, log, start).solved(plan(level, number, groups)):
        labels, effort = (robot, noise, level, found.processing, found.method, number), found.effort
        if found.base is None:
            yield *labels, None, None, None, *effort, False, found.note
            continue
        position = own.positions(found.base, found.theta) if simulated else None
        errors = own.error(found.base), own.torques(found.base), position
        yield *labels, *errors, *effort, simulated and position is None, ""


def plan(level: str, number: int, groups: Sequence[str]) -> list[tuple[str, str]]:
    """Return processings and methods of a run."""
    wanted = []
    for group in groups:
        processings, methods = GROUPS[group]
        for processing in processings:
            if level not in MAIN:
                # Other levels differ little from these.
                own = [name for name in methods if name in ("WLS", "PC-WLS")]
                planned = processing != "unfiltered"
            else:
                own = [*methods]
                planned = group == "direct" or number % SELDOM == 0
                planned |= group in ("instrumental", "didim") and processing == "masked"
            wanted += [(processing, method) for method in own if planned]
    return wanted


def summary(found: Sequence[dict[str, Any]]) -> Rows:
    """Yield medians over the runs of every cell, processing and method.

    Beside them stands the error of the masked PC-WLS of the same runs.
    """
    groups = dict(grouped(found, *KEYS))
    for key in sorted(groups, key=lambda key: (CELLS.index(key[:3]), key)):
        own, beside = groups[key], groups.get((*key[:3], "masked", "PC-WLS"))
        solved = ~np.isnan(own["error"].astype(float))
        figures = (middle(own[name][solved]) for name in FIGURES)
        same = beside and middle(beside["error"][np.isin(beside["run"], own["run"][solved])])
        counts = len(solved), (~solved).sum(), own["diverged"].sum()
        yield *key, *counts, same, *figures


def middle(values: Array) -> float | None:
    """Return the median of what is known."""
    values = known(values)
    return float(np.median(values)) if len(values) else None


def errors(rows: Sequence[dict[str, Any]]) -> Rows:
    """Yield the errors of base parameters, with a column for each level of noise.

    Runs are the fewest of the main levels.
    """
    for key, own in grouped(rows, *KEYS[:2], *KEYS[3:]):
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
    rows_of = partial(rows, study.methods, study.out / "motions")
    axes = range(study.runs), CELLS[: study.cells]
    found = study.rows("runs.csv", COLUMNS, rows_of, *axes, jobs=study.jobs)
    header = (*KEYS, "runs", "failed", "diverged", "masked_pc_wls", *FIGURES)
    medians = study.write("figures.csv", header, summary(found))
    study.write("errors.csv", (*KEYS[:2], *KEYS[3:], "runs", *NOISE), errors(medians))


if __name__ == "__main__":
    main()
