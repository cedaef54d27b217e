"""Whole jobs: at the size of the paper, of a robot's hour, and of pieces on a cluster.

Every job runs in a fresh process, stage by stage. At the size of the paper (periods, all cores)
beside it stand decoding the file once and one zero-phase pass over its twelve channels, on one
thread, and what moving the bytes of a stage takes at the bandwidth of the memory. The job of an
hour of log (3.6 million samples of six axes at 1 kHz, no periods) has one core, and libraries
loaded before. Then pieces of that log on a local cluster (extra ``dask``) with one worker and with
two, each on a core of its own: robots one by one, and one problem from all pieces; and the same
with a worker that is killed on the way.
"""

from __future__ import annotations

import json
import os
import signal
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from harness import ONE_THREAD, Bench, Laps, apart, ratio, timed

from sdpid._common.tables import Table

ROBOT = "denso_vp6242"
# Samples of the hour, and periods of its motion.
HOUR, PERIODS = 3_600_000, 10
# Pieces for the cluster: as many as divide evenly among the workers, each of five minutes.
PIECES, PIECE = 4, 300_000
# Bytes copied to measure the bandwidth; each is read and written.
COPIED = 1 << 28
WRITTEN = 1 << 17

Ratios = Iterator[tuple[object, ...]]


def job(file: str, at_work: bool) -> dict[str, Any]:
    """Do the whole job, as `sdpid.identify` and `Identification.save` do it."""
    laps = Laps()
    if at_work:
        on_core(0)
    import sdpid
    from sdpid.experiment.preparation.prepare import samples_of
    from sdpid.experiment.processing.choose import default_processing

    if at_work:
        # Compiled kernels and solvers are loaded once a worker, not once a robot.
        sdpid.solve_sdp(small_problem())
    laps.end("load libraries")
    robot = sdpid.load_robot(ROBOT)
    laps.end("load the robot")
    log = sdpid.read_recording(file)
    laps.end("open, check time")
    processing = default_processing(log) if at_work else None
    laps.end("choose settings")
    samples = samples_of(robot, log, processing)
    laps.end("read and process")
    problem = stated(robot, samples, log, weighting="residual" if at_work else "gls")
    laps.end("regressor, weights, compress")
    sdpid.solve_wls(problem)
    laps.end("WLS")
    estimate = sdpid.solve_sdp(problem)
    laps.end("SDP")
    certificate = sdpid.certify(estimate)
    assert certificate.passed, certificate.summary()
    laps.end("certificate")
    # Looks at the rows again, for their digest and the error of the compression.
    json.dumps(certificate.to_dict())
    laps.end("certificate as a file")
    with tempfile.TemporaryDirectory() as folder:
        sdpid.write_urdf(estimate, target=Path(folder) / "identified.urdf")
    laps.end("URDF")
    return {
        "stages": laps.stages,
        "log": [log.n_samples, log.n, Path(file).stat().st_size],
        "rows": [*samples.effort.shape, problem.base.count],
    }


def stated(robot: Any, samples: Any, log: Any, **how: Any) -> Any:
    """Return the problem of samples, or of the files of pieces of a log."""
    import sdpid
    from sdpid.experiment.preparation.prepare import default_friction

    given = {"friction": default_friction(log), "constraints": sdpid.Constraints.of_size(robot)}
    return sdpid.build_problem(robot, samples, **{"weighting": "residual", **given, **how})


def small_problem() -> Any:
    """Return a problem that loads all that is loaded on first use."""
    import sdpid

    robot = sdpid.load_robot(ROBOT)
    q, v, a, tau = np.random.default_rng(0).standard_normal((4, 200, robot.n))
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=tau)
    constraints = sdpid.Constraints.of_size(robot)
    return sdpid.build_problem(robot, samples, weighting="residual", constraints=constraints)


def on_core(core: int) -> None:
    """Stay on one core."""
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[core % len(cores)]})


