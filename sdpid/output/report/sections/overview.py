"""All joints of a result in one figure: `Identification.plot`."""

from __future__ import annotations

from typing import Any

from sdpid.output.report.judged import Judged, judged
from sdpid.output.report.sections.joints import joints_shown
from sdpid.plots.figures import dress, panels
from sdpid.plots.joints import plot_friction_curve, plot_joint

# Inches: of the figure, and of a row.
_WIDTH, _ROW = 14.0, 2.1


def plot_overview(result: Judged, *, title: str | None = None, axes: Any = None) -> Any:
    """Show effort, error and friction of every joint, with their bands: one row a joint.

    Parameters
    ----------
    result : Identification
        The result; shown is what it is judged by, held out where there is something held out.
    title : str, optional
        Heading of the figure.
    axes : array of matplotlib.axes.Axes, shape (n, 3), optional
        Where to draw; by default in a figure of its own.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, shape (n, 3)
        Of effort and error over time, and of friction over velocity; the last of a row is empty
        where a joint has no friction.
    """
    (samples, _), joints = judged(result), list(joints_shown(result))
    starts = samples.starts
    size = (_WIDTH, 0.6 + _ROW * len(joints))
    axes = panels(axes, len(joints), 3, size=size, title=title, width_ratios=(3.0, 2.0, 2.0))
    for row, own in zip(axes, joints, strict=True):
        rows = own.measured, own.predicted, own.used
        plot_joint(samples.time, *rows, band=own.half, unit=own.unit, starts=starts, axes=row[:2])
        dress(row[0], title=own.name, xlabel=row[1].get_xlabel())
        if own.curve is None:
            row[2].set_axis_off()
        else:
            plot_friction_curve(own.curve, cloud=own.cloud, driven=own.speeds, axes=row[2])
    return axes
