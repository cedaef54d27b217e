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

from functools import cache, partial

import numpy as np
from legged import THREE, Walker, without_imu
from study import Rows, Study

import sdpid
from sdpid.experiment.inspection.delays import channel_delays, is_significant
from sdpid.experiment.inspection.subject import Subject
from sdpid.experiment.plant.legged.simulate import Sensors, record
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
# Late channels, ms, of the second table.
LATE: dict[str, dict[str, float]] = {
    "nothing": {},
    "torques 2 ms": {"effort": 2.0},
    "torques 4 ms, IMU 2 ms, flags 10 ms": {"effort": 4.0, "imu": 2.0, "contacts": 10.0},
}
LATE_COLUMNS = (
    *("late", "taken", "joints_percent", "base_force_n", "mass_percent"),
    *("effort_ms", "imu_ms", "contacts_ms"),
)


def recorded(
    walker: Walker, motion: str, delays_ms: dict[str, float], seed: int, threshold: float = 0.0
) -> sdpid.Recording:
    """Return a run, its channels late by so much against the joints.

    Flags are those above a threshold, a share of the weight.
    """
    least = min(0.0, *delays_ms.values()) if delays_ms else 0.0
    late = {name: (value - least) * 1e-3 for name, value in delays_ms.items()}
    run = walker.run(motion)
    assert run.recording.contacts is not None
    return record(
        find_legs(walker.robot),
        (np.arange(len(run.motion.position)) - BEFORE) * run.recording.step,
        run.motion,
        Sensors(delays={"joints": -least * 1e-3, **late}, flag_threshold=threshold * walker.weight),
        held=run.recording.contacts.n == 1,
        rng=np.random.default_rng(seed),
    )


def found_rows(walker: Walker, motion: str, draws: int) -> Rows:
    """Yield what is found of each channel of each log of a motion, ms."""
    rng = np.random.default_rng([walker.seed, ROBOTS.index(walker.name), MOTIONS.index(motion)])
    for draw in range(draws):
        values = rng.choice(DELAYS_MS, len(CHANNELS)) if draw else np.zeros(4)
        true = dict(zip(CHANNELS, values.tolist(), strict=True))
        log = recorded(walker, motion, true, seed=draw)
        sensors = {"IMU": log, "pose": without_imu(log)}
        if motion in LIFTING:
            low = recorded(walker, motion, true, seed=draw, threshold=THRESHOLD)
            sensors["IMU, flags with a threshold"] = low
        for sensor, each in sensors.items():
            for channel, delay in channel_delays(walker.robot, each).items():
                off, told = 1e3 * delay.value - true[channel], is_significant(channel, delay)
                long, none = abs(true[channel]) >= LONG_MS[channel], true[channel] == 0.0
                counts = long, told and long, none, told and none
                yield motion, sensor, channel, abs(off), 1e3 * delay.error, *counts


def late_rows(walker: Walker, words: str) -> Rows:
    """Yield the rows of the table of errors."""
    delays = LATE[words]
    logs = [recorded(walker, motion, delays, i) for i, motion in enumerate(THREE)]
    taken = with_delays([Subject.of(log, walker.robot) for log in logs], Processing())
    on_time = [1e3 * getattr(taken, f"{each}_delay_s") for each in ("effort", "imu", "contacts")]
    ways = {"on time": ({}, on_time)}
    if delays:
        as_they_are = {f"{each}_delay_s": 0.0 for each in CHANNELS}
        ways["as recorded"] = (as_they_are, [0.0] * 3)
    for how, (changes, shown) in ways.items():
        result = walker.identify(logs, processing=changes)
        yield words, how, *walker.judged(result.estimate), *shown


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
    walker = cache(partial(Walker, seconds=study.seconds))
    by, counts = ("motion", "base_motion", "channel"), ("long", "told", "without", "false")
    found = study.rows(
        "logs.csv",
        (*by, "off", "error", *counts),
        lambda name, seed, motion: found_rows(walker(name, seed), motion, study.draws),
        *(study.robots, range(study.seeds), MOTIONS),
    )
    columns = {
        "logs": "count off",
        "median_ms": "median off",
        "worst_ms": "max off",
        "stated_error_ms": "median error",
        **{each: f"sum {each}" for each in counts},
    }
    ordered = sorted(found, key=lambda row: [row[name] for name in by])
    study.summary("legged_delays.csv", ordered, by, columns)
    last = walker(study.robots[-1], 0)
    study.rows("legged_late.csv", LATE_COLUMNS, partial(late_rows, last), [*LATE][: study.late])


if __name__ == "__main__":
    main()
