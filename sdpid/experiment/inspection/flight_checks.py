"""Check that a robot whose contacts are all open falls."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.experiment.inspection.evidence import GRAVITY
from sdpid.experiment.inspection.finding import Finding
from sdpid.experiment.inspection.kinds import found
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.recording.recording import Recording

# Times without a closed contact that are shorter than this (s) say little about acceleration, and
# a small share of a log may be flags that close late.
_LEAST_TIME, _LEAST_SHARE = 0.3, 0.2
# A robot in the air feels nothing on average, one on the ground all of gravity.
_BORNE_SHARE = 0.5


@check
def contacts_missing(subject: Subject) -> Iterator[Finding]:
    """Find a robot that stands or walks, and of which no contact is said to be closed."""
    if subject.based is None:
        return
    log, _ = subject.based
    up, gravity = np.array([0.0, 0.0, 1.0]), GRAVITY
    if subject.floating is not None:
        vector = np.asarray(subject.floating.gravity)
        gravity = float(np.linalg.norm(vector))
        if gravity == 0.0:
            return
        up = -vector / gravity
    times, felt = [], []
    for run in _open_runs(log):
        specific = _specific_force(log, run, up, gravity)
        if specific is None:
            return
        times.append((run.stop - run.start) * log.step)
        felt.append(specific)
    share = sum(times) / (log.n_samples * log.step)
    if share < _LEAST_SHARE:
        return
    mean = float(np.average(felt, weights=times))
    if mean < _BORNE_SHARE * gravity:
        return
    said = "the recording has no contacts"
    if log.contacts is not None:
        said = f"no contact is closed for {100.0 * share:.3g} % of the time"
    limit = _BORNE_SHARE * gravity
    yield found(
        "contacts_missing",
        said=said,
        share=share,
        specific_force=mean,
        limit=limit,
        gravity=gravity,
    )


def _open_runs(log: Recording) -> list[slice]:
    """Return the times in which no contact is closed."""
    borne: Mask = np.zeros((log.n_samples, 1), dtype=np.bool_)
    if log.contacts is not None:
        borne = log.contacts.closed
    in_air = (~borne).all(axis=1)
    edges = np.flatnonzero(np.diff(np.pad(in_air.astype(np.int8), 1)))
    runs = [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
    return [run for run in runs if (run.stop - run.start) * log.step >= _LEAST_TIME]


def _specific_force(log: Recording, run: slice, up: Array, gravity: float) -> float | None:
    """Return the mean specific force upward, m/s², of what there is; None of nothing."""
    assert log.base is not None
    base = log.base.rows(run)
    time = log.step * np.arange(base.n_samples)
    sensed = base.sensed("accelerometer")
    if sensed is not None:
        return float(np.einsum("kij,kj->ki", base.rotations, sensed).mean(axis=0) @ up)
    if base.linear_velocity is not None:
        velocity = base.linear_velocity
        if base.velocity_frame == "base":
            velocity = np.einsum("kij,kj->ki", base.rotations, velocity)
        return float(np.polyfit(time, velocity @ up, 1)[0]) + gravity
    if base.position is not None:
        return 2.0 * float(np.polyfit(time, base.position @ up, 2)[0]) + gravity
    return None
