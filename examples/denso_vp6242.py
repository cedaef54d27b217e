"""The Denso VP-6242G case study, end to end, on a simulated plant.

Kinematic table, excitation, closed-loop experiment, signal processing, then weighted least
squares (WLS), the paper's constrained nonlinear program (CWLS, by SLSQP from many starts) and
the semidefinite program (SDP) that is equivalent to it; tables, figures, URDF and certificate.

    python examples/denso_vp6242.py --out results
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import sdpid
from sdpid._common.files import atomic_write_text
from sdpid._common.tables import Table
from sdpid.assurance.diagnostics.validation import implied_error
from sdpid.estimation.local.stationarity import FEASIBLE_LOCAL
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.experiment.processing.stages import filter_stages
from sdpid.output.plots.plots import (
    plot_convergence,
    plot_reconstruction,
    plot_signals,
    save_figure,
)
from sdpid.robot.description.catalog import bundled_folder
from sdpid.robot.inertia import margin

ROBOT = "denso_vp6242"

# The paper ran with 0.01 kg·m² on the inertias about the centres of mass (Table V). A margin of
# 0.005 on the second moments implies that, and is what the plant's true parameters have.
MARGIN_SPATIAL, MARGIN_PSEUDO = 0.01, 0.005


def arguments() -> argparse.Namespace:
    """Read the command line; sizes default to the paper's, or to small ones with --quick."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder for the results")
    parser.add_argument("--periods", type=int, help="recorded periods (paper: 12)")
    parser.add_argument("--period", type=float, help="length of a period in s (paper: 380)")
    parser.add_argument("--seed", type=int, default=0, help="of the excitation and the noise")
    parser.add_argument("--starts", type=int, help="starts of the local solvers (default 20)")
    parser.add_argument(
        "--unmodelled", action="store_true", help="add effects that no linear model has"
    )
    parser.add_argument("--quick", action="store_true", help="a small experiment, few starts")
    options = parser.parse_args()
    small = {"periods": 8, "period": 76.0, "starts": 4}
    full = {"periods": 12, "period": 380.0, "starts": 20}
    for name, value in (small if options.quick else full).items():
        if getattr(options, name) is None:
            setattr(options, name, value)
    return options


class Clock:
    """Says what is being done and how long the step before took."""

    def __init__(self) -> None:
        self.start = self.last = time.perf_counter()

    def __call__(self, what: str) -> None:
        """Print the time so far and what comes next."""
        now = time.perf_counter()
        print(f"[{now - self.start:6.1f} s] {what}", flush=True)
        self.last = now


def published(folder: Path) -> dict[str, dict[str, float]]:
    """Return the columns of the paper's Table IV by parameter."""
    with (folder / "table_iv.csv").open(encoding="utf-8", newline="") as file:
        return {
            row["parameter"]: {key: float(row[key]) for key in ("cwls", "wls", "sigma")}
            for row in csv.DictReader(file)
        }


def write_table_iv(out: Path, columns: dict[str, Any], problem: sdpid.Problem) -> Table:
    """Write our estimates beside the paper's."""
    base = problem.base
    paper = published(bundled_folder(ROBOT))
    header = ("parameter", "unit", *columns, "paper_cwls", "paper_wls", "paper_sigma")
    rows = []
    for i, name in enumerate(base.names):
        own = [float(values[i]) for values in columns.values()]
        other = [paper[name][key] for key in ("cwls", "wls", "sigma")]
        rows.append((name, base.units[i], *own, *other))
    table = Table(header, tuple(rows))
    table.write(out / "table_iv.csv")
    return table


def write_table_v(out: Path, thetas: dict[str, np.ndarray], links: int) -> Table:
    """Write both margins and the mass of every link beside the paper's."""
    with (bundled_folder(ROBOT) / "table_v.csv").open(encoding="utf-8", newline="") as file:
        paper = list(csv.DictReader(file))
    header = ["link"]
    columns: list[list[Any]] = [list(range(1, links + 1))]
    for name, theta in thetas.items():
        bodies = theta[: 10 * links].reshape(links, 10)
        header += [f"{name}_lambda_min_Ig", f"{name}_second_moment", f"{name}_mass"]
        columns += [
            margin(bodies, "spatial_inertia").tolist(),
            margin(bodies, "pseudo_inertia").tolist(),
            bodies[:, 0].tolist(),
        ]
    keys = list(paper[0])
    header += ["paper_lambda_min_Ig", "paper_mass"]
    columns += [[float(row[keys[1]]) for row in paper], [float(row[keys[2]]) for row in paper]]
    table = Table(tuple(header), tuple(zip(*columns, strict=True)))
    table.write(out / "table_v.csv")
    return table


