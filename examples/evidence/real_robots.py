"""Five real robots, many methods: what each predicts on motion that it was not trained on.

Every set of docs/evidence/data.md is processed with default settings that are chosen on its
training part
alone, and fitted by least squares, ridge regression, the semidefinite program with several priors,
and two local solvers, all with the same friction terms. Held out are the second run where there
are two, otherwise all rows behind the first 60 % of the record. The published numbers that can be
compared stand beside.

    python examples/evidence/real_robots.py --data /path/to/data --out results

robot_defaults.py shows how the defaults were chosen. The folder of the data may also be named by
the environment variable SDPID_DATA.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from data_sets import ROBOTS, SETS, TRAINED, part

import sdpid
from sdpid._common.arrays import Array
from sdpid._common.files import atomic_write_text
from sdpid._common.tables import Table
from sdpid.estimation.compression.covariance import Weighting
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.prepare import SMOOTH, default_friction, samples_of
from sdpid.experiment.processing.choose import default_processing
from sdpid.robot.inertia import Consistency, margin

Terms = tuple[str | sdpid.friction.FrictionTerm, ...]
Solver = Callable[[Problem], Estimate]

# What is known of a drive and stands in no log: the wrist's motors of the TX40 turn two joints.
DRIVES: dict[str, Terms] = {
    "staubli_tx40": ("rotor_inertia", sdpid.friction.Coupling("joint_5", "joint_6", width=0.05)),
}

QUICK = ("panda_unisa", "ur10_unisa")
QUICK_METHODS = ("description, friction fitted", "OLS", "SDP 4×4")

# Strength in nats that holds the links at the description.
FIXED = 1e8

DEFAULT = "SDP 4×4"

# A margin this small, kg·m², is at the boundary of what can exist.
ROUNDING = 1e-9

HEADER = (
    "set",
    "method",
    "trained_percent",
    "held_out_percent",
    "solve_s",
    "least_margin_4x4",
    "heaviest_link_kg",
    "status",
    "gap",
    "held_out_rmse",
    "message",
)


def local(solver: Callable[..., Estimate]) -> Solver:
    """Return a local solver from one random start."""
    return lambda problem: solver(problem, seed=0)


@dataclass(frozen=True)
class Method:
    """A way to estimate: the solver, and what it is given."""

    solve: Solver
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
    "SLSQP 4×4, no prior": Method(local(sdpid.solve_slsqp)),
    "SLSQP 4×4": Method(local(sdpid.solve_slsqp), ONE_NAT),
    "log-Cholesky 4×4, no prior": Method(local(sdpid.solve_log_cholesky)),
    "log-Cholesky 4×4": Method(local(sdpid.solve_log_cholesky), ONE_NAT),
}


@dataclass(frozen=True)
class Case:
    """A robot's records: what is trained on, and what is predicted."""

    name: str
    robot: sdpid.RobotModel
    log: sdpid.Recording
    rest: sdpid.Recording
    second_run: bool

    @classmethod
    def read(cls, folder: Path, name: str) -> Case:
        """Read a set: two runs, or one record whose rest is predicted."""
        data = SETS[name]
        logs = [sdpid.read_recording(folder / name / f"{run}.npz") for run in data.records]
        robot = sdpid.load_robot(folder / name / data.urdf)
        if len(logs) == 2:
            return cls(name, robot, logs[0], logs[1], True)
        cut = round(TRAINED * logs[0].n_samples)
        return cls(name, robot, part(logs[0], 0, cut), logs[0], False)

    def trained(self, processing: sdpid.Processing) -> sdpid.Samples:
        """Return the training samples, which saw nothing of the rest."""
        return samples_of(self.robot, self.log, processing)

    def held_out(self, processing: sdpid.Processing) -> sdpid.Samples:
        """Return the samples to predict.

        A record's rest is filtered with its own past before it, which is what was measured then;
        nothing of the rest reaches the training samples.
        """
        samples = samples_of(self.robot, self.rest, processing)
        return samples if self.second_run else since(samples, float(self.log.time[-1]))

    def problem(
        self,
        samples: sdpid.Samples,
        method: Method,
        terms: Iterable[str | sdpid.friction.FrictionTerm],
    ) -> Problem:
        """Return the problem of a method, with the default bounds."""
        return sdpid.build_problem(
            self.robot,
            samples,
            friction=terms,
            weighting=method.weighting,
            consistency=method.consistency,
            constraints=sdpid.Constraints.of_size(self.robot),
            prior=method.prior,
        )


