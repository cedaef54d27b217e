"""Does `identify` find the truth with its defaults? Measured on simulated logs of four robots.

Each log of simulated_logs.py, its conditions drawn from the seed, goes through `sdpid.identify`
without any hint. Counted are the errors of friction curves, how many 95 % intervals hold the truth,
and how many estimates are outside their own interval. With --effects the base is tilted, friction
grows with load, or rotors add inertia.

    python examples/evidence/truth.py --out results --seeds 10 --jobs 2

Forty logs with profile intervals take some ten minutes on one core.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from simulated_logs import Truth, drawn, log_of, there
from study import Rows, Study, grouped, known

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.intervals.delta_method import friction_curve

# Speeds at which friction curves are compared, rad/s, on joints that reach them and whose Coulomb
# friction is so many times the noise of the effort.
SPEEDS, ABOVE_NOISE = (0.1, 0.3, 1.0), 5.0

# How kinds of quantities begin that are friction curves.
AT = "friction at "

# What is simulated beside ordinary friction; what the parameters of an effect are, and its name
# among those that `identify` chooses.
EFFECTS: dict[str, dict[str, float]] = {
    "none": {},
    "tilt": {"tilt_deg": 1.5},
    "load": {"load": 0.1},
    "rotor": {"rotor": 0.5},
}
OF_EFFECT = {
    "tilt": ("tilt", "tilt"),
    "load": ("load", "load"),
    "rotor": ("rotor inertia", "rotor_inertia"),
}

KINDS = {"m": "mass", "mx": "first moment", "my": "first moment", "mz": "first moment"}
KINDS |= dict.fromkeys(("xx", "xy", "xz", "yy", "yz", "zz"), "inertia")
KINDS |= {"Fv": "viscous", "Fo": "offset", "Fs": "Coulomb", "Ia": "rotor inertia"}
KINDS |= {"Gx": "tilt", "Gy": "tilt", "Fl": "load"}

# One quantity of one log. Of a log itself, a "log", the name lists the effects that were chosen,
# and the estimate is the number of estimates that are outside their own interval.
COLUMNS = (
    *("effect", "robot", "seed", "kind", "name", "truth", "estimate"),
    *("lower", "upper", "profile_lower", "profile_upper"),
)
NONE = (None, None)


def run(study: Study, effect: str, robot: str, seed: int) -> Rows:
    """Simulate a log, identify from it and compare: yield a row of the log, and its quantities."""
    conditions = replace(drawn(robot, seed), **EFFECTS[effect])
    if study.quick:
        conditions = replace(conditions, duration=15.0, rate_hz=100.0)
    log, truth = log_of(conditions, seed)
    try:
        result = sdpid.identify(truth.robot, log)
    except sdpid.errors.SdpidError as error:
        yield "refused", str(error), None, 0, *NONE, *NONE
        return
    estimate, outside = result.estimate, 0
    if result.intervals is not None:
        values = estimate.named() | (estimate.named_theta() or {})
        own = [values[name] for name in result.intervals.names]
        outside = int(np.count_nonzero(~result.intervals.contains(own)))
    chosen = ", ".join(each.name for each in result.problem.origin.effects if each.chosen)
    yield "log", chosen, None, outside, *NONE, *NONE
    friction, half_widths = friction_curve(estimate, SPEEDS)
    for k, speed in enumerate(SPEEDS):
        true = truth.friction(np.full((1, truth.robot.n), speed))[0]
        for j in range(truth.robot.n):
            if truth.top_speed[j] >= speed and truth.coulomb[j] >= ABOVE_NOISE * truth.noise[j]:
                value, half = friction[k, j], half_widths[k, j]
                ends = value - half, value + half
                yield f"{AT}{speed:g}", f"joint {j + 1}", true[j], value, *ends, *NONE
    found, exact = ends_of(result.intervals), {}
    if not study.no_profile:
        names = result.problem.base.names
        exact = ends_of(sdpid.confidence_intervals(estimate, parameters=names, n_jobs=1))
    for kind, name, *numbers in base_parameters(truth, estimate):
        yield kind, name, *numbers, *found.get(name, NONE), *exact.get(name, NONE)


def ends_of(intervals: Any) -> dict[str, tuple[float, float]]:
    """Return the ends of intervals by name of the parameter."""
    if intervals is None:
        return {}
    ends = zip(intervals.lower.tolist(), intervals.upper.tolist(), strict=True)
    return dict(zip(intervals.names, ends, strict=True))


def base_parameters(truth: Truth, estimate: Any) -> Iterator[tuple[str, str, float, float]]:
    """Yield kind, name, true and estimated value of the base parameters whose truth is known."""
    base = estimate.problem.base
    theta = truth.theta(estimate.problem)
    unknown = np.isnan(theta)
    values = base.matrix @ np.where(unknown, 0.0, theta)
    for i in np.flatnonzero(~np.any(base.matrix[:, unknown] != 0.0, axis=1)):
        kind = KINDS[base.names[i].rstrip("0123456789_").removesuffix("r")]
        yield kind, base.names[i], float(values[i]), float(estimate.base[i])


def held(own: Mapping[str, Array], way: str = "") -> float | None:
    """Return the share of intervals that hold the truth, %, of those that there are."""
    lower, upper = (own[f"{way}{end}"].astype(float) for end in ("lower", "upper"))
    inside = (lower <= own["truth"]) & (own["truth"] <= upper)
    inside = inside[~np.isnan(lower)]
    return 100.0 * float(np.mean(inside)) if inside.size else None


def off(own: Mapping[str, Array]) -> Array:
    """Return relative errors, %."""
    return np.abs(100.0 * (own["estimate"] / own["truth"] - 1.0))


def friction_table(rows: Sequence[Mapping[str, Any]]) -> Rows:
    """Yield the errors of friction at each speed."""
    for (kind,), own in grouped(rows, "kind"):
        if kind.startswith(AT):
            yield kind.removeprefix(AT), len(own["truth"]), *np.quantile(off(own), [0.5, 0.9])


def interval_table(rows: Sequence[Mapping[str, Any]]) -> Rows:
    """Yield how often intervals hold, of each kind of quantity, and of its worst parameter."""
    for (kind,), own in grouped(rows, "kind"):
        parameters = grouped([row for row in rows if row["kind"] == kind], "robot", "name")
        shares = [share for _, one in parameters if (share := held(one)) is not None]
        worst = f"{min(shares):.0f}" if shares else ""
        yield kind, len(own["truth"]), held(own), worst, held(own, "profile_")


def found_row(
    effect: str, logs: Sequence[Mapping[str, Any]], rows: Sequence[Mapping[str, Any]]
) -> tuple[object, ...]:
    """Return how often an effect was chosen, and how right its parameters are."""
    kind, name = OF_EFFECT[effect]
    kinds = {each: own for (each,), own in grouped(rows, "kind")}
    chosen = [[*filter(None, log["name"].split(", "))] for log in logs if log["kind"] == "log"]
    shares = (
        100.0 * sum(each) / len(logs)
        for each in ([name in own for own in chosen], [bool({*own} - {name}) for own in chosen])
    )
    count = len(known(kinds[kind]["lower"])) if kind in kinds else 0
    share = held(kinds[kind]) if kind in kinds else None
    middle = np.median(off(kinds[f"{AT}0.3"])) if f"{AT}0.3" in kinds else None
    return effect, len(logs), *shares, count, share, middle


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
    axes = study.effects, study.robots, range(study.seeds)
    done = study.rows("truth.csv", COLUMNS, partial(run, study), *axes, jobs=study.jobs)
    effects: list[tuple[object, ...]] = []
    for effect in study.effects:
        logs = [row for row in done if row["effect"] == effect and row["truth"] is None]
        rows = [row for row in done if row["effect"] == effect and row["truth"] is not None]
        if effect in OF_EFFECT:
            effects.append(found_row(effect, logs, rows))
        else:
            header = "friction at, rad/s", "joints", "error, median, %", "90th percentile, %"
            study.write("friction.csv", header, friction_table(rows), digits=3)
            header = (
                *("kind", "parameters", "intervals that hold the truth, %", "worst parameter, %"),
                "profile, %",
            )
            study.write("intervals.csv", header, interval_table(rows), digits=3)
        refused = sum(log["kind"] == "refused" for log in logs)
        print(
            f"{effect}: {len(logs)} logs, {refused} refused, "
            f"{sum(log['estimate'] for log in logs)} estimates outside their own interval, "
            f"effects chosen in {sum(log['kind'] == 'log' and log['name'] != '' for log in logs)}"
        )
    if effects:
        header = ("effect", "logs", "chosen_percent", "another_chosen_percent", "intervals")
        header += ("held_percent", "friction_error_percent")
        study.write("truth_effects.csv", header, effects)


if __name__ == "__main__":
    main()
