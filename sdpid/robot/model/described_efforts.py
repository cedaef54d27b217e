"""Efforts that a description's bodies need, quickly."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid.robot.model.model import RobotModel

__all__ = ["described_efforts"]


def described_efforts(
    robot: RobotModel, q: Array, v: Array, a: Array, *, gravity: ArrayLike | None = None
) -> Array:
    """Return the efforts of the bodies in a robot's description, without friction.

    By the recursive Newton-Euler algorithm, 2 µs a sample: a tenth of the regressor's time.

    Parameters
    ----------
    robot : RobotModel
        On a fixed base.
    q, v, a : ndarray, shape (K, n)
        Positions, velocities and accelerations of the joints, rad (m).
    gravity : array_like, shape (3,), optional
        In place of the robot's own, m/s².

    Returns
    -------
    ndarray, shape (K, n)
        N·m (N).
    """
    import pinocchio as pin

    model = robot.pin_model.copy()
    for place, body in enumerate(robot.prior, 1):
        # A body without mass has no center of mass.
        massive = body[0] > 0.0
        make = pin.Inertia.FromDynamicParameters
        model.inertias[place] = make(body) if massive else pin.Inertia.Zero()
    if gravity is not None:
        model.gravity.linear = np.asarray(gravity, dtype=np.float64)
    data = model.createData()
    states = robot.configuration(q), v @ robot.expansion.T, a @ robot.expansion.T
    efforts = np.array([pin.rnea(model, data, *state) for state in zip(*states, strict=True)])
    return np.asarray(efforts @ robot.expansion)