def since(samples: sdpid.Samples, moment: float) -> sdpid.Samples:
    """Return the samples after a time."""
    assert samples.time is not None
    begin = int(np.searchsorted(samples.time, moment, side="right"))
    return samples.between(begin, samples.n_samples)


def rows(case: Case, names: Iterable[str], said: list[str]) -> Iterator[tuple[object, ...]]:
    """Yield the rows of a set, and say how it was prepared."""
    processing = default_processing(case.log)
    start = time.perf_counter()
    samples = case.trained(processing)
    terms = (*default_friction(case.log), *DRIVES.get(case.name, ()))
    # The speeds of friction are chosen once; all methods have the same terms.
    closed = case.problem(samples, METHODS[DEFAULT], terms).friction.terms
    seconds = time.perf_counter() - start
    fresh = case.held_out(processing)
    said.append(
        f"| {ROBOTS[case.name]} | {processing.cutoff_hz:.3g} | {processing.velocity} | "
        f"{len(samples.effort)} | {len(fresh.effort)} | {seconds:.2g} |"
    )
    for name in names:
        method = METHODS[name]
        message, gap = "", None
        estimate: Estimate | None = None
        seconds = 0.0
        try:
            problem = case.problem(samples, method, closed)
            if name == next(iter(names)):
                method.solve(problem)  # the first solve loads libraries
            start = time.perf_counter()
            estimate = method.solve(problem)
            status = estimate.status
        except sdpid.errors.SolverError as error:
            estimate, message, status = error.found, str(error), type(error).__name__
        except sdpid.errors.SdpidError as error:
            message, status = str(error), type(error).__name__
        seconds = time.perf_counter() - start
        if estimate is None:
            yield case.name, name, *(None,) * 5, status, gap, None, message
            continue
        if estimate.method == "sdp":
            gap = sdpid.certify(estimate).gap
        least = heaviest = None
        if estimate.theta is not None:
            links = estimate.theta[: 10 * case.robot.n_links].reshape(-1, 10)
            margins = margin(links, "pseudo_inertia")
            # A link without a positive mass has no margin: it is no body at all.
            least = -np.inf if np.any(np.isnan(margins)) else float(np.min(margins))
            heaviest = float(links[:, 0].max())
        fit = sdpid.validate(estimate, fresh)
        yield (
            case.name,
            name,
            100.0 * sdpid.validate(estimate).relative,
            100.0 * fit.relative,
            seconds,
            least,
            heaviest,
            status,
            gap,
            " ".join(f"{value:.4g}" for value in fit.rmse),
            message,
        )


PREPARED = (
    "What was trained on and predicted; preparing takes in processing and the speeds of friction:",
    "",
    "| set | cut-off, Hz | velocity | training samples | held-out samples | preparing, s |",
    "|---|---|---|---|---|---|",
)


def table(done: Sequence[tuple[object, ...]]) -> str:
    """Return the results, one line a method and one column a set."""
    names = list(dict.fromkeys(str(row[0]) for row in done))
    cells = {(row[0], row[1]): row for row in done}
    lines = []
    titles = (
        "Relative residual on what was held out (on the training rows), %",
        "Seconds of the solver, whole call",
        "Least 4×4 margin of any link, kg·m² (heaviest link, kg)",
    )
    for kind, title in enumerate(titles):
        lines += [f"{title}:", "", "| method | " + " | ".join(ROBOTS[n] for n in names) + " |"]
        lines.append("|---|" + "---|" * len(names))
        for method in dict.fromkeys(str(row[1]) for row in done):
            line = [shown(cells[name, method], kind) for name in names]
            if any(line):
                lines.append(f"| {method} | " + " | ".join(line) + " |")
        lines.append("")
    return "\n".join(lines)


