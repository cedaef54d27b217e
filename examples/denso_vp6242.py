"""The Denso VP-6242G case study, end to end, on a simulated plant.

Kinematic table, excitation, closed-loop experiment, signal processing, then weighted least
squares (WLS), the paper's constrained nonlinear program (CWLS, by SLSQP from many starts) and
the semidefinite program (SDP) that is equivalent to it; tables, figures, URDF and certificate.

    python examples/denso_vp6242.py --out results
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import sdpid
from sdpid import plots

ROBOT = "denso_vp6242"
FOLDER = Path(__file__).resolve().parents[1] / "models" / ROBOT

# The paper ran with 0.01 kg·m² on the inertias about the centers of mass (Table V). A margin of
# 0.005 on the second moments implies that, and is what the plant's true parameters have.
MARGINS = {"spatial_inertia": 0.01, "pseudo_inertia": 0.005}


def arguments() -> argparse.Namespace:
    """Read the command line; sizes default to the paper's, or to small ones with --quick."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder for the results")
    parser.add_argument("--periods", type=int, help="recorded periods (paper: 12)")
    parser.add_argument("--period", type=float, help="length of a period in s (paper: 380)")
    parser.add_argument("--seed", type=int, default=0, help="random seed of motion and noise")
    parser.add_argument("--starts", type=int, help="starts of the local solvers (default 20)")
    parser.add_argument(
        "--unmodeled", action="store_true", help="add effects that no linear model has"
    )
    parser.add_argument("--quick", action="store_true", help="a small experiment, few starts")
    options = parser.parse_args()
    small = {"periods": 8, "period": 76.0, "starts": 4}
    full = {"periods": 12, "period": 380.0, "starts": 20}
    for name, value in (small if options.quick else full).items():
        if getattr(options, name) is None:
            setattr(options, name, value)
    return options


def center_margins(theta: np.ndarray, links: int) -> tuple[list[float], list[float]]:
    """Return the least eigenvalues of each link's I_g and of its second moments about there."""
    inertias, moments = [], []
    for m, x, y, z, xx, xy, yy, xz, yz, zz in theta[: 10 * links].reshape(links, 10):
        h = np.array([x, y, z])
        about_joint = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        about_center = about_joint - (h @ h * np.eye(3) - np.outer(h, h)) / m
        second = 0.5 * np.trace(about_center) * np.eye(3) - about_center
        inertias.append(float(np.linalg.eigvalsh(about_center)[0]))
        moments.append(float(np.linalg.eigvalsh(second)[0]))
    return inertias, moments


def table_iv(columns: dict[str, Any], problem: Any) -> pd.DataFrame:
    """Return our base parameters beside the paper's."""
    ours = pd.DataFrame({"unit": problem.base.units, **columns}, index=problem.base.names)
    paper = pd.read_csv(FOLDER / "table_iv.csv", index_col="parameter")[["cwls", "wls", "sigma"]]
    return ours.join(paper.add_prefix("paper_")).rename_axis("parameter")


def table_v(thetas: dict[str, np.ndarray], links: int) -> pd.DataFrame:
    """Return both margins and the mass of every link beside the paper's."""
    paper = pd.read_csv(FOLDER / "table_v.csv", index_col="link")
    paper.columns = pd.Index(["lambda_min_Ig", "mass"])
    columns: dict[str, Any] = {}
    for name, theta in thetas.items():
        inertias, moments = center_margins(theta, links)
        columns[f"{name}_lambda_min_Ig"] = inertias
        columns[f"{name}_second_moment"] = moments
        columns[f"{name}_mass"] = theta[0 : 10 * links : 10]
    return pd.DataFrame(columns, index=paper.index).join(paper.add_prefix("paper_"))


def best_local(comparison: Any) -> Any:
    """Return the cheapest feasible local result: what the paper's procedure would report."""
    local = [
        (row.status, estimate)
        for row, estimate in zip(comparison.rows, comparison.estimates, strict=True)
        if row.solver == "slsqp" and estimate is not None
    ]
    feasible = [estimate for status, estimate in local if status != "infeasible"]
    if not feasible:
        print("no start of SLSQP ended feasible; the cheapest infeasible one is shown")
    return min(feasible or [estimate for _, estimate in local], key=lambda each: each.cost)


