"""Compare defaults on six real robots, each left out in turn.

Every candidate goes through `sdpid.identify` on every case of held_out.py and is scored by its
error on common rows of joints that move, which no candidate changes. Of each robot the others
choose.

    python examples/evidence/robot_defaults.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from data_sets import TITLES
from held_out import QUICK, Case, cases, error
from study import Study, grouped

import sdpid
from sdpid.experiment.preparation.prepare import samples_of
from sdpid.experiment.processing.choose import default_processing

# Arguments of `identify` for a recording to train on.
Arguments = Callable[[sdpid.Recording], dict[str, Any]]


def times(factor: float, log: sdpid.Recording) -> dict[str, Any]:
    """Return the default cut-off times a factor, at most 2/15 of the rate."""
    cutoff = min(factor * default_processing(log).cutoff_hz, 2.0 / 15.0 * log.rate_hz)
    return {"processing": {"cutoff_hz": cutoff}}


# The first of each is the default.
CANDIDATES: dict[str, dict[str, Arguments]] = {
    "cut-off": {
        f"{factor:g} times the default's": partial(times, factor)
        for factor in (1.0, 0.5, 0.8, 1.2, 2.0)
    },
    "mask": {
        "default": lambda log: {},
        "none": lambda log: {"processing": {"reversal_time": None}},
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
        quick={"sets": [*QUICK[:1]], "candidates": 1},
        sets=[*TITLES],
        candidates=max(map(len, CANDIDATES.values())),
    )
    found = {case.name: case for case in cases(study.data, study.sets)}
    for title, all_candidates in CANDIDATES.items():
        candidates = dict([*all_candidates.items()][: study.candidates])

        def scored(
            case: tuple[str, str], candidates: dict[str, Arguments] = candidates
        ) -> Iterator[tuple[object, ...]]:
            label, name = case
            yield label, found[name].robot_name, name, held_out(found[name], candidates[label])

        header = ("candidate", "robot", "case", "error")
        every = itertools.product(candidates, found)
        errors = study.rows(f"{title}.cases.csv", header, every, scored)
        robots = means(errors)
        lines = (
            [label, *own["error"], np.exp(np.mean(np.log(list(robots[label].values()))))]
            for (label,), own in grouped(errors, "candidate")
        )
        study.write(f"{title}.csv", (title, *found, "robots' mean"), lines, digits=3)
        header = ("left out", "the others choose", "it then has, %", "default, %")
        study.write(f"{title}.chosen.csv", header, chosen(robots), digits=3)


if __name__ == "__main__":
    main()
