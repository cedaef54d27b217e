"""Methods that simulate the closed loop: instrumental variables, DIDIM and output error."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from birdy_robots import Benchmark

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem

# Rounds of simulation at most, and the change at which they end, as in the benchmark.
ROUNDS, TOLERANCE = 10, 0.025

METHODS = ("IV", "PC-IV", "DIDIM", "PC-DIDIM", "CLOE", "PC-CLOE")


def solver(
    benchmark: Benchmark,
    problem: Problem,
    log: sdpid.Recording,
    processing: sdpid.Processing,
    method: str,
    start: Array,
) -> Callable[[], Estimate]:
    """Return what solves a problem by one of `METHODS`; consistent ones are called PC."""
    consistent = method.startswith("PC-")
    if not consistent:
        problem = problem.constrained(consistency="none")
    options: dict[str, Any] = {
        "processing": processing,
        "controller": benchmark.controller,
        "max_iterations": ROUNDS,
        "tolerance": TOLERANCE,
    }
    if method.endswith("IV"):
        solve = sdpid.solve_sdp if consistent else sdpid.solve_wls
        options |= {"solver": solve, "start": benchmark.model(start)}
        return partial(sdpid.solve_instrumental, problem, log, **options)
    kind = "didim" if method.endswith("DIDIM") else "closed_loop"
    # DIDIM hardly depends on the controller; output error does, on its delay too.
    rate = benchmark.rate_hz if kind == "closed_loop" else None
    options |= {"method": kind, "start": start, "control_hz": rate}
    return partial(sdpid.solve_output_error, problem, log, **options)
