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

import argparse
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from legged import THREE, Walker, identified, without_imu

import sdpid
from sdpid._common.progress import progress
from sdpid._common.tables import Table
from sdpid.experiment.inspection.delays import channel_delays, is_significant
from sdpid.experiment.inspection.subject import Subject
from sdpid.experiment.plant.legged.sensors import Sensors, record
from sdpid.experiment.plant.legged.simulate import LeggedRun
from sdpid.experiment.preparation.prepare import with_delays
from sdpid.experiment.processing.settings import Processing
from sdpid.robot.legs import find_legs

CHANNELS = ("effort", "imu", "base", "contacts")
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


def found_rows(
    robots: Sequence[str], seeds: int, seconds: float, draws: int
) -> Iterator[tuple[object, ...]]:
    """Yield the rows of the table of delays."""
    rng = np.random.default_rng(0)
    found: dict[tuple[str, str, str], list[tuple[float, float, float, bool]]] = defaultdict(list)
    with progress(len(robots) * seeds * len(MOTIONS), "legged_delays") as advance:
        for name in robots:
            for seed in range(seeds):
                walker = Walker(name, seed, seconds)
                for motion in MOTIONS:
                    run = walker.run(motion)
                    for draw in range(draws):
                        values = rng.choice(DELAYS_MS, len(CHANNELS)) if draw else np.zeros(4)
                        true = dict(zip(CHANNELS, values.tolist(), strict=True))
                        log = recorded(walker, run, true, seed=draw)
                        sensors = [("IMU", log), ("pose", without_imu(log))]
                        if motion in LIFTING:
                            log = recorded(walker, run, true, seed=draw, threshold=THRESHOLD)
                            sensors.append(("IMU, flags with a threshold", log))
                        for sensor, each in sensors:
                            for channel, delay in channel_delays(walker.robot, each).items():
                                off = 1e3 * delay.value - true[channel]
                                told = is_significant(channel, delay)
                                found[motion, sensor, channel].append(
                                    (off, 1e3 * delay.error, true[channel], told)
                                )
                                if abs(off) > 1.0:
                                    print("off:", name, seed, motion, sensor, channel, true, off)
                    advance(1)
    for (motion, sensor, channel), values in found.items():
        off, error, true_ms = (np.array([each[i] for each in values]) for i in range(3))
        told = np.array([each[3] for each in values])
        long, none = np.abs(true_ms) >= LONG_MS[channel], true_ms == 0.0
        yield (
            motion, sensor, channel, len(values), float(np.median(np.abs(off))),
            float(np.abs(off).max()), float(np.median(error)), int(long.sum()),
            int((told & long).sum()), int(none.sum()), int((told & none).sum()),
        )  # fmt: skip


def late_rows(name: str, seconds: float, cases: int) -> Iterator[tuple[object, ...]]:
    """Yield the rows of the table of errors."""
    walker = Walker(name, 0, seconds)
    for words, delays in list(LATE.items())[:cases]:
        logs = [
            recorded(walker, walker.runs[motion], {k: 1e3 * v for k, v in delays.items()}, i)
            for i, motion in enumerate(THREE)
        ]
        taken = with_delays([Subject.of(log, walker.robot) for log in logs], Processing())
        on_time = [
            1e3 * getattr(taken, f"{each}_delay_s") for each in ("effort", "imu", "contacts")
        ]
        as_they_are = {f"{each}_delay_s": 0.0 for each in CHANNELS}
        for how, changes in (("on time", {}), ("as recorded", as_they_are)):
            if not delays and how == "as recorded":
                continue
            row = identified(walker, logs, intervals=False, processing=changes)
            shown = on_time if how == "on time" else [0.0] * 3
            yield (words, how, row[0], row[1], row[3], *shown)


def main() -> None:
    """Write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--only", choices=("delays", "late"), help="one table")
    parser.add_argument("--quick", action="store_true", help="one robot, one seed, two cases")
    parser.add_argument("--out", type=Path, default=Path("results"))
    chosen = parser.parse_args()
    robots, draws, cases = ("go1", "a1", "solo12"), 5, len(LATE)
    if chosen.quick:
        robots, draws, cases = ("solo12",), 2, 2
        chosen.seeds, chosen.seconds = 1, 3.0
    chosen.out.mkdir(parents=True, exist_ok=True)
    if chosen.only != "late":
        rows = list(found_rows(robots, chosen.seeds, chosen.seconds, draws))
        Table(COLUMNS, tuple(sorted(rows, key=str))).write(chosen.out / "legged_delays.csv")
    if chosen.only != "delays":
        late = []
        for row in late_rows(robots[-1], chosen.seconds, cases):
            print(*row, flush=True)
            late.append(row)
        Table(LATE_COLUMNS, tuple(late)).write(chosen.out / "legged_late.csv")


if __name__ == "__main__":
    main()
