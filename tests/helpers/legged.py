"""Samples of a quadruped whose forces, motion and parameters are known: made by Pinocchio."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin

from sdpid import RobotModel, Samples, load_robot
from sdpid._common.arrays import Array, Mask
from sdpid.experiment.processing.contact_samples import ContactSamples

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
RADIUS = (0.0, 0.0, -0.018)

# Of the efforts of simulated sensors: joints in N·m, the base in N and N·m.
NOISE = np.array([0.4] * 3 + [0.05] * 3 + [0.02] * 12)


@dataclass(frozen=True, eq=False)
class Gait:
    """Samples without noise, and what they were made of.

    Attributes
    ----------
    robot : RobotModel
    samples : Samples
        Forces are not told.
    forces : ndarray, shape (K, 4, 3)
        In the world's axes.
    theta : ndarray, shape (10·links,)
    """

    robot: RobotModel
    samples: Samples
    forces: Array
    theta: Array

    def measured(self, covariance: Any, forces: Array | None = None) -> Samples:
        """Return the samples with measured forces."""
        contacts = self.samples.contacts
        assert contacts is not None
        given = np.concatenate(
            [self.forces if forces is None else forces, np.zeros_like(self.forces)], axis=2
        )
        known = replace(contacts, forces=given, force_covariance=covariance)
        return replace(self.samples, contacts=known)

    def noisy(self, seed: int = 0, noise: Array = NOISE) -> Samples:
        """Return samples with noise in their efforts; the base's stands for that of motion."""
        rng = np.random.default_rng(seed)
        effort = self.samples.effort + noise * rng.normal(size=self.samples.effort.shape)
        return replace(self.samples, effort=effort)


@cache
def quadruped() -> RobotModel:
    """Return a quadruped of example-robot-data."""
    return load_robot("solo12", root="free_flyer")


def contact_jacobians(model: Any, data: Any, q: Array, offset: Any) -> Array:
    """Return the Jacobians (4, 3, nv) of the points by which the feet touch the ground."""
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    frames = [model.getFrameId(name) for name in FEET]
    whole = [pin.getFrameJacobian(model, data, each, pin.LOCAL_WORLD_ALIGNED) for each in frames]
    return np.array([J[:3] - pin.skew(np.array(offset)) @ J[3:] for J in whole])


def gait(K: int = 240, seed: int = 0, *, share: float = 0.6) -> Gait:
    """Return random states; every foot is down in a share of the samples."""
    rng = np.random.default_rng(seed)
    robot = quadruped()
    model = robot.pin_model
    data = model.createData()
    down: Mask = rng.random((K, 4)) < share
    q, v, a = np.zeros((K, 19)), rng.normal(size=(K, 18)), 5.0 * rng.normal(size=(K, 18))
    tau, forces = np.zeros((K, 18)), np.zeros((K, 4, 3))
    v[:, :3] = 0.0
    weight = 9.81 * float(robot.prior[:, 0].sum())
    for k in range(K):
        q[k] = pin.integrate(model, pin.neutral(model), 0.4 * rng.normal(size=18))
        q[k, :3] = 0.0
        forces[k] = down[k, :, None] * weight * (np.array([0, 0, 0.4]) + 0.1 * rng.normal(size=3))
        push = np.einsum("fij,fi->j", contact_jacobians(model, data, q[k], RADIUS), forces[k])
        # Nothing drives the base but the feet: its acceleration follows.
        M = pin.crba(model, data, q[k])
        M = np.triu(M) + np.triu(M, 1).T
        a[k, :6] += np.linalg.solve(M[:6, :6], (push - pin.rnea(model, data, q[k], v[k], a[k]))[:6])
        tau[k] = pin.rnea(model, data, q[k], v[k], a[k]) - push
    tau[:, :6] = 0.0
    samples = Samples(
        position=q,
        velocity=v,
        acceleration=a,
        effort=tau,
        block=4,
        contacts=ContactSamples(frames=FEET, kind="point", offset=RADIUS, down=down),
    )
    return Gait(robot, samples, forces, robot.prior.ravel())
