"""Controllers of joints, for simulations in closed loop.

``sdpid.simulate_closed_loop(estimate.model(), motion, sdpid.controllers.PD(kp, kd))`` moves a model
as a robot moves that has this controller.
"""

from sdpid.experiment.simulation.controllers import PD, PID, ComputedTorque, Controller, P

__all__ = ["PD", "PID", "ComputedTorque", "Controller", "P"]