def shown(row: Sequence[object], kind: int) -> str:
    """Return a cell of one of the three tables."""
    trained, held, seconds, least, heaviest, status = row[2:8]
    if not isinstance(held, float):
        return str(status) if kind == 0 else ""
    if kind == 0:
        # Local solvers may stop before they are at an optimum.
        mark = "" if status == "optimal" else " ¹"
        return f"{held:.4g} ({trained:.3g}){mark}"
    if kind == 1:
        return f"{seconds:.2g}"
    if not isinstance(least, float):
        return ""
    size = "0" if abs(least) < ROUNDING else f"{least:.0e}"
    return f"{'no body' if least == -np.inf else size} ({heaviest:.3g})"


# Published root mean square errors, N·m, and on what; see the sets' sources in
# docs/evidence/data.md.
PUBLISHED: dict[str, tuple[str, tuple[float, ...]]] = {
    "staubli_tx40": (
        "FIGAROH, its own training rows (this whole record)",
        (6.39, 6.08, 2.67, 1.17, 1.57, 0.80),
    ),
    "ur10_unisa": (
        "UNISA's identified model, whole record (rebuilt to about 1 %)",
        (4.22, 4.90, 1.58, 0.70, 0.84, 1.32),
    ),
    "kuka_lwr4plus": (
        "FloBaRoID, description alone, run 1",
        (0.36, 1.55, 0.49, 0.98, 0.63, 0.49, 0.27),
    ),
}

# Robots whose published model has friction that differs in the two directions of motion.
ASYMMETRIC = ("ur10_unisa",)

# FIGAROH's filter, Hz: errors are compared on rows filtered alike.
PUBLISHED_HZ = {"staubli_tx40": 100.0}

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


def comparison(folder: Path, names: Sequence[str]) -> str:
    """Return published numbers beside those of the default estimate."""
    lines = ["Root mean square error of each joint, N·m:", "", "| set | model | joints 1, 2, … |"]
    lines.append("|---|---|---|")
    gravity = ""
    scored = [
        "The default estimate on held-out rows that are filtered at other cut-offs, %:",
        "",
        "| set | " + " | ".join(f"{factor:g} × its own" for factor in SCORED) + " |",
        "|---|" + "---|" * len(SCORED),
    ]
    for name in names:
        case = Case.read(folder, name)
        processing = default_processing(case.log)
        terms = (*default_friction(case.log), *DRIVES.get(name, ()))
        estimate = sdpid.solve_sdp(case.problem(case.trained(processing), METHODS[DEFAULT], terms))
        cells = []
        for factor in SCORED:
            cutoff = factor * processing.cutoff_hz
            if cutoff < HIGHEST * case.log.rate_hz:
                fresh = case.held_out(replace(processing, cutoff_hz=cutoff))
                cells.append(f"{100.0 * sdpid.validate(estimate, fresh).relative:.3g}")
            else:
                cells.append("")
        scored.append(f"| {ROBOTS[name]} | " + " | ".join(cells) + " |")
        if name in PUBLISHED:
            words, numbers = PUBLISHED[name]
            lines.append(f"| {ROBOTS[name]} | {words} | {joined(numbers)} |")
            fit = sdpid.validate(estimate, case.held_out(processing))
            lines.append(f"| {ROBOTS[name]} | default, held out | {joined(fit.rmse)} |")
            if name in PUBLISHED_HZ:
                alike = replace(processing, cutoff_hz=PUBLISHED_HZ[name])
                fit = sdpid.validate(estimate, case.held_out(alike))
                words = f"default, held out, filtered at {PUBLISHED_HZ[name]:g} Hz as there"
                lines.append(f"| {ROBOTS[name]} | {words} | {joined(fit.rmse)} |")
                for way in ("WLS", "SDP 4×4, no prior", DEFAULT):
                    errors, overall = blocked(case, way, terms, PUBLISHED_HZ[name])
                    words = f"{way}, {BLOCKS} blocks in time, at {PUBLISHED_HZ[name]:g} Hz"
                    lines.append(
                        f"| {ROBOTS[name]} | {words} | {joined(errors)} ({overall:.3g} %) |"
                    )
            everything = case.log if case.second_run else case.rest
            samples = samples_of(case.robot, everything, processing)
            whole = sdpid.solve_sdp(case.problem(samples, METHODS[DEFAULT], terms))
            words = "default, trained on run 1" if case.second_run else "default, whole record"
            lines.append(f"| {ROBOTS[name]} | {words} | {joined(sdpid.validate(whole).rmse)} |")
            if name in ASYMMETRIC:
                terms = (sdpid.friction.AsymmetricCoulomb(width=SMOOTH), *terms[1:])
                for words, rows in (("held out", case.trained(processing)), ("whole", samples)):
                    shown = case.held_out(processing) if words == "held out" else rows
                    own = sdpid.solve_sdp(case.problem(rows, METHODS[DEFAULT], terms))
                    errors = joined(sdpid.validate(own, shown).rmse)
                    lines.append(
                        f"| {ROBOTS[name]} | Coulomb friction asymmetric, {words} | {errors} |"
                    )
        if name == "panda_unisa":
            samples = samples_of(case.robot, case.rest, processing)
            gravity = "\n\n" + gravities(case, samples, terms)
    return "\n".join(scored) + "\n\n" + "\n".join(lines) + gravity


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


