"""DIDIM, which simulates and solves in turn, against one semidefinite program of the same log.

The Denso under its drives' position loop, 28 s at 1 kHz, processed to 1000 samples. The reference
is `solve_sdp` of the problem that DIDIM is given, with and without what comes before it: processing
the log and building the problem.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from harness import Bench, Row

from sdpid.estimation.closed_loop.solve import solve_output_error
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.plant.simulate import load_drives, simulate
from sdpid.experiment.processing.process import process
from sdpid.experiment.simulation.controllers import P
from sdpid.experiment.trajectory.paper import paper_excitation
from sdpid.robot.model.load import load_robot

ROBOT = "denso_vp6242"

# By how much the standard parameters of the other start are off at most.
SPREAD = 0.3


def measure(bench: Bench) -> Iterator[Row]:
    """Measure DIDIM from either start."""
    robot, drives = load_robot(ROBOT), load_drives(ROBOT)
    motion = paper_excitation(ROBOT, 0, periods=1, period=bench.size(10.0, 6.0))
    log = simulate(robot, motion, seed=0, progress=False)
    law = P(drives.proportional_gain, drives.velocity_gain)

    def built() -> Problem:
        return build_problem(robot, process(log, progress=False))

    problem = built()
    near = solve_sdp(problem)
    rng = np.random.default_rng(0)
    far = near.some_theta * (1.0 + SPREAD * rng.uniform(-1.0, 1.0, problem.n_theta))
    starts = {"the optimum of least squares": near, f"parameters off by {SPREAD:.0%}": far}
    actions = {
        name: partial(solve_output_error, problem, log, controller=law, start=start)
        for name, start in starts.items()
    }
    seconds = bench.seconds(
        solve=lambda: solve_sdp(problem), whole=lambda: solve_sdp(built()), **actions
    )
    for name, action in actions.items():
        found = action()
        what = f"from {name}: {found.iterations} iterations, {found.simulations} simulations"
        yield Row.of(what, seconds[name], "one solve", seconds["solve"], status=found.status)
        yield Row.of(what, seconds[name], "processed, built and solved", seconds["whole"])
