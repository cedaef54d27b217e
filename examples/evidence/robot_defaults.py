"""Compare defaults on six real robots, each left out in turn, and on simulated logs.

Which predict best, and which find the truth?

Every candidate goes through `sdpid.identify` on every case of held_out.py and is scored by its
error on common rows of joints that move, which no candidate changes. Of each robot the others
choose. Beside stand the errors of friction curves on simulated logs (see truth.py), which have no
vote: what wins on robots must not lose there.

    python examples/evidence/robot_defaults.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from held_out import QUICK, TITLES, Case, cases, error
from simulated_logs import drawn, log_of, there
from truth import friction_rows

import sdpid
from sdpid._common.files import atomic_write_text
from sdpid.experiment.preparation.prepare import samples_of
from sdpid.experiment.processing.choose import default_processing
from sdpid.robot.friction.term import FrictionTerm

# Arguments of `identify` for a recording to train on.
Arguments = Callable[[sdpid.Recording], dict[str, Any]]


def same(**arguments: Any) -> Arguments:
    """Return arguments that do not depend on the recording."""
    return lambda log: dict(arguments)


def smooth(width: float | None, *others: str | FrictionTerm) -> Arguments:
    """Return a smooth sign of a width (rad/s), other terms, viscous friction and an offset."""
    return same(friction=(sdpid.friction.Coulomb(width=width), *others, "viscous", "offset"))


def times(factor: float) -> Arguments:
    """Return the default cut-off times a factor, at most 2/15 of the rate."""

    def changed(log: sdpid.Recording) -> dict[str, Any]:
        cutoff = min(factor * default_processing(log).cutoff_hz, 2.0 / 15.0 * log.rate_hz)
        return {"processing": {"cutoff_hz": cutoff}}

    return changed


# The first of each is the default; simpler ones come before others.
CANDIDATES: dict[str, dict[str, Arguments]] = {
    "terms": {
        "default": same(),
        "sign": smooth(0.0),
        "tanh 0.02": smooth(0.02),
        "tanh, chosen widths": smooth(None),
        "tanh 0.005, sigmoid": smooth(0.005, "sigmoid"),
        "tanh 0.01, sigmoid": smooth(0.01, "sigmoid"),
        "tanh 0.02, sigmoid": smooth(0.02, "sigmoid"),
        "tanh 0.05, sigmoid": smooth(0.05, "sigmoid"),
        "tanh 0.02, square root": smooth(0.02, "square_root"),
        "tanh 0.005, square root, sigmoid": smooth(0.005, "square_root", "sigmoid"),
    },
    "cut-off": {
        f"{factor:g} times the default's": times(factor) for factor in (1.0, 0.5, 0.8, 1.2, 2.0)
    },
    "mask": {
        "default": same(),
        "none": same(processing={"reversal_time": None}),
    },
    "filter": {
        "default": same(),
        "order 2": same(processing={"order": 2}),
    },
    "prior": {
        "default": same(),
        "a third of a nat": same(prior=sdpid.Prior(strength=1.0 / 3.0)),
        "three nats": same(prior=sdpid.Prior(strength=3.0)),
        "evidence": same(prior=sdpid.Prior(strength="evidence")),
        "entropic": same(prior=sdpid.Prior(kind="entropic")),
        "links only": same(prior=sdpid.Prior(friction=False)),
    },
}

# Another candidate must predict better than the default by more than this: what is seen on other
# choices of robots is 1 % of luck.
BETTER = 1.01


def held_out(case: Case, arguments: Arguments) -> float:
    """Return the geometric mean of a case's errors in %, infinite where there is no estimate."""
    given = case.arguments(arguments(case.log))
    try:
        estimate = sdpid.identify(case.robot, case.log, intervals=False, **given).estimate
    except sdpid.errors.SdpidError:
        return float("inf")
    errors = [
        error(estimate, samples_of(case.robot, other, case.common), case.after, only_moving=True)
        for other in case.others.values()
    ]
    return float(np.exp(np.mean(np.log(errors))))


def friction_error(arguments: Arguments, seeds: int, data: Path | None) -> tuple[float, float]:
    """Return median and 90th percentile of the errors of simulated friction curves, %."""
    errors = []
    for robot in there(data):
        for seed in range(seeds):
            log, truth = log_of(drawn(robot, seed), seed, data)
            try:
                result = sdpid.identify(truth.robot, log, intervals=False, **arguments(log))
            except sdpid.errors.SdpidError:
                errors.append(float("inf"))
                continue
            rows = friction_rows(("none", robot, seed), truth, result.estimate)
            errors += [abs(row.estimate / row.truth - 1.0) for row in rows]
    middle, tail = np.quantile(errors, [0.5, 0.9]) if errors else (np.nan, np.nan)
    return 100.0 * float(middle), 100.0 * float(tail)


def by_robot(scores: Mapping[str, float], found: Sequence[Case]) -> dict[str, float]:
    """Return the geometric mean of the cases' errors of each robot."""
    robots = dict.fromkeys(case.robot_name for case in found)
    return {
        robot: float(
            np.exp(np.mean([np.log(scores[c.name]) for c in found if c.robot_name == robot]))
        )
        for robot in robots
    }


def compared(
    title: str, candidates: Mapping[str, Arguments], found: Sequence[Case], seeds: int, data: Path
) -> str:
    """Return the table of candidates, and of each robot what the others would have chosen."""
    lines = [
        f"| {title} | " + " | ".join(case.name for case in found) + " | robots' mean | truth |"
    ]
    lines.append("|---|" + "---|" * (len(found) + 2))
    robots: dict[str, dict[str, float]] = {}
    for label, arguments in candidates.items():
        scores = {case.name: held_out(case, arguments) for case in found}
        robots[label] = by_robot(scores, found)
        mean = float(np.exp(np.mean(np.log(list(robots[label].values())))))
        cells = [f"{scores[case.name]:.3g}" for case in found]
        middle, tail = friction_error(arguments, seeds, data)
        cells += [f"{mean:.4g}", f"{middle:.2g}, {tail:.2g}" if np.isfinite(middle) else ""]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
        print(lines[-1], flush=True)
    default = next(iter(candidates))
    lines += [
        "",
        "| left out | the others choose | it then has, % | default, % |",
        "|---|---|---|---|",
    ]
    for name in robots[default]:
        others = [other for other in robots[default] if other != name]
        mean = {
            label: float(np.mean(np.log([own[other] for other in others])))
            for label, own in robots.items()
        }
        best = min(mean, key=mean.__getitem__)
        if mean[best] > mean[default] - float(np.log(BETTER)):
            best = default
        cells = [name, best, f"{robots[best][name]:.3g}", f"{robots[default][name]:.3g}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> int:
    """Compare and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--only", action="append", choices=tuple(CANDIDATES), help="default all")
    parser.add_argument("--seeds", type=int, default=3, help="simulated logs of each robot")
    parser.add_argument("--quick", action="store_true", help="one set, one candidate")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    found = list(cases(options.data, QUICK[:1] if options.quick else tuple(TITLES)))
    tables = []
    for title, candidates in CANDIDATES.items():
        if found and (options.only is None or title in options.only):
            chosen = dict(list(candidates.items())[: 1 if options.quick else None])
            seeds = 0 if options.quick else options.seeds
            tables.append(compared(title, chosen, found, seeds, options.data))
    text = "\n\n".join(tables) + "\n" if tables else "Nothing to show: no data.\n"
    atomic_write_text(options.out / "robot_defaults.md", text)
    print(f"\n{text}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
