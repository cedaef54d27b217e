"""Which friction terms and cut-off predict best on five real robots, each left out in turn.

Every candidate is fitted to the training part of every set by the semidefinite program with the
default prior, and scored by its residual on what was held out (see real_robots.py). Of each robot
the others choose.

    python examples/robot_defaults.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from data_sets import ROBOTS, SETS
from real_robots import DEFAULT, DRIVES, METHODS, QUICK, Case, Terms, found

import sdpid
from sdpid._files import atomic_write_text
from sdpid.experiment.preparation import SMOOTH, default_processing


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
}

# More terms must predict better by more than this, or any noise would add some.
BETTER = 1.01

# Cut-offs, as factors of the default rule's (30 times the motion, at most 2/15 of the rate).
CUTOFFS: tuple[float, ...] = (1.0 / 3.0, 0.5, 2.0 / 3.0, 1.0, 1.5, 2.0)


def choices(cases: Sequence[Case], friction: Mapping[str, Terms], factors: Iterable[float]) -> str:
    """Return what other defaults would predict, and which are best without each robot."""
    terms: dict[str, dict[str, float]] = {}
    for label, candidate in friction.items():
        terms[label] = {c.name: held_out(c, candidate, 1.0) for c in cases}
        print(label, [f"{value:.2f}" for value in terms[label].values()], flush=True)
    cutoffs: dict[str, dict[str, float]] = {}
    for factor in factors:
        label = f"{30.0 * factor:.0f} times the motion"
        cutoffs[label] = {c.name: held_out(c, smooth("sigmoid"), factor) for c in cases}
        print(label, [f"{value:.2f}" for value in cutoffs[label].values()], flush=True)
    size = {label: len(candidate) for label, candidate in friction.items()}
    return f"{left_out('terms', terms, size)}\n\n{left_out('cut-off', cutoffs)}\n"


def held_out(case: Case, terms: Terms, factor: float) -> float:
    """Return the residual in %, on held-out rows that every candidate shares."""
    processing = default_processing(case.log)
    # The same rows for every cut-off, or the lowest would win by smoothing what is predicted.
    fresh = case.held_out(processing)
    highest = 2.0 / 15.0 * case.log.rate_hz
    cutoff = min(factor * processing.cutoff_hz, max(highest, processing.cutoff_hz))
    drives = tuple(term for term in DRIVES.get(case.name, ()) if term not in terms)
    try:
        samples = case.trained(replace(processing, cutoff_hz=cutoff))
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
    friction, factors = FRICTION, CUTOFFS
    if options.quick:
        friction = {label: FRICTION[label] for label in ("tanh 0.02", "tanh 0.02, sigmoid")}
        factors = CUTOFFS[2:4]
    text = "Nothing to show: no data.\n"
    if names:
        text = choices([Case.read(options.data, name) for name in names], friction, factors)
    atomic_write_text(options.out / "robot_defaults.md", text)
    print(f"\n{text}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