def reference(file: str) -> dict[str, float]:
    """Decode the file and filter its channels once, each on one thread; imports do not count."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    from scipy.signal import butter, sosfiltfilt

    pa.set_cpu_count(1)
    sections = butter(2, 15.0, fs=1000.0, output="sos")
    sosfiltfilt(sections, np.zeros(100))
    laps = Laps()
    with pq.ParquetFile(file, pre_buffer=False) as stream:
        for _ in stream.iter_batches(batch_size=WRITTEN, use_threads=False):
            pass
    laps.end("decode")
    table = pq.read_table(file, use_threads=False)
    channels = [table.column(k).to_numpy() for k in range(1, table.num_columns)]
    laps.end("read into arrays")
    for channel in channels:
        sosfiltfilt(sections, channel)
    laps.end("filter")
    return laps.stages


def bandwidth() -> float:
    """Return the bytes a second that a copy reads and writes."""
    source, target = np.ones(COPIED // 8), np.empty(COPIED // 8)
    best = np.inf
    for _ in range(6):
        begin = perf_counter()
        np.copyto(target, source)
        best = min(best, perf_counter() - begin)
    return float(2 * COPIED / best)


def bytes_moved(one: dict[str, Any]) -> dict[str, float]:
    """Return the bytes that some stages cannot but move."""
    samples, n, stored = one["log"]
    K, joints, columns = one["rows"]
    moved = {
        # Compressed bytes are read; all columns are written once and checked once.
        "open, check time": stored + 2 * 8 * samples * (2 * n + 1),
        # Channels are read and written once.
        "read and process": 2 * 8 * samples * 2 * n,
        # Rows of the regressor with the effort, written and read once.
        "regressor, weights, compress": 2 * 8 * K * joints * (columns + 1),
    }
    return {**moved, "whole job": sum(moved.values())}


def of_runs(runs: Sequence[dict[str, float]]) -> dict[str, np.ndarray]:
    """Return the seconds of each stage in each repeat."""
    return {stage: np.array([run[stage] for run in runs]) for stage in runs[0]}


def whole(bench: Bench) -> Ratios:
    """Yield the job against reading and filtering, and stages against what their bytes take."""
    from solvers import QUICK, denso_log

    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder) / "paper.parquet")
        denso_log(*bench.size((None, None), QUICK)).to_parquet(file)
        found: dict[str, list[Any]] = bench.in_turn(
            {
                "job": partial(apart, job, file, False),
                "reference": partial(apart, reference, file),
                "bandwidth": partial(apart, bandwidth),
            }
        )
    speed, parts = float(np.median(found["bandwidth"])), of_runs(found["reference"])
    stages = of_runs([run["stages"] for run in found["job"]])
    total = np.sum(list(stages.values()), axis=0)
    # Decoded into arrays, as a filter needs them; and batch by batch, and dropped.
    read, dropped = (parts[how] + parts["filter"] for how in ("read into arrays", "decode"))
    yield ratio("whole job, paper size", total, "read and filter once", read)
    yield ratio("whole job, paper size", total, "decode and filter once", dropped)
    for stage, seconds in (stages | parts).items():
        yield ratio(stage, seconds, "whole job", total)
    for stage, size in bytes_moved(found["job"][0]).items():
        limit = np.full(len(total), size / speed)
        yield ratio(stage, stages.get(stage, total), "its bytes at memory speed", limit)


@contextmanager
def hour_of_log(bench: Bench) -> Iterator[Path]:
    """Simulate an hour; its periods are not told, as those of a robot at work are not known."""
    from solvers import QUICK, denso_log

    log = denso_log(*bench.size((PERIODS, None), QUICK))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "hour.parquet"
        part(log, 0, min(HOUR, log.n_samples)).to_parquet(file)
        yield file


def part(log: Any, begin: int, end: int) -> Any:
    """Return some samples of a log, without its periods."""
    import sdpid

    names = ("time", "position", "effort")
    arrays = {name: getattr(log, name)[begin:end] for name in names}
    return sdpid.Recording(joint_names=log.joint_names, **arrays)


def hour(bench: Bench) -> Table:
    """Return the stages of an hour, and their sum without what happens once."""
    with hour_of_log(bench) as file:
        action = partial(apart, job, str(file), True, environment=ONE_THREAD)
        (runs,) = bench.in_turn({"hour": action}).values()
    stages = of_runs([run["stages"] for run in runs])
    every = [each for stage, each in stages.items() if stage != "load libraries"]
    stages["a robot's hour"] = np.sum(every, axis=0)
    lines = ((stage, np.median(s), s.min(), s.max()) for stage, s in stages.items())
    return Table(("stage", "seconds", "least", "most"), tuple(lines))


def one_robot(file: str, processing: Any) -> tuple[Any, ...]:
    """Return what a fleet keeps of one robot: parameters, factor, certificate."""
    import sdpid
    from sdpid.experiment.preparation.prepare import samples_of

    robot, log = sdpid.load_robot(ROBOT), sdpid.read_recording(file)
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
        for core, address in enumerate(client.run(os.getpid)):
            client.run(on_core, core, workers=[address])
            client.run(_loaded, workers=[address])
        yield client


def _loaded() -> None:
    import sdpid

    sdpid.solve_sdp(small_problem())


def together(files: Sequence[Path], processing: Any, client: Any = None) -> Any:
    """Return one problem from all pieces."""
    import sdpid
    from sdpid.estimation.compression.distributed_rows import DistributedSamples

    robot, there = sdpid.load_robot(ROBOT), files
    if client is not None:
        there = DistributedSamples.read(client, robot, files, processing=processing)
    return stated(robot, there, sdpid.read_recording(files[0]), processing=processing)


def on_cluster(workers: int, files: Sequence[Path], processing: Any, A: Any) -> dict[str, float]:
    """Return what robots one by one and one problem took; with a worker killed if there are two.

    The answer must always be the same.
    """

    def pieces() -> float:
        seconds, there = timed(partial(together, files, processing, client))
        assert np.array_equal(there.A, A), "another answer"
        return seconds

    with cluster(workers) as client:
        robots, _ = timed(
            lambda: client.gather([client.submit(one_robot, str(f), processing) for f in files])
        )
        found = {"robots": robots, "pieces": pieces()}
        if workers > 1:
            victim = next(iter(client.run(os.getpid).values()))
            timer = threading.Timer(found["pieces"] / 2.0, os.kill, (victim, signal.SIGKILL))
            timer.start()
            found["lost"] = pieces()
            timer.join()
    return found


def scaling(bench: Bench) -> Ratios:
    """Yield one worker's times as ratios to those of two, and those with a loss."""
    import sdpid
    from sdpid.experiment.processing.choose import default_processing

    # Workers inherit it.
    os.environ.update(ONE_THREAD)
    with hour_of_log(bench) as file:
        log = sdpid.read_recording(file)
        processing = default_processing(log)
        size = min(PIECE, log.n_samples // PIECES)
        files = [file.with_name(f"{k}.parquet") for k in range(PIECES)]
        for k, piece in enumerate(files):
            part(log, k * size, (k + 1) * size).to_parquet(piece)
        here = together(files, processing).A
        action = partial(on_cluster, files=files, processing=processing, A=here)
        found = bench.in_turn({"one": partial(action, 1), "two": partial(action, 2)})
    one, two = map(of_runs, found.values())
    for key, what in (("robots", "robots one by one"), ("pieces", "pieces of one problem")):
        yield ratio(f"{PIECES} {what}, 1 worker", one[key], "2 workers", two[key])
    killed = "pieces of one problem, one of 2 workers killed"
    yield ratio(killed, two["lost"], "2 workers", two["pieces"])
