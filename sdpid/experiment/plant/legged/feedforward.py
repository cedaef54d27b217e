"""Torques that carry a robot's weight along a planned motion."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.plant.legged.paths import Plan
from sdpid.robot.legs.legs import Legs


def weight_torques(legs: Legs, plan: Plan, times: Array) -> Array:
    """Return the joint torques that hold the robot still at every instant of a plan.

    The robot is that of its description: a controller does not know the true one. The feet that
    are down share the weight with the least squared force; torques on soles count as forces at
    half of their smaller half width, so that a foot above which the weight is bears it.

    Returns
    -------
    ndarray, shape (K, joints)
    """
    import pinocchio as pin
    from scipy.spatial.transform import Rotation

    model = legs.robot.pin_model
    data = model.createData()
    joints, _ = plan.joints(times)
    position, turn = plan.base(times)
    q = np.hstack([position, Rotation.from_rotvec(turn).as_quat(), joints])
    down = plan.down(times)
    out = np.empty_like(joints)
    lever = np.ones(3)
    if legs.sole is not None:
        lever = np.repeat([1.0, 0.25 * float((legs.sole[1] - legs.sole[0]).min())], 3)
    for k, row in enumerate(q):
        gravity = pin.computeGeneralizedGravity(model, data, row)
        out[k] = gravity[6:]
        ids = [frame for frame, bears in zip(legs.frame_ids, down[k], strict=True) if bears]
        if plan.held or not ids:
            continue
        pin.computeJointJacobians(model, data, row)
        J = np.vstack(
            [
                lever[:, None]
                * pin.getFrameJacobian(model, data, i, pin.LOCAL_WORLD_ALIGNED)[: len(lever)]
                for i in ids
            ]
        )
        force = np.linalg.lstsq(J[:, :6].T, gravity[:6], rcond=None)[0]
        out[k] -= J[:, 6:].T @ force
    return out
