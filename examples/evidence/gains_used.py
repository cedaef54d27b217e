"""Measure whether intervals hold the truth where gains that are off made torques of currents.

Logs of simulated_logs.py are turned into currents by gains that nobody knows. Whoever identifies
has gains that are off, drawn from their stated covariance: 4 % at the first joint, 2 % at the
others, 1 % of it in common. Counted are the 95 % intervals of base parameters, and of a payload
on the last link, that hold the truth: with the errors of the gains, and with gains that are taken
as exact.

    python examples/evidence/gains_used.py --out results --seeds 60

Sixty logs take some eight minutes on one core.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from simulated_logs import Truth, drawn, log_of, other_log
from study import Rows, Study
from truth import base_parameters, ends_of

import sdpid
from sdpid.robot.inertia import theta_from_physical

ROBOT = "ur10"
# Standard errors as shares, and the part that all have in common.
FIRST, OTHERS, COMMON = 0.04, 0.02, 0.01
# N·m/A, of which nothing depends on: all errors are shares.
TRUE = 10.0
# A payload on the last link: kg, m, and its inertia about the center of mass, kg·m².
MASS, COM, INERTIA = 2.8, (0.03, 0.02, 0.09), np.diag([0.012, 0.012, 0.008])
LONGEST = 40.0
MOSTLY = 0.5

# Of one interval: the kind, whether it holds the truth with and without the gains' errors, and by
# how much these widen it.
EACH = ("quantity", "held", "exact_held", "wider")


def gains_of(robot: sdpid.RobotModel, rng: np.random.Generator) -> sdpid.DriveGains:
    """Return gains that are off by errors drawn from their covariance."""
    relative = np.diag(np.array([FIRST, *[OTHERS] * (robot.n - 1)]) ** 2 - COMMON**2) + COMMON**2
    gains = TRUE * (1.0 + np.linalg.cholesky(relative) @ rng.standard_normal(robot.n))
    return sdpid.DriveGains(
        joint_names=robot.joint_names,
        gains=gains,
        covariance=relative * np.outer(gains, gains),
        basis="simulation",
    )


def in_amperes(log: sdpid.Recording) -> sdpid.Recording:
    """Return a log with currents in place of torques."""
    return replace(log, effort=np.asarray(log.effort) / TRUE, currents=True)


def compared(kind: str, value: float, own: Any, exact: Any) -> tuple[object, ...]:
    """Return what is found of an interval with the errors of the gains, and of one without."""
    (low, high), (least, most) = own, exact
    return kind, low <= value <= high, least <= value <= most, (high - low) / (most - least)


def run(study: Study, seed: int) -> Rows:
    """Yield what was found of one simulated arm, by gains that are off."""
    usual = drawn(ROBOT, seed)
    duration = 15.0 if study.quick else min(usual.duration, LONGEST)
    log, truth = log_of(replace(usual, rate_hz=min(usual.rate_hz, 200.0), duration=duration), seed)
    inertias = truth.inertias.copy()
    inertias[-1] += theta_from_physical(MASS, COM, INERTIA)
    logs = in_amperes(log), in_amperes(other_log(replace(truth, inertias=inertias), seed))
    gains = gains_of(truth.robot, np.random.default_rng([seed, 3]))
    try:
        yield from parameters(truth, logs[0], gains)
        payloads = [
            sdpid.identify_payload(truth.robot, logs[1], logs[0], gains=each)
            for each in (gains, gains.gains)
        ]
    except sdpid.errors.SdpidError as error:
        print(f"{seed}: {error}", flush=True)
        return
    tensor = INERTIA[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    kinds = ("payload: mass", *("payload: center of mass",) * 3, *("payload: inertia",) * 6)
    for k, (kind, value) in enumerate(zip(kinds, (MASS, *COM, *tensor), strict=True)):
        yield compared(kind, value, *((each.lower[k], each.upper[k]) for each in payloads))


def parameters(truth: Truth, log: sdpid.Recording, gains: sdpid.DriveGains) -> Rows:
    """Yield what was found of the base parameters."""
    result = sdpid.identify(truth.robot, log, gains=gains)
    problem = result.problem
    rows = problem.require_rows_here("study")
    exact = replace(problem, rows=replace(rows, samples=replace(rows.samples, gains=None)))
    known, alone = (
        sdpid.confidence_intervals(each, parameters=problem.base.names, method="gauss_markov")
        for each in (result.estimate, replace(result.estimate, problem=exact))
    )
    share = dict(zip(known.names, known.shares["gains"].tolist(), strict=True))
    ends, others = ends_of(known), ends_of(alone)
    for _, name, value, _ in base_parameters(truth, result.estimate):
        if name in ends:
            kind = "most of the variance the gains'" if share[name] > MOSTLY else "the others"
            yield compared(f"base parameters, {kind}", value, ends[name], others[name])


def main() -> None:
    """Run every log and write the table: counts, shares that hold, and the median widening."""
    study = Study(__doc__, quick={"seeds": 1}, seeds=(60, "simulated arms"))
    found = study.rows("each.csv", EACH, partial(run, study), range(study.seeds))
    columns = {
        "intervals": "count held",
        "held_percent": "percent held",
        "exact_held_percent": "percent exact_held",
        "wider": "median wider",
    }
    study.summary("gains_used.csv", found, EACH[:1], columns)


if __name__ == "__main__":
    main()
