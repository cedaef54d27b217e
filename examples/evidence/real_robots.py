"""Five real robots, many methods: what each predicts on motion that it was not trained on.

Every set of docs/evidence/data.md is processed with default settings that are chosen on its
training part alone, and fitted by least squares, ridge regression and the semidefinite program with
several priors, all with the same friction terms; local solvers, seconds and bodies are those of
examples/benchmark. Held out are the second
run where there are two, otherwise all rows behind the first 60 % of the record. The published
numbers that can be compared stand beside.

    python examples/evidence/real_robots.py --data /path/to/data --out results

held_out.py shows how the defaults were chosen. The folder of the data may also be named by
the environment variable SDPID_DATA.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from data_sets import SETS, Terms
from held_out import QUICK, Case, first_of_arms
from study import Rows, Study, pivot

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.compression.covariance import Weighting
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.prepare import SMOOTH, default_friction, samples_of
from sdpid.experiment.processing.choose import default_processing
from sdpid.robot.inertia import Consistency

QUICK_METHODS = ("description, friction fitted", "OLS", "SDP 4×4")

# Strength in nats that holds the links at the description.
FIXED = 1e8

DEFAULT = "SDP 4×4"

HEADER = ("set", "method", "trained", "held_out", "status")


@dataclass(frozen=True)
class Method:
    """A way to estimate: the solver, and what it is given."""

    solve: Callable[[Problem], Estimate]
    prior: sdpid.Prior | None = None
    consistency: Consistency = "pseudo_inertia"
    weighting: Weighting = "residual"


ONE_NAT = sdpid.Prior()
METHODS = {
    "description, friction fitted": Method(sdpid.solve_wls, sdpid.Prior(strength=FIXED)),
    "OLS": Method(sdpid.solve_wls, weighting="gls"),
    "WLS": Method(sdpid.solve_wls),
    "ridge, pullback": Method(sdpid.solve_wls, ONE_NAT),
    "ridge, scaled, evidence": Method(
        sdpid.solve_wls, sdpid.Prior(kind="scaled_euclidean", strength="evidence")
    ),
    "SDP 6×6, no prior": Method(sdpid.solve_sdp, None, "spatial_inertia"),
    "SDP 4×4, no prior": Method(sdpid.solve_sdp),
    "SDP 6×6": Method(sdpid.solve_sdp, ONE_NAT, "spatial_inertia"),
    DEFAULT: Method(sdpid.solve_sdp, ONE_NAT),
    "SDP 4×4, evidence": Method(sdpid.solve_sdp, sdpid.Prior(strength="evidence")),
    "SDP 4×4, entropic": Method(sdpid.solve_sdp, sdpid.Prior(kind="entropic")),
    "SDP 4×4, scaled euclidean": Method(sdpid.solve_sdp, sdpid.Prior(kind="scaled_euclidean")),
    "SDP 4×4, euclidean": Method(sdpid.solve_sdp, sdpid.Prior(kind="euclidean")),
}


def problem_of(case: Case, samples: sdpid.Samples, method: Method, terms: Terms) -> Problem:
    """Return the problem of a method, with the default bounds."""
    return sdpid.build_problem(
        case.robot,
        samples,
        friction=terms,
        weighting=method.weighting,
        consistency=method.consistency,
        constraints=sdpid.Constraints.of_size(case.robot),
        prior=method.prior,
    )


def terms_of(case: Case) -> Terms:
    """Return the friction terms that all methods of a set have."""
    return (*default_friction(case.log), *case.terms)


def prepared(case: Case) -> Rows:
    """Yield what is trained on and predicted, and how long that takes to prepare."""
    start = time.perf_counter()
    processing = default_processing(case.log)
    samples = case.trained(processing)
    problem_of(case, samples, METHODS[DEFAULT], terms_of(case))
    seconds = time.perf_counter() - start
    counts = len(samples.effort), len(case.held_out(processing).effort)
    yield case.robot_name, processing.cutoff_hz, processing.velocity, *counts, seconds


def rows(names: Iterable[str], case: Case) -> Rows:
    """Yield the rows of a set."""
    processing = default_processing(case.log)
    samples, fresh = case.trained(processing), case.held_out(processing)
    # The speeds of friction are chosen once; all methods have the same terms.
    closed = problem_of(case, samples, METHODS[DEFAULT], terms_of(case)).friction.terms
    for name in names:
        method = METHODS[name]
        try:
            estimate = method.solve(problem_of(case, samples, method, closed))
            status = estimate.status
        except sdpid.errors.SdpidError as error:
            estimate, status = getattr(error, "found", None), type(error).__name__
        if estimate is None:
            yield case.robot_name, name, None, None, status
            continue
        errors = (100.0 * sdpid.validate(estimate, each).relative for each in (None, fresh))
        yield case.robot_name, name, *errors, status


def residuals(row: Mapping[str, Any]) -> str:
    """Return the error on what was held out, and that on what was trained on."""
    if row["held_out"] is None:
        return str(row["status"])
    return f"{row['held_out']:.4g} ({row['trained']:.3g})"


# Published root mean square errors, N·m, and on what; see the sets' sources in
# docs/evidence/data.md.
PUBLISHED: dict[str, tuple[str, tuple[float, ...]]] = {
    "TX40": (
        "FIGAROH, its own training rows (this whole record)",
        (6.39, 6.08, 2.67, 1.17, 1.57, 0.80),
    ),
    "UR10": (
        "UNISA's identified model, whole record (rebuilt to about 1 %)",
        (4.22, 4.90, 1.58, 0.70, 0.84, 1.32),
    ),
    "LWR 4+": (
        "FloBaRoID, description alone, run 1",
        (0.36, 1.55, 0.49, 0.98, 0.63, 0.49, 0.27),
    ),
}

# Robots whose published model has friction that differs in the two directions of motion.
ASYMMETRIC = ("UR10",)

# FIGAROH's filter, Hz: errors are compared on rows filtered alike.
PUBLISHED_HZ = {"TX40": 100.0}

# Blocks of a record that are held out in turn.
BLOCKS = 5

# Cut-offs that the held-out rows are filtered at too, as factors of the default.
SCORED = (0.5, 1.0, 2.0, 4.0)

# No filter needs a cut-off above this share of the rate.
HIGHEST = 0.4

# Gaz et al., gravity parameters of the Panda, kg·m, as weights of (link, parameter of theta).
GAZ: dict[str, tuple[float, dict[tuple[int, int], float]]] = {
    "m2·c2y − m3·c3z − 0.316·(m3 + … + m7)": (
        -3.136,
        {(2, 2): 1.0, (3, 3): -1.0, **{(i, 0): -0.316 for i in range(3, 8)}},
    ),
    "m4·c4y + m5·c5z + 0.384·(m5 + m6 + m7)": (
        1.752,
        {(4, 2): 1.0, (5, 3): 1.0, **{(i, 0): 0.384 for i in range(5, 8)}},
    ),
    "m6·c6x + 0.088·m7": (0.164, {(6, 1): 1.0, (7, 0): 0.088}),
    "m6·c6y − m7·c7z": (-0.062, {(6, 2): 1.0, (7, 3): -1.0}),
}


def cutoffs(case: Case) -> Rows:
    """Yield the errors of the default estimate on rows that are filtered at other cut-offs, %."""
    processing = default_processing(case.log)
    estimate = default(case, case.trained(processing), terms_of(case))
    errors = []
    for factor in SCORED:
        changed = replace(processing, cutoff_hz=factor * processing.cutoff_hz)
        fits = changed.cutoff_hz < HIGHEST * case.log.rate_hz
        fresh = case.held_out(changed) if fits else None
        errors.append(fresh and 100.0 * sdpid.validate(estimate, fresh).relative)
    yield case.robot_name, *errors


def default(case: Case, samples: sdpid.Samples, terms: Terms) -> Estimate:
    """Return the estimate that `identify` solves for."""
    return sdpid.solve_sdp(problem_of(case, samples, METHODS[DEFAULT], terms))


def published(case: Case) -> Rows:
    """Yield errors of joints, N·m: published ones, and those of estimates beside them."""
    name, processing, terms = case.robot_name, default_processing(case.log), terms_of(case)
    if name not in PUBLISHED:
        return
    words, numbers = PUBLISHED[name]
    lines = [(words, joined(numbers))]
    trained, fresh = case.trained(processing), case.held_out(processing)
    estimate = default(case, trained, terms)
    lines.append(("default, held out", joined(sdpid.validate(estimate, fresh).rmse)))
    if name in PUBLISHED_HZ:
        at = f"{PUBLISHED_HZ[name]:g} Hz"
        alike = case.held_out(replace(processing, cutoff_hz=PUBLISHED_HZ[name]))
        errors = joined(sdpid.validate(estimate, alike).rmse)
        lines.append((f"default, held out, filtered at {at} as there", errors))
        for way in ("WLS", "SDP 4×4, no prior", DEFAULT):
            each, overall = blocked(case, way, terms, PUBLISHED_HZ[name])
            words = f"{way}, {BLOCKS} blocks in time, at {at}"
            lines.append((words, f"{joined(each)} ({overall:.3g} %)"))
    everything = case.log if case.after is None else case.rest
    samples = samples_of(case.robot, everything, processing)
    words = "default, trained on run 1" if case.after is None else "default, whole record"
    lines.append((words, joined(sdpid.validate(default(case, samples, terms)).rmse)))
    if name in ASYMMETRIC:
        terms = (sdpid.friction.AsymmetricCoulomb(width=SMOOTH), *terms[1:])
        for words, rows, shown in (("held out", trained, fresh), ("whole", samples, samples)):
            errors = joined(sdpid.validate(default(case, rows, terms), shown).rmse)
            lines.append((f"Coulomb friction asymmetric, {words}", errors))
    yield from ((case.robot_name, *line) for line in lines)


def blocked(case: Case, way: str, terms: Terms, scored_at: float) -> tuple[Array, float]:
    """Return errors of each joint and overall, %, five blocks in time each held out in turn.

    What is before and after a block is processed apart from it; the block's rows are filtered at
    another cut-off.
    """
    method = METHODS[way]
    crossed = sdpid.cross_validate(
        case.robot,
        case.rest,
        folds=BLOCKS,
        scored=replace(default_processing(case.log), cutoff_hz=scored_at),
        friction=terms,
        weighting=method.weighting,
        consistency=method.consistency,
        prior=method.prior or False,
    )
    if method.solve is sdpid.solve_wls:
        return crossed.rmse_unconstrained, 100.0 * crossed.relative_unconstrained
    return crossed.rmse, 100.0 * crossed.relative


def joined(numbers: Iterable[float]) -> str:
    """Return numbers to three digits."""
    return ", ".join(f"{number:.3g}" for number in numbers)


WAYS = ("SDP 4×4, no prior", DEFAULT)


def gravities(case: Case) -> Rows:
    """Yield the Panda's gravity parameters, from the whole record, beside those of Gaz et al."""
    samples = samples_of(case.robot, case.rest, default_processing(case.log))
    problems = [(problem_of(case, samples, METHODS[way], terms_of(case)), way) for way in WAYS]
    found = [METHODS[way].solve(problem).theta for problem, way in problems]
    for words, (published, weights) in GAZ.items():
        cells = []
        for theta in found:
            assert theta is not None
            value = sum(w * float(theta[10 * (i - 1) + k]) for (i, k), w in weights.items())
            cells.append(f"{value:.3f} ({100.0 * (value / published - 1.0):+.1f} %)")
        yield words, published, *cells


def main() -> None:
    """Run every set and write the tables."""
    study = Study(
        __doc__,
        data=True,
        quick={"sets": [*QUICK], "methods": [*QUICK_METHODS]},
        sets=[*SETS],
        methods=[*METHODS],
    )
    found = first_of_arms(study.data, study.sets, known_drives=True)
    arms = found.values()
    header = ("set", "cut-off, Hz", "velocity", "training samples", "held-out samples")
    study.rows("prepared.csv", (*header, "preparing, s"), prepared, arms, digits=3)
    done = study.rows("methods.csv", HEADER, partial(rows, study.methods), arms)
    study.write("residuals.csv", *pivot(done, "method", "set", residuals))
    header = ("set", *(f"{factor:g} × its own" for factor in SCORED))
    study.rows("cutoffs.csv", header, cutoffs, arms, digits=3)
    study.rows("published.csv", ("set", "model", "joints 1, 2, …"), published, arms)
    pandas = [found["Panda"]] if "Panda" in found else []
    study.rows("panda_gravity.csv", ("parameter", "Gaz et al.", *WAYS), gravities, pandas)


if __name__ == "__main__":
    main()
