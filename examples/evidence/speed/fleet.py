"""What a fleet costs: logs of an hour, a robot each; and logs in pieces on a cluster.

First the job of one robot and one hour of its log (3.6 million samples of six axes at 1 kHz, no
periods), stage by stage, in a fresh process on one core: seconds, processor time, peak memory, and
bytes of what is kept. Then pieces of that log on a local cluster (extra ``dask``) with one worker
and with two, each on a core of its own: robots one by one, and one problem from all pieces; what is
sent; the most memory of a worker; and the same with a worker that is killed on the way.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from harness import Bench, Laps, Row, apart, peak, timed

import sdpid
from sdpid._common.arrays import Array
from sdpid._common.tables import Table
from sdpid.estimation.compression import distributed_rows
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.prepare import default_friction, samples_of
from sdpid.experiment.processing.choose import default_processing

ROBOT = "denso_vp6242"
# Samples of the hour, and periods of its motion.
HOUR, PERIODS = 3_600_000, 10
# Pieces for the cluster: as many as divide evenly among the workers, each of five minutes.
PIECES, PIECE = 4, 300_000
_MIB = 1 << 20
ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)  # fmt: skip


@contextmanager
def hour_of_log(bench: Bench) -> Iterator[Path]:
    """Simulate an hour; its periods are not told, as those of a robot at work are not known."""
    from denso import QUICK, denso_log

    log = denso_log(*bench.size((PERIODS, None), QUICK))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "hour.parquet"
        part(log, 0, min(HOUR, log.n_samples)).to_parquet(file)
        yield file


def part(log: sdpid.Recording, begin: int, end: int) -> sdpid.Recording:
    """Return some samples of a log, without its periods."""
    return sdpid.Recording(
        time=log.time[begin:end],
        position=log.position[begin:end],
        effort=log.effort[begin:end],
        joint_names=log.joint_names,
    )


def on_core(core: int) -> None:
    """Stay on one core."""
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[core % len(cores)]})


def stated(robot: sdpid.RobotModel, samples: Any, log: sdpid.Recording, **more: Any) -> Problem:
    """Return the problem of samples, or of the files of pieces of a log."""
    return sdpid.build_problem(
        robot,
        samples,
        friction=default_friction(log),
        weighting="residual",
        constraints=sdpid.Constraints.of_size(robot),
        **more,
    )


def job(file: str) -> dict[str, Any]:
    """Do one robot's job on one core, and return what each stage took."""
    on_core(0)
    laps = Laps()
    # Compiled kernels and solvers are loaded once a worker, not once a robot.
    import clarabel  # noqa: F401

    sdpid.solve_sdp(small_problem())
    laps.end("load libraries")
    import pyarrow.parquet as pq

    with pq.ParquetFile(file, pre_buffer=False) as stream:
        for _ in stream.iter_batches(batch_size=1 << 17, use_threads=False):
            pass
    laps.end("decode once, for comparison")
    robot = sdpid.load_robot(ROBOT)
    log = sdpid.read_recording(file)
    laps.end("open, check time")
    processing = default_processing(log)
    laps.end("choose settings")
    samples = samples_of(robot, log, processing)
    laps.end("read and process")
    problem = stated(robot, samples, log)
    laps.end("regressor, weights, compress")
    estimate = sdpid.solve_sdp(problem)
    laps.end("SDP")
    certificate = sdpid.certify(estimate)
    assert certificate.passed, certificate.summary()
    laps.end("certificate")
    # Looks at the rows again, for their digest and the error of the compression.
    written = json.dumps(certificate.to_dict())
    laps.end("certificate as a file")
    factor = (problem.A, problem.rhs, problem.floor)
    return {
        "stages": laps.stages,
        "peak": peak(),
        "log_bytes": Path(file).stat().st_size,
        "rows": log.n_samples,
        "samples": samples.n_samples,
        "columns": problem.base.count,
        "factor_bytes": len(pickle.dumps(factor, protocol=5)),
        "certificate_bytes": len(written),
    }


