"""Signals of one joint before and after filtering, as in the paper's Fig. 3."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.processing.derivatives import Stencil
from sdpid.experiment.processing.filters import ZeroPhaseFilter
from sdpid.experiment.recording.recording import Recording

_UNITS = {"position": "rad", "torque": "N·m", "velocity": "rad/s", "acceleration": "rad/s²"}


@dataclass(frozen=True, eq=False)
class Stages:
    """Signals of one joint in a stretch of a recording.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Seconds.
    before, after : dict of str to ndarray
        ``position``, ``torque``, ``velocity`` and ``acceleration``. Before filtering, the
        derivatives are those of the filtered position.
    """

    time: Array
    before: dict[str, Array]
    after: dict[str, Array]

    def __repr__(self) -> str:
        return f"Stages({', '.join(self.before)}: {len(self.time)} samples)"

    def plot(self, *, title: str | None = None, axes: Any = None) -> Any:
        """Show each signal before and after filtering, and what was taken away (extra ``plot``).

        Parameters
        ----------
        title : str, optional
            Heading of the figure.
        axes : array of matplotlib.axes.Axes, shape (4, 2), optional
            Where to draw; by default in a figure of its own.

        Returns
        -------
        ndarray of matplotlib.axes.Axes, shape (4, 2)
        """
        from sdpid.plots.in_pages import in_notebook
        from sdpid.plots.signals import plot_signals

        drawn = plot_signals(
            self.time, self.before, self.after, units=_UNITS, title=title, axes=axes
        )
        return in_notebook(drawn, axes)


def filter_stages(
    log: Recording,
    joint: int,
    *,
    window: tuple[float, float],
    low_pass: ZeroPhaseFilter,
    difference: Stencil,
    twice: bool,
) -> Stages:
    """Filter a stretch of one joint's signals, as section III-C does.

    Parameters
    ----------
    log : Recording
        The recording.
    joint : int
        Index of the joint.
    window : (float, float)
        From and to, in the recording's time (s).
    low_pass : ZeroPhaseFilter
        The filter.
    difference : Stencil
        How the filtered position is differentiated.
    twice : bool
        Whether derivatives pass the filter once more.

    Raises
    ------
    DataError
        When the window holds too few samples or the joint does not exist.
    """
    if not 0 <= joint < log.n:
        raise DataError(f"joint {joint} does not exist; the recording has {log.n}, counted from 0.")
    first, last = np.searchsorted(log.time, window)
    pad = 2 * low_pass.reach + 2 * difference.margin
    start, stop = max(0, int(first) - pad), min(len(log.time), int(last) + pad)
    if last - first < 2 or stop - start <= 2 * pad:
        raise DataError(
            f"window {window[0]:g} … {window[1]:g} s: {last - first} samples, too few to filter; "
            f"the recording runs from {log.time[0]:g} to {log.time[-1]:g} s."
        )
    position = np.ascontiguousarray(log.position[start:stop, joint])
    torque = np.ascontiguousarray(log.effort[start:stop, joint])
    smooth = low_pass.apply(position)
    velocity = difference.velocity(smooth, log.step)
    acceleration = difference.acceleration(smooth, log.step)
    margin = difference.margin
    before = {
        "position": position[margin:-margin],
        "torque": torque[margin:-margin],
        "velocity": velocity,
        "acceleration": acceleration,
    }
    after = {
        "position": smooth[margin:-margin],
        "torque": low_pass.apply(torque)[margin:-margin],
        "velocity": low_pass.apply(velocity) if twice else velocity,
        "acceleration": low_pass.apply(acceleration) if twice else acceleration,
    }
    inner = slice(int(first) - start - margin, int(last) - start - margin)
    return Stages(
        time=np.array(log.time[first:last]),
        before={key: value[inner] for key, value in before.items()},
        after={key: value[inner] for key, value in after.items()},
    )
