"""Checking a result from its log, against making and compressing its rows."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from harness import Bench, Row

import sdpid
from sdpid.assurance.certificate.compression import base_limit, enclose_compression
from sdpid.assurance.log_proof.chain.check import check_log
from sdpid.assurance.log_proof.recipe import Recipe
from sdpid.assurance.log_proof.row_error import row_error
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import Problem
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.experiment.preparation.several import prepare_recordings

ROBOT = "denso_vp6242"

# Six joints make a million rows of these, some of which are masked.
_SAMPLES, _RATE_HZ = 175_000, 100.0


def write_log(path: Path, count: int) -> Path:
    """Write a log of half an hour of motion with a period longer than that."""
    robot, rng = sdpid.load_robot(ROBOT), np.random.default_rng(0)
    t = np.arange(count) / _RATE_HZ
    q, v, a = (np.zeros((len(t), robot.n)) for _ in range(3))
    for _ in range(3):
        w, c = rng.uniform(1.0, 6.0, robot.n), rng.uniform(0.0, 6.0, robot.n)
        angle = w * t[:, None] + c
        q, v, a = q + np.sin(angle), v + w * np.cos(angle), a - w**2 * np.sin(angle)
    links = true_parameters(ROBOT)[: 10 * robot.n_links]
    effort = robot.inverse_dynamics(links.reshape(-1, 10), q, v, a) + 2.0 * np.sign(v) + v
    effort += 0.1 * rng.standard_normal(effort.shape)
    np.savez(path, t=t, q=q, tau=effort)
    return path


def measure(bench: Bench) -> Iterator[Row]:
    """Measure the whole check, and its two passes over the rows."""
    with tempfile.TemporaryDirectory() as name:
        folder, file = Path(name) / "results", Path(name) / "run.npz"
        log = write_log(file, bench.size(_SAMPLES, 2_000))
        result = sdpid.identify(
            ROBOT, log, processing={"decimation": 1}, effects="none", intervals=False
        )
        result.save(folder, figures=False)
        problem = result.problem
        print(f"{problem.robot.name}: {problem.samples.n_samples} samples, {problem.n_rows} rows")
        yield from _passes(problem, bench)
        yield _whole(folder, log, problem, bench)


def _passes(problem: Problem, bench: Bench) -> Iterator[Row]:
    """Measure the two proofs on the rows against compressing these."""
    rows, feasible = problem.require_rows_here("benchmark"), problem.feasible
    limit = base_limit(problem.base.matrix, feasible.lower, feasible.upper)
    found = bench.seconds(
        factor=lambda: Factor.of(rows, "residual"),
        enclosing=lambda: enclose_compression(
            rows,
            problem.sigma,
            "residual",
            A=problem.A,
            rhs=problem.rhs,
            floor=problem.floor,
            base_limit=limit,
        ),
        equations=lambda: row_error(rows, problem.sigma, "residual", feasible),
    )
    both = found["enclosing"] + found["equations"]
    yield Row.of("enclose the compression", found["enclosing"], "compress", found["factor"])
    yield Row.of("enclose the rows", found["equations"], "compress", found["factor"])
    yield Row.of("both", both, "compress", found["factor"])


def _whole(folder: Path, log: Path, problem: Problem, bench: Bench) -> Row:
    """Measure the check of a file against reading, processing and compressing it."""
    recipe = Recipe.from_dict(json.loads((folder / "manifest.json").read_text())["recipe"])

    def again() -> Factor:
        read = sdpid.read_recording(log)
        samples = prepare_recordings(problem.robot, read, recipe.processing).samples
        source = RowSource(problem.robot, problem.friction, problem.base, samples)
        return Factor.of(source, "residual")

    found = bench.seconds(checked=lambda: check_log(folder, log), made=again)
    return Row.of("verify --data", found["checked"], "read, process, compress", found["made"])
