"""The whole job at the size of the paper: from a Parquet file to a certified result and a URDF.

Every measurement runs in a fresh process: the job; what it is compared with (decoding the file
once and one zero-phase pass over its twelve channels, on one thread); and the bandwidth of the
memory. Beside each stage stands what moving its bytes takes at this bandwidth.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from harness import Bench, Laps, Row, apart, peak

ROBOT = "denso_vp6242"
# Bytes copied to measure the bandwidth; each is read and written.
_COPIED = 1 << 28
_MIB = 1 << 20
_WRITTEN = 1 << 17


def job(file: str) -> dict[str, Any]:
    """Do the whole job, as `sdpid.identify` and `Identification.save` do it."""
    laps = Laps()
    from sdpid.assurance.certificate.certificate import certify
    from sdpid.estimation.constraints.constraints import Constraints
    from sdpid.estimation.problem import build_problem
    from sdpid.estimation.sdp.solve import solve_sdp
    from sdpid.estimation.wls import solve_wls
    from sdpid.experiment.preparation.prepare import default_friction, samples_of
    from sdpid.experiment.readers.read import read_recording
    from sdpid.output.robots.urdf import write_urdf
    from sdpid.robot.model.load import load_robot

    laps.end("import")
    robot = load_robot(ROBOT)
    laps.end("load the robot")
    log = read_recording(file)
    laps.end("decode, check")
    samples = samples_of(robot, log)
    laps.end("process")
    problem = build_problem(
        robot,
        samples,
        friction=default_friction(log),
        weighting="gls",
        constraints=Constraints.of_size(robot),
    )
    laps.end("regressor, compress")
    solve_wls(problem)
    laps.end("WLS")
    estimate = solve_sdp(problem)
    laps.end("SDP")
    certificate = certify(estimate)
    laps.end("certificate")
    with tempfile.TemporaryDirectory() as folder:
        write_urdf(estimate, target=Path(folder) / "identified.urdf")
    laps.end("URDF")
    assert certificate.passed
    return {
        "stages": laps.stages,
        "peak": peak(),
        "log": [log.n_samples, log.n, Path(file).stat().st_size],
        "rows": [*samples.effort.shape, problem.base.count],
    }


def reference(file: str) -> dict[str, list[float]]:
    """Decode the file and filter its channels once, each on one thread; imports do not count."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    from scipy.signal import butter, sosfiltfilt

    pa.set_cpu_count(1)
    sections = butter(2, 15.0, fs=1000.0, output="sos")
    sosfiltfilt(sections, np.zeros(100))
    laps = Laps()
    with pq.ParquetFile(file, pre_buffer=False) as stream:
        for _ in stream.iter_batches(batch_size=_WRITTEN, use_threads=False):
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
    source, target = np.ones(_COPIED // 8), np.empty(_COPIED // 8)
    best = np.inf
    for _ in range(6):
        begin = perf_counter()
        np.copyto(target, source)
        best = min(best, perf_counter() - begin)
    return float(2 * _COPIED / best)


def bytes_moved(one: dict[str, Any]) -> dict[str, float]:
    """Return the bytes that some stages cannot but move."""
    samples, n, stored = one["log"]
    K, joints, columns = one["rows"]
    moved = {
        # Compressed bytes are read; all columns are written once and checked once.
        "decode, check": stored + 2 * 8 * samples * (2 * n + 1),
        # Channels are read and written once.
        "process": 2 * 8 * samples * 2 * n,
        # Rows of the regressor with the effort, written and read once.
        "regressor, compress": 2 * 8 * K * joints * (columns + 1),
    }
    return {**moved, "whole job": sum(moved.values())}


def measure(bench: Bench) -> Iterator[Row]:
    """Yield the job against reading and filtering, and stages against what their bytes take."""
    from denso import QUICK, denso_log

    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder) / "paper.parquet")
        denso_log(*bench.size((None, None), QUICK)).to_parquet(file)
        found: dict[str, list[Any]] = bench.in_turn(
            {
                "job": partial(apart, job, file),
                "reference": partial(apart, reference, file),
                "bandwidth": partial(apart, bandwidth),
            }
        )
    one, speed = found["job"][0], float(np.median(found["bandwidth"]))
    samples, n, stored = one["log"]
    print(
        f"{samples:,} samples x {2 * n} channels, {stored / 1e6:,.0f} MB on disk, "
        f"{8e-6 * samples * (2 * n + 1):,.0f} MB decoded; "
        f"peak {max(run['peak'] for run in found['job']) / _MIB:,.0f} MiB; "
        f"memory {speed / 1e9:.3g} GB/s"
    )
    stages = {s: np.array([run["stages"][s][0] for run in found["job"]]) for s in one["stages"]}
    parts = {s: np.array([run[s][0] for run in found["reference"]]) for s in found["reference"][0]}
    total = np.sum(list(stages.values()), axis=0)
    # Decoded into arrays, as a filter needs them; and batch by batch, and dropped.
    read, dropped = (parts[how] + parts["filter"] for how in ("read into arrays", "decode"))
    yield Row.of("whole job, paper size", total, "read and filter once", read)
    yield Row.of("whole job, paper size", total, "decode and filter once", dropped)
    for stage, seconds in (stages | parts).items():
        yield Row.of(stage, seconds, "whole job", total)
    for stage, size in bytes_moved(one).items():
        limit = np.full(len(total), size / speed)
        seconds = total if stage == "whole job" else stages[stage]
        yield Row.of(stage, seconds, "its bytes at memory speed", limit)
