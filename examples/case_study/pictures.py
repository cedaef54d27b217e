"""Pictures of the Denso case study."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import sdpid
from case_study.estimates import STRIDE, Estimates
from sdpid import plots

# Okabe and Ito's colors, which readers with any color vision can tell apart.
COLORS = {"true": "#C3C8CF", "WLS": "#D55E00", "CWLS": "#56B4E9", "SDP": "#0072B2"}
STYLES = {"true": "-", "WLS": "-", "CWLS": "--", "SDP": ":"}
SOLVERS = {"slsqp": ("SLSQP", "#56B4E9", "o"), "log_cholesky": ("log-Cholesky", "#E69F00", "D")}
HEADINGS = {
    "ideal": "Ideal plant",
    "unmodeled": "Plant with effects that no linear model has",
}

# Gaps below this are drawn at it: rounding of the costs.
LEAST_GAP = 1e-10

# Seconds of the second experiment whose reconstruction is drawn, so that curves can be told apart.
SHOWN = 60.0


def reconstruction(found: Estimates, path: Path) -> None:
    """Draw a minute of the second experiment; the errors in the legends are those of all rows."""
    check = found.experiment.check
    count = round(SHOWN / (check.time[1] - check.time[0]))
    title = "Second experiment: measured torque and its reconstruction"
    fit = sdpid.validate(found.sdp("4x4"), check)
    plots.save_figure(plots.plot_fit(check, fit, count=count, title=title), path)


def plants(found: Mapping[str, Estimates], path: Path) -> None:
    """Draw eigenvalues of the mass matrix, and ends of the local solvers, plant beside plant."""
    figure = Figure(figsize=(5.2 * len(found) + 0.6, 7.2), layout="constrained", facecolor="white")
    axes = figure.subplots(2, len(found), squeeze=False, sharey="row")
    for (plant, each), (upper, lower) in zip(found.items(), axes.T, strict=True):
        _eigenvalues(upper, each)
        _ends(lower, each)
        upper.set_title(HEADINGS[plant], loc="left", fontsize=11, fontweight="bold")
    axes[0, 0].set_ylabel("least eigenvalue of M(q), kg·m²")
    axes[1, 0].set_ylabel("(cost − bound) / bound")
    for axis in axes.flat:
        axis.grid(visible=True, color="#E5E7EB", linewidth=0.7)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
    for row in axes:
        row[-1].legend(fontsize=8, loc="best", framealpha=0.9)
    plots.save_figure(figure, path)


def _eigenvalues(axis: Any, found: Estimates) -> None:
    """Draw the least eigenvalues of the mass matrix along the motion."""
    samples = found.experiment.samples
    time = samples.time[::STRIDE] - samples.time[0]
    axis.axhline(0.0, color="black", linewidth=1.0)
    for name, color in COLORS.items():
        width = 4.0 if name == "true" else 1.3
        values = found.eigenvalues[name]
        axis.plot(time, values, STYLES[name], color=color, linewidth=width, label=name)
    axis.set_xlabel("time on the recorded motion, s")


def _ends(axis: Any, found: Estimates) -> None:
    """Draw where every start of the local solvers ended, above the proven bound."""
    axis.set(xscale="log", yscale="log", xlabel="solver time, s")
    for name, (label, color, marker) in SOLVERS.items():
        for inequality, filled in (("6x6", False), ("4x4", True)):
            rows = [r for r in found.comparisons[inequality].rows if r.solver == name]
            good = [r for r in rows if r.gap is not None and r.status != "infeasible"]
            text = f"{label}, {inequality.replace('x', '×')}"
            if len(good) < len(rows):
                text += f" ({len(rows) - len(good)} of {len(rows)} ended infeasible: not shown)"
            axis.plot(
                [r.seconds for r in good],
                np.maximum([r.gap for r in good], LEAST_GAP),
                linestyle="none",
                marker=marker,
                markersize=5,
                color=color,
                markerfacecolor=color if filled else "none",
                label=text,
            )
    for inequality, marker in (("6x6", "P"), ("4x4", "*")):
        best = found.comparisons[inequality].certificate
        axis.plot(
            [best.estimate.solve_time],
            [max(best.gap, LEAST_GAP)],
            linestyle="none",
            marker=marker,
            markersize=12,
            color=COLORS["SDP"],
            markeredgecolor="white",
            label=f"SDP {inequality.replace('x', '×')}, proven",
        )
