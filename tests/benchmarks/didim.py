"""DIDIM, which simulates and solves in turn, against one semidefinite program of the same log.

    python -m tests.benchmarks.didim [--repeat 5]

The Denso under its drives' position loop, 28 s at 1 kHz, processed to 1000 samples. The reference
is `solve_sdp` of the problem that DIDIM is given, with and without what comes before it: processing
the log and building the problem.
"""

from __future__ import annotations

import sys

import numpy as np

from sdpid.estimation.output_error.solve import solve_output_error
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.plant.drives import load_drives
from sdpid.experiment.plant.simulate import simulate
from sdpid.experiment.processing.process import process
from sdpid.experiment.simulation.controllers import P
from sdpid.experiment.trajectory.paper import paper_excitation
from sdpid.robot.model.load import load_robot
from tests.benchmarks.timing import Row, print_table, side_by_side

ROBOT, SECONDS = "denso_vp6242", 10.0

# By how much the standard parameters of the other start are off at most.
SPREAD = 0.3


def measure(repeats: int) -> list[Row]:
    """Return the rows of the table."""
    robot, drives = load_robot(ROBOT), load_drives(ROBOT)
    motion = paper_excitation(ROBOT, 0, periods=1, period=SECONDS)
    log = simulate(robot, motion, seed=0, progress=False)
    law = P(drives.proportional_gain, drives.velocity_gain)

    def built() -> Problem:
        return build_problem(robot, process(log, progress=False))

    problem = built()
    near = solve_sdp(problem)
    rng = np.random.default_rng(0)
    far = near.some_theta * (1.0 + SPREAD * rng.uniform(-1.0, 1.0, problem.n_theta))
    starts = {"the optimum of least squares": near, f"parameters off by {SPREAD:.0%}": far}
    actions = [
        lambda start=start: solve_output_error(problem, log, controller=law, start=start)
        for start in starts.values()
    ]
    solve, whole, *timed = side_by_side(
        (lambda: solve_sdp(problem), lambda: solve_sdp(built()), *actions), repeats
    )
    rows = []
    for name, action, seconds in zip(starts, actions, timed, strict=True):
        found = action()
        what = f"from {name}: {found.iterations} iterations, {found.simulations} simulations"
        rows.append(Row.of(what, seconds, "one solve", solve, status=found.status))
        rows.append(Row.of(what, seconds, "processed, built and solved", whole))
    return rows


if __name__ == "__main__":
    sys.exit(print_table("tests.benchmarks.didim", measure))
