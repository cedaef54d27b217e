"""What comes before the rows: importing and processing."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import numpy as np

from sdpid.experiment.processing.filters import low_pass
from sdpid.experiment.processing.process import Processing, process
from sdpid.experiment.recording.recording import Recording
from tests.benchmarks.timing import Row, side_by_side


def processing(log: Recording, repeats: int) -> Iterator[Row]:
    """Measure `process` against filtering positions and efforts once."""
    from scipy.signal import sosfiltfilt

    settings = Processing()
    filter_ = low_pass("butterworth", settings.cutoff_hz, settings.order, log.rate_hz)
    # SciPy asks for writable arrays.
    sections = np.array(filter_.sections)
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