def gravities(case: Case, samples: sdpid.Samples, terms: Terms) -> str:
    """Return the Panda's gravity parameters beside those of Gaz et al."""
    ways = ("SDP 4×4, no prior", DEFAULT)
    lines = [
        "Gravity parameters of the Panda, kg·m, from the whole record:",
        "",
        "| parameter | Gaz et al. | " + " | ".join(ways) + " |",
        "|---|---|---|---|",
    ]
    found = [METHODS[way].solve(case.problem(samples, METHODS[way], terms)) for way in ways]
    for words, (published, weights) in GAZ.items():
        cells = []
        for estimate in found:
            assert estimate.theta is not None
            theta = estimate.theta
            value = sum(w * float(theta[10 * (i - 1) + k]) for (i, k), w in weights.items())
            cells.append(f"{value:.3f} ({100.0 * (value / published - 1.0):+.1f} %)")
        lines.append(f"| {words} | {published} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def found(folder: Path | None, names: Iterable[str]) -> list[str]:
    """Return the sets that are there, and say which are not."""
    there = []
    for name in names:
        if folder is None or not (folder / name).is_dir():
            where = "SDPID_DATA is not set" if folder is None else f"not in {folder}"
            print(
                f"{name}: skipped, {where}; docs/evidence/data.md says where it comes from",
                flush=True,
            )
        else:
            there.append(name)
    return there


def main() -> int:
    """Run every set and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--set", action="append", choices=tuple(SETS), help="a set (default all)")
    parser.add_argument("--quick", action="store_true", help="two sets, three methods")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    names = found(options.data, options.set or (QUICK if options.quick else tuple(SETS)))
    done: list[tuple[object, ...]] = []
    said: list[str] = []
    start = time.perf_counter()
    Table(HEADER, ()).write(options.out / "real_robots.csv")
    for name in names:
        methods = QUICK_METHODS if options.quick else tuple(METHODS)
        for cells in rows(Case.read(options.data, name), methods, said):
            done.append(cells)
            print(Table(HEADER[:8], (cells[:8],)).text(3).splitlines()[1], flush=True)
            Table(HEADER, tuple(done)).write(options.out / "real_robots.csv")
    text = "Nothing to show: no data.\n"
    if names:
        text = "\n".join([*PREPARED, *said, "", table(done), comparison(options.data, names), ""])
    atomic_write_text(options.out / "real_robots.md", text)
    print(f"\n{text}\n{time.perf_counter() - start:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
