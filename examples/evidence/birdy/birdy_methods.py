"""The methods that are compared, each from a log to an estimate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from birdy_robots import Benchmark

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem

# What the benchmark's "no filter" lets through: MATLAB's decimate filters at 0.8 of half the rate
# that is left, with order 8. Where nothing is left out (138.9 Hz) next to nothing is filtered.
UNFILTERED_SHARE, UNFILTERED_ORDER, UNFILTERED_TOP = 0.4, 8, 0.499

# Logs are decimated to this rate, Hz; those of 138.9 Hz stay as they are.
DECIMATED_HZ = 500.0

# "filtered" is the benchmark's. Logs of 69.4 Hz cannot have its cut-off: theirs is the same share
# of the rate as that of logs of 138.9 Hz.
CUTOFF_HZ, CUTOFF_SHARE, ORDER = 50.0, 0.36, 4

# "masked" filters friction's columns as it filters torques, leaves out what the filter smears about
# a reversal, for a period of the cut-off, and differentiates to a higher order: without noise that
# takes the error of base parameters from 0.28 to 0.03 % on the RV2SQ.
REVERSAL_SPEED = 0.05

# Rounds of simulation at most, and the change at which they end, as in the benchmark.
ROUNDS, TOLERANCE = 10, 0.025

# Samples that are cut off at either end of the log, once it is filtered.
CUT = 50

# Methods that simulate the closed loop.
CLOSED_LOOP = ("IV", "PC-IV", "DIDIM", "PC-DIDIM", "CLOE", "PC-CLOE")

PROCESSINGS = ("unfiltered", "filtered", "masked")

# Groups of methods, which are run together or apart: processings and methods. Robust ones take
# seconds where logs hold outliers, which filters smear; "identify" processes as it sees fit.
GROUPS = {
    "direct": (PROCESSINGS, ("OLS", "WLS", "PC-OLS", "PC-WLS")),
    "instrumental": (PROCESSINGS, ("IV", "PC-IV")),
    "didim": (PROCESSINGS, ("DIDIM", "PC-DIDIM")),
    "output_error": (("masked",), ("CLOE", "PC-CLOE")),
    "identify": (("default",), ("identify",)),
    "robust": (("filtered", "masked"), ("IRLS", "PC-IRLS")),
}
SOLVERS: dict[str, Callable[[Problem], Estimate]] = {
    "OLS": sdpid.solve_wls,
    "PC-OLS": sdpid.solve_sdp,
    "WLS": sdpid.solve_wls,
    "PC-WLS": sdpid.solve_sdp,
    "IRLS": partial(sdpid.solve_robust, solver=sdpid.solve_wls),
    "PC-IRLS": sdpid.solve_robust,
}


def processing(benchmark: Benchmark, name: str) -> sdpid.Processing:
    """Return one of `PROCESSINGS` for a robot's logs."""
    rate = benchmark.sample_hz
    decimation = max(1, round(rate / DECIMATED_HZ))
    plain = sdpid.Processing(
        cutoff_hz=min(CUTOFF_HZ, CUTOFF_SHARE * rate),
        order=ORDER,
        decimation=decimation,
        reversal_time=None,
        filter_friction=False,
        covariance=None,
        trim_s=CUT / rate,
    )
    if name == "masked":
        return replace(
            plain,
            reversal_speed=REVERSAL_SPEED,
            reversal_time=1.0 / plain.cutoff_hz,
            filter_friction=True,
            derivative="central6",
        )
    if name == "filtered":
        return plain
    if decimation > 1:
        cutoff = UNFILTERED_SHARE * rate / decimation
        return replace(plain, cutoff_hz=cutoff, order=UNFILTERED_ORDER)
    return replace(plain, cutoff_hz=UNFILTERED_TOP * rate, order=1)


@dataclass(frozen=True)
class Result:
    """What a method found in a run.

    Attributes
    ----------
    processing, method : str
        Names.
    base : ndarray, shape (b,), or None
        Base parameters; None where the method failed.
    theta : ndarray, shape (p,), or None
        Standard parameters, where it has any.
    effort : tuple of float, int, int
        Seconds of the processor from the log to the estimate, rounds of solving, and how often the
        robot was simulated.
    note : str
        Why it failed.
    """

    processing: str
    method: str
    base: Array | None
    theta: Array | None = None
    effort: tuple[float, int, int] = (0.0, 1, 0)
    note: str = ""


