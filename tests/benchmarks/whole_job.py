"""The whole job at the size of the paper: from a Parquet file to a certified result and a URDF.

    python -m tests.benchmarks.whole_job [--repeat 5] [--long] [--log paper.parquet] [--csv out.csv]

Every measurement runs in a fresh process: the job; what it is compared with (decoding the file
once and one zero-phase pass over its twelve channels, on one thread); and the bandwidth of the
memory. ``--long`` makes a log of ten times the length as well (5 GB on disk, for minutes).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Table
from tests.benchmarks.timing import Row, peak

ROBOT, SEED = "denso_vp6242", 0
# The long log has so many times the periods.
TIMES = 10
# The noise that is added to the efforts of repeated periods, in parts of their own.
_FRESH = 0.5
_REPEATS = 5
# Bytes copied to measure the bandwidth; each is read and written.
_COPIED = 1 << 28
_MIB = 1 << 20
_WRITTEN = 1 << 17


class Clock:
    """Seconds and memory from stage to stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = perf_counter()

    def lap(self, stage: str) -> None:
        """End a stage."""
        now = perf_counter()
        self.seconds[stage] = now - self._last
        self._last = now


def job(file: str) -> dict[str, Any]:
    """Do the whole job, as `sdpid.identify` and `Identification.save` do it."""
    clock = Clock()
    from sdpid.assurance.certificate.certificate import certify
    from sdpid.estimation.constraints.constraints import Constraints
    from sdpid.estimation.problem import build_problem
    from sdpid.estimation.sdp.solve import solve_sdp
    from sdpid.estimation.wls import solve_wls
    from sdpid.experiment.preparation.for_robot import default_friction, prepare
    from sdpid.experiment.readers.read import read_recording
    from sdpid.output.robots.urdf import write_urdf
    from sdpid.robot.model.load import load_robot

    clock.lap("import")
    robot = load_robot(ROBOT)
    clock.lap("load the robot")
    log = read_recording(file)
    clock.lap("decode, check")
    samples = prepare(robot, log)
    clock.lap("process")
    problem = build_problem(
        robot,
        samples,
        friction=default_friction(log),
        weighting="gls",
        constraints=Constraints.of_size(robot),
    )
    clock.lap("regressor, compress")
    wls = solve_wls(problem)
    clock.lap("WLS")
    estimate = solve_sdp(problem)
    clock.lap("SDP")
    certificate = certify(estimate)
    clock.lap("certificate")
    with tempfile.TemporaryDirectory() as folder:
        write_urdf(estimate, target=Path(folder) / "identified.urdf")
    clock.lap("URDF")
    assert certificate.passed
    return {
        "seconds": clock.seconds,
        "peak": peak(),
        "log": [log.n_samples, log.n, Path(file).stat().st_size],
        "samples": samples.effort.shape,
        "columns": problem.base.count,
        "cost": [wls.cost, estimate.cost],
        "theta": estimate.theta.tolist() if estimate.theta is not None else None,
    }


