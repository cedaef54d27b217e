"""Jacobians: velocities of all links per joint velocity, and of joints per link velocity.

Velocities are (angular, linear) in the frame of each link, at its origin, so that the kinetic
energy of a link is half ``V^T·I·V`` with the 6×6 spatial inertia of `sdpid.robot.inertia`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid.robot.model.model import RobotModel

# From Pinocchio's (linear, angular) to (angular, linear).
_ANGULAR_FIRST = np.array([3, 4, 5, 0, 1, 2])


def link_jacobians(robot: RobotModel, q: ArrayLike) -> Array:
    """Return the velocities of the links per unit of each coordinate's velocity.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    q : array_like, shape (K, n)
        Joint positions; with a floating base those of the joints only, (K, n − 6).

    Returns
    -------
    ndarray, shape (K, links, 6, n)
    """
    import pinocchio as pin

    configurations = robot.at_rest(q)
    model = robot.pin_model
    data = model.createData()
    out = np.empty((len(configurations), robot.n_links, 6, model.nv))
    for k, configuration in enumerate(configurations):
        pin.computeJointJacobians(model, data, configuration)
        for i in range(robot.n_links):
            out[k, i] = local_jacobian(model, data, i + 1)
    return np.asarray(out[:, :, _ANGULAR_FIRST] @ robot.expansion)


def joint_rates(robot: RobotModel) -> Array:
    """Return the matrix N (nv, 6·links) that maps link velocities to joint velocities.

    A joint's velocity is the component along its axis of what its link moves relative to the link
    before, ``S^T·(V − X·V_before)``. Turning the joint does not change its axis, in either frame,
    so N does not depend on the position. Coordinates are those of Pinocchio's joints.
    """
    import pinocchio as pin

    model: Any = robot.pin_model
    data = model.createData()
    q = pin.neutral(model)
    pin.computeJointJacobians(model, data, q)
    out = np.zeros((model.nv, 6 * robot.n_links))
    for i in range(1, model.njoints):
        joint = model.joints[i]
        columns = slice(joint.idx_v, joint.idx_v + joint.nv)
        S = local_jacobian(model, data, i)[_ANGULAR_FIRST, columns]
        out[columns, 6 * i - 6 : 6 * i] = S.T
        before = model.parents[i]
        if before > 0:
            # Action on motions from the frame before to this one, angular first.
            X = data.oMi[i].actInv(data.oMi[before]).action
            X = X[np.ix_(_ANGULAR_FIRST, _ANGULAR_FIRST)]
            out[columns, 6 * before - 6 : 6 * before] = -S.T @ X
    return out


def local_jacobian(model: Any, data: Any, joint: int) -> Array:
    """Return the Jacobian (6, nv) of a joint's frame, linear first, of Jacobians in `data`."""
    import pinocchio as pin

    # With a single joint the binding drops the axis of length one.
    found = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL)
    return np.asarray(found).reshape(6, -1)
