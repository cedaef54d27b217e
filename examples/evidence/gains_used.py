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

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from simulated_logs import Conditions, Truth, drawn, log_of, other_log
from study import Study, grouped
from truth import base_rows, ends_of

import sdpid
from sdpid._common.arrays import Array
from sdpid.robot.inertia import theta_from_physical

ROBOT = "ur10"
# Standard errors as shares, and the part that all have in common.
FIRST, OTHERS, COMMON = 0.04, 0.02, 0.01
# N·m/A, of which nothing depends on: all errors are shares.
TRUE = 10.0
# A payload on the last link: kg, m, and its inertia about the center of mass, kg·m².
MASS, COM, INERTIA = 2.8, (0.03, 0.02, 0.09), np.diag([0.012, 0.012, 0.008])
LONGEST = 40.0

HEADER = ("quantity", "intervals", "held_percent", "exact_held_percent", "wider")
MOSTLY = 0.5


# Of one interval: the kind, whether it holds the truth with and without the gains' errors, and by
# how much these widen it.
Found = tuple[str, bool, bool, float]


def covariance(n: int) -> Array:
    """Return the covariance (n, n) of the gains' errors as shares."""
    own = np.array([FIRST, *[OTHERS] * (n - 1)]) ** 2 - COMMON**2
    return np.diag(own) + COMMON**2


def gains_of(robot: sdpid.RobotModel, rng: np.random.Generator) -> sdpid.DriveGains:
    """Return gains that are off by errors drawn from their covariance."""
    relative = covariance(robot.n)
    off = np.linalg.cholesky(relative) @ rng.standard_normal(robot.n)
    gains = TRUE * (1.0 + off)
    return sdpid.DriveGains(
        joint_names=robot.joint_names,
        gains=gains,
        covariance=relative * np.outer(gains, gains),
        basis="simulation",
    )


def in_amperes(log: sdpid.Recording) -> sdpid.Recording:
    """Return a log with currents in place of torques."""
    return replace(log, effort=np.asarray(log.effort) / TRUE, currents=True)


def run(seed: int, conditions: Conditions) -> Iterator[Found]:
    """Yield what was found of one simulated arm, by gains that are off."""
    log, truth = log_of(conditions, seed)
    loaded = other_log(with_payload(truth), seed)
    gains = gains_of(truth.robot, np.random.default_rng([seed, 3]))
    logs = in_amperes(log), in_amperes(loaded)
    yield from parameters(truth, logs[0], gains)
    payloads = [
        sdpid.identify_payload(truth.robot, logs[1], logs[0], gains=each)
        for each in (gains, gains.gains)
    ]
    tensor = INERTIA[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    values = np.array([MASS, *COM, *tensor])
    kinds = ("payload: mass", *("payload: center of mass",) * 3, *("payload: inertia",) * 6)
    for k, (kind, value) in enumerate(zip(kinds, values.tolist(), strict=True)):
        numbers: list[float] = []
        for payload in payloads:
            low, high = float(payload.lower[k]), float(payload.upper[k])
            numbers += [low <= value <= high, high - low]
        yield kind, bool(numbers[0]), bool(numbers[2]), numbers[1] / numbers[3]


def parameters(truth: Truth, log: sdpid.Recording, gains: sdpid.DriveGains) -> Iterator[Found]:
    """Yield what was found of the base parameters."""
    result = sdpid.identify(truth.robot, log, gains=gains)
    problem = result.problem
    rows = problem.require_rows_here("study")
    exact = replace(problem, rows=replace(rows, samples=replace(rows.samples, gains=None)))
    names = problem.base.names
    intervals = sdpid.confidence_intervals(result.estimate, parameters=names, method="gauss_markov")
    others = ends_of(
        sdpid.confidence_intervals(
            replace(result.estimate, problem=exact), parameters=names, method="gauss_markov"
        )
    )
    share = dict(zip(intervals.names, intervals.shares["gains"].tolist(), strict=True))
    for row in base_rows((ROBOT, ROBOT, 0), truth, result.estimate, ends_of(intervals), others):
        if row.lower is None or row.upper is None:
            continue
        assert row.profile_lower is not None
        assert row.profile_upper is not None
        kind = "most of the variance the gains'" if share[row.name] > MOSTLY else "the others"
        yield (
            f"base parameters, {kind}",
            row.lower <= row.truth <= row.upper,
            row.profile_lower <= row.truth <= row.profile_upper,
            (row.upper - row.lower) / (row.profile_upper - row.profile_lower),
        )


def with_payload(truth: Truth) -> Truth:
    """Return an arm that carries the payload."""
    inertias = truth.inertias.copy()
    inertias[-1] += theta_from_physical(MASS, COM, INERTIA)
    return replace(truth, inertias=inertias)


def main() -> None:
    """Run every log and write the table: counts, shares that hold, and the median widening."""
    study = Study(__doc__, quick={"seeds": 1}, seeds=(60, "simulated arms"))

    def rows(seed: int) -> Iterator[tuple[object, ...]]:
        conditions = drawn(ROBOT, seed)
        rate = min(conditions.rate_hz, 200.0)
        duration = 15.0 if study.quick else min(conditions.duration, LONGEST)
        try:
            yield from run(seed, replace(conditions, rate_hz=rate, duration=duration))
        except sdpid.errors.SdpidError as error:
            print(f"{seed}: {error}", flush=True)

    header = ("quantity", "held", "exact_held", "wider")
    found = study.rows("each.csv", header, range(study.seeds), rows)
    lines = []
    for (kind,), own in grouped(found, "quantity"):
        held = (100.0 * own[name].mean() for name in header[1:3])
        lines.append((kind, len(own["held"]), *held, np.median(own["wider"])))
    study.write("gains_used.csv", HEADER, lines)


if __name__ == "__main__":
    main()
