"""The legs of a floating robot: its feet, the joints that carry them, and joints that reach."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Indices, frozen
from sdpid.errors import DataError, ModelError
from sdpid.experiment.plant.legged.feet import foot_radius
from sdpid.robot.model.model import RobotModel

__all__ = ["Legs", "find_legs"]

# Names of frames at which legs end, in any spelling.
_FOOT = "foot"
# What every leg of three joints is bent to (abduction, hip, knee), in rad: knees backward, as
# quadrupeds stand.
_BENT = (0.0, 0.8, -1.6)
# Inverse kinematics ends at this distance in m; Newton's method is there after a few steps.
_REACHED, _STEPS = 1e-9, 50
# Damping of the inverse kinematics in m: a stretched leg is not thrown about.
_DAMPING = 1e-4


@dataclass(frozen=True, eq=False)
class Legs:
    """The legs of a robot, each of three joints and a ball for a foot.

    Attributes
    ----------
    robot : RobotModel
        The robot, on a floating base.
    frames : tuple of str
        The frame at the center of each foot's ball.
    joints : ndarray of int, shape (c, 3)
        The joints of each leg, counted from 0 after the base.
    radius : float
        Radius of the balls, m.
    standing : ndarray, shape (joints,)
        Joint positions in which the robot stands, rad.
    """

    robot: RobotModel
    frames: tuple[str, ...]
    joints: Indices
    radius: float
    standing: Array

    @property
    def n_joints(self) -> int:
        """Number of joints without the base."""
        return self.robot.n - self.robot.n_base

    @functools.cached_property
    def height(self) -> float:
        """Height of the base above the feet's centers when the robot stands, m."""
        return float(-self.feet(self.standing[None])[0, :, 2].mean())

    @functools.cached_property
    def center_of_mass(self) -> Array:
        """The description's center of mass in the base frame when the robot stands, m, (3,)."""
        import pinocchio as pin

        model = self.robot.pin_model
        q = pin.neutral(model)
        q[7:] = self.standing
        return frozen(pin.centerOfMass(model, model.createData(), q))

    @property
    def frame_ids(self) -> list[int]:
        """Pinocchio's numbers of the feet's frames."""
        return [self.robot.pin_model.getFrameId(name) for name in self.frames]

    def feet(self, joints: Array) -> Array:
        """Return the feet's centers in the base frame, shape (K, c, 3), for (K, joints)."""
        import pinocchio as pin

        model = self.robot.pin_model
        data = model.createData()
        out = np.empty((len(joints), len(self.frames), 3))
        q = pin.neutral(model)
        for k, row in enumerate(joints):
            q[7:] = row
            pin.forwardKinematics(model, data, q)
            for i, frame in enumerate(self.frame_ids):
                out[k, i] = pin.updateFramePlacement(model, data, frame).translation
        return out

    def reach(self, targets: Array) -> Array:
        """Return the joints that put the feet where they are wanted.

        Parameters
        ----------
        targets : ndarray, shape (K, c, 3)
            Centers of the feet in the base frame, m; a motion, so that each is near the last.

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
        q = pin.neutral(model)
        q[7:] = self.standing
        out = np.empty((len(targets), self.n_joints))
        for k, wanted in enumerate(targets):
            for _ in range(_STEPS):
                pin.computeJointJacobians(model, data, q)
                worst = 0.0
                for i, frame in enumerate(self.frame_ids):
                    error = wanted[i] - pin.updateFramePlacement(model, data, frame).translation
                    worst = max(worst, float(np.abs(error).max()))
                    J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
                    J = J[:3, 6 + self.joints[i]]
                    q[7 + self.joints[i]] += J.T @ np.linalg.solve(
                        J @ J.T + _DAMPING**2 * np.eye(3), error
                    )
                if worst < _REACHED:
                    break
            else:
                raise DataError(
                    f"legged plant of '{self.robot.name}': a foot misses its place by "
                    f"{worst:.2g} m at instant {k} of the motion (limit {_REACHED:g}); take a "
                    "smaller motion."
                )
            out[k] = q[7:]
        return out


def find_legs(
    robot: RobotModel,
    *,
    feet: Sequence[str] | None = None,
    radius: float | None = None,
    standing: ArrayLike | None = None,
) -> Legs:
    """Find the legs of a robot.

    Parameters
    ----------
    robot : RobotModel
        A robot on a floating base, ``load_robot(..., root="free_flyer")``.
    feet : sequence of str, optional
        Frames at the centers of the feet; by default the links with 'foot' in their names.
    radius : float, optional
        Radius of the feet, m; by default that of their collision geometry.
    standing : array_like, shape (joints,), optional
        Joint positions in which the robot stands, rad; by default every leg's knee bent backward.

    Returns
    -------
    Legs

    Raises
    ------
    ModelError
        When the base is fixed, there are no such frames, or a leg has not three joints.

    Examples
    --------
    >>> from sdpid.experiment.plant.legged.legs import find_legs
    >>> legs = find_legs(sdpid.load_robot("solo12", root="free_flyer"))
    >>> legs.frames, round(legs.height, 3), round(legs.radius, 3)
    (('FL_FOOT', 'FR_FOOT', 'HL_FOOT', 'HR_FOOT'), 0.223, 0.016)
    """
    model = robot.pin_model
    if not robot.free_flyer:
        raise ModelError(
            f"legged plant: '{robot.name}' is on a fixed base; load it with "
            'load_robot(..., root="free_flyer").'
        )
    if feet is None:
        # Bodies, not the joints before them: those have frames of the same place.
        kinds = [str(frame.type) for frame in model.frames]
        feet = [
            frame.name
            for frame, kind in zip(model.frames, kinds, strict=True)
            if _FOOT in frame.name.lower() and kind == "BODY"
        ]
    if not feet:
        raise ModelError(
            f"legged plant: '{robot.name}' has no link with '{_FOOT}' in its name; give feet=."
        )
    chains = []
    for name in feet:
        if not model.existFrame(name):
            raise ModelError(f"legged plant: '{robot.name}' has no frame '{name}'; see feet=.")
        chain, joint = [], model.frames[model.getFrameId(name)].parentJoint
        while joint > 1:
            chain.append(model.joints[joint].idx_v - 6)
            joint = model.parents[joint]
        if len(chain) != len(_BENT):
            raise ModelError(
                f"legged plant of '{robot.name}': {len(chain)} joints lead to '{name}'; legs of "
                f"{len(_BENT)} joints are supported."
            )
        chains.append(chain[::-1])
    angles = np.zeros(robot.n - 6)
    angles[np.array(chains)] = _BENT
    if standing is not None:
        angles = np.asarray(standing, dtype=np.float64)
        if angles.shape != (robot.n - 6,):
            raise DataError(
                f"standing: shape {angles.shape}, expected {(robot.n - 6,)}: one angle a joint."
            )
    radius = foot_radius(robot, tuple(feet), angles) if radius is None else radius
    return Legs(robot, tuple(feet), np.array(chains), radius, frozen(angles))
