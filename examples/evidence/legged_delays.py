"""Delays between channels of legged robots' logs: how well they are found, what they cost.

Quadrupeds in MuJoCo as in `legged.py`. Efforts, IMU, pose of the base and flags of contacts are
each early by 1 ms, on time, or late by 1, 2 or 4 ms against the joints, drawn for each log; one
log of each motion has no delay. *Worst* and *median* are of found less true delays, *told* counts
delays of at least 2 ms (4 of flags) that inspection tells, *false* those told where there is none.
Flags are also made by a threshold of a fifth of the weight, at which the feet carry much already.

* ``legged_delays.csv``: errors of what is found, by motion and channel, with an IMU and without.
* ``legged_late.csv``: errors on a held-out walk, of logs with late channels, taken on time or not.

    python examples/evidence/legged_delays.py --out results
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import cache

import numpy as np
from legged import THREE, Walker, identified, without_imu
from study import Study, grouped

import sdpid
from sdpid.experiment.inspection.delays import channel_delays, is_significant
from sdpid.experiment.inspection.subject import Subject
from sdpid.experiment.plant.legged.sensors import Sensors, record
from sdpid.experiment.plant.legged.simulate import LeggedRun
from sdpid.experiment.preparation.prepare import with_delays
from sdpid.experiment.processing.settings import Processing
from sdpid.robot.legs import find_legs

CHANNELS = ("effort", "imu", "base", "contacts")
ROBOTS = ("go1", "a1", "solo12")
MOTIONS = (*THREE, "walk")
DELAYS_MS = (-1.0, 0.0, 1.0, 2.0, 4.0)
# Delays that count as told or missed, ms.
LONG_MS = {"effort": 2.0, "imu": 2.0, "base": 2.0, "contacts": 4.0}
# Of the weight: below it, a foot is said to be up; and motions in which feet are.
THRESHOLD, LIFTING = 0.2, ("trot", "walk")
# What the first samples of a run are kept for: later delays, in samples.
BEFORE = 20
COLUMNS = (
    "motion", "base_motion", "channel", "logs", "median_ms", "worst_ms", "stated_error_ms",
    "long", "told", "without", "false",
)  # fmt: skip
# Late channels, in s, of the second table.
LATE: dict[str, dict[str, float]] = {
    "nothing": {},
    "torques 2 ms": {"effort": 0.002},
    "torques 4 ms, IMU 2 ms, flags 10 ms": {"effort": 0.004, "imu": 0.002, "contacts": 0.01},
}
LATE_COLUMNS = (
    "late", "taken", "joints_percent", "base_force_n", "mass_percent",
    "effort_ms", "imu_ms", "contacts_ms",
)  # fmt: skip


def recorded(
    walker: Walker,
    run: LeggedRun,
    delays_ms: dict[str, float],
    seed: int,
    threshold: float = 0.0,
) -> sdpid.Recording:
    """Return a run, its channels late by so much against the joints.

    Flags are those above a threshold, a share of the weight.
    """
    least = min(0.0, *delays_ms.values()) if delays_ms else 0.0
    late = {name: (value - least) * 1e-3 for name, value in delays_ms.items()}
    robot, motion = walker.robot, run.motion
    contacts = run.recording.contacts
    assert contacts is not None
    weight = 9.81 * float(run.theta[: 10 * robot.n_links : 10].sum())
    return record(
        find_legs(robot),
        (np.arange(len(motion.position)) - BEFORE) * run.recording.step,
        motion,
        Sensors(delays={"joints": -least * 1e-3, **late}, flag_threshold=threshold * weight),
        gravity=robot.gravity,
        held=contacts.n == 1,
        rng=np.random.default_rng(seed),
    )


def found_rows(walker: Walker, motion: str, draws: int) -> Iterator[tuple[object, ...]]:
    """Yield what is found of each channel of each log of a motion."""
    rng = np.random.default_rng([walker.seed, ROBOTS.index(walker.name), MOTIONS.index(motion)])
    run = walker.run(motion)
    for draw in range(draws):
        values = rng.choice(DELAYS_MS, len(CHANNELS)) if draw else np.zeros(4)
        true = dict(zip(CHANNELS, values.tolist(), strict=True))
        log = recorded(walker, run, true, seed=draw)
        sensors = {"IMU": log, "pose": without_imu(log)}
        if motion in LIFTING:
            low = recorded(walker, run, true, seed=draw, threshold=THRESHOLD)
            sensors["IMU, flags with a threshold"] = low
        for sensor, each in sensors.items():
            for channel, delay in channel_delays(walker.robot, each).items():
                off, error = 1e3 * delay.value - true[channel], 1e3 * delay.error
                yield (
                    motion,
                    sensor,
                    channel,
                    off,
                    error,
                    true[channel],
                    is_significant(channel, delay),
                )


def late_rows(walker: Walker, words: str) -> Iterator[tuple[object, ...]]:
    """Yield the rows of the table of errors."""
    delays = LATE[words]
    logs = [
        recorded(walker, walker.runs[motion], {k: 1e3 * v for k, v in delays.items()}, i)
        for i, motion in enumerate(THREE)
    ]
    taken = with_delays([Subject.of(log, walker.robot) for log in logs], Processing())
    on_time = [1e3 * getattr(taken, f"{each}_delay_s") for each in ("effort", "imu", "contacts")]
    ways = {"on time": ({}, on_time)}
    if delays:
        as_they_are = {f"{each}_delay_s": 0.0 for each in CHANNELS}
        ways["as recorded"] = (as_they_are, [0.0] * 3)
    for how, (changes, shown) in ways.items():
        row = identified(walker, logs, processing=changes)
        yield words, how, row[0], row[1], row[3], *shown


def main() -> None:
    """Write the tables."""
    study = Study(
        __doc__,
        quick={"robots": ["solo12"], "seeds": 1, "seconds": 3.0, "draws": 2, "late": 2},
        seeds=2,
        seconds=5.0,
        robots=[*ROBOTS],
        draws=(5, "logs of each motion"),
        late=(len(LATE), "rows of the second table"),
    )
    walker = cache(lambda name, seed: Walker(name, seed, study.seconds))
    found = study.rows(
        "logs.csv",
        ("motion", "base_motion", "channel", "off", "error", "true", "told"),
        itertools.product(study.robots, range(study.seeds), MOTIONS),
        lambda case: found_rows(walker(*case[:2]), case[2], study.draws),
    )
    rows = []
    for key, own in grouped(found, *COLUMNS[:3]):
        off, told = np.abs(own["off"]), own["told"]
        long, none = np.abs(own["true"]) >= LONG_MS[key[2]], own["true"] == 0.0
        counts = long.sum(), (told & long).sum(), none.sum(), (told & none).sum()
        rows.append((*key, len(off), np.median(off), off.max(), np.median(own["error"]), *counts))
    study.write("legged_delays.csv", COLUMNS, sorted(rows, key=str))
    last = study.robots[-1]
    words = [*LATE][: study.late]
    study.rows(
        "legged_late.csv", LATE_COLUMNS, words, lambda each: late_rows(walker(last, 0), each)
    )


if __name__ == "__main__":
    main()
