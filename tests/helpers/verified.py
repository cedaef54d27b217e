"""Written robots, read as anybody reads them and compared with what they were written from."""

from pathlib import Path
from typing import Any

import numpy as np

import sdpid
from sdpid.estimation.estimate import Estimate
from sdpid.robot.model.base_parameters import generic_states


def differences(estimate: Estimate, path: Path) -> list[str]:
    """Return what of a URDF or an MJCF is not of an estimate and its robot: bodies and efforts."""
    robot, theta = estimate.problem.robot, estimate.theta
    assert theta is not None
    root = "free_flyer" if robot.free_flyer and path.suffix == ".urdf" else None
    file = sdpid.load_robot(path, root=root)
    bodies = dict(zip(robot.link_names, estimate.problem.feasible.bodies(theta), strict=True))
    # MuJoCo keeps the name of its world for itself.
    own = [bodies.get(link, bodies.get(link.removesuffix("_link"))) for link in file.link_names]
    found = [
        f"link {link}"
        for link, body, wanted in zip(file.link_names, file.prior, own, strict=True)
        if not np.allclose(body, wanted, rtol=1e-12, atol=1e-12)
    ]
    if found or sorted(file.joint_names) != sorted(robot.joint_names):
        return found or ["joints"]
    states = generic_states(robot, 8, 1)
    order: Any = [robot.joint_names.index(name) for name in file.joint_names]
    if file.joint_names == robot.joint_names and file.pin_model.nq == robot.pin_model.nq:
        order = slice(None)  # configurations have other columns than joints
    elif robot.free_flyer or robot.pin_model.nq != robot.n:
        return []
    gravity = estimate.model().tilted_gravity
    if path.suffix == ".urdf" and gravity.any():
        # A base that is turned leaves gravity its size.
        gravity = gravity * (np.linalg.norm(robot.gravity) / np.linalg.norm(gravity))
    robot = robot.with_gravity(gravity)
    wanted = robot.inverse_dynamics(np.array(list(bodies.values())), *states)[:, order]
    efforts = file.inverse_dynamics(file.prior, *(each[:, order] for each in states))
    return [] if np.allclose(efforts, wanted, rtol=1e-9, atol=1e-9) else ["efforts"]
