"""What a fleet costs: logs of an hour, a robot each; and logs in pieces on a cluster.

    python -m tests.benchmarks.fleet [--repeat 5] [--log hour.parquet] [--csv out.csv]

First the job of one robot and one hour of its log (3.6 million samples of six axes at 1 kHz, no
periods), stage by stage, in a fresh process on one core: seconds, processor time, peak memory, and
bytes of what is kept. Then pieces of that log on a local cluster (extra ``dask``) with one worker
and with two, each on a core of its own: robots one by one, and one problem from all pieces; what is
sent; the most memory of a worker; and the same with a worker that is killed on the way.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

import sdpid
from sdpid._common.tables import Table
from sdpid.estimation.compression import distributed_rows
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.for_robot import default_friction, default_processing, prepare
from tests.benchmarks.timing import Row, peak
from tests.benchmarks.timing import table as ratios

ROBOT, SEED = "denso_vp6242", 0
HOUR = 3_600_000
PERIODS = 10
# Pieces for the cluster: as many as divide evenly among the workers, each of five minutes.
PIECES, PIECE = 4, 300_000
_REPEATS = 5
_MIB = 1 << 20
ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)  # fmt: skip


def make_log(path: Path) -> None:
    """Simulate an hour; its periods are not told, as those of a robot at work are not known."""
    from sdpid.experiment.plant.simulate import simulate, true_parameters
    from sdpid.experiment.trajectory.paper import paper_excitation

    trajectory = paper_excitation(ROBOT, SEED, periods=PERIODS)
    robot, theta = sdpid.load_robot(ROBOT), true_parameters(ROBOT)
    log = simulate(robot, trajectory, theta=theta, seed=SEED, progress=False)
    part(log, 0, HOUR).to_parquet(path)


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


def hour(file: str) -> dict[str, Any]:
    """Do one robot's job on one core, and return the seconds of each stage."""
    on_core(0)
    seconds: dict[str, tuple[float, float]] = {}
    last = perf_counter(), process_time()

    def lap(stage: str) -> None:
        nonlocal last
        now = perf_counter(), process_time()
        seconds[stage] = now[0] - last[0], now[1] - last[1]
        last = now

    # Compiled kernels and solvers are loaded once a worker, not once a robot.
    import clarabel  # noqa: F401

    sdpid.solve_sdp(small_problem())
    lap("load libraries")
    import pyarrow.parquet as pq

    with pq.ParquetFile(file, pre_buffer=False) as stream:
        for _ in stream.iter_batches(batch_size=1 << 17, use_threads=False):
            pass
    lap("decode once, for comparison")
    robot = sdpid.load_robot(ROBOT)
    log = sdpid.read_recording(file)
    lap("open, check time")
    processing = default_processing(log)
    lap("choose settings")
    samples = prepare(robot, log, processing)
    lap("read and process")
    problem = sdpid.build_problem(
        robot,
        samples,
        friction=default_friction(log),
        weighting="residual",
        constraints=sdpid.Constraints.of_size(robot),
    )
    lap("regressor, weights, compress")
    estimate = sdpid.solve_sdp(problem)
    lap("SDP")
    certificate = sdpid.certify(estimate)
    assert certificate.passed, certificate.summary()
    lap("certificate")
    # Looks at the rows again, for their digest and the error of the compression.
    written = json.dumps(certificate.to_dict())
    lap("certificate as a file")
    factor = (problem.A, problem.rhs, problem.floor)
    return {
        "seconds": seconds,
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
    rng = np.random.default_rng(SEED)
    q, v, a, tau = rng.standard_normal((4, 200, robot.n))
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=tau)
    return sdpid.build_problem(
        robot, samples, weighting="residual", constraints=sdpid.Constraints.of_size(robot)
    )


def apart(file: Path) -> dict[str, Any]:
    """Do the job of an hour in a fresh process."""
    command = [sys.executable, "-m", "tests.benchmarks.fleet", "--apart", str(file)]
    environment = dict(os.environ) | ONE_THREAD
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} failed:\n{done.stderr}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def one_robot(file: str, processing: sdpid.Processing) -> tuple[Any, ...]:
    """Return what a fleet keeps of one robot: parameters, factor, certificate."""
    robot = sdpid.load_robot(ROBOT)
    log = sdpid.read_recording(file)
    problem = sdpid.build_problem(
        robot,
        prepare(robot, log, processing),
        friction=default_friction(log),
        weighting="residual",
        constraints=sdpid.Constraints.of_size(robot),
    )
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
    return sdpid.build_problem(
        robot,
        files
        if client is None
        else distributed_rows.DistributedSamples.read(client, robot, files, processing=processing),
        processing=processing,
        friction=default_friction(sdpid.read_recording(files[0])),
        weighting="residual",
        constraints=sdpid.Constraints.of_size(robot),
    )


