"""Costs of many solves over time, above the bound that is proven."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from sdpid._arrays import Array
from sdpid._extras import require
from sdpid.errors import DataError
from sdpid.output.figures import (
    BLUE,
    GREY,
    INK,
    METHOD_MARKERS,
    ORANGE,
    PURPLE,
    RED,
    SKY,
    dress,
    legend,
    new_figure,
)

# A violation (kg·m², kg, …) up to this counts as feasible: a local solver's own rounding.
_FEASIBLE = 1e-9
# Costs relatively closer to the bound than this are drawn at it: rounding of the cost itself.
_LEAST_GAP = 1e-12


class CostStep(Protocol):
    """A step of a local solver: `sdpid.estimation.estimate.Step` or alike."""

    @property
    def seconds(self) -> float:
        """Seconds since the start."""

    @property
    def cost(self) -> float:
        """Weighted cost."""

    @property
    def violation(self) -> float:
        """Worst violation of a constraint, 0 when feasible."""


def plot_convergence(
    histories: Sequence[Sequence[CostStep]],
    bound: float,
    references: Mapping[str, tuple[float, float]] | None = None,
    *,
    label: str = "SLSQP",
    feasible: float = _FEASIBLE,
    title: str | None = None,
) -> Any:
    """Show how far above the proven bound the costs of many local solves are, over time.

    Parameters
    ----------
    histories : sequence of sequences of Step
        The steps of each start: seconds, cost and violation.
    bound : float
        Proven lower bound of the cost over the feasible set.
    references : mapping of str to (seconds, cost), optional
        Single points to mark, such as the SDP's optimum.
    label : str, optional
        What the local solver is called.
    feasible : float, optional
        Largest violation that counts as feasible. Steps beyond it are drawn faint and dotted:
        their cost may be below the bound, because the bound does not hold for them.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    DataError
        When there is nothing to draw, or the bound is not finite.
    """
    runs_ = [_steps(history) for history in histories if len(history) > 0]
    points = {name: (float(s), float(c)) for name, (s, c) in (references or {}).items()}
    if not np.isfinite(bound) or not (runs_ or points):
        raise DataError(f"plot: bound is {bound}, with {len(runs_)} histories; nothing to draw.")
    # A bound that is not positive (exact data) is no scale: the differences stand as they are.
    scale, ylabel = (bound, "(cost − bound) / bound") if bound > 0.0 else (1.0, "cost − bound")
    seconds = np.concatenate([r[0] for r in runs_] + [np.array([s for s, _ in points.values()])])
    positive = seconds[seconds > 0.0]
    # The first step is at time zero, for which a logarithmic axis has no place.
    earliest = 0.5 * float(positive.min()) if positive.size else 1e-3
    honest = [(r[1] - bound)[r[2] <= feasible] / scale for r in runs_]
    gaps = np.concatenate([*honest, [(c - bound) / scale for _, c in points.values()]])
    shown = gaps[gaps > _LEAST_GAP]
    smallest = float(shown.min()) if shown.size else _LEAST_GAP
    floor = 10.0 ** (np.floor(np.log10(smallest)) - 1.0)
    figure = new_figure(9.0, 5.6, title)
    axis = figure.subplots()
    axis.set_xscale("log")
    axis.set_yscale("log")
    for steps in runs_:
        _draw_run(axis, steps, bound, scale, floor, earliest, feasible)
    for i, (name, (when, cost)) in enumerate(points.items()):
        gap = max((cost - bound) / scale, floor)
        axis.plot(
            [max(when, earliest)],
            [gap],
            linestyle="none",
            marker="*" if i == 0 else METHOD_MARKERS[i % 6],
            markersize=16 if i == 0 else 9,
            color=(RED, PURPLE, ORANGE, SKY)[i % 4],
            markeredgecolor="white",
            markeredgewidth=0.8,
            zorder=6,
            label=f"{name} (gap {(cost - bound) / scale:.1e}, {when:.3g} s)",
        )
    axis.axhline(floor, color=INK, linewidth=2.2, label=f"proven lower bound ({bound:.6g})")
    axis.set_ylim(bottom=floor / 2.0)
    axis.margins(x=0.05)
    dress(axis, xlabel="solver time [s]", ylabel=ylabel)
    axis.minorticks_off()
    _legend_of_runs(axis, runs_, label, feasible)
    return figure


def _steps(history: Sequence[CostStep]) -> tuple[Array, Array, Array]:
    rows = np.array([(s.seconds, s.cost, s.violation) for s in history], dtype=np.float64)
    return rows[:, 0], rows[:, 1], rows[:, 2]


def _draw_run(
    axis: Any,
    steps: tuple[Array, Array, Array],
    bound: float,
    scale: float,
    floor: float,
    earliest: float,
    feasible: float,
) -> None:
    """Draw one start: solid where feasible, faint and dotted where not, its end marked."""
    seconds, cost, violation = steps
    x = np.maximum(seconds, earliest)
    y = np.maximum((cost - bound) / scale, floor)
    good = violation <= feasible
    axis.plot(x, y, color=SKY, linewidth=0.8, linestyle=":", alpha=0.7, zorder=2)
    # A stretch of line is feasible when both its ends are.
    axis.plot(x, np.where(good, y, np.nan), color=BLUE, linewidth=1.1, alpha=0.8, zorder=3)
    axis.plot(
        x[-1:],
        y[-1:],
        linestyle="none",
        marker="o" if good[-1] else "X",
        markersize=5 if good[-1] else 6,
        color=BLUE if good[-1] else GREY,
        markeredgecolor="white",
        markeredgewidth=0.5,
        clip_on=False,
        zorder=5,
    )


def _legend_of_runs(
    axis: Any, histories: Sequence[tuple[Array, Array, Array]], label: str, feasible: float
) -> None:
    Line2D = require("matplotlib.lines", extra="plot").Line2D
    handles, labels = axis.get_legend_handles_labels()
    ends = [bool(violation[-1] <= feasible) for _, _, violation in histories]
    entries: list[tuple[Any, str]] = []
    if histories:
        entries += [
            (Line2D([], [], color=BLUE, linewidth=1.1), f"{label}, feasible"),
            (
                Line2D([], [], color=SKY, linewidth=1.0, linestyle=":"),
                f"{label}, infeasible\n(the bound does not hold there)",
            ),
        ]
    if any(ends):
        dot = Line2D([], [], color=BLUE, marker="o", markersize=5, linestyle="none")
        entries.append((dot, f"end of a start ({sum(ends)})"))
    if not all(ends):
        cross = Line2D([], [], color=GREY, marker="X", markersize=6, linestyle="none")
        entries.append((cross, f"end, infeasible ({len(ends) - sum(ends)})"))
    legend(
        axis,
        handles=[h for h, _ in entries] + handles,
        labels=[text for _, text in entries] + labels,
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        borderaxespad=0.0,
        frameon=False,
    )
