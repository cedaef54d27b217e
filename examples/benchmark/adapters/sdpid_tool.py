"""Methods of sdpid for the benchmark."""

# /// script
# [tool.benchmark]
# name = "sdpid"
# wrist = true
# methods = [
#   "own rows, defaults",
#   "SDP",
#   "SDP, free friction",
#   "SDP 6×6, tanh",
#   "least squares",
#   "least squares, tanh",
#   "SLSQP",
#   "log-Cholesky",
# ]
#
# [tool.benchmark.bounds]
# "SDP" = "SDP"
# "SDP, free friction" = "SDP, free friction"
# "SDP 6×6, tanh" = "SDP 6×6, tanh"
# "SLSQP" = "SDP"
# "log-Cholesky" = "SDP"
# ///

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from protocol import Answer, Method, Rows, Task, main

import sdpid

FRICTION = ("viscous", "offset")
# As in examples/evidence/real_robots.py, rad/s.
WRIST_WIDTH = 0.05
# FloBaRoID's, 0.02 rad/s.
TANH = sdpid.friction.Coulomb(width=0.02)


def _robot(task: Task) -> Any:
    return sdpid.load_robot(task.urdf)


def _terms(task: Task) -> tuple[Any, ...]:
    """Return the terms of a known drive."""
    if not task.wrist:
        return ()
    return "rotor_inertia", sdpid.friction.Coupling(*task.wrist, width=WRIST_WIDTH)


def _answer(estimate: Any, **facts: float) -> Answer:
    def predict(rows: Rows) -> np.ndarray:
        samples = sdpid.Samples(
            position=rows.position,
            velocity=rows.velocity,
            acceleration=rows.acceleration,
            effort=np.zeros_like(rows.position),
        )
        return np.asarray(sdpid.validate(estimate, samples).effort_predicted)

    links = estimate.problem.robot.n_links
    bodies = None if estimate.theta is None else estimate.theta[: 10 * links].reshape(-1, 10)
    return Answer(predict, bodies, str(estimate.status), facts)


def defaults(task: Task) -> Answer:
    """Return what `sdpid.identify` finds from the log; a known drive is given."""
    log = sdpid.Recording(**task.log, joint_names=task.joints)
    given: dict[str, Any] = {}
    if task.wrist:
        from sdpid.experiment.preparation.prepare import default_friction

        given["friction"] = (*default_friction(log), *_terms(task))
    result = sdpid.identify(_robot(task), log, intervals=False, **given)
    return _answer(result.estimate)


def _on_common(
    solve: Callable[[Any], Any],
    *,
    certified: bool = False,
    coulomb: Any = "coulomb",
    signed: bool = True,
    **options: Any,
) -> Callable[[Task], Answer]:
    """Return a method on the common rows: plain sums of squares, the common friction."""

    def method(task: Task) -> Answer:
        robot = _robot(task)
        samples = sdpid.Samples(**vars(task.common))
        problem = sdpid.build_problem(
            robot,
            samples,
            friction=(coulomb, *FRICTION, *_terms(task)),
            constraints=replace(sdpid.Constraints.of_size(robot), friction_nonnegative=signed),
            **{"weighting": "gls", **options},
        )
        estimate = solve(problem)
        if not certified:
            return _answer(estimate)
        certificate = sdpid.certify(estimate)
        return _answer(
            estimate, bound=certificate.lower_bound, gap=certificate.gap, cost=estimate.cost
        )

    return method


METHODS: dict[str, Method] = {
    "own rows, defaults": defaults,
    "least squares": _on_common(sdpid.solve_wls),
    "least squares, tanh": _on_common(sdpid.solve_wls, coulomb=TANH),
    "SDP": _on_common(sdpid.solve_sdp, certified=True),
    # What two peers solve: friction of any sign; besides, the 6×6 inequality and Coulomb friction
    # as a tanh. FloBaRoID bounds viscous friction, so its optimum lies above this bound.
    "SDP, free friction": _on_common(sdpid.solve_sdp, certified=True, signed=False),
    "SDP 6×6, tanh": _on_common(
        sdpid.solve_sdp,
        certified=True,
        coulomb=TANH,
        signed=False,
        consistency="spatial_inertia",
    ),
    "SLSQP": _on_common(lambda problem: sdpid.solve_slsqp(problem, seed=0)),
    "log-Cholesky": _on_common(lambda problem: sdpid.solve_log_cholesky(problem, seed=0)),
}

if __name__ == "__main__":
    main(METHODS, ("sdpid", "pin", "clarabel", "scipy"))
