"""Figures of estimates: their parameters, and the costs of many solves above the proven bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid.errors import DataError
from sdpid.plots.figures import (
    BLUE,
    FAINT,
    GRAY,
    INK,
    MARKERS,
    PALETTE,
    PLAIN,
    RED,
    SKY,
    SMALL,
    dress,
    legend,
    legend_of_all,
    panels,
)

# Of a forest plot: rows reach to one either way; what lies beyond this is drawn there, as an arrow.
_EDGE = 1.12

# Numbers with more decimals are written with a power of ten.
_DECIMALS = 5

# Where the smaller side of an interval is a smaller share of the larger, its ends are written.
_EVEN = 0.9

# Colors and marks of what is shown beside the last, which is drawn with its intervals.
_BESIDE = ((GRAY, "D"), (RED, "x"))

# A violation (kg·m², kg, …) up to this counts as feasible: a local solver's own rounding.
_FEASIBLE = 1e-9
# The axis ends at this multiple of the largest gap of a start or of a feasible step.
_HEADROOM = 3.0
# Costs relatively closer to the bound than this are drawn at it: rounding of the cost itself.
_LEAST_GAP = 1e-12


def plot_parameters(
    names: Sequence[str],
    units: Sequence[str],
    estimates: Mapping[str, ArrayLike],
    *,
    true: ArrayLike | None = None,
    errors: Mapping[str, ArrayLike] | None = None,
    title: str | None = None,
    axes: Any = None,
) -> Any:
    """Show parameters by unit, estimates side by side with bars of twice their standard errors.

    Parameters
    ----------
    names, units : sequence of str
        The b parameters.
    estimates : mapping of str to array_like, shape (b,)
        Values by method.
    true : array_like, shape (b,), optional
        Known values, drawn as bars to be hit.
    errors : mapping of str to array_like, shape (b,), optional
        Standard errors of some of the methods.
    title : str, optional
        Heading of the figure.
    axes : sequence of matplotlib.axes.Axes, optional
        Where to draw, one for each unit; by default in a figure of its own.

    Returns
    -------
    ndarray of matplotlib.axes.Axes
        One for each unit, in the order in which units first occur.

    Raises
    ------
    DataError
        When lengths do not fit, or there is nothing to draw.

    Examples
    --------
    >>> names, units = problem.base.names[:6], problem.base.units[:6]
    >>> values = {"least squares": result.wls.base[:6], "this estimate": estimate.base[:6]}
    >>> axes = sdpid.plots.plot_parameters(names, units, values)
    >>> len(axes)
    3
    """
    count = len(names)
    values = {key: real_array(v, key, ndim=1) for key, v in estimates.items()}
    sigma = {key: real_array(v, f"errors of {key}", ndim=1) for key, v in (errors or {}).items()}
    known = None if true is None else real_array(true, "true", ndim=1)
    for key, array in {"units": units, "true": known, **values, **sigma}.items():
        if array is not None:
            _sized(array, key, count)
    if count == 0 or not values:
        raise DataError("plot: no parameters or no estimates; nothing to draw.")
    groups = [(u, [i for i in range(count) if units[i] == u]) for u in dict.fromkeys(units)]
    widest = max(len(rows) for _, rows in groups)
    size = (max(6.0, 1.6 + 0.34 * widest), 0.9 + 2.3 * len(groups))
    drawn = panels(axes, len(groups), size=size, title=title)
    step = 0.7 / len(values)
    for axis, (unit, rows) in zip(drawn[:, 0], groups, strict=True):
        at = np.arange(len(rows), dtype=np.float64)
        if known is not None:
            axis.hlines(
                known[rows], at - 0.42, at + 0.42, color=INK, linewidth=1.6, label="true", zorder=2
            )
        for k, (method, value) in enumerate(values.items()):
            spread = 2.0 * sigma[method][rows] if method in sigma else None
            label = f"{method} ± 2σ" if spread is not None else method
            look = {"marker": MARKERS[k % len(MARKERS)], "color": PALETTE[k % len(PALETTE)]}
            style = {"ls": "none", "markersize": 4, "elinewidth": 1.0, "zorder": 3, **look}
            x = at + step * (k - 0.5 * (len(values) - 1))
            axis.errorbar(x, value[rows], yerr=spread, label=label, **style)
        axis.axhline(0.0, color=GRAY, linewidth=0.6, zorder=1)
        dress(axis, ylabel=unit)
        axis.set_xticks(at, [names[i] for i in rows], rotation=90, fontsize=SMALL, **PLAIN)
        axis.set_xlim(-0.7, widest - 0.3)
    legend_of_all(drawn)
    return drawn[:, 0]


def plot_forest(
    names: Sequence[str],
    estimates: Mapping[str, ArrayLike],
    *,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    axes: Any = None,
) -> Any:
    """Show parameters one below the other, each on its own scale, zero in the middle.

    A row's scale is the largest of the values but the second last's (least squares may be out by
    any factor); what lies beyond the frame is an arrow at its edge. Numbers stand on the right.

    Parameters
    ----------
    names : sequence of str
        The k parameters.
    estimates : mapping of str to array_like, shape (k,)
        One to three sets of values, the most important last; NaN where there is none.
    lower, upper : array_like, shape (k,), optional
        Intervals of the last values; NaN or infinite where there are none.
    axes : matplotlib.axes.Axes, optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    DataError
        When there is nothing to draw, or lengths do not fit.

    Examples
    --------
    >>> names = ("Fv1", "Fv2", "zzr1")
    >>> wls = [result.wls.named()[name] for name in names]
    >>> best = [estimate.named()[name] for name in names]
    >>> axes = sdpid.plots.plot_forest(names, {"least squares": wls, "this estimate": best})
    >>> axes.figure is not None
    True
    """
    count = len(names)
    values = {name: _sized(each, name, count) for name, each in estimates.items()}
    if not count or not 1 <= len(values) <= 1 + len(_BESIDE):
        raise DataError(
            f"plot: {count} parameters and {len(values)} sets of values; give at least one "
            f"parameter, and one to {1 + len(_BESIDE)} sets."
        )
    *beside, (ours, own) = values.items()
    unknown = np.full(count, np.nan)
    ends = [_sized(unknown if each is None else each, "ends", count) for each in (lower, upper)]
    scale = row_scales(own, [each for _, each in beside][:-1], ends)
    ((axis,),) = panels(axes, size=(5.5, 0.6 + 0.17 * count))
    for side in axis.spines.values():
        side.set_visible(False)
    axis.set(xlim=(-1.2, 1.2), ylim=(count - 0.5, -0.5), xticks=[])
    axis.set_yticks(np.arange(count), names, fontsize=SMALL, color=INK, **PLAIN)
    axis.tick_params(length=0.0)
    axis.hlines(np.arange(count), -1.2, 1.2, color=FAINT, linewidth=0.7, zorder=0.5)
    axis.axvline(0.0, color=GRAY, linewidth=0.8, zorder=0.6)
    at = np.arange(count, dtype=np.float64)
    known = np.isfinite(ends[0]) & np.isfinite(ends[1])
    low, high = (np.clip(each / scale, -_EDGE, _EDGE)[known] for each in ends)
    axis.hlines(at[known], low, high, color=BLUE, linewidth=1.6)
    looks = _BESIDE[len(_BESIDE) - len(beside) :]
    for (name, each), (color, mark) in zip(beside, looks, strict=True):
        _marks(axis, each / scale, at, color, mark, name, markerfacecolor="none")
    _marks(axis, own / scale, at, BLUE, "o", ours)
    for k in range(count):
        halves = (float(own[k] - ends[0][k]), float(ends[1][k] - own[k])) if known[k] else None
        style = {"transform": axis.get_yaxis_transform(), "va": "center", "fontsize": SMALL}
        axis.text(1.03, k, told(float(own[k]), halves), color=INK, clip_on=False, **style, **PLAIN)
    legend(axis, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
    return axis


def _sized(values: Any, name: str, count: int) -> Any:
    """Return an array, one entry a parameter."""
    found = np.asarray(values)
    if found.shape != (count,):
        raise DataError(f"plot: {name} has shape {found.shape}, there are {count} names.")
    return found


def row_scales(own: Array, described: Sequence[Array], ends: Sequence[Array]) -> Array:
    """Return the scale (k,) of each row: the largest size of what it shows beside least squares."""
    sizes = np.abs(np.stack([own, *described, *ends]))
    largest = np.max(np.where(np.isfinite(sizes), sizes, 0.0), axis=0)
    return np.where(largest > 0.0, largest, 1.0)


def _marks(axis: Any, x: Array, y: Array, color: str, mark: str, label: str, **look: Any) -> None:
    """Draw values, and arrows at the edge where they lie beyond it."""
    style = {"color": color, "linestyle": "none", "markersize": 4.0}
    axis.plot(np.where(abs(x) <= _EDGE, x, np.nan), y, marker=mark, label=label, **style, **look)
    axis.plot(np.where(x < -_EDGE, -_EDGE, np.nan), y, marker="<", **style)
    axis.plot(np.where(x > _EDGE, _EDGE, np.nan), y, marker=">", **style)


def told(value: float, halves: tuple[float, float] | None) -> str:
    """Return a value with its interval, in as many digits as that allows.

    The interval is what is below and what is above: its half width, or its ends where a limit
    cuts off one side.
    """
    half = 0.0 if halves is None else max(halves)
    if halves is None or not half > 0.0:
        return f"{value:.3g}".replace("-", "−")
    decimals = 1 - int(np.floor(np.log10(half)))
    fixed = 0 <= decimals <= _DECIMALS

    def text(number: float) -> str:
        # Adding zero makes −0 of what is rounded to nothing 0.
        return f"{round(number, decimals) + 0.0:.{decimals}f}" if fixed else f"{number:.2g}"

    if min(halves) < _EVEN * half:
        words = f"{text(value - halves[0])} … {text(value + halves[1])}"
    else:
        words = f"{text(value)} ± {text(half)}"
    return words.replace("-", "−")


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
    runs = [_steps(history, timed) for history in histories if len(history) > 0]
    points = {name: (float(s), float(c)) for name, (s, c) in (references or {}).items()}
    if not np.isfinite(bound) or not (runs or points):
        raise DataError(f"plot: bound is {bound}, with {len(runs)} histories; nothing to draw.")
    # A bound that is not positive (exact data) is no scale: the differences stand as they are.
    scale, ylabel = (bound, "(cost − bound) / bound") if bound > 0.0 else (1.0, "cost − bound")
    seconds = np.concatenate([*(x for x, _, _ in runs), [s for s, _ in points.values()]])
    positive = seconds[seconds > 0.0]
    # The first step is at time zero, for which a logarithmic axis has no place.
    earliest = (0.5 * float(positive.min()) if positive.size else 1e-3) if timed else 0.0
    honest = [cost[violation <= feasible] for _, cost, violation in runs]
    gaps = (np.concatenate([*honest, [c for _, c in points.values()]]) - bound) / scale
    shown = gaps[gaps > _LEAST_GAP]
    smallest = float(shown.min()) if shown.size else _LEAST_GAP
    floor = float(10.0 ** (np.floor(np.log10(smallest)) - 1.0))
    ((axis,),) = panels(axes, size=(9.0, 5.6), title=title)
    axis.set(xscale="log" if timed else "linear", yscale="log")
    ends: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
    words = f"{label}, feasible", f"{label}, infeasible\n(the bound does not hold there)"
    for when, cost, violation in runs:
        x, y = np.maximum(when, earliest), np.maximum((cost - bound) / scale, floor)
        good = violation <= feasible
        # A stretch of line is feasible when both its ends are.
        axis.plot(x, np.where(good, y, np.nan), color=BLUE, lw=1.1, zorder=3, label=words[0])
        axis.plot(x, y, color=SKY, lw=0.8, ls=":", alpha=0.7, zorder=2, label=words[1])
        ends[bool(good[-1])].append((x[-1], y[-1]))
        words = "", ""
    style = {"ls": "none", "markeredgecolor": "white", "markeredgewidth": 0.5}
    for feasibly, marker, color, what in (
        (True, "o", BLUE, "end of a start"),
        (False, "X", GRAY, "end, infeasible"),
    ):
        if found := ends[feasibly]:
            told = {**style, "clip_on": False, "zorder": 5, "label": f"{what} ({len(found)})"}
            axis.plot(*np.transpose(found), marker=marker, markersize=6, color=color, **told)
    if failed:
        axis.plot([], [], ls="none", label=f"failed, nothing to draw ({failed})")
    for i, (name, (instant, reached)) in enumerate(points.items()):
        text = f"{name} (gap {(reached - bound) / scale:.1e}, {instant:.3g} s)"
        gap, color = max((reached - bound) / scale, floor), PALETTE[1 + i % 5]
        if timed:
            marker, size = ("*", 16) if i == 0 else (MARKERS[i % len(MARKERS)], 9)
            told = {**style, "marker": marker, "markersize": size, "color": color, "zorder": 6}
            axis.plot([max(instant, earliest)], [gap], label=text, **told)
        else:
            axis.axhline(gap, color=color, linewidth=1.4, linestyle="--", zorder=4, label=text)
    axis.axhline(floor, color=INK, linewidth=2.2, label=f"proven lower bound ({bound:.6g})")
    # Trial steps far outside may cost any amount; they leave the picture.
    starts = [max(float((cost[0] - bound) / scale), 0.0) for _, cost, _ in runs]
    axis.set_ylim(floor / 2.0, _HEADROOM * max([*starts, *gaps.tolist(), 10.0 * floor]))
    axis.margins(x=0.05)
    dress(axis, xlabel="solver time [s]" if timed else "iteration", ylabel=ylabel)
    axis.minorticks_off()
    place = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.0), "borderaxespad": 0.0}
    legend(axis, **place, frameon=False)
    return axis


def _steps(history: Sequence[CostStep], timed: bool) -> tuple[Array, Array, Array]:
    """Return seconds or counts, costs and violations of the steps of one start."""
    rows = np.array([(s.seconds, s.cost, s.violation) for s in history], dtype=np.float64)
    return rows[:, 0] if timed else np.arange(float(len(rows))), rows[:, 1], rows[:, 2]