def main() -> None:
    """Run the case study."""
    options = arguments()
    out: Path = options.out
    out.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()

    def say(what: str) -> None:
        print(f"[{time.perf_counter() - begin:6.1f} s] {what}", flush=True)

    def show(title: str, table: pd.DataFrame, file: str) -> None:
        print(f"\n{title}\n{table.to_string(float_format='{:.4g}'.format)}")
        table.to_csv(out / file)

    robot = sdpid.load_robot(ROBOT)
    theta_true = np.loadtxt(FOLDER / "true_parameters.csv", delimiter=",", skiprows=1, usecols=2)
    size = {"periods": options.periods, "period": options.period}
    seed = options.seed
    trajectory = sdpid.paper_excitation(ROBOT, seed, **size)
    fresh = sdpid.paper_excitation(ROBOT, seed + 1000, **size)
    print(f"{trajectory.duration:g} s of excitation, {trajectory.n_samples} samples per joint")
    print("\n".join(trajectory.velocity_report()))

    def experiment(path: sdpid.Trajectory, **changes: Any) -> sdpid.Recording:
        settings = {"theta": theta_true, "seed": seed, "unmodeled": options.unmodeled}
        return sdpid.simulate(robot, path, **(settings | changes))

    say("simulating the experiment")
    log = experiment(trajectory)
    say("processing")
    # Sigma_k needs more periods than joints; with fewer its pooled form is used throughout.
    kind = "pooled" if options.periods <= robot.n + 1 else "period"
    default = sdpid.Processing(covariance=kind)
    literal = replace(sdpid.Processing.paper(), covariance=kind)
    samples, samples_literal = sdpid.process(log, default), sdpid.process(log, literal)
    first = log.start or 0.0
    window = (first + 40.0, first + 80.0) if options.quick else (1200.0, 1400.0)
    filtered = sdpid.Processing.paper().stages(log, 0, window=window)
    axes = filtered.plot(title="Axis 1 before and after filtering")
    plots.save_figure(axes, out / "figure_3.png")
    del log
    say("simulating the validation experiment, another seed")
    check_log = experiment(fresh, seed=seed + 1000)
    check, check_literal = sdpid.process(check_log, default), sdpid.process(check_log, literal)
    del check_log
    say("the same without noise, to know the noise floor")
    exact = sdpid.process(experiment(fresh, noise=False), replace(default, covariance=None))
    noise = np.where(check.mask, check.effort - exact.effort, 0.0)
    floor = np.sqrt((noise**2).sum(axis=0) / check.mask.sum(axis=0))

    say("estimating")
    spatial, pseudo = (
        sdpid.build_problem(
            robot, samples, consistency=kind, constraints=sdpid.Constraints(margin=margin)
        )
        for kind, margin in MARGINS.items()
    )
    print(spatial.base.explain())
    wls = sdpid.solve_wls(spatial)
    wls_literal = sdpid.solve_wls(sdpid.build_problem(robot, samples_literal, base=spatial.base))
    eigenvalue = np.linalg.eigvalsh(wls.mass_matrix(samples.position[::97])).min()
    print(f"smallest eigenvalue of the mass matrix with WLS on the motion: {eigenvalue:.4g}")
    say(f"comparing solvers, local ones from {options.starts} starts under either consistency")
    comparisons = {
        "6x6": sdpid.compare(spatial, starts=options.starts, seed=seed),
        "4x4": sdpid.compare(pseudo, starts=options.starts, seed=seed),
    }
    say("writing")
    for name, comparison in comparisons.items():
        print(f"\n{name}:\n{comparison.table()}")
        plots.save_figure(comparison.plot(against="seconds"), out / f"convergence_{name}.png")
    rows = {name: comparison.to_frame() for name, comparison in comparisons.items()}
    pd.concat(rows, names=["consistency"]).droplevel(1).to_csv(out / "comparison.csv")

    cwls = best_local(comparisons["6x6"])
    sdp_6, sdp_4 = (comparisons[k].certificate.estimate for k in ("6x6", "4x4"))
    base_true = spatial.base.matrix @ theta_true
    columns = {
        "true": base_true,
        "wls": wls.base,
        "sigma": wls.standard_errors,
        "cwls": cwls.base,
        "sdp_6x6": sdp_6.base,
        "sdp_4x4": sdp_4.base,
        "wls_iii_c": wls_literal.base,
        "sigma_iii_c": wls_literal.standard_errors,
    }
    show("Table IV", table_iv(columns, spatial), "table_iv.csv")
    thetas = {
        "true": theta_true,
        "cwls": cwls.theta,
        "sdp_6x6": sdp_6.theta,
        "sdp_4x4": sdp_4.theta,
    }
    show("Table V", table_v(thetas, robot.n_links).T, "table_v.csv")
    fit = sdpid.validate(sdp_4, check)
    errors = {
        "noise_floor": floor,
        "rmse_wls": sdpid.validate(wls, check).rmse,
        "rmse_sdp_4x4": fit.rmse,
        "rmse_wls_iii_c": sdpid.validate(wls_literal, check_literal).rmse,
    }
    index = pd.Index(robot.joint_names, name="joint")
    show("Torque reconstruction, N·m", pd.DataFrame(errors, index=index), "reconstruction.csv")
    inside = int(np.sum(np.abs(wls.base - base_true) <= 1.96 * wls.standard_errors))
    print(f"\ntrue base parameters inside the 95 % intervals: {inside} of {wls.base.size}")
    # A minute of it, so that the curves can be told apart; the errors are those of all rows.
    title = "Second experiment: measured torque and its reconstruction"
    minute = round(60.0 / (check.time[1] - check.time[0]))
    plots.save_figure(plots.plot_fit(check, fit, count=minute, title=title), out / "figure_4.png")
    certificate = comparisons["4x4"].certificate
    certificate.to_json(out / "certificate.json")
    print(f"\n{certificate.summary()}")
    print(sdpid.write_urdf(sdp_4, target=out / "identified.urdf").describe())
    summary = {
        "seed": seed,
        "unmodeled": options.unmodeled,
        **size,
        "gap_6x6": comparisons["6x6"].certificate.gap,
        "gap_4x4": certificate.gap,
        "certified": certificate.passed,
        "inside_95": inside,
        "mass_matrix_eigenvalue_wls": float(eigenvalue),
        "seconds": time.perf_counter() - begin,
    }
    (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    say(f"done: {out}")


if __name__ == "__main__":
    main()
