"""Limits of torque and of the tool's speed as functions of a state, for a search.

Each is at least zero where the limit is held, in shares of it, and smooth enough to be
differentiated. What happens between the instants at which a search looks is left to
`sdpid.excitation.limits.check`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.errors import ModelError
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.limits.torque import TorqueModel
from sdpid.robot.model.model import RobotModel


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueWithin:
    """Torques stay within their limits: one function a limited joint, 1 − (torque/limit)².

    The added deviations and the steps of Coulomb friction are counted as constants at a state.

    Attributes
    ----------
    model : TorqueModel
        The torques.
    limits : JointLimits
        Their limits, less the model's reserve.
    """

    model: TorqueModel
    limits: JointLimits
    name: str = field(default="torque", init=False)

    @cached_property
    def _limited(self) -> Indices:
        return np.flatnonzero(np.isfinite(self.limits.torque))

    @cached_property
    def _allowed(self) -> Array:
        return self.model.allowed(self.limits.torque)[self._limited]

    def evaluate(self, q: Array, v: Array, a: Array) -> Array:
        """Return the slacks (K, m) at states (K, n), in shares of the limits squared."""
        size = np.abs(self.model.torque(q, v, a)) + self.model.spread(q, v, a)
        return np.asarray(1.0 - (size[:, self._limited] / self._allowed) ** 2)

    def derivatives(self, q: Array, v: Array, a: Array) -> tuple[Array | None, ...]:
        """Return derivatives (K, m, n) by position, velocity and acceleration."""
        torque, *slopes = self.model.torque_and_derivatives(q, v, a)
        size = np.abs(torque) + self.model.spread(q, v, a)
        scale = -2.0 * (np.sign(torque) * size)[:, self._limited] / self._allowed**2
        return tuple(scale[:, :, None] * slope[:, self._limited] for slope in slopes)


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolSpeedWithin:
    """The speed of the tool stays within its limit: one function a frame, 1 − (speed/limit)².

    Attributes
    ----------
    robot : RobotModel
        The robot.
    speed : float
        The limit, m/s.
    frames : tuple of int
        Indices of the frames whose speed it is, see `tool_frames`.
    """

    robot: RobotModel
    speed: float
    frames: tuple[int, ...]
    name: str = field(default="tool speed", init=False)

    @classmethod
    def of(cls, robot: RobotModel, limits: JointLimits) -> ToolSpeedWithin | None:
        """Build from the limits of a robot; None where the speed is not limited."""
        if limits.tool_speed is None:
            return None
        frames = tool_frames(robot, limits.tool)
        return cls(robot=robot, speed=limits.tool_speed, frames=frames)

    def speeds(self, q: Array, v: Array) -> Array:
        """Return the speeds (K, frames) at states (K, n), m/s."""
        return self._velocities(q, v)[0]

    def evaluate(self, q: Array, v: Array, a: Array) -> Array:
        """Return the slacks (K, frames) at states (K, n), in shares of the limit squared."""
        return np.asarray(1.0 - self.speeds(q, v) ** 2 / self.speed**2)

    def derivatives(self, q: Array, v: Array, a: Array) -> tuple[Array | None, ...]:
        """Return derivatives (K, frames, n) by position and velocity."""
        _, by_position, by_velocity = self._velocities(q, v, derivatives=True)
        scale = -2.0 / self.speed**2
        return scale * by_position, scale * by_velocity, None

    def _velocities(
        self, q: Array, v: Array, *, derivatives: bool = False
    ) -> tuple[Array, Array, Array]:
        """Return speeds (K, frames), and half the derivatives of their squares (K, frames, n)."""
        import pinocchio as pin

        robot, model = self.robot, self.robot.pin_model
        data, E = model.createData(), robot.expansion
        own = pin.ReferenceFrame.LOCAL
        speeds = np.empty((len(q), len(self.frames)))
        slopes = np.zeros((2, len(q), len(self.frames), robot.n))
        zero = np.zeros(model.nv)
        for k, state in enumerate(zip(robot.configuration(q), v @ E.T, strict=True)):
            if derivatives:
                pin.computeForwardKinematicsDerivatives(model, data, *state, zero)
            else:
                pin.forwardKinematics(model, data, *state)
            for c, frame in enumerate(self.frames):
                pin.updateFramePlacement(model, data, frame)
                velocity = pin.getFrameVelocity(model, data, frame, own).linear
                speeds[k, c] = np.linalg.norm(velocity)
                if derivatives:
                    by = pin.getFrameVelocityDerivatives(model, data, frame, own)
                    # With a single joint the binding drops the axis of length one.
                    slopes[:, k, c] = [velocity @ part.reshape(6, -1)[:3] @ E for part in by]
        return speeds, slopes[0], slopes[1]


def tool_frames(robot: RobotModel, tool: str | None = None) -> tuple[int, ...]:
    """Return the indices of the frames whose speed is limited as the tool's.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    tool : str, optional
        One frame of the description; by default, of every last link, the frame that is farthest
        from its joint.

    Raises
    ------
    ModelError
        When the robot has no such frame.
    """
    model, numbers = robot.pin_model, robot.frame_numbers
    if tool is not None:
        if tool not in numbers:
            names = ", ".join(dict.fromkeys(str(frame.name) for frame in model.frames))
            raise ModelError(f"'{robot.name}' has no frame '{tool}' for the tool; it has {names}.")
        return (numbers[tool],)
    lengths = [float(np.linalg.norm(frame.placement.translation)) for frame in model.frames]
    owners = np.array([frame.parentJoint for frame in model.frames])
    last = set(range(1, model.njoints)) - {model.parents[i] for i in range(1, model.njoints)}
    own = (np.flatnonzero(owners == link).tolist() for link in sorted(last))
    return tuple(max(each, key=lambda index: lengths[index]) for each in own)
