"""Controllers of joints, for simulations in closed loop.

``sdpid.simulate_closed_loop(estimate.model(), motion, sdpid.controllers.PD(kp, kd))`` moves a model
as a robot moves that has this controller. ``fit_controller(log, "pd")`` finds the gains in a log
with commanded positions.
"""

from sdpid.experiment.simulation.controllers import PD, PID, ComputedTorque, Controller, P
from sdpid.experiment.simulation.fit_controller import fit_controller

__all__ = ["PD", "PID", "ComputedTorque", "Controller", "P", "fit_controller"]
