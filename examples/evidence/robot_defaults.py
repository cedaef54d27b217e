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

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from held_out import QUICK, TITLES, Case, cases, error
from simulated_logs import drawn, log_of, there
from study import Study, grouped
from truth import friction_rows

import sdpid
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


def friction_errors(arguments: Arguments, robot: str, seed: int) -> list[float]:
    """Return errors of the friction curves of a simulated log, %; infinite without an estimate."""
    log, truth = log_of(drawn(robot, seed), seed)
    try:
        result = sdpid.identify(truth.robot, log, intervals=False, **arguments(log))
    except sdpid.errors.SdpidError:
        return [float("inf")]
    rows = friction_rows(("none", robot, seed), truth, result.estimate)
    return [100.0 * abs(row.estimate / row.truth - 1.0) for row in rows]


def means(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Return of each candidate the geometric mean of the cases' errors of each robot."""
    found: dict[str, dict[str, float]] = {}
    for (label, robot), own in grouped(rows, "candidate", "robot"):
        found.setdefault(label, {})[robot] = float(np.exp(np.mean(np.log(own["error"]))))
    return found


def chosen(robots: dict[str, dict[str, float]]) -> Iterator[tuple[object, ...]]:
    """Yield of each robot what the others would have chosen."""
    default = next(iter(robots))
    for name in robots[default]:
        mean = {
            label: float(np.mean([np.log(own[other]) for other in own if other != name]))
            for label, own in robots.items()
        }
        best = min(mean, key=mean.__getitem__)
        if mean[best] > mean[default] - float(np.log(BETTER)):
            best = default
        yield name, best, robots[best][name], robots[default][name]


def main() -> None:
    """Compare and write the tables."""
    study = Study(
        __doc__,
        data=True,
        quick={"sets": [*QUICK[:1]], "candidates": 1, "seeds": 0},
        only=([*CANDIDATES], "what is chosen"),
        sets=[*TITLES],
        candidates=max(map(len, CANDIDATES.values())),
        seeds=(3, "simulated logs of each robot"),
    )
    found = {case.name: case for case in cases(study.data, study.sets)}
    for title in study.only:
        candidates = dict([*CANDIDATES[title].items()][: study.candidates])

        def scored(
            case: tuple[str, str], candidates: dict[str, Arguments] = candidates
        ) -> Iterator[tuple[object, ...]]:
            label, name = case
            yield label, found[name].robot_name, name, held_out(found[name], candidates[label])

        header = ("candidate", "robot", "case", "error")
        every = itertools.product(candidates, found)
        errors = study.rows(f"{title}.cases.csv", header, every, scored)
        robots, seeds = means(errors), range(study.seeds)
        lines = []
        for label, arguments in candidates.items():
            of_cases = [row["error"] for row in errors if row["candidate"] == label]
            mean = float(np.exp(np.mean(np.log(list(robots[label].values())))))
            true = [
                e for r in there() for seed in seeds for e in friction_errors(arguments, r, seed)
            ]
            ends = [float(each) for each in np.quantile(true, [0.5, 0.9])] if true else [None] * 2
            lines.append([label, *of_cases, mean, *ends])
        header = (title, *found, "robots' mean", "truth, median", "truth, 90 %")
        study.write(f"{title}.csv", header, lines, digits=3)
        header = ("left out", "the others choose", "it then has, %", "default, %")
        study.write(f"{title}.chosen.csv", header, chosen(robots), digits=3)


if __name__ == "__main__":
    main()
