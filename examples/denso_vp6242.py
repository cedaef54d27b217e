"""The Denso VP-6242G case study, end to end, on two simulated plants.

Kinematic table, excitation, closed-loop experiment, signal processing, then weighted least
squares (WLS), the paper's constrained nonlinear program (CWLS, by SLSQP from many starts) and
the semidefinite program (SDP) that is equivalent to it; tables, figures, URDF and certificate.
One plant is ideal, the other has effects that no linear model has, as every real robot.
RESULTS/index.html shows everything; evidence/real_arms.py compares public records of real arms.

    python examples/denso_vp6242.py --out results
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import pandas as pd
from case_study import pictures, tables
from case_study.estimates import Estimates, estimate_all
from case_study.experiments import PLANTS, Size, run_experiments
from case_study.page import Page, point

import sdpid
from sdpid import plots


def arguments() -> argparse.Namespace:
    """Read the command line; sizes default to the paper's, or to small ones with --quick."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder for the results")
    parser.add_argument("--plant", choices=(*PLANTS, "both"), default="both", help="which plant")
    parser.add_argument("--periods", type=int, help="recorded periods (paper: 12)")
    parser.add_argument("--period", type=float, help="length of a period in s (paper: 380)")
    parser.add_argument("--seed", type=int, default=0, help="random seed of motion and noise")
    parser.add_argument("--starts", type=int, help="starts of the local solvers (default 20)")
    parser.add_argument("--quick", action="store_true", help="a small experiment, few starts")
    options = parser.parse_args()
    small = {"periods": 8, "period": 38.0, "starts": 1, "iterations": 30}
    full = {"periods": 12, "period": 380.0, "starts": 20, "iterations": None}
    for name, value in (small if options.quick else full).items():
        if getattr(options, name, None) is None:
            setattr(options, name, value)
    return options


def write_plant(found: Estimates, out: Path, page: Page) -> None:
    """Write the tables, pictures, certificate and URDF of one plant, and show them on the page."""
    shown = {
        "Table IV": (tables.table_iv(found), "table_iv.csv"),
        "Table V": (tables.table_v(found), "table_v.csv"),
        "Torque reconstruction, N·m": (tables.reconstruction(found), "reconstruction.csv"),
    }
    for title, (table, file) in shown.items():
        page.table(title, table)
        table.to_csv(out / file)
    page.picture(out / "figure_3.png", out.parent)
    pictures.reconstruction(found, out / "figure_4.png")
    page.picture(out / "figure_4.png", out.parent)
    for name, comparison in found.comparisons.items():
        path = out / f"convergence_{name}.png"
        plots.save_figure(comparison.plot(against="seconds"), path)
        page.text(f"Solvers, {name} inequality", comparison.table())
        page.picture(path, out.parent)
    tables.comparison(found).to_csv(out / "comparison.csv")
    certificate = found.comparisons["4x4"].certificate
    certificate.to_json(out / "certificate.json")
    page.text("Certificate", certificate.summary())
    written = sdpid.write_urdf(found.sdp("4x4"), target=out / "identified.urdf")
    page.text("identified.urdf", written.describe())


def main() -> None:
    """Run the case study."""
    options = arguments()
    out: Path = options.out
    names = tuple(PLANTS) if options.plant == "both" else (options.plant,)
    for name in names:
        (out / name).mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()

    def say(what: str) -> None:
        print(f"[{time.perf_counter() - begin:6.1f} s] {what}", flush=True)

    def simulated(done: int, count: int) -> None:
        say(f"simulated and processed {done} of {count} experiments")

    window = (20.0, 40.0) if options.quick else (1200.0, 1400.0)
    size = Size(options.periods, options.period, options.seed, window)
    page = Page("The Denso VP-6242G case study")
    trajectory = size.trajectory()
    print(f"{trajectory.duration:g} s of excitation, {trajectory.n_samples} samples per joint")
    page.text("Excitation", "\n".join(trajectory.velocity_report()))
    say(f"simulating and processing experiments on two plants ({', '.join(names)})")
    experiments = run_experiments(names, size, out, simulated)
    found: dict[str, Estimates] = {}
    facts: dict[str, dict[str, Any]] = {}
    for name, experiment in experiments.items():
        say(f"{name} plant: all solvers, local ones from {options.starts} starts")
        found[name] = estimate_all(
            experiment,
            starts=options.starts,
            seed=options.seed,
            max_iterations=options.iterations,
        )
        page.heading(pictures.HEADINGS[name])
        write_plant(found[name], out / name, page)
        facts[name] = found[name].facts()
    pictures.plants(found, out / "plants.png")
    solvers = tables.solvers({name: tables.comparison(each) for name, each in found.items()})
    solvers.to_csv(out / "solvers.csv")
    table = pd.DataFrame(facts).rename_axis("fact")
    table.to_csv(out / "plants.csv")
    page.heading("Both plants")
    page.picture(out / "plants.png", out)
    page.table("Facts", table)
    page.table("Solvers", solvers)
    page.write(out / "index.html", point(facts, options.starts))
    run = {"seed": options.seed, "periods": options.periods, "period": options.period}
    summary = {**run, "plants": facts, "seconds": time.perf_counter() - begin}
    (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    print(f"\n{table.to_string(float_format='{:.3g}'.format)}\n\n{point(facts, options.starts)}")
    say(f"done; everything, with tables and pictures: {out / 'index.html'}")


if __name__ == "__main__":
    main()
