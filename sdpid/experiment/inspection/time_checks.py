"""Checks of the time stamps: gaps, and rows that only repeat the row before."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid.errors import DataError
from sdpid.experiment.inspection.finding import Finding, Subject, check
from sdpid.experiment.recording.gaps import continuous
from sdpid.experiment.recording.stored import blocks

# A row is repeated where no position and no effort changes. More repeats than these in a row are
# rest; a logger that runs faster than the robot makes fewer, many times.
_MOST_REPEATS = 20
_SHARE = 0.02


@check
def gaps_and_wraps(subject: Subject) -> Iterator[Finding]:
    """Find gaps and stamps that came late, and angles that wrap."""
    try:
        _, notes = continuous(subject.log)
    except DataError as refused:
        yield Finding(severity="error", kind="time_stamps", message=str(refused))
        return
    for note in notes:
        yield Finding(severity="note", kind="continued", message=note)


@check
def repeated_rows(subject: Subject) -> Iterator[Finding]:
    """Find rows that repeat the row before, as loggers write that run faster than the robot."""
    log = subject.log
    columns = [array[:, j] for array in (log.position, log.effort) for j in range(log.n)]
    repeats, run, last = 0, 0, None
    for parts in zip(*(blocks(column) for column in columns), strict=True):
        values = np.column_stack([part for _, part in parts])
        before = values[:-1] if last is None else np.vstack([last, values[:-1]])
        same = (values[len(values) - len(before) :] == before).all(axis=1)
        last = values[-1]
        # Lengths of the runs of repeats; one that reaches the end goes on in the next block.
        breaks = np.flatnonzero(~same)
        if not breaks.size:
            run += same.size
            continue
        runs = np.diff(breaks, prepend=-1) - 1
        runs[0] += run
        repeats += int(runs[runs <= _MOST_REPEATS].sum())
        run = same.size - 1 - int(breaks[-1])
    repeats += run if run <= _MOST_REPEATS else 0
    share = repeats / log.n_samples
    if share > _SHARE:
        yield Finding(
            severity="warning",
            kind="repeated_rows",
            message=(
                f"{repeats} of {log.n_samples} rows ({100 * share:.3g} %) repeat the row before "
                f"in every position and effort, limit {100 * _SHARE:g} %: the log is written "
                "faster than the robot measures"
            ),
            remedy="remove the repeated rows, or log at the robot's own rate",
            numbers={"rows": repeats, "share": share, "limit": _SHARE},
        )
