"""Direct and inverse dynamics: least squares with the regressor of the simulated motion."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from sdpid.estimation.compression.covariance import JointRows
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.estimate import Estimate, Status, Step
from sdpid.estimation.information import require_excitation
from sdpid.estimation.output_error.followed import ClosedLoop, Followed
from sdpid.estimation.output_error.rows import cost_in, linearized
from sdpid.estimation.output_error.starts import Solver
from sdpid.estimation.output_error.trials import Trial, compared
from sdpid.estimation.problem import Problem


@dataclass(eq=False)
class Search:
    """What the iterations have found so far.

    Attributes
    ----------
    estimate : Estimate
        Of the last linearized problem.
    followed : Followed
        The motion simulated last.
    history : list of Step
        One an iteration.
    simulations : int
        How often all recordings were simulated.
    status : str
        ``"optimal"`` where the iterations settled.
    """

    estimate: Estimate
    followed: Followed
    history: list[Step]
    simulations: int
    status: Status


def iterate(
    problem: Problem,
    loop: ClosedLoop,
    start: Estimate,
    followed: Followed,
    solver: Solver,
    max_iterations: int,
    tolerance: float,
) -> Search:
    """Solve for the measured efforts with the regressor of the motion simulated last.

    `followed` is the motion of the start.

    Feedback keeps the simulated motion near the commanded one whatever the parameters are. So its
    regressor hardly depends on them, and holds no noise of the encoders.
    """
    begin = time.perf_counter()
    rows = problem.require_rows_here("output error")
    estimate, trials = start, list[Trial]()
    status: Status = "iteration limit"
    for count in range(1, max_iterations + 1):
        simulated = RowSource(rows.robot, rows.friction, rows.base, loop.samples(followed))
        linear, joints = _linear(problem, simulated)
        if problem.prior is None:
            require_excitation(linear.excitation)
        found = solver(linear)
        seconds, violation = time.perf_counter() - begin, found.violation or 0.0
        if joints is None:
            trials.append(Trial(seconds, None, found.cost, None, violation))
        else:
            squares = joints.squared_residuals(found.base)
            variances = np.diagonal(linear.sigma)
            trials.append(Trial(seconds, squares, found.cost, variances, violation))
        drop = cost_in(linear, estimate) - found.cost
        estimate = found
        followed = loop.require(found.model(), f"iteration {count}")
        if drop <= tolerance * max(found.cost, np.finfo(float).tiny):
            status = "optimal"
            break
    return Search(estimate, followed, compared(trials), 1 + len(trials), status)


def _linear(problem: Problem, rows: RowSource) -> tuple[Problem, JointRows | None]:
    """Return the problem of other rows, and these joint by joint where variances are from them."""
    if problem.weighting != "residual":
        return linearized(problem, rows, Factor.of(rows, problem.weighting)), None
    joints = JointRows.merged(rows.map(JointRows.of))
    return linearized(problem, rows, Factor.of_joints(rows, joints)), joints