def main() -> int:
    """Run the case study."""
    options = arguments()
    out: Path = options.out
    out.mkdir(parents=True, exist_ok=True)
    say = Clock()

    robot = sdpid.load_robot(ROBOT)
    theta_true = true_parameters(ROBOT)
    size = {"periods": options.periods, "period": options.period}
    trajectory = sdpid.paper_excitation(ROBOT, options.seed, **size)
    fresh = sdpid.paper_excitation(ROBOT, options.seed + 1000, **size)
    print(f"{trajectory.duration:g} s of excitation, {trajectory.n_samples} samples per joint")
    print("\n".join(trajectory.velocity_report()))

    def experiment(path: sdpid.Trajectory, **changes: Any) -> sdpid.Recording:
        settings = {"theta": theta_true, "seed": options.seed, "unmodelled": options.unmodelled}
        return sdpid.simulate(robot, path, **(settings | changes))

    say("simulating the experiment")
    log = experiment(trajectory)
    say("processing")
    # Sigma_k needs more periods than joints; with fewer its pooled form is used throughout.
    few = options.periods <= robot.n + 1
    default = sdpid.Processing(covariance="pooled" if few else "period")
    literal = replace(sdpid.Processing.paper(), covariance="pooled" if few else "period")
    samples = sdpid.process(log, default)
    samples_literal = sdpid.process(log, literal)
    first = log.start or 0.0
    window = (1200.0, 1400.0) if not options.quick else (first + 40.0, first + 80.0)
    stages = filter_stages(log, 0, window)
    figure = plot_signals(
        stages.time,
        stages.before,
        stages.after,
        units={"position": "rad", "torque": "N·m", "velocity": "rad/s", "acceleration": "rad/s²"},
        title="Axis 1 before and after filtering",
    )
    save_figure(figure, out / "figure_3.png")
    del log
    say("simulating the validation experiment, another seed")
    check_log = experiment(fresh, seed=options.seed + 1000)
    check = sdpid.process(check_log, default)
    check_literal = sdpid.process(check_log, literal)
    del check_log
    say("the same without noise, to know the noise floor")
    exact = sdpid.process(experiment(fresh, noise=False), replace(default, covariance=None))
    noise = np.where(check.mask, check.effort - exact.effort, 0.0)
    floor = np.sqrt((noise**2).sum(axis=0) / check.mask.sum(axis=0))

    say("estimating")
    spatial = sdpid.build_problem(
        robot,
        samples,
        consistency="spatial_inertia",
        constraints=sdpid.Constraints(margin=MARGIN_SPATIAL),
    )
    pseudo = spatial.constrained(
        consistency="pseudo_inertia", constraints=sdpid.Constraints(margin=MARGIN_PSEUDO)
    )
    print(spatial.base.explain())
    wls = sdpid.solve_wls(spatial)
    wls_literal = sdpid.solve_wls(
        sdpid.build_problem(robot, samples_literal, base=spatial.base, weighting="gls")
    )
    eigenvalue = np.linalg.eigvalsh(sdpid.mass_matrix(wls, samples.position[::97])).min()
    print(f"smallest eigenvalue of the mass matrix with WLS on the motion: {eigenvalue:.4g}")
    say(f"comparing solvers, local ones from {options.starts} starts under either consistency")
    comparisons = {
        "6x6": sdpid.compare(spatial, starts=options.starts, seed=options.seed),
        "4x4": sdpid.compare(pseudo, starts=options.starts, seed=options.seed),
    }
    say("writing")
    header: tuple[str, ...] = ()
    rows: list[tuple[Any, ...]] = []
    for kind, comparison in comparisons.items():
        print(f"\n{kind}:\n{comparison.table()}")
        header = ("consistency", *vars(comparison.rows[0]))
        rows += [(kind, *vars(row).values()) for row in comparison.rows]
    Table(header, tuple(rows)).write(out / "comparison.csv")

    cwls = best_local(comparisons["6x6"])
    sdp_6, sdp_4 = (comparisons[k].certificate.estimate for k in ("6x6", "4x4"))
    columns = {
        "true": spatial.base_of(theta_true),
        "wls": wls.base,
        "sigma": wls.standard_errors,
        "cwls": cwls.base,
        "sdp_6x6": sdp_6.base,
        "sdp_4x4": sdp_4.base,
        "wls_iii_c": wls_literal.base,
        "sigma_iii_c": wls_literal.standard_errors,
    }
    table_iv = write_table_iv(out, columns, spatial)
    print(f"\nTable IV\n{table_iv.text()}")
    thetas = {"true": theta_true, "cwls": cwls.theta, "sdp_6x6": sdp_6.theta}
    table_v = write_table_v(out, {**thetas, "sdp_4x4": sdp_4.theta}, robot.n_links)
    print(f"\nTable V\n{table_v.text(3)}")

    fits = {name: sdpid.validate(e, check) for name, e in (("wls", wls), ("sdp_4x4", sdp_4))}
    fit_literal = sdpid.validate(wls_literal, check_literal)
    implied = implied_error(wls, check)
    limit = 1.2 * np.hypot(floor, implied)
    report = {
        "joint": list(robot.joint_names),
        "noise_floor": floor.tolist(),
        "implied_prediction_error": implied.tolist(),
        "limit": limit.tolist(),
        **{f"rmse_{name}": fit.rmse.tolist() for name, fit in fits.items()},
        "rmse_wls_iii_c": fit_literal.rmse.tolist(),
    }
    rows_report = tuple(zip(*report.values(), strict=True))
    print(f"\nTorque reconstruction, N·m\n{Table(tuple(report), rows_report).text()}")
    Table(tuple(report), rows_report).write(out / "reconstruction.csv")
    inside = np.abs(wls.base - columns["true"]) <= 1.96 * wls.standard_errors
    print(f"\ntrue base parameters inside the 95 % intervals: {inside.sum()} of {inside.size}")

    # A minute of it, so that the curves can be told apart; the errors are those of all rows.
    shown = slice(0, round(60.0 / (check.time[1] - check.time[0])))
    figure = plot_reconstruction(
        check.time[shown],
        check.effort[shown],
        fits["sdp_4x4"].effort_predicted[shown],
        robot.joint_names,
        fits["sdp_4x4"].rmse,
        mask=check.mask[shown],
        title="Second experiment: measured torque and its reconstruction",
    )
    save_figure(figure, out / "figure_4.png")
    for kind, comparison in comparisons.items():
        best = comparison.certificate.estimate
        runs = [e for e in comparison.estimates if e is not None and e.method == "slsqp"]
        histories = [e.history for e in runs if e.history]
        figure = plot_convergence(
            histories,
            comparison.certificate.lower_bound,
            {"SDP": (best.solve_time, best.cost)},
            feasible=FEASIBLE_LOCAL,
            title=f"{kind} consistency: cost over time against the proven bound",
        )
        save_figure(figure, out / f"convergence_{kind}.png")
    certificate = comparisons["4x4"].certificate
    certificate.to_json(out / "certificate.json")
    print(f"\n{certificate.summary()}")
    exported = sdpid.write_urdf(sdp_4, target=out / "identified.urdf")
    print(exported.describe())
    summary = {
        "seed": options.seed,
        "unmodelled": options.unmodelled,
        **size,
        "gap_6x6": comparisons["6x6"].certificate.gap,
        "gap_4x4": certificate.gap,
        "certified": certificate.passed,
        "inside_95": int(inside.sum()),
        "mass_matrix_eigenvalue_wls": float(eigenvalue),
        "seconds": time.perf_counter() - say.start,
    }
    atomic_write_text(out / "summary.json", json.dumps(summary, indent=1) + "\n")
    say(f"done: {out}")
    return 0


def best_local(comparison: sdpid.Comparison) -> sdpid.Estimate:
    """Return the cheapest feasible local result: what the paper's procedure would report."""
    local = [e for e in comparison.estimates if e is not None and e.method == "slsqp"]
    feasible = [e for e in local if e.violation is not None and e.violation <= FEASIBLE_LOCAL]
    if not feasible:
        print("no start of SLSQP ended feasible; the least infeasible one is shown")
        return min(local, key=lambda e: e.violation or 0.0)
    return min(feasible, key=lambda e: e.cost)


if __name__ == "__main__":
    sys.exit(main())