def small_problem() -> Problem:
    """Return a problem that loads all that is loaded on first use."""
    robot = sdpid.load_robot(ROBOT)
    rng = np.random.default_rng(0)
    q, v, a, tau = rng.standard_normal((4, 200, robot.n))
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=tau)
    return sdpid.build_problem(
        robot, samples, weighting="residual", constraints=sdpid.Constraints.of_size(robot)
    )


def one_robot(file: str, processing: sdpid.Processing) -> tuple[Any, ...]:
    """Return what a fleet keeps of one robot: parameters, factor, certificate."""
    robot = sdpid.load_robot(ROBOT)
    log = sdpid.read_recording(file)
    problem = stated(robot, samples_of(robot, log, processing), log)
    estimate = sdpid.solve_sdp(problem)
    found = sdpid.certify(estimate).to_dict()
    return estimate.theta, (problem.A, problem.rhs, problem.floor), found


@contextmanager
def cluster(workers: int) -> Iterator[Any]:
    """Start workers, each on a core of its own and with everything loaded."""
    import dask
    import distributed

    with (
        dask.config.set({"distributed.nanny.pre-spawn-environ": ONE_THREAD}),
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=":0", processes=True
        ) as found,
        distributed.Client(found) as client,
    ):
        addresses = client.run(os.getpid)
        for core, address in enumerate(addresses):
            client.run(on_core, core, workers=[address])
            client.run(_loaded, workers=[address])
        yield client


def _loaded() -> None:
    sdpid.solve_sdp(small_problem())


class Clock:
    """Seconds on the clock, and what they would be if nothing else ran.

    The latter is the processor time of this process and of the busiest worker, one after the
    other: here they take turns, as everything that is gathered is waited for.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._used = client.run(process_time)
        self._own, self._begin = process_time(), perf_counter()

    def stop(self) -> tuple[float, float]:
        """Return both."""
        seconds, own = perf_counter() - self._begin, process_time() - self._own
        used = self._client.run(process_time)
        return seconds, own + max(used[worker] - self._used[worker] for worker in used)


class Sent:
    """Bytes that the client receives, counted as pickled."""

    def __init__(self) -> None:
        self.bytes = 0

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Count what a problem gathers."""
        gathered = distributed_rows._gathered

        def counting(client: Any, futures: Any) -> list[Any]:
            found = gathered(client, futures)
            self.bytes += sum(len(pickle.dumps(each, protocol=5)) for each in found)
            return found

        distributed_rows._gathered = counting
        try:
            yield
        finally:
            distributed_rows._gathered = gathered


def together(files: Sequence[Path], processing: sdpid.Processing, client: Any = None) -> Problem:
    """Return one problem from all pieces."""
    robot = sdpid.load_robot(ROBOT)
    there: Any = files
    if client is not None:
        read = distributed_rows.DistributedSamples.read
        there = read(client, robot, files, processing=processing)
    return stated(robot, there, sdpid.read_recording(files[0]), processing=processing)


def on_cluster(
    workers: int, files: Sequence[Path], processing: sdpid.Processing, here: Problem
) -> dict[str, Any]:
    """Return what robots one by one and one problem took; with a worker killed if there are two."""
    with cluster(workers) as client:
        clock = Clock(client)
        tasks = [client.submit(one_robot, str(f), processing) for f in files]
        kept = client.gather(tasks)
        found: dict[str, Any] = {"robots": clock.stop()}
        found["robot_bytes"] = len(pickle.dumps(kept[0], protocol=5))
        sent = Sent()
        clock = Clock(client)
        with sent.counted():
            there = together(files, processing, client)
        found["pieces"] = clock.stop()
        found["sent"] = sent.bytes
        found["same"] = bool(np.array_equal(there.A, here.A))
        found["peak"] = max(client.run(peak).values())
        if workers > 1:
            found["lost"] = _with_a_loss(client, files, processing, found["pieces"][0] / 2.0, here)
    return found


