"""Does `identify` find the truth with its defaults? Measured on simulated logs of four robots.

Each log of simulated_logs.py, its conditions drawn from the seed, goes through `sdpid.identify`
without any hint. Counted are the errors of friction curves and base parameters, how many 95 %
intervals hold the truth, and how many estimates are outside their own interval. With --effect the
base is tilted, friction grows with load or falls with speed, or rotors add inertia.

    python examples/evidence/truth.py --out results --seeds 10 --jobs 2

Forty logs with profile intervals take some ten minutes on one core.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from simulated_logs import ROBOTS, Conditions, Truth, drawn, log_of, there

import sdpid
from sdpid._common.files import atomic_write_text
from sdpid._common.tables import Table
from sdpid._common.threads import parallel
from sdpid.assurance.intervals.delta_method import friction_curve

# Speeds at which friction curves are compared, rad/s, on joints that reach them and whose Coulomb
# friction is so many times the noise of the effort.
SPEEDS, ABOVE_NOISE = (0.1, 0.3, 1.0), 5.0

# Standard normal quantile.
NORMAL = 1.959963984540054

# What is simulated beside ordinary friction.
EFFECTS: dict[str, dict[str, float]] = {
    "none": {},
    "tilt": {"tilt_deg": 1.5},
    "load": {"load": 0.1},
    "rotor": {"rotor": 0.5},
    "stribeck": {"stribeck": 0.4},
}

KINDS = {"m": "mass", "mx": "first moment", "my": "first moment", "mz": "first moment"}
KINDS |= dict.fromkeys(("xx", "xy", "xz", "yy", "yz", "zz"), "inertia")
KINDS |= {"Fv": "viscous", "Fo": "offset", "Fs": "Coulomb", "Ia": "rotor inertia"}
KINDS |= {"Gx": "tilt", "Gy": "tilt", "Fl": "load"}


@dataclass(frozen=True)
class Row:
    """One quantity of one log: the truth, what was found, and its intervals.

    `error` is the stated standard error; ends are None where there is no interval.
    """

    effect: str
    robot: str
    seed: int
    kind: str
    name: str
    truth: float
    estimate: float
    error: float
    lower: float | None = None
    upper: float | None = None
    profile_lower: float | None = None
    profile_upper: float | None = None


@dataclass(frozen=True)
class Run:
    """What became of one log."""

    rows: list[Row]
    intervals: int
    outside: int
    seconds: float
    chosen: tuple[str, ...] = ()
    message: str = ""


def run(
    effect: str, conditions: Conditions, seed: int, data: Path | None, profile: bool, **given: Any
) -> Run:
    """Simulate a log, identify from it and compare."""
    log, truth = log_of(conditions, seed, data)
    known = effect, conditions.robot, seed
    start = time.perf_counter()
    try:
        result = sdpid.identify(truth.robot, log, **given)
    except sdpid.errors.SdpidError as error:
        return Run([], 0, 0, time.perf_counter() - start, (), f"{known}: {error}")
    seconds = time.perf_counter() - start
    rows = friction_rows(known, truth, result.estimate)
    found, outside = ends_of(result.intervals), 0
    count = 0 if result.intervals is None else len(result.intervals)
    if result.intervals is not None:
        names = result.intervals.names
        values = result.estimate.named() | (result.estimate.named_theta() or {})
        own = [values[name] for name in names]
        outside = int(np.count_nonzero(~result.intervals.contains(own)))
    exact: dict[str, tuple[float, float]] = {}
    if profile:
        exact = ends_of(
            sdpid.confidence_intervals(
                result.estimate, parameters=result.problem.base.names, n_jobs=1
            )
        )
    rows += base_rows(known, truth, result.estimate, found, exact)
    chosen = tuple(each.name for each in result.problem.origin.effects if each.chosen)
    return Run(rows, count, outside, seconds, chosen)


def ends_of(intervals: Any) -> dict[str, tuple[float, float]]:
    """Return the ends of intervals by name of the parameter."""
    if intervals is None:
        return {}
    ends = zip(intervals.lower.tolist(), intervals.upper.tolist(), strict=True)
    return dict(zip(intervals.names, ends, strict=True))


def friction_rows(known: tuple[str, str, int], truth: Truth, estimate: Any) -> list[Row]:
    """Return the friction curve at some speeds: half of what reversing the motion changes."""
    friction, half_widths = friction_curve(estimate, SPEEDS)
    rows = []
    for k, speed in enumerate(SPEEDS):
        true = truth.friction(np.full((1, truth.robot.n), speed))[0]
        for j in range(truth.robot.n):
            if truth.top_speed[j] < speed or truth.coulomb[j] < ABOVE_NOISE * truth.noise[j]:
                continue
            value, half = friction[k, j], half_widths[k, j]
            numbers = (
                float(x) for x in (true[j], value, half / NORMAL, value - half, value + half)
            )
            rows.append(Row(*known, f"friction at {speed:g}", f"joint {j + 1}", *numbers))
    return rows


def base_rows(
    known: tuple[str, str, int],
    truth: Truth,
    estimate: Any,
    found: dict[str, tuple[float, float]],
    exact: dict[str, tuple[float, float]],
) -> list[Row]:
    """Return the base parameters whose truth is known."""
    base = estimate.problem.base
    theta = truth.theta(estimate.problem)
    unknown = np.isnan(theta)
    values = base.matrix @ np.where(unknown, 0.0, theta)
    clear = ~np.any(base.matrix[:, unknown] != 0.0, axis=1)
    rows = []
    for i in np.flatnonzero(clear):
        name = base.names[i]
        symbol = name.rstrip("0123456789_").removesuffix("r")
        rows.append(
            Row(
                *known,
                KINDS[symbol],
                name,
                float(values[i]),
                float(estimate.base[i]),
                float(estimate.standard_errors[i]),
                *found.get(name, (None, None)),
                *exact.get(name, (None, None)),
            )
        )
    return rows


def held(rows: Iterable[Row], profile: bool = False) -> list[bool]:
    """Return whether each interval holds the truth, of the rows that have one."""
    out = []
    for row in rows:
        ends = (row.profile_lower, row.profile_upper) if profile else (row.lower, row.upper)
        if ends[0] is not None and ends[1] is not None:
            out.append(ends[0] <= row.truth <= ends[1])
    return out


def share(values: Sequence[bool]) -> str:
    """Return a share in percent, or nothing."""
    return f"{100.0 * float(np.mean(values)):.1f}" if values else ""


def summary(runs: Sequence[Run]) -> str:
    """Return the tables of one effect."""
    rows = [row for each in runs for row in each.rows]
    lines = [
        "| friction at, rad/s | joints | error, median, % | 90th percentile, % | bias, % |",
        "|---|---|---|---|---|",
    ]
    for speed in SPEEDS:
        errors = np.array(
            [r.estimate / r.truth - 1.0 for r in rows if r.kind == f"friction at {speed:g}"]
        )
        if errors.size:
            middle, tail = 100.0 * np.quantile(np.abs(errors), [0.5, 0.9])
            bias = 100.0 * float(np.median(errors))
            lines.append(f"| {speed:g} | {errors.size} | {middle:.2f} | {tail:.2f} | {bias:+.2f} |")
    lines += [
        "",
        "| kind | parameters | error in stated errors, median, 90th percentile | intervals that "
        "hold the truth, % | profile, % | worst parameter, default, profile, % |",
        "|---|---|---|---|---|---|",
    ]
    for kind in dict.fromkeys(row.kind for row in rows):
        own = [row for row in rows if row.kind == kind]
        z = np.abs([(r.estimate - r.truth) / r.error for r in own])
        middle, tail = np.quantile(z, [0.5, 0.9])
        names = dict.fromkeys((row.robot, row.name) for row in own)
        groups = [[row for row in own if (row.robot, row.name) == name] for name in names]
        worst = []
        for profile in (False, True):
            shares = [np.mean(h) for g in groups if (h := held(g, profile))]
            worst.append(f"{100.0 * min(shares):.0f}" if shares else "")
        lines.append(
            f"| {kind} | {len(own)} | {middle:.2f}, {tail:.2f} | {share(held(own))} | "
            f"{share(held(own, True))} | {', '.join(worst)} |"
        )
    lines += ["", "| effect | chosen, % of the logs |", "|---|---|"]
    for effect in dict.fromkeys(name for each in runs for name in each.chosen):
        lines.append(f"| {effect} | {share([effect in each.chosen for each in runs])} |")
    seconds = np.array([each.seconds for each in runs])
    count, outside = sum(e.intervals for e in runs), sum(e.outside for e in runs)
    lines += [
        "",
        f"{len(runs)} logs, {sum(bool(each.message) for each in runs)} refused; {outside} of "
        f"{count} estimates outside their own interval; {np.median(seconds):.2g} s a log (median).",
        *[each.message for each in runs if each.message],
    ]
    return "\n".join(lines)


# What the parameters of an effect are, and its name among those that `identify` chooses.
OF_EFFECT = {
    "tilt": ("tilt", "tilt"),
    "load": ("load", "load"),
    "rotor": ("rotor inertia", "rotor_inertia"),
}
FOUND = (
    "effect",
    "logs",
    "chosen_percent",
    "another_chosen_percent",
    "intervals",
    "held_percent",
    "friction_error_percent",
)


def found_row(effect: str, runs: Sequence[Run]) -> tuple[object, ...]:
    """Return how often an effect was chosen, and how right its parameters are."""
    kind, name = OF_EFFECT[effect]
    rows = [row for each in runs for row in each.rows]
    inside = held([row for row in rows if row.kind == kind])
    errors = [abs(r.estimate / r.truth - 1.0) for r in rows if r.kind == "friction at 0.3"]
    own = [name in each.chosen for each in runs]
    others = [any(each != name for each in run.chosen) for run in runs]
    shares = (100.0 * float(np.mean(each)) if each else None for each in (own, others))
    middle = 100.0 * float(np.median(errors)) if errors else None
    kept = 100.0 * float(np.mean(inside)) if inside else None
    return effect, len(runs), *shares, len(inside), kept, middle


def main() -> int:
    """Run every log and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--robot", action="append", choices=ROBOTS, help="a robot (default all)")
    parser.add_argument("--effect", action="append", choices=tuple(EFFECTS), help="default: none")
    parser.add_argument("--seeds", type=int, default=10, help="logs of each robot")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--no-profile", action="store_true", help="without profile intervals")
    parser.add_argument("--quick", action="store_true", help="one short log")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    robots = ("ur10",) if options.quick else there(options.data)
    robots = tuple(name for name in robots if options.robot is None or name in options.robot)
    effects = options.effect or ["none"]
    done: list[Row] = []
    text = []
    chosen: list[tuple[object, ...]] = []
    for effect in effects:
        tasks = []
        for robot in robots:
            for seed in range(
                options.first, options.first + (1 if options.quick else options.seeds)
            ):
                conditions = replace(drawn(robot, seed), **EFFECTS[effect])
                if options.quick:
                    conditions = replace(conditions, duration=15.0, rate_hz=100.0)
                tasks.append((effect, conditions, seed))
        profile = not (options.no_profile or options.quick)
        runs = parallel(options.jobs)(_delayed(*task, options.data, profile) for task in tasks)
        done += [row for each in runs for row in each.rows]
        table = Table(tuple(f.name for f in fields(Row)), tuple(astuple(row) for row in done))
        table.write(options.out / "truth.csv")
        if effect in OF_EFFECT:
            chosen.append(found_row(effect, runs))
            Table(FOUND, tuple(chosen)).write(options.out / "truth_effects.csv")
        text += [f"## {effect}", "", summary(runs), ""]
        print("\n".join(text[-3:]), flush=True)
    atomic_write_text(options.out / "truth.md", "\n".join(text))
    return 0


def _delayed(*task: Any) -> Any:
    from joblib import delayed

    return delayed(run)(*task)


if __name__ == "__main__":
    sys.exit(main())
