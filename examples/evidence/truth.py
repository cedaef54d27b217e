"""Does `identify` find the truth with its defaults? Measured on simulated logs of four robots.

Each log of simulated_logs.py, its conditions drawn from the seed, goes through `sdpid.identify`
without any hint. Counted are the errors of friction curves and base parameters, how many 95 %
intervals hold the truth, and how many estimates are outside their own interval. With --effect the
base is tilted, friction grows with load or falls with speed, or rotors add inertia.

    python examples/evidence/truth.py --out results --seeds 10 --jobs 2

Forty logs with profile intervals take some ten minutes on one core.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from simulated_logs import Conditions, Truth, drawn, log_of, there
from study import Study, grouped

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.intervals.delta_method import friction_curve

# Speeds at which friction curves are compared, rad/s, on joints that reach them and whose Coulomb
# friction is so many times the noise of the effort.
SPEEDS, ABOVE_NOISE = (0.1, 0.3, 1.0), 5.0

# How kinds of quantities begin that are friction curves.
AT = "friction at "

# Standard normal quantile.
NORMAL = 1.959963984540054

# What is simulated beside ordinary friction.
EFFECTS: dict[str, dict[str, float]] = {
    "none": {},
    "tilt": {"tilt_deg": 1.5},
    "load": {"load": 0.1},
    "rotor": {"rotor": 0.5},
}

KINDS = {"m": "mass", "mx": "first moment", "my": "first moment", "mz": "first moment"}
KINDS |= dict.fromkeys(("xx", "xy", "xz", "yy", "yz", "zz"), "inertia")
KINDS |= {"Fv": "viscous", "Fo": "offset", "Fs": "Coulomb", "Ia": "rotor inertia"}
KINDS |= {"Gx": "tilt", "Gy": "tilt", "Fl": "load"}


class Row(NamedTuple):
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


# Of a quantity without a value the row tells of the log: what was chosen, and how it went.
COLUMNS = (*Row._fields, "chosen", "intervals", "outside", "seconds")


def run(effect: str, conditions: Conditions, seed: int, profile: bool) -> Iterator[tuple[Any, ...]]:
    """Simulate a log, identify from it and compare: yield a row of the log, and its quantities."""
    log, truth = log_of(conditions, seed)
    known, none = (effect, conditions.robot, seed), (None,) * 7
    start = time.perf_counter()
    try:
        result = sdpid.identify(truth.robot, log)
    except sdpid.errors.SdpidError as error:
        yield (*known, "refused", str(error), *none, [], 0, 0, time.perf_counter() - start)
        return
    seconds = time.perf_counter() - start
    found, outside = ends_of(result.intervals), 0
    if result.intervals is not None:
        values = result.estimate.named() | (result.estimate.named_theta() or {})
        own = [values[name] for name in result.intervals.names]
        outside = int(np.count_nonzero(~result.intervals.contains(own)))
    exact: dict[str, tuple[float, float]] = {}
    if profile:
        names = result.problem.base.names
        exact = ends_of(sdpid.confidence_intervals(result.estimate, parameters=names, n_jobs=1))
    chosen = [each.name for each in result.problem.origin.effects if each.chosen]
    yield (*known, "log", "", *none, chosen, len(found), outside, seconds)
    rows = friction_rows(known, truth, result.estimate)
    for row in (*rows, *base_rows(known, truth, result.estimate, found, exact)):
        yield (*row, None, None, None, None)


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
            rows.append(Row(*known, f"{AT}{speed:g}", f"joint {j + 1}", *numbers))
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


def held(own: Mapping[str, Array], kind: str = "") -> Array:
    """Return whether each interval holds the truth; NaN where there is none."""
    lower, upper = (own[f"{kind}{end}"].astype(float) for end in ("lower", "upper"))
    inside = (lower <= own["truth"]) & (own["truth"] <= upper)
    return np.where(np.isnan(lower), np.nan, inside)


def percent(values: Any) -> float | None:
    """Return the share in percent of what is known, or nothing."""
    known = np.asarray(values, dtype=float)
    known = known[~np.isnan(known)]
    return 100.0 * float(np.mean(known)) if known.size else None


def friction_table(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[object, ...]]:
    """Yield the errors of friction at each speed."""
    for (kind,), own in grouped(rows, "kind"):
        if kind.startswith(AT):
            errors = 100.0 * (own["estimate"] / own["truth"] - 1.0)
            middle, tail = np.quantile(np.abs(errors), [0.5, 0.9])
            yield kind.removeprefix(AT), errors.size, middle, tail, np.median(errors)


def interval_table(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[object, ...]]:
    """Yield errors in stated errors, and how often intervals hold, of each kind of quantity."""
    for (kind,), own in grouped(rows, "kind"):
        z = np.abs((own["estimate"] - own["truth"]) / own["error"])
        parameters = [*grouped([row for row in rows if row["kind"] == kind], "robot", "name")]
        shares, worst = [], []
        for way in ("", "profile_"):
            shares.append(percent(held(own, way)))
            each = [percent(held(one, way)) for _, one in parameters]
            least = min((share for share in each if share is not None), default=None)
            worst.append("" if least is None else f"{least:.0f}")
        ends = ", ".join(f"{end:.2f}" for end in np.quantile(z, [0.5, 0.9]))
        yield kind, len(z), ends, *shares, ", ".join(worst)


# What the parameters of an effect are, and its name among those that `identify` chooses.
OF_EFFECT = {
    "tilt": ("tilt", "tilt"),
    "load": ("load", "load"),
    "rotor": ("rotor inertia", "rotor_inertia"),
}
FOUND = (
    *("effect", "logs", "chosen_percent", "another_chosen_percent", "intervals", "held_percent"),
    "friction_error_percent",
)


def found_row(
    effect: str, logs: Sequence[Mapping[str, Any]], kinds: Mapping[str, Mapping[str, Array]]
) -> tuple[object, ...]:
    """Return how often an effect was chosen, and how right its parameters are."""
    kind, name = OF_EFFECT[effect]
    inside = held(kinds[kind]) if kind in kinds else np.zeros(0)
    own = [name in each["chosen"] for each in logs]
    others = [any(each != name for each in log["chosen"]) for log in logs]
    middle = None
    if friction := kinds.get(f"{AT}0.3"):
        middle = 100.0 * np.median(np.abs(friction["estimate"] / friction["truth"] - 1.0))
    count = int(np.count_nonzero(~np.isnan(inside)))
    return effect, len(logs), percent(own), percent(others), count, percent(inside), middle


def main() -> None:
    """Run every log and write the tables."""
    study = Study(
        __doc__,
        quick={"robots": ["ur10"], "seeds": 1, "no_profile": True},
        robots=[*there()],
        effects=["none"],
        seeds=(10, "logs of each robot"),
        jobs=1,
        no_profile=(False, "without profile intervals"),
    )

    def rows_of(case: tuple[str, str, int]) -> Iterator[tuple[object, ...]]:
        effect, robot, seed = case
        conditions = replace(drawn(robot, seed), **EFFECTS[effect])
        if study.quick:
            conditions = replace(conditions, duration=15.0, rate_hz=100.0)
        return run(effect, conditions, seed, not study.no_profile)

    cases = itertools.product(study.effects, study.robots, range(study.seeds))
    done = study.rows("truth.csv", COLUMNS, cases, rows_of, jobs=study.jobs)
    effects: list[tuple[object, ...]] = []
    for effect in study.effects:
        own = [row for row in done if row["effect"] == effect]
        logs = [row for row in own if row["kind"] in ("log", "refused")]
        rows = [row for row in own if row["truth"] is not None]
        if effect in OF_EFFECT:
            kinds = {kind: each for (kind,), each in grouped(rows, "kind")}
            effects.append(found_row(effect, logs, kinds))
        suffix = "" if effect == "none" else f"_{effect}"
        header = (
            "friction at, rad/s",
            "joints",
            "error, median, %",
            "90th percentile, %",
            "bias, %",
        )
        study.write(f"friction{suffix}.csv", header, friction_table(rows), digits=3)
        header = (
            *("kind", "parameters", "error in stated errors, median, 90th percentile"),
            *("intervals that hold the truth, %", "profile, %"),
            "worst parameter, default, profile, %",
        )
        study.write(f"intervals{suffix}.csv", header, interval_table(rows), digits=3)
        names = dict.fromkeys(name for each in logs for name in each["chosen"])
        chosen = ((name, percent([name in each["chosen"] for each in logs])) for name in names)
        study.write(f"chosen{suffix}.csv", ("effect", "chosen, % of the logs"), chosen, digits=3)
        count, outside, seconds = (
            [each[name] for each in logs] for name in ("intervals", "outside", "seconds")
        )
        print(
            f"{len(logs)} logs, {sum(each['kind'] == 'refused' for each in logs)} refused; "
            f"{sum(outside)} of {sum(count)} estimates outside their own interval; "
            f"{np.median(seconds):.2g} s a log (median)"
        )
    if effects:
        study.write("truth_effects.csv", FOUND, effects)


if __name__ == "__main__":
    main()
