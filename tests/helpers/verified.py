"""Written robots as the stand-alone checker sees them."""

from __future__ import annotations

from pathlib import Path

from sdpid.estimation.estimate import Estimate
from sdpid.verifier.result import Result
from sdpid.verifier.results import mjcf, urdf
from sdpid.verifier.results.joint_friction import Friction


def checked(estimate: Estimate, path: Path, *, fitted: bool = False) -> Result:
    """Return what the checker says of a URDF or an MJCF that holds an estimate."""
    problem, theta = estimate.problem, estimate.theta
    assert theta is not None
    robot, values = problem.robot, theta.tolist()
    bodies = {link: values[10 * k : 10 * k + 10] for k, link in enumerate(robot.link_names)}
    named = dict(zip(problem.base.theta_names, values, strict=True))
    friction = Friction.of(robot.joint_names, named, fitted)
    content = path.read_bytes()
    if b"<mujoco" in content:
        return mjcf.check(content, bodies, friction)
    return urdf.check(content, bodies, problem.consistency, friction)
