"""What is simulated beside the estimate: the description, and least squares."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import frozen
from sdpid.assurance.diagnostics.described import described_dynamics
from sdpid.assurance.diagnostics.held_out import (
    DESCRIPTION,
    FRICTION_FITTED,
    LEAST_SQUARES,
    friction_fitted,
)
from sdpid.errors import SdpidError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.dynamics import RobotDynamics

# What takes the place of the joints that are free.
CLOSED_LOOP = "closed loop"

# A model that comes without an estimate.
MODEL = "this model"

# What needs no model.
CONSTANT_VELOCITY = "constant velocity"
STAND_STILL = "stand still"
FLOOR = "noise alone"


def models_beside(estimate: Estimate, samples: Samples) -> dict[str, RobotDynamics]:
    """Return the robots to simulate beside an estimate, by name.

    Its description as it is and with friction fitted, where the description has masses, and the
    least-squares fit of the same rows, where the estimate is not one itself.
    """
    found: dict[str, RobotDynamics] = {}
    problem = estimate.problem
    if np.any(problem.robot.prior[:, 0] > 0.0):
        found[DESCRIPTION] = described_dynamics(problem.robot, samples)
        found[FRICTION_FITTED] = replace(estimate.model(), theta=frozen(friction_fitted(estimate)))
    if estimate.method != "wls":
        # Where no rows determine it, the others stand.
        with contextlib.suppress(SdpidError):
            found[LEAST_SQUARES] = solve_wls(replace(problem, prior=None)).model()
    return found