def reference(file: str) -> dict[str, Any]:
    """Decode the file and filter its channels once, each on one thread; imports do not count."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    from scipy.signal import butter, sosfiltfilt

    pa.set_cpu_count(1)
    sections = butter(2, 15.0, fs=1000.0, output="sos")
    sosfiltfilt(sections, np.zeros(100))
    clock = Clock()
    with pq.ParquetFile(file, pre_buffer=False) as stream:
        for _ in stream.iter_batches(batch_size=_WRITTEN, use_threads=False):
            pass
    clock.lap("decode")
    table = pq.read_table(file, use_threads=False)
    channels = [table.column(k).to_numpy() for k in range(1, table.num_columns)]
    clock.lap("read")
    for channel in channels:
        sosfiltfilt(sections, channel)
    clock.lap("filter")
    return {"seconds": clock.seconds, "peak": peak()}


def bandwidth() -> dict[str, Any]:
    """Return the bytes a second that a copy reads and writes."""
    source, target = np.ones(_COPIED // 8), np.empty(_COPIED // 8)
    best = np.inf
    for _ in range(6):
        begin = perf_counter()
        np.copyto(target, source)
        best = min(best, perf_counter() - begin)
    return {"bandwidth": 2 * _COPIED / best}


def make_log(path: Path) -> None:
    """Simulate the experiment of the paper."""
    from sdpid.experiment.plant.simulate import simulate, true_parameters
    from sdpid.experiment.trajectory.paper import paper_excitation
    from sdpid.robot.model.load import load_robot

    trajectory = paper_excitation(ROBOT, SEED)
    theta = true_parameters(ROBOT)
    simulate(load_robot(ROBOT), trajectory, theta=theta, seed=SEED, progress=False).to_parquet(path)


def lengthen(source: Path, target: Path, times: int = TIMES) -> None:
    """Write a log with so many times the periods: repeated, with fresh noise on the efforts.

    Lead-in and lead-out stay as they are; a period is in memory at a time.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    from sdpid.experiment.readers.read import read_recording

    log = read_recording(source, stored=True)
    layout = log.period_layout
    assert layout is not None
    first, length, periods = layout
    end = first + periods * length
    rng = np.random.default_rng(SEED)
    one, other = (log.effort[at : at + length] for at in (first, first + length))
    sigma = _FRESH * (one - other).std(axis=0) / np.sqrt(2.0)
    schema = pq.read_schema(source)
    said = json.loads(schema.metadata[b"sdpid"])
    said["periods"] = times * periods
    schema = schema.with_metadata({b"sdpid": json.dumps(said).encode()})
    bounds = [(0, first)]
    bounds += [(first + p * length, first + (p + 1) * length) for p in range(periods)] * times
    bounds.append((end, log.n_samples))
    row = 0
    options: dict[str, Any] = {
        "compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True
    }  # fmt: skip
    with pq.ParquetWriter(target, schema, **options) as writer:
        for low, high in bounds:
            position, effort = log.position[low:high], log.effort[low:high]
            effort = effort + sigma * rng.standard_normal(effort.shape)
            time = (row + np.arange(high - low)) * log.step
            columns = [time, *position.T, *effort.T]
            arrays = [pa.array(np.ascontiguousarray(values)) for values in columns]
            writer.write_table(pa.table(arrays, schema=schema), row_group_size=_WRITTEN)
            row += high - low


def _apart(what: str, *arguments: str) -> dict[str, Any]:
    """Measure in a fresh process."""
    command = [sys.executable, "-m", "tests.benchmarks.whole_job", "--apart", what, *arguments]
    environment = {"OPENBLAS_NUM_THREADS": "1"} | dict(os.environ)
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


class Measured:
    """The job and its references, measured in turn.

    Parameters
    ----------
    file : path
        The log.
    repeats : int
        How often.
    """

    def __init__(self, file: Path, repeats: int) -> None:
        jobs, references, bandwidths = [], [], []
        for _ in range(repeats):
            jobs.append(_apart("job", str(file)))
            references.append(_apart("reference", str(file)))
            bandwidths.append(_apart("bandwidth")["bandwidth"])
        self.first = jobs[0]
        self.stages = tuple(self.first["seconds"])
        self.seconds = {s: np.array([each["seconds"][s] for each in jobs]) for s in self.stages}
        self.total: Array = np.sum(list(self.seconds.values()), axis=0)
        self.peak = max(each["peak"] for each in jobs)
        parts = tuple(references[0]["seconds"])
        times = {s: np.array([each["seconds"][s] for each in references]) for s in parts}
        # Decoded batch by batch and dropped; and decoded into arrays, as a filter needs them.
        self.least_reference = times["decode"] + times["filter"]
        self.reference = times["read"] + times["filter"]
        self.reference_parts = times
        self.bandwidth = float(np.median(bandwidths))

    def limits(self) -> dict[str, float]:
        """Return the seconds that moving the bytes of a stage takes at the bandwidth measured."""
        rows, n, stored = self.first["log"]
        K, p = self.first["samples"][0], self.first["columns"]
        touched = {
            # Compressed bytes are read; all columns are written once and checked once.
            "decode, check": stored + 2 * 8 * rows * (2 * n + 1),
            # Channels are read and written once.
            "process": 2 * 8 * rows * 2 * n,
            # Rows of the regressor with the effort, written and read once.
            "regressor, compress": 2 * 8 * K * n * (p + 1),
        }
        touched["whole job"] = sum(touched.values())
        return {stage: size / self.bandwidth for stage, size in touched.items()}


