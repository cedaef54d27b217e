"""Say what a URDF of an estimate misses of measured efforts, before it is written."""

from __future__ import annotations

import numpy as np

from sdpid.errors import ExportError
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.processing.samples import Samples
from sdpid.output.robots.export_report import Errors, Written
from sdpid.output.robots.joint_friction import joint_attributes
from sdpid.output.robots.places import Kind
from sdpid.robot.friction.terms import Coulomb, Viscous

# The attributes that a URDF has for friction.
PLACES: dict[Kind, str] = {Coulomb: "friction", Viscous: "damping"}


def urdf_errors(estimate: Estimate, samples: Samples | None = None) -> Errors | None:
    """Return the errors of an estimate's URDF beside the estimate's own.

    Parameters
    ----------
    estimate : Estimate
        The estimate.
    samples : Samples, optional
        Where efforts are predicted; by default the problem's own.

    Returns
    -------
    Errors or None
        None where no URDF can be written, or there are no rows.
    """
    problem, theta = estimate.problem, estimate.theta
    robot = problem.robot
    if theta is None or robot.urdf is None or problem.consistency == "none":
        return None
    try:
        written = joint_attributes(problem, theta, PLACES, "URDF").values
    except ExportError:  # negative friction
        return None
    damping, dry = (np.array(each) for each in robot.described_friction())
    for j, joint in enumerate(robot.joint_names):
        values = written.get(joint, {})
        dry[j] = values.get(PLACES[Coulomb], dry[j])
        damping[j] = values.get(PLACES[Viscous], damping[j])
    seen = robot.with_gravity(estimate.model().tilted_gravity)
    return Written(estimate, (dry, damping, np.zeros(robot.n)), seen).errors(samples)
