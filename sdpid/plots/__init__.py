"""Figures of what was measured and found: the public namespace `sdpid.plots` (extra ``plot``).

Every function returns matplotlib axes, one or an array of them, and most draw into `axes` that are
given. Nothing is shown and no global state of matplotlib is touched. `save_figure` writes the
figure of some axes to a file.
"""

from sdpid.plots.estimates import plot_convergence, plot_forest, plot_parameters
from sdpid.plots.figures import save_figure
from sdpid.plots.joints import plot_friction_curve, plot_joint, plot_joint_errors
from sdpid.plots.motion import plot_against_limits, plot_mass_matrix, plot_motion, plot_rollout
from sdpid.plots.reconstruction import plot_fit, plot_reconstruction, plot_signals

__all__ = [
    "plot_against_limits",
    "plot_convergence",
    "plot_fit",
    "plot_forest",
    "plot_friction_curve",
    "plot_joint",
    "plot_joint_errors",
    "plot_mass_matrix",
    "plot_motion",
    "plot_parameters",
    "plot_reconstruction",
    "plot_rollout",
    "plot_signals",
    "save_figure",
]
