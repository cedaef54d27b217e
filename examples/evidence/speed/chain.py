"""What comes before the rows: importing and processing."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from functools import cache, partial

import numpy as np
from harness import Bench, Row

from sdpid.estimation.problem import Problem, build_problem
from sdpid.experiment.plant.simulate import simulate
from sdpid.experiment.processing.filters import low_pass
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.trajectory.paper import paper_excitation
from sdpid.robot.model.load import load_robot

ROBOT = "denso_vp6242"

# Periods, and seconds of one, of records that are only to show that all runs.
QUICK = (8, 6.0)


@cache
def denso_log(periods: int | None, period: float | None) -> Recording:
    """Return a record of the simulated Denso; by default as long as the paper's."""
    trajectory = paper_excitation(ROBOT, 0, periods=periods, period=period)
    return simulate(load_robot(ROBOT), trajectory, seed=0, progress=False)


def short_log(bench: Bench) -> Recording:
    """Return a record of the case study's experiment in small."""
    return denso_log(*bench.size((8, 38.0), QUICK))


@cache
def denso_problem(bench: Bench) -> Problem:
    """Return its problem: 48 base parameters."""
    log = short_log(bench)
    problem = build_problem(load_robot(ROBOT), process(log, progress=False))
    print(
        f"{ROBOT}: {log.n_samples} samples of {2 * log.n} channels, "
        f"{problem.samples.n_samples} after processing, {problem.n_rows} rows, "
        f"{problem.n_theta} parameters"
    )
    return problem


def processing(bench: Bench) -> Iterator[Row]:
    """Measure `process` against filtering positions and efforts once."""
    from scipy.signal import sosfiltfilt

    log, settings = short_log(bench), Processing()
    filter_ = low_pass("butterworth", settings.cutoff_hz, settings.order, log.rate_hz)
    # SciPy asks for writable arrays.
    sections = np.array(filter_.sections)
    # Channel by channel in memory, as it is fastest.
    channels = np.ascontiguousarray(np.hstack([log.position, log.effort]).T)
    found = bench.seconds(
        whole=lambda: process(log, settings, progress=False),
        once=lambda: sosfiltfilt(sections, channels),
    )
    yield Row.of("process", found["whole"], "one sosfiltfilt", found["once"])


def importing(bench: Bench) -> Iterator[Row]:
    """Measure ``import sdpid`` in fresh interpreters, whose own start is not counted."""
    found = bench.in_turn({name: partial(_seconds_to_import, name) for name in ("sdpid", "numpy")})
    ours, reference = (np.array(each) for each in found.values())
    yield Row.of("import sdpid", ours, "import numpy", reference)


def _seconds_to_import(name: str) -> float:
    code = f"from time import perf_counter as t; b = t(); import {name}; print(t() - b)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout)