def _with_a_loss(
    client: Any, files: Sequence[Path], processing: sdpid.Processing, after: float, here: Problem
) -> float:
    """Return the seconds with a worker killed on the way; the answer must be the same."""
    victim = next(iter(client.run(os.getpid).values()))
    timer = threading.Timer(after, os.kill, (victim, signal.SIGKILL))
    timer.start()
    seconds, there = timed(lambda: together(files, processing, client))
    timer.join()
    assert np.array_equal(there.A, here.A), "another answer after the loss of a worker"
    return seconds


def hour(bench: Bench) -> Table:
    """Return the stages of an hour, and their sum without what happens once."""
    with hour_of_log(bench) as file:
        action = partial(apart, job, str(file), environment=ONE_THREAD)
        (runs,) = bench.in_turn({"hour": action}).values()
    one = runs[0]
    print(
        f"one hour: {one['rows']:,} samples, {one['log_bytes'] / 1e6:,.0f} MB; {one['samples']:,} "
        f"after processing; peak {max(run['peak'] for run in runs) / _MIB:,.0f} MiB; kept of it: "
        f"factor of {one['columns']} columns {one['factor_bytes']:,} bytes, certificate "
        f"{one['certificate_bytes']:,} bytes"
    )
    once = ("load libraries", "decode once, for comparison")
    stages = {s: np.array([run["stages"][s] for run in runs]) for s in one["stages"]}
    stages["a robot's hour"] = np.sum([stages[s] for s in stages if s not in once], axis=0)
    lines = []
    for stage, each in stages.items():
        spread = np.stack([np.median(each, axis=0), each.min(axis=0), each.max(axis=0)])
        lines.append((stage, *spread.T.ravel().tolist()))
    names = ("seconds", "least", "most", "processor", "least_p", "most_p")
    return Table(("stage", *names), tuple(lines))


def scaling(bench: Bench) -> Iterator[Row]:
    """Yield one worker's times as ratios to those of two, and those with a loss."""
    # Workers inherit it.
    os.environ.update(ONE_THREAD)
    with hour_of_log(bench) as file:
        log = sdpid.read_recording(file)
        processing = default_processing(log)
        size = min(PIECE, log.n_samples // PIECES)
        files = [file.with_name(f"{k}.parquet") for k in range(PIECES)]
        for k, piece in enumerate(files):
            part(log, k * size, (k + 1) * size).to_parquet(piece)
        here = together(files, processing)
        action = partial(on_cluster, files=files, processing=processing, here=here)
        one, two = bench.in_turn({"one": partial(action, 1), "two": partial(action, 2)}).values()
    runs = [*one, *two]
    least = PIECES * here.robot.n * (here.base.count + 1) ** 2 * 8
    memory = [max(run["peak"] for run in each) / _MIB for each in (one, two)]
    print(
        f"{PIECES} pieces of {size:,} samples ({here.samples.n_samples:,} in all after "
        f"processing): {runs[-1]['sent']:,} bytes gathered, {least:,} of them triangles; of a "
        f"robot {runs[-1]['robot_bytes']:,}; most memory of a worker {memory[0]:,.0f} MiB (1), "
        f"{memory[1]:,.0f} MiB (2); same to the last bit: {all(run['same'] for run in runs)}"
    )

    def seconds(runs: list[dict[str, Any]], key: str) -> Array:
        return np.array([run[key] for run in runs]).T

    for column, clock in enumerate(("clock", "processor of the busiest")):
        for key, what in (("robots", "robots one by one"), ("pieces", "pieces of one problem")):
            name = f"{PIECES} {what}, 1 worker, {clock}"
            yield Row.of(name, seconds(one, key)[column], "2 workers", seconds(two, key)[column])
    lost, whole = seconds(two, "lost"), seconds(two, "pieces")[0]
    yield Row.of("pieces of one problem, one of 2 workers killed", lost, "2 workers", whole)