@dataclass(frozen=True, eq=False)
class Run:
    """A robot with a log and a start, a description that is off."""

    benchmark: Benchmark
    log: sdpid.Recording
    start: Array

    def solved(self, wanted: list[tuple[str, str]]) -> Iterator[Result]:
        """Yield the results of processings and methods."""
        for name in dict.fromkeys(processing for processing, _ in wanted):
            methods = [method for processing, method in wanted if processing == name]
            if name == "default":
                yield self._timed(name, "identify", self._identified)
            else:
                yield from self._from_rows(name, methods)

    def _timed(
        self, name: str, method: str, solve: Callable[[], Estimate], before: float = 0.0
    ) -> Result:
        """Return what a method finds, or why it fails; `before` are seconds spent for several."""
        begin = time.process_time()
        try:
            found = solve()
        except sdpid.errors.SdpidError as error:
            return Result(name, method, None, note=f"{type(error).__name__}: {error}"[:200])
        seconds = before + time.process_time() - begin
        # Of one linear problem there is one iteration, whatever its solver counts.
        own = found.iterations if hasattr(found, "simulations") else 1
        rounds = getattr(found, "rounds", own)
        simulations = getattr(found, "simulations", rounds if method in CLOSED_LOOP else 0)
        base = found.base
        if found.theta is not None:
            # Base parameters of another description may be others.
            base = self.benchmark.base.matrix @ found.theta
        return Result(name, method, base, found.theta, (seconds, rounds, simulations))

    def _identified(self) -> Estimate:
        """Return what `sdpid.identify` makes of the log, with the start for a description."""
        names = ("time", "position", "effort", "reference")
        inside = {name: getattr(self.log, name)[CUT:-CUT] for name in names}
        record = sdpid.Recording(joint_names=self.log.joint_names, **inside)
        known = {"friction": self.benchmark.friction, "effects": "none", "intervals": False}
        return sdpid.identify(self.benchmark.described(self.start), record, **known).estimate

    def _from_rows(self, name: str, methods: list[str]) -> Iterator[Result]:
        """Yield the results of methods that begin with the same rows."""
        robot = self.benchmark.described(self.start)
        begin = time.process_time()
        chosen = processing(self.benchmark, name)
        samples = sdpid.process(self.log, chosen)
        processed = time.process_time() - begin
        built: dict[str, tuple[Problem, float]] = {}
        for method in methods:
            weighting: Any = "gls" if method.endswith("OLS") else "residual"
            if weighting not in built:
                begin = time.process_time()
                problem = sdpid.build_problem(
                    robot,
                    samples,
                    friction=self.benchmark.friction,
                    weighting=weighting,
                    # The bounds of `sdpid.identify`.
                    constraints=sdpid.Constraints.of_size(robot),
                    base=self.benchmark.base,
                )
                built[weighting] = problem, processed + time.process_time() - begin
            problem, before = built[weighting]
            solve = partial(
                SOLVERS.get(method, partial(self._closed_loop, chosen, method)), problem
            )
            yield self._timed(name, method, solve, before)

    def _closed_loop(self, chosen: sdpid.Processing, method: str, problem: Problem) -> Estimate:
        """Solve a problem by one of `CLOSED_LOOP`; consistent ones are called PC."""
        consistent = method.startswith("PC-")
        if not consistent:
            problem = problem.constrained(consistency="none")
        options: dict[str, Any] = {
            "processing": chosen,
            "controller": self.benchmark.controller,
            "max_iterations": ROUNDS,
            "tolerance": TOLERANCE,
        }
        if method.endswith("IV"):
            solve = sdpid.solve_sdp if consistent else sdpid.solve_wls
            options |= {"solver": solve, "start": self.benchmark.model(self.start)}
            return sdpid.solve_instrumental(problem, self.log, **options)
        kind = "didim" if method.endswith("DIDIM") else "closed_loop"
        # DIDIM hardly depends on the controller; output error does, on its delay too.
        rate = self.benchmark.rate_hz if kind == "closed_loop" else None
        options |= {"method": kind, "start": self.start, "control_hz": rate}
        return sdpid.solve_output_error(problem, self.log, **options)
