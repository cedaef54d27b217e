"""Figures of what was measured and found: the public namespace `sdpid.plots` (extra ``plot``).

Every function returns a `matplotlib.figure.Figure`; nothing is shown and no global state of
matplotlib is touched. `save_figure` writes a figure to a file.
"""

from sdpid.output.plots.convergence import plot_convergence
from sdpid.output.plots.figures import save_figure
from sdpid.output.plots.filtering import plot_filtering, plot_signals
from sdpid.output.plots.parameters import plot_parameters
from sdpid.output.plots.reconstruction import plot_fit, plot_reconstruction

__all__ = [
    "plot_convergence",
    "plot_filtering",
    "plot_fit",
    "plot_parameters",
    "plot_reconstruction",
    "plot_signals",
    "save_figure",
]
