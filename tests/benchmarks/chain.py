"""What comes before a solver: importing, processing, regressor and compression."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from sdpid._arrays import Array
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.weighting import whitener
from sdpid.experiment.filters import butterworth
from sdpid.experiment.processing import Processing, process
from sdpid.experiment.recording import Recording
from sdpid.experiment.samples import Samples
from sdpid.robot import kernels
from sdpid.robot.load import load_robot
from sdpid.robot.model import RobotModel
from tests.benchmarks.timing import Row, side_by_side

# Bytes of the copy that measures the bandwidth of the memory: no cache holds them.
COPY = 1 << 27

# Bytes of one block of the regressor, as a caller that goes through a log in blocks has them.
BLOCK = 12 << 20

# Arms of 6 axes, and a humanoid of 32.
BLOCK_ROBOTS = ("denso_vp6242", "talos_reduced")


def regressor(robot: RobotModel, samples: Samples, repeats: int) -> Iterator[Row]:
    """Measure a sample of the regressor against Pinocchio's and against writing its bytes.

    The bandwidth is that of a copy, counted in bytes written.
    """
    import pinocchio as pin

    q, v, a = samples.position, samples.velocity, samples.acceleration
    count, model = len(q), robot.pin_model
    configurations = robot.configuration(q)
    velocities, accelerations = np.ascontiguousarray(v), np.ascontiguousarray(a)
    source, target = np.ones(COPY // 8), np.zeros(COPY // 8)

    def bare() -> None:
        data, compute = model.createData(), pin.computeJointTorqueRegressor
        for k in range(count):
            compute(model, data, configurations[k], velocities[k], accelerations[k])

    seconds, alone, copy = side_by_side(
        (lambda: robot.regressor(q, v, a), bare, lambda: np.copyto(target, source)), repeats
    )
    written = robot.regressor(q, v, a).nbytes
    what = "regressor, per sample"
    yield Row.of(what, seconds / count, "bare loop over Pinocchio", alone / count)
    yield Row.of(what, seconds / count, "its bytes / bandwidth", copy * written / COPY / count)


def regressor_blocks(repeats: int) -> Iterator[Row]:
    """Measure a sample of the regressor in blocks, with and without Numba, against Pinocchio's."""
    import pinocchio as pin

    rng = np.random.default_rng(0)
    for name in BLOCK_ROBOTS:
        robot = load_robot(name)
        model, count = robot.pin_model, BLOCK // (80 * robot.n * robot.n_links)
        states = [rng.uniform(-1.0, 1.0, (count, robot.n)) for _ in range(3)]
        q, v, a = robot.configuration(states[0]), states[1], states[2]

        def ours(robot: RobotModel = robot, states: list[Array] = states) -> None:
            robot.regressor(*states)

        def uncompiled(robot: RobotModel = robot, states: list[Array] = states) -> None:
            before, kernels.compiled = kernels.compiled, lambda: None
            try:
                robot.regressor(*states)
            finally:
                kernels.compiled = before

        def bare(model: Any = model, rows: tuple[Array, ...] = (q, v, a)) -> None:
            data, compute = model.createData(), pin.computeJointTorqueRegressor
            for state in zip(*rows, strict=True):
                compute(model, data, *state)

        seconds, slow, alone = side_by_side((ours, uncompiled, bare), repeats) / count
        what = f"regressor, {robot.n} axes, {count} samples"
        yield Row.of(what, seconds, "bare loop over Pinocchio", alone)
        yield Row.of(f"{what}, no Numba", slow, "bare loop over Pinocchio", alone)


def processing(log: Recording, repeats: int) -> Iterator[Row]:
    """Measure `process` against filtering positions and efforts once."""
    from scipy.signal import sosfiltfilt

    settings = Processing()
    low_pass = butterworth(settings.cutoff_hz, settings.order, log.rate_hz)
    # SciPy asks for writable arrays.
    sections = np.array(low_pass.sections)
    # Channel by channel in memory, as it is fastest.
    channels = np.ascontiguousarray(np.hstack([log.position, log.effort]).T)
    seconds, once = side_by_side(
        (
            lambda: process(log, settings, progress=False),
            lambda: sosfiltfilt(sections, channels),
        ),
        repeats,
    )
    yield Row.of("process", seconds, "one sosfiltfilt", once)


def compression(problem: Problem, repeats: int) -> Iterator[Row]:
    """Measure a sample of `build_problem` against QR of the rows that it compresses."""
    robot, samples, base = problem.robot, problem.samples, problem.base
    stacked = []
    for _, W, effort, mask in problem.rows.chunks():
        rows = np.concatenate([W, effort[:, :, None]], axis=2)
        weight = whitener(problem.sigma, mask, -0.5)
        stacked.append((weight @ rows).reshape(-1, rows.shape[2]))
    whitened = np.concatenate(stacked)
    fresh, again, plain = side_by_side(
        (
            lambda: build_problem(robot, samples),
            lambda: build_problem(robot, samples, base=base),
            lambda: np.linalg.qr(whitened, mode="r"),
        ),
        repeats,
    )
    count, against = len(samples.effort), "numpy QR of its rows"
    yield Row.of("build_problem, per sample", fresh / count, against, plain / count)
    yield Row.of("the same, base given", again / count, against, plain / count)


def importing(repeats: int) -> Iterator[Row]:
    """Measure ``import sdpid`` in fresh interpreters, whose own start is not counted."""
    seconds, numpy = np.array(
        [[_seconds_to_import(name) for name in ("sdpid", "numpy")] for _ in range(repeats + 1)]
    )[1:].T
    yield Row.of("import sdpid", seconds, "import numpy", numpy)


def _seconds_to_import(name: str) -> float:
    code = f"from time import perf_counter as t; b = t(); import {name}; print(t() - b)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout)
