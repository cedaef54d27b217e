"""The record of the simulated Denso that parts are measured on, and its problem."""

from __future__ import annotations

from functools import cache

from harness import Bench

from sdpid.estimation.problem import Problem, build_problem
from sdpid.experiment.plant.simulate import simulate
from sdpid.experiment.processing.process import process
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


@cache
def denso_problem(bench: Bench) -> Problem:
    """Return the problem of the case study's experiment in small: 48 base parameters."""
    log = denso_log(*bench.size((8, 38.0), QUICK))
    problem = build_problem(load_robot(ROBOT), process(log, progress=False))
    print(
        f"{ROBOT}: {log.n_samples} samples of {2 * log.n} channels, "
        f"{problem.samples.n_samples} after processing, {problem.n_rows} rows, "
        f"{problem.n_theta} parameters"
    )
    return problem
