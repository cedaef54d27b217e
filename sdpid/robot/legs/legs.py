"""The legs of a robot: its feet, the joints that carry them, and joints that reach."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen
from sdpid.errors import DataError
from sdpid.robot.model.geometry import link_placements
from sdpid.robot.model.jacobians import frame_axes, frame_places
from sdpid.robot.model.model import RobotModel

# Inverse kinematics ends at this distance in m; Newton's method is there after a few steps.
_REACHED, _STEPS = 1e-9, 50
# Damping of the inverse kinematics in m: a stretched leg is not thrown about.
_DAMPING = 1e-4


@dataclass(frozen=True, eq=False)
class Legs:
    """The legs of a robot: of three joints and a ball for a foot, or of six and a flat sole.

    Attributes
    ----------
    robot : RobotModel
        The robot, on a floating base.
    frames : tuple of str
        The frame at the center of each foot's ball, or in the plane of each sole.
    joints : ndarray of int, shape (c, 3) or (c, 6)
        The joints of each leg, counted from 0 after the base.
    radius : float
        Radius of the balls, m; 0 of soles.
    standing : ndarray, shape (joints,)
        Joint positions in which the robot stands, rad.
    sole : ndarray, shape (2, 2), or None
        The lower and the upper corner of all soles in their frames' x and y, m; None for balls.
    """

    robot: RobotModel
    frames: tuple[str, ...]
    joints: Indices
    radius: float
    standing: Array
    sole: Array | None = None

    @property
    def flat(self) -> bool:
        """Whether the feet are soles."""
        return self.sole is not None

    @functools.cached_property
    def free(self) -> Indices:
        """The joints beside the legs, counted from 0 after the base."""
        return np.setdiff1d(np.arange(self.n_joints), self.joints)

    @functools.cached_property
    def loads(self) -> tuple[Array, Array]:
        """What each joint bears: a mass, kg, and its lever, m, two arrays (joints,).

        A leg bears its share of the robot at its length; other joints what they move, at the
        distance of the farthest center of mass.
        """
        model, mass = self.robot.pin_model, self.robot.prior[:, 0]
        masses = np.full(self.n_joints, mass.sum() / len(self.frames))
        levers = np.full(self.n_joints, self.height)
        placed = link_placements(self.robot, self.robot.at_rest(self.standing[None])[0])
        centers = [
            place[:3, :3] @ body.lever + place[:3, 3]
            for place, body in zip(placed, list(model.inertias)[1:], strict=True)
        ]
        for joint in self.free:
            own = next(i for i in range(2, model.njoints) if model.joints[i].idx_v == joint + 6)
            moved, axis = np.array(model.subtrees[own]) - 1, placed[own - 1, :3, 3]
            masses[joint] = mass[moved].sum()
            levers[joint] = np.linalg.norm(np.array(centers)[moved] - axis, axis=1).max()
        return frozen(masses), frozen(levers)

    @property
    def n_joints(self) -> int:
        """Number of joints without the base."""
        return self.robot.n - self.robot.n_base

    @functools.cached_property
    def height(self) -> float:
        """Height of the base above the feet's centers when the robot stands, m."""
        return float(-self.feet(self.standing[None])[0, :, 2].mean())

    def centers_of_mass(self, joints: Array) -> Array:
        """Return the description's center of mass in the base frame, (K, 3), for (K, joints)."""
        import pinocchio as pin

        data = self.robot.pin_model.createData()
        found = (
            pin.centerOfMass(self.robot.pin_model, data, q).copy()
            for q in self.robot.at_rest(joints)
        )
        return np.stack([*found])

    @functools.cached_property
    def center_of_mass(self) -> Array:
        """The center of mass when the robot stands, m, (3,)."""
        return frozen(self.centers_of_mass(self.standing[None])[0])

    def axes(self) -> Array:
        """Return the axes of the feet's frames as columns when the robot stands, (c, 3, 3)."""
        q = self.robot.at_rest(self.standing[None])
        return np.asarray(frame_axes(self.robot, q, self.frames)[0])

    @property
    def frame_ids(self) -> list[int]:
        """Pinocchio's numbers of the feet's frames."""
        return [self.robot.pin_model.getFrameId(name) for name in self.frames]

    def feet(self, joints: Array) -> Array:
        """Return the feet's centers in the base frame, shape (K, c, 3), for (K, joints)."""
        return frame_places(self.robot, self.robot.at_rest(joints), self.frames)

    def reach(self, targets: Array, turned: Array | None = None) -> Array:
        """Return the joints that put the feet where they are wanted.

        Parameters
        ----------
        targets : ndarray, shape (K, c, 3)
            Centers of the feet in the base frame, m; a motion, so that each is near the last.
        turned : ndarray, shape (K, 3, 3), optional
            The world's axes in the base frame, in which soles are level.

        Returns
        -------
        ndarray, shape (K, joints)

        Raises
        ------
        DataError
            When a foot cannot be reached.
        """
        import pinocchio as pin

        model = self.robot.pin_model
        data = model.createData()
        q = self.robot.at_rest(self.standing[None])[0]
        out = np.empty((len(targets), self.n_joints))
        for k, wanted in enumerate(targets):
            for _ in range(_STEPS):
                pin.computeJointJacobians(model, data, q)
                worst = 0.0
                for i, frame in enumerate(self.frame_ids):
                    foot = pin.updateFramePlacement(model, data, frame)
                    error = wanted[i] - foot.translation
                    if self.flat and turned is not None:
                        error = np.concatenate([error, pin.log3(turned[k] @ foot.rotation.T)])
                    worst = max(worst, float(np.abs(error).max()))
                    J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
                    J = J[: len(error), 6 + self.joints[i]]
                    q[7 + self.joints[i]] += J.T @ np.linalg.solve(
                        J @ J.T + _DAMPING**2 * np.eye(len(error)), error
                    )
                if worst < _REACHED:
                    break
            else:
                raise DataError(
                    f"legs of '{self.robot.name}': a foot misses its place by "
                    f"{worst:.2g} m at instant {k} of the motion (limit {_REACHED:g}); take a "
                    "smaller motion."
                )
            out[k] = q[7:]
        return out
