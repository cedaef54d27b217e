"""Costs of many solves over time or iterations, above the bound that is proven."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.plots.figures import (
    BLUE,
    GRAY,
    INK,
    METHOD_MARKERS,
    ORANGE,
    PURPLE,
    RED,
    SKY,
    dress,
    head,
    legend,
    new_figure,
)

# A violation (kg·m², kg, …) up to this counts as feasible: a local solver's own rounding.
_FEASIBLE = 1e-9
# The axis ends at this multiple of the largest gap of a start or of a feasible step.
_HEADROOM = 3.0
# Costs relatively closer to the bound than this are drawn at it: rounding of the cost itself.
_LEAST_GAP = 1e-12


class CostStep(Protocol):
    """A step of a local solver."""

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
    against: Literal["seconds", "iterations"] = "seconds",
    failed: int = 0,
    label: str = "SLSQP",
    feasible: float = _FEASIBLE,
    title: str | None = None,
    axes: Any = None,
) -> Any:
    """Show the costs of many local solves above the proven lower bound, step by step.

    Parameters
    ----------
    histories : sequence of sequences of Step
        The steps of each start: seconds, cost and violation.
    bound : float
        Proven lower bound of the cost over the feasible set.
    references : mapping of str to (seconds, cost), optional
        Single points to mark, such as the SDP's optimum. Over iterations they are lines, as
        iterations of different solvers are not alike.
    against : {"seconds", "iterations"}, optional
        What the horizontal axis shows.
    failed : int, optional
        Number of starts that have no history because they failed; the legend says so.
    label : str, optional
        What the local solver is called.
    feasible : float, optional
        Largest violation that counts as feasible. Steps beyond it are drawn faint and dotted:
        their cost may be below the bound, because the bound does not hold for them.
    title : str, optional
        Heading of the figure.
    axes : matplotlib.axes.Axes, optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    DataError
        When there is nothing to draw, or the bound is not finite.

    Examples
    --------
    >>> local = sdpid.solve_slsqp(problem, start=1.01 * estimate.theta)
    >>> bound = sdpid.certify(estimate).lower_bound
    >>> axes = sdpid.plots.plot_convergence([local.history], bound, against="iterations")
    >>> axes.get_xlabel()
    'iteration'
    """
    if against not in ("seconds", "iterations"):
        raise DataError(f"plot: against is {against!r}: use 'seconds' or 'iterations'.")
    timed = against == "seconds"
    runs_ = [_steps(history, timed) for history in histories if len(history) > 0]
    points = {name: (float(s), float(c)) for name, (s, c) in (references or {}).items()}
    if not np.isfinite(bound) or not (runs_ or points):
        raise DataError(f"plot: bound is {bound}, with {len(runs_)} histories; nothing to draw.")
    # A bound that is not positive (exact data) is no scale: the differences stand as they are.
    scale, ylabel = (bound, "(cost − bound) / bound") if bound > 0.0 else (1.0, "cost − bound")
    seconds = np.concatenate([r[0] for r in runs_] + [np.array([s for s, _ in points.values()])])
    positive = seconds[seconds > 0.0]
    # The first step is at time zero, for which a logarithmic axis has no place.
    earliest = 0.5 * float(positive.min()) if positive.size and timed else 1e-3
    honest = [(r[1] - bound)[r[2] <= feasible] / scale for r in runs_]
    gaps = np.concatenate([*honest, [(c - bound) / scale for _, c in points.values()]])
    shown = gaps[gaps > _LEAST_GAP]
    smallest = float(shown.min()) if shown.size else _LEAST_GAP
    floor = 10.0 ** (np.floor(np.log10(smallest)) - 1.0)
    axis = axes
    if axis is None:
        axis = new_figure(9.0, 5.6, title).subplots()
    else:
        head(axis, title)
    if timed:
        axis.set_xscale("log")
    else:
        earliest = 0.0
    axis.set_yscale("log")
    for steps in runs_:
        _draw_run(axis, steps, bound, scale, floor, earliest, feasible)
    for i, (name, (when, cost)) in enumerate(points.items()):
        gap = max((cost - bound) / scale, floor)
        text = f"{name} (gap {(cost - bound) / scale:.1e}, {when:.3g} s)"
        if not timed:
            color = (RED, PURPLE, ORANGE, SKY)[i % 4]
            axis.axhline(gap, color=color, linewidth=1.4, linestyle="--", zorder=4, label=text)
            continue
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
            label=text,
        )
    axis.axhline(floor, color=INK, linewidth=2.2, label=f"proven lower bound ({bound:.6g})")
    # Trial steps far outside may cost any amount; they leave the picture.
    starts = [max(float((r[1][0] - bound) / scale), 0.0) for r in runs_]
    top = _HEADROOM * max([*starts, *gaps.tolist(), 10.0 * floor])
    axis.set_ylim(floor / 2.0, top)
    axis.margins(x=0.05)
    dress(axis, xlabel="solver time [s]" if timed else "iteration", ylabel=ylabel)
    axis.minorticks_off()
    _legend_of_runs(axis, runs_, label, feasible, failed)
    return axis


def _steps(history: Sequence[CostStep], timed: bool) -> tuple[Array, Array, Array]:
    rows = np.array([(s.seconds, s.cost, s.violation) for s in history], dtype=np.float64)
    return rows[:, 0] if timed else np.arange(float(len(rows))), rows[:, 1], rows[:, 2]


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
        color=BLUE if good[-1] else GRAY,
        markeredgecolor="white",
        markeredgewidth=0.5,
        clip_on=False,
        zorder=5,
    )


def _legend_of_runs(
    axis: Any,
    histories: Sequence[tuple[Array, Array, Array]],
    label: str,
    feasible: float,
    failed: int,
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
        cross = Line2D([], [], color=GRAY, marker="X", markersize=6, linestyle="none")
        entries.append((cross, f"end, infeasible ({len(ends) - sum(ends)})"))
    if failed:
        nothing = Line2D([], [], linestyle="none")
        entries.append((nothing, f"failed, nothing to draw ({failed})"))
    legend(
        axis,
        handles=[h for h, _ in entries] + handles,
        labels=[text for _, text in entries] + labels,
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        borderaxespad=0.0,
        frameon=False,
    )
