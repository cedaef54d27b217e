"""Estimated parameters side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import real_array
from sdpid.errors import DataError
from sdpid.plots.figures import (
    GRAY,
    INK,
    METHOD_COLORS,
    METHOD_MARKERS,
    PLAIN,
    SMALL,
    axes_of,
    bottom_legend,
    dress,
    figure_of,
    head,
    legend,
    new_figure,
)


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
    sized = {"units": np.array(units), **values, **sigma}
    if known is not None:
        sized["true"] = known
    for key, array in sized.items():
        if len(array) != count:
            raise DataError(f"plot: {key} has {len(array)} entries, there are {count} names.")
    if count == 0 or not values:
        raise DataError("plot: no parameters or no estimates; nothing to draw.")
    groups = [(u, [i for i in range(count) if units[i] == u]) for u in dict.fromkeys(units)]
    widest = max(len(rows) for _, rows in groups)
    own = axes is None
    if own:
        figure = new_figure(max(6.0, 1.6 + 0.34 * widest), 0.9 + 2.3 * len(groups), title)
        axes = figure.subplots(len(groups), 1, squeeze=False)[:, 0]
    else:
        axes = axes_of(axes, len(groups))[:, 0]
        head(axes, title)
    step = 0.7 / len(values)
    for axis, (unit, rows) in zip(axes, groups, strict=True):
        at = np.arange(len(rows), dtype=np.float64)
        if known is not None:
            axis.hlines(
                known[rows], at - 0.42, at + 0.42, color=INK, linewidth=1.6, label="true", zorder=2
            )
        for k, (method, value) in enumerate(values.items()):
            spread = 2.0 * sigma[method][rows] if method in sigma else None
            axis.errorbar(
                at + step * (k - 0.5 * (len(values) - 1)),
                value[rows],
                yerr=spread,
                linestyle="none",
                marker=METHOD_MARKERS[k % 6],
                color=METHOD_COLORS[k % 6],
                markersize=4,
                elinewidth=1.0,
                label=f"{method} ± 2σ" if spread is not None else method,
                zorder=3,
            )
        axis.axhline(0.0, color=GRAY, linewidth=0.6, zorder=1)
        dress(axis, ylabel=unit)
        axis.set_xticks(at, [names[i] for i in rows], rotation=90, fontsize=SMALL, **PLAIN)
        axis.set_xlim(-0.7, widest - 0.3)
    if own:
        bottom_legend(figure_of(axes), *axes[0].get_legend_handles_labels())
    else:
        legend(axes[0])
    return axes
