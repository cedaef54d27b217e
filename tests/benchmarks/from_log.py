"""Checking a result from its log, against making and compressing its rows.

python -m tests.benchmarks --only log [--repeat 5]
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import sdpid
from sdpid.assurance.certificate.compression import base_limit, enclose_compression
from sdpid.assurance.log_proof.chain.check import check_log
from sdpid.assurance.log_proof.recipe import Recipe
from sdpid.assurance.log_proof.row_error import row_error
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.several import prepare_recordings
from tests.benchmarks.timing import Row, side_by_side

ROBOT = "denso_vp6242"

# Six joints make a million rows of these, some of which are masked.
_SAMPLES, _RATE = 175_000, 100.0

_PROCESSING = {"decimation": 1}


def write_log(path: Path) -> Path:
    """Write a log of half an hour of motion with a period longer than that."""
    robot, rng = sdpid.load_robot(ROBOT), np.random.default_rng(0)
    t = np.arange(_SAMPLES) / _RATE
    q, v, a = (np.zeros((len(t), robot.n)) for _ in range(3))
    for _ in range(3):
        w, c = rng.uniform(1.0, 6.0, robot.n), rng.uniform(0.0, 6.0, robot.n)
        angle = w * t[:, None] + c
        q, v, a = q + np.sin(angle), v + w * np.cos(angle), a - w**2 * np.sin(angle)
    from sdpid.experiment.plant.simulate import true_parameters

    links = true_parameters(ROBOT)[: 10 * robot.n_links]
    effort = robot.inverse_dynamics(links.reshape(-1, 10), q, v, a) + 2.0 * np.sign(v) + v
    effort += 0.1 * rng.standard_normal(effort.shape)
    np.savez(path, t=t, q=q, tau=effort)
    return path


def saved(log: Path, folder: Path) -> Problem:
    """Identify from the log and save the results."""
    result = sdpid.identify(ROBOT, log, processing=_PROCESSING, effects="none", intervals=False)
    result.save(folder, figures=False)
    return result.problem


def measure(repeats: int) -> Iterator[Row]:
    """Measure the whole check, and its two passes over the rows."""
    with tempfile.TemporaryDirectory() as name:
        folder, log = Path(name) / "results", write_log(Path(name) / "run.npz")
        problem = saved(log, folder)
        print(f"{problem.robot.name}: {problem.samples.n_samples} samples, {problem.n_rows} rows")
        yield from _passes(problem, repeats)
        yield from _whole(folder, log, problem, repeats)


def _passes(problem: Problem, repeats: int) -> Iterator[Row]:
    """Measure the two proofs on the rows against compressing these."""
    rows, feasible = problem.require_rows_here("benchmark"), problem.feasible
    limit = base_limit(problem.base.matrix, feasible.lower, feasible.upper)
    seconds = side_by_side(
        (
            lambda: Factor.of(rows, "residual"),
            lambda: enclose_compression(
                rows,
                problem.sigma,
                "residual",
                A=problem.A,
                rhs=problem.rhs,
                floor=problem.floor,
                base_limit=limit,
            ),
            lambda: row_error(rows, problem.sigma, "residual", feasible),
        ),
        repeats,
    )
    factor, enclosing, equations = seconds
    yield Row.of("enclose the compression", enclosing, "compress", factor)
    yield Row.of("enclose the rows", equations, "compress", factor)
    yield Row.of("both", enclosing + equations, "compress", factor)


def _whole(folder: Path, log: Path, problem: Problem, repeats: int) -> Iterator[Row]:
    """Measure the check of a file against reading, processing and compressing it."""
    recipe = Recipe.from_dict(json.loads((folder / "manifest.json").read_text())["recipe"])

    def again() -> Factor:
        read = sdpid.read_recording(log)
        samples = prepare_recordings(problem.robot, read, recipe.processing).samples
        source = RowSource(problem.robot, problem.friction, problem.base, samples)
        return Factor.of(source, "residual")

    checked, made = side_by_side((lambda: check_log(folder, log), again), repeats)
    yield Row.of("verify --data", checked, "read, process, compress", made)