def scaling(file: Path, repeats: int) -> dict[str, Any]:
    """Measure pieces on one worker and on two, and with one of two killed."""
    log = sdpid.read_recording(file)
    processing = default_processing(log)
    times: dict[tuple[str, int], list[tuple[float, float]]] = {}
    out: dict[str, Any] = {"peaks": {}, "sent": 0, "killed": [], "same": True}
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{k}.parquet" for k in range(PIECES)]
        for k, piece in enumerate(files):
            part(log, k * PIECE, (k + 1) * PIECE).to_parquet(piece)
        here = together(files, processing)
        out["columns"] = here.base.count
        out["samples"] = here.samples.n_samples
        for repeat in range(repeats):
            for workers in ((1, 2), (2, 1))[repeat % 2]:
                with cluster(workers) as client:
                    clock = Clock(client)
                    tasks = [client.submit(one_robot, str(f), processing) for f in files]
                    found = client.gather(tasks)
                    times.setdefault(("robots", workers), []).append(clock.stop())
                    out["robot_bytes"] = len(pickle.dumps(found[0], protocol=5))
                    sent = Sent()
                    clock = Clock(client)
                    with sent.counted():
                        there = together(files, processing, client)
                    times.setdefault(("pieces", workers), []).append(clock.stop())
                    out["sent"] = sent.bytes
                    out["same"] &= bool(np.array_equal(there.A, here.A))
                    most = max(client.run(peak).values())
                    out["peaks"][workers] = max(most, out["peaks"].get(workers, 0))
                    if workers == 2:
                        killed = _with_a_loss(
                            client, files, processing, times["pieces", 2][-1][0] / 2.0, here
                        )
                        out["killed"].append(killed)
    out["times"] = {key: np.array(each) for key, each in times.items()}
    return out


def _with_a_loss(
    client: Any, files: Sequence[Path], processing: sdpid.Processing, after: float, here: Any
) -> float:
    """Return the seconds with a worker killed on the way; the answer must be the same."""
    victim = next(iter(client.run(os.getpid).values()))
    timer = threading.Timer(after, os.kill, (victim, signal.SIGKILL))
    begin = perf_counter()
    timer.start()
    there = together(files, processing, client)
    seconds = perf_counter() - begin
    timer.join()
    assert np.array_equal(there.A, here.A), "another answer after the loss of a worker"
    return seconds


def stages(runs: Sequence[dict[str, Any]]) -> Table:
    """Return the medians of the stages of an hour, and their sum without what happens once."""
    once = ("load libraries", "decode once, for comparison")
    lines: list[tuple[object, ...]] = []
    both = {s: np.array([run["seconds"][s] for run in runs]) for s in runs[0]["seconds"]}
    both["a robot's hour"] = np.sum([both[s] for s in both if s not in once], axis=0)
    for stage, each in both.items():
        spread = [value for column in each.T for value in _three(column)]
        lines.append((stage, *spread))
    names = ("seconds", "least", "most", "processor", "least_p", "most_p")
    return Table(("stage", *names), tuple(lines))


def _three(values: np.ndarray) -> tuple[float, ...]:
    return float(np.median(values)), float(values.min()), float(values.max())


def rows(found: dict[str, Any]) -> list[Row]:
    """Return one worker's times as ratios to those of two, and those with a loss."""
    times = found["times"]
    out = []
    for column, clock in enumerate(("clock", "processor of the busiest")):
        for key, what in (("robots", "robots one by one"), ("pieces", "pieces of one problem")):
            one, two = times[key, 1][:, column], times[key, 2][:, column]
            out.append(Row.of(f"{PIECES} {what}, 1 worker, {clock}", one, "2 workers", two))
    lost = np.array(found["killed"])
    two = times["pieces", 2][:, 0]
    out.append(Row.of("pieces of one problem, one of 2 workers killed", lost, "2 workers", two))
    return out


def show_hour(runs: Sequence[dict[str, Any]]) -> None:
    """Print what a robot's hour took."""
    one = runs[0]
    size = max(run["peak"] for run in runs) / _MIB
    print(
        f"one hour: {one['rows']:,} samples, {one['log_bytes'] / 1e6:,.0f} MB; {one['samples']:,} "
        f"after processing; peak {size:,.0f} MiB; kept of it: factor of {one['columns']} columns "
        f"{one['factor_bytes']:,} bytes, certificate {one['certificate_bytes']:,} bytes\n"
    )
    print(stages(runs).text(digits=3), "\n", flush=True)


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.fleet")
    parser.add_argument("--repeat", type=int, default=_REPEATS)
    parser.add_argument("--log", type=Path, help="the hour, as this made it before")
    parser.add_argument("--keep", type=Path, help="write the hour here")
    parser.add_argument("--part", choices=("hour", "cluster"), help="one part only")
    parser.add_argument("--csv", type=Path, help="write the ratios here as well")
    parser.add_argument("--stages", type=Path, help="write the stages of an hour here as well")
    parser.add_argument("--apart", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.apart:
        print(json.dumps(hour(options.apart)))
        return 0
    os.environ.update(ONE_THREAD)
    with tempfile.TemporaryDirectory() as folder:
        file: Path | None = options.log
        if file is None:
            file = options.keep or Path(folder) / "hour.parquet"
            make_log(file)
        if options.part != "cluster":
            runs = [apart(file) for _ in range(options.repeat)]
            show_hour(runs)
            if options.stages is not None:
                stages(runs).write(options.stages)
        if options.part == "hour":
            return 0
        found = scaling(file, options.repeat)
        least = PIECES * sdpid.load_robot(ROBOT).n * (found["columns"] + 1) ** 2 * 8
        print(
            f"{PIECES} pieces of {PIECE:,} samples ({found['samples']:,} in all after processing): "
            f"{found['sent']:,} bytes gathered, {least:,} of them triangles; of a robot "
            f"{found['robot_bytes']:,}; most memory of a worker "
            + ", ".join(f"{size / _MIB:,.0f} MiB ({w})" for w, size in found["peaks"].items())
            + f"; same to the last bit: {found['same']}\n"
        )
        result = ratios(rows(found))
        print(result.text(digits=3))
        if options.csv is not None:
            result.write(options.csv)
    return 0


if __name__ == "__main__":
    sys.exit(main())
