"""Written robots, compared with what they were written from as `sdpid.verify` does."""

from pathlib import Path

from sdpid.estimation.estimate import Estimate
from sdpid.workflow.written_files import robot_differences


def differences(estimate: Estimate, path: Path) -> list[str]:
    """Return what of a URDF or an MJCF is not of an estimate, its robot and its rows."""
    problem, theta = estimate.problem, estimate.theta
    assert theta is not None
    asked = problem.robot.link_names, problem.consistency
    return list(robot_differences(path, asked, theta, problem))
