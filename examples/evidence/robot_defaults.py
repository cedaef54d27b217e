"""Compare defaults on six real robots, each left out in turn.

Every candidate goes through `sdpid.identify` on every case of held_out.py and is scored by its
error on common rows of joints that move, which no candidate changes. Of each robot the others
choose.

    python examples/evidence/robot_defaults.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from data_sets import EVERY
from held_out import QUICK, Case, cases, error
from study import Rows, Study, grouped

import sdpid
from sdpid.experiment.processing.choose import default_processing

# Candidates for the cut-off, as factors of the default one, which is the first.
FACTORS = (1.0, 0.5, 0.8, 1.2, 2.0)
# A cut-off is at most this share of the rate.
HIGHEST = 2.0 / 15.0
# Another candidate must predict better than the default by more than this: what is seen on other
# choices of robots is 1 % of luck.
BETTER = 1.01
# What is given beside the defaults, the first of each being the default.
CANDIDATES: dict[str, dict[str, float | dict[str, Any]]] = {
    "cut-off": {f"{factor:g} times the default's": factor for factor in FACTORS},
    "mask": {"default": {}, "none": {"processing": {"reversal_time": None}}},
}


def mean(values: Any) -> float:
    """Return the geometric mean."""
    return float(np.exp(np.mean(np.log(values))))


def held_out(candidate: str, case: Case) -> Rows:
    """Yield the geometric mean of a case's errors in %, infinite where there is no estimate."""
    title, _, label = candidate.partition(": ")
    given = CANDIDATES[title][label]
    if isinstance(given, float):
        cutoff = min(given * default_processing(case.log).cutoff_hz, HIGHEST * case.log.rate_hz)
        given = {"processing": {"cutoff_hz": cutoff}}
    try:
        estimate = case.identify(**given).estimate
    except sdpid.errors.SdpidError:
        yield label, case.robot_name, case.name, float("inf")
        return
    errors = [error(case, estimate, other) for other in case.others.values()]
    yield label, case.robot_name, case.name, mean(errors)


def chosen(robots: dict[str, dict[str, float]]) -> Rows:
    """Yield of each robot what the others would have chosen, by errors with each candidate."""
    default = next(iter(robots))
    for name in robots[default]:
        others = {
            label: float(np.mean([np.log(own[other]) for other in own if other != name]))
            for label, own in robots.items()
        }
        best = min(others, key=lambda label: others[label])
        yield name, default if others[best] > others[default] - np.log(BETTER) else best


def main() -> None:
    """Compare and write the tables."""
    study = Study(
        __doc__,
        data=True,
        quick={"sets": [*QUICK[:1]], "candidates": 1},
        sets=[*EVERY],
        candidates=max(map(len, CANDIDATES.values())),
    )
    found = [*cases(study.data, study.sets)]
    for title, candidates in CANDIDATES.items():
        wanted = [f"{title}: {label}" for label in candidates][: study.candidates]
        header = ("candidate", "robot", "case", "error")
        errors = study.rows(f"{title}.cases.csv", header, held_out, wanted, found)
        lines, robots = [], {}
        for (label,), own in grouped(errors, "candidate"):
            names = dict.fromkeys(own["robot"])
            robots[label] = {name: mean(own["error"][own["robot"] == name]) for name in names}
            lines.append((label, *own["error"], mean([*robots[label].values()])))
        study.write(f"{title}.csv", (title, *map(str, found), "robots' mean"), lines, digits=3)
        study.write(f"{title}.chosen.csv", ("left out", "the others choose"), chosen(robots))


if __name__ == "__main__":
    main()
