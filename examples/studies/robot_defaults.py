"""Which friction terms, filter and cut-off predict best on five real robots, each left out in turn.

Every candidate is fitted to the training part of every set by the semidefinite program with the
default prior, and scored by its residual on what was held out (see real_robots.py). Of each robot
the others choose.

    python examples/studies/robot_defaults.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from data_sets import ROBOTS, SETS
from real_robots import DEFAULT, DRIVES, METHODS, QUICK, Case, Terms, found

import sdpid
from sdpid._common.files import atomic_write_text
from sdpid.experiment.preparation.for_robot import SMOOTH, default_processing

Change = Callable[[sdpid.Recording, sdpid.Processing], sdpid.Processing]


def smooth(*others: str | sdpid.FrictionTerm, width: float | None = SMOOTH) -> Terms:
    """Return a smooth sign, other terms, viscous friction and an offset."""
    return (sdpid.Coulomb(width=width), *others, "viscous", "offset")


FRICTION: dict[str, Terms] = {
    "sign": ("coulomb", "viscous", "offset"),
    "tanh 0.01": smooth(width=0.01),
    "tanh 0.02": smooth(),
    "tanh 0.05": smooth(width=0.05),
    "tanh 0.1": smooth(width=0.1),
    "tanh, chosen widths": smooth(width=None),
    "tanh 0.02, Stribeck": smooth(sdpid.Stribeck(width=SMOOTH)),
    "tanh 0.02, square root": smooth("square_root"),
    "tanh 0.02, sigmoid 0.2": smooth(sdpid.SigmoidFriction(velocity=0.2)),
    "tanh 0.02, sigmoid": smooth("sigmoid"),
    "tanh 0.01, sigmoid": smooth("sigmoid", width=0.01),
    "tanh 0.05, sigmoid": smooth("sigmoid", width=0.05),
    "tanh 0.02, square root, sigmoid": smooth("square_root", "sigmoid"),
    "tanh 0.02, sigmoid, rotor inertia": smooth("sigmoid", "rotor_inertia"),
    "asymmetric tanh 0.02, sigmoid": (
        sdpid.AsymmetricCoulomb(width=SMOOTH),
        *smooth("sigmoid")[1:],
    ),
}

# More terms must predict better by more than this, or any noise would add some.
BETTER = 1.01

# Cut-offs, as factors of the default rule's (30 times the motion, at most 2/15 of the rate).
CUTOFFS: tuple[float, ...] = (1.0 / 3.0, 0.5, 2.0 / 3.0, 1.0, 1.5, 2.0)


# Other ways to process, beside the default's cut-off.
FILTERS: dict[str, Change] = {
    "default": lambda log, default: default,
    "rule noise": lambda log, default: default_processing(log, rule="noise"),
    "Bessel": lambda log, default: replace(default, filter="bessel"),
    "order 2": lambda log, default: replace(default, order=2),
    "central": lambda log, default: replace(default, derivative="central"),
    "Savitzky-Golay": lambda log, default: replace(default, derivative="savitzky_golay"),
}


def times(factor: float) -> Change:
    """Return the default with another cut-off, up to what differences allow."""

    def change(log: sdpid.Recording, default: sdpid.Processing) -> sdpid.Processing:
        highest = max(2.0 / 15.0 * log.rate_hz, default.cutoff_hz)
        return replace(default, cutoff_hz=min(factor * default.cutoff_hz, highest))

    return change


def choices(
    cases: Sequence[Case],
    friction: Mapping[str, Terms],
    factors: Iterable[float],
    filters: Mapping[str, Change],
) -> str:
    """Return what other defaults would predict, and which are best without each robot."""
    default, usual = FILTERS["default"], smooth("sigmoid")
    terms = scores(cases, {label: (each, default) for label, each in friction.items()})
    size = {label: len(candidate) for label, candidate in friction.items()}
    cutoffs = {f"{30.0 * factor:.0f} times the motion": times(factor) for factor in factors}
    tables = [left_out("terms", terms, size)]
    for title, changes in (("cut-off", cutoffs), ("processing", filters)):
        found = scores(cases, {label: (usual, change) for label, change in changes.items()})
        tables.append(left_out(title, found))
    return "\n\n".join(tables) + "\n"


def scores(
    cases: Sequence[Case], candidates: Mapping[str, tuple[Terms, Change]]
) -> dict[str, dict[str, float]]:
    """Return the held-out residuals of all candidates on all sets, %."""
    out = {}
    for label, (terms, change) in candidates.items():
        out[label] = {case.name: held_out(case, terms, change) for case in cases}
        print(label, [f"{value:.2f}" for value in out[label].values()], flush=True)
    return out


def held_out(case: Case, terms: Terms, change: Change) -> float:
    """Return the residual in %, on held-out rows that every candidate shares."""
    processing = default_processing(case.log)
    # The same rows for every filter, or the lowest cut-off would win by smoothing what is
    # predicted.
    fresh = case.held_out(processing)
    drives = tuple(term for term in DRIVES.get(case.name, ()) if term not in terms)
    try:
        samples = case.trained(change(case.log, processing))
        problem = case.problem(samples, METHODS[DEFAULT], (*terms, *drives))
        return 100.0 * sdpid.validate(sdpid.solve_sdp(problem), fresh).relative
    except sdpid.SdpidError:
        return float("inf")


def left_out(
    title: str, scores: Mapping[str, Mapping[str, float]], size: Mapping[str, int] | None = None
) -> str:
    """Return the table of candidates, and of each robot what the others would have chosen.

    The least geometric mean is chosen; where candidates have sizes, of those within 1 % of it
    the smallest, and of equally small ones the first.
    """
    names = list(next(iter(scores.values())))
    lines = [f"| {title} | " + " | ".join(ROBOTS[n] for n in names) + " | geometric mean |"]
    lines.append("|---|" + "---|" * (len(names) + 1))
    for label, score in scores.items():
        values = [score[name] for name in names]
        mean = float(np.exp(np.mean(np.log(values))))
        lines.append(f"| {label} | " + " | ".join(f"{v:.3g}" for v in (*values, mean)) + " |")
    lines += ["", "| left out | the others choose | it then has, % |", "|---|---|---|"]
    for name in names:
        others = [other for other in names if other != name]

        def mean_of(label: str, others: Sequence[str] = others) -> float:
            return float(np.mean([np.log(scores[label][other]) for other in others]))

        best = min(scores, key=mean_of)
        if size is not None:
            limit = mean_of(best) + float(np.log(BETTER))
            best = min((label for label in scores if mean_of(label) <= limit), key=size.__getitem__)
        lines.append(f"| {ROBOTS[name]} | {best} | {scores[best][name]:.3g} |")
    return "\n".join(lines)


def main() -> int:
    """Compare and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--quick", action="store_true", help="two sets, few candidates")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    names = found(options.data, QUICK if options.quick else tuple(SETS))
    friction, factors, filters = FRICTION, CUTOFFS, FILTERS
    if options.quick:
        friction = {label: FRICTION[label] for label in ("tanh 0.02", "tanh 0.02, sigmoid")}
        factors, filters = CUTOFFS[2:4], {"default": FILTERS["default"]}
    text = "Nothing to show: no data.\n"
    if names:
        cases = [Case.read(options.data, name) for name in names]
        text = choices(cases, friction, factors, filters)
    atomic_write_text(options.out / "robot_defaults.md", text)
    print(f"\n{text}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