def rows_of(found: Measured) -> Iterator[Row]:
    """Yield the job against reading and filtering, and each stage against what its bytes take."""
    yield Row.of("whole job, paper size", found.total, "read and filter once", found.reference)
    name = "decode and filter once"
    yield Row.of("whole job, paper size", found.total, name, found.least_reference)
    limits = found.limits()
    for stage in found.stages:
        if stage in limits:
            limit = np.full(len(found.total), limits[stage])
            yield Row.of(stage, found.seconds[stage], "its bytes at memory speed", limit)


def table(found: Measured) -> Table:
    """Return the stages, the sum, and the references."""
    limits = found.limits()
    header = ("stage", "seconds", "least", "most", "limit_s", "ratio")
    stages = {**found.seconds, "whole job": found.total}
    rows: list[tuple[object, ...]] = []

    def add(what: str, seconds: Array, limit: float | None, ratio: Array | None = None) -> None:
        spread = (float(np.median(seconds)), float(seconds.min()), float(seconds.max()))
        rows.append((what, *spread, limit, None if ratio is None else float(np.median(ratio))))

    for stage, seconds in stages.items():
        add(stage, seconds, limits.get(stage))
    parts = found.reference_parts
    add("reference: decode", parts["decode"], None)
    add("reference: read into arrays", parts["read"], None)
    add("reference: filter 12 channels", parts["filter"], None)
    add("read + filter; job over it", found.reference, None, found.total / found.reference)
    least = found.least_reference
    add("decode + filter; job over it", least, None, found.total / least)
    return Table(header, tuple(rows))


def show(found: Measured, name: str) -> None:
    """Print the log's size, peak memory and the stages."""
    rows, n, size = found.first["log"]
    print(
        f"{name}: {rows:,} samples x {2 * n} channels, {size / 1e6:,.0f} MB on disk, "
        f"{8e-6 * rows * (2 * n + 1):,.0f} MB decoded; peak {found.peak / _MIB:,.0f} MiB; "
        f"memory {found.bandwidth / 1e9:.3g} GB/s\n"
    )
    print(table(found).text(digits=3), "\n")


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.whole_job")
    parser.add_argument("--repeat", type=int, default=_REPEATS)
    parser.add_argument("--long", action="store_true", help="ten times the length as well")
    parser.add_argument("--log", type=Path, help="the log, as `sdpid simulate` wrote it")
    parser.add_argument("--csv", type=Path, help="write the table here as well")
    parser.add_argument("--apart", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.apart:
        what, *arguments = options.apart
        actions: dict[str, Callable[..., dict[str, Any]]] = {
            "job": job, "reference": reference, "bandwidth": bandwidth
        }  # fmt: skip
        print(json.dumps(actions[what](*arguments)))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        file = options.log
        if file is None:
            file = Path(folder) / "paper.parquet"
            make_log(file)
        found = Measured(file, options.repeat)
        show(found, "paper size")
        if options.csv is not None:
            table(found).write(options.csv)
        if options.long:
            long = Path(folder) / "long.parquet"
            lengthen(file, long)
            again = _apart("job", str(long))
            seconds, total = again["seconds"], sum(again["seconds"].values())
            print(f"{TIMES} times as long: {again['log'][0]:,} samples, {again['log'][2]:,} bytes")
            for stage, each in seconds.items():
                print(f"  {stage:24} {each:8.3f} s")
            print(
                f"  {'whole job':24} {total:8.3f} s, {total / np.median(found.total):.2f} times; "
                f"peak {again['peak'] / _MIB:,.0f} MiB"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
