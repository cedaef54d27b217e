"""Run a planned motion in MuJoCo and note everything that is true at every sample.

Motors are continuous: proportional and derivative feedback of the state itself, plus a command
that is interpolated between samples. Friction is a smooth function of speed: MuJoCo's own dry
friction has the wrong sign for some milliseconds where a foot's impact stops a joint. Both are
forces at the stages of the fourth-order Runge-Kutta method, which adds neither inertia nor
damping. The first stage of a step is the sample itself, so that what is noted there obeys the
equation of motion to the solver's tolerance.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen, frozen_view
from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.experiment.plant.legged.friction import DryFriction
from sdpid.experiment.plant.legged.model import LeggedModel, build_legged
from sdpid.experiment.plant.legged.motions import LEAD, Plan
from sdpid.experiment.plant.legged.truth import Motion
from sdpid.robot.legs.legs import Legs

# Stiffness of the motors' feedback over the torque that a joint bears at its lever, 1/rad, and
# damping over stiffness, s: the joints follow within hundredths of a radian.
_STIFFNESS, _DAMPING = 12.0, 0.06
_GRAVITY = 9.81
# A base that turns over this far has fallen: cosine of the angle to the vertical.
_FALLEN = 0.5
# The classical Runge-Kutta method: where its stages are in a step, and what they weigh.
_STAGES, _WEIGHTS = (0.0, 0.5, 0.5, 1.0), (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)
# The command is solved for at every so many samples, and interpolated.
_COMMAND_STRIDE = 5


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


def run_plan(
    legs: Legs,
    plan: Plan,
    theta: Array,
    *,
    friction: DryFriction,
    rate_hz: float,
    before: int = 0,
) -> tuple[Array, Motion]:
    """Simulate a plan.

    Parameters
    ----------
    legs : Legs
        The robot.
    plan : Plan
        What it shall do.
    theta : ndarray, shape (10·links + 3·joints,)
        True parameters.
    friction : DryFriction
        The law of dry friction.
    rate_hz : float
        Samples a second; the integrator's steps are as long.
    before : int, optional
        Samples of the lead to keep, in front of the motion.

    Returns
    -------
    time : ndarray, shape (N,)
        In s from the start of the motion; negative in the lead.
    motion : Motion

    Raises
    ------
    DataError
        When the robot falls.
    """
    mujoco = require("mujoco", extra="sim")
    step = 1.0 / rate_hz
    first = round(LEAD * rate_hz) - before
    total = round((LEAD + plan.duration) * rate_hz)
    times = np.asarray(np.arange(total + 1) * step, np.float64)
    desired, speeds = plan.joints(times)
    gains = _gains(legs)
    coarse: Array = times[::_COMMAND_STRIDE]
    weight = weight_torques(legs, plan, coarse) if plan.effort is None else plan.effort(coarse)
    weight = np.stack([np.interp(times, coarse, each) for each in weight.T], axis=1)
    command = gains[0] * desired + gains[1] * speeds + weight
    position, turn = plan.base(np.zeros(1))
    built = build_legged(
        legs, theta, held=plan.held, timestep=step, start=np.hstack([position[0], turn[0]])
    )
    rubbing = friction, theta[10 * legs.robot.n_links :].reshape(3, -1)
    stepper = _Stepper(mujoco, built, rubbing, gains, desired[0])
    data = stepper.data
    notes = _Notes(mujoco, legs, built, total - first)
    for k in range(total):
        torques = stepper.evaluate(command[k])
        if k >= first:
            notes.take(data, torques, k - first)
        stepper.advance(command[k], command[k + 1], step)
        if k % 100 == 0 and not 1.0 - 2.0 * (data.qpos[4] ** 2 + data.qpos[5] ** 2) > _FALLEN:
            raise DataError(
                f"legged plant of '{legs.robot.name}': the robot falls at {times[k] - LEAD:.2f} s "
                "of the motion; change its parameters less, or take another motion."
            )
    return np.asarray(times[first:total] - LEAD), notes.motion()


def _gains(legs: Legs) -> tuple[Array, Array]:
    """Return stiffness and damping of the motors' feedback."""
    mass, lever = legs.loads
    stiffness = _STIFFNESS * _GRAVITY * mass * lever
    return stiffness, _DAMPING * stiffness


class _Stepper:
    """A state of the plant, its derivative under a command, and the way to the next sample."""

    def __init__(
        self,
        mujoco: Any,
        built: LeggedModel,
        friction: tuple[DryFriction, Array],
        gains: tuple[Array, Array],
        joints: Array,
    ) -> None:
        self._mujoco, self._built, self._gains = mujoco, built, gains
        self._law, (self._coulomb, self._viscous, _) = friction
        self.data = mujoco.MjData(built.model)
        self.data.qpos[built.qpos] = joints

    def evaluate(self, command: Array) -> Array:
        """Solve for the acceleration, and return torques of motors and friction, (2, joints)."""
        data, built = self.data, self._built
        speed = data.qvel[built.dof]
        torque = command - self._gains[0] * data.qpos[built.qpos] - self._gains[1] * speed
        friction = self._coulomb * self._law(speed) + self._viscous * speed
        data.qfrc_applied[built.dof] = torque - friction
        self._mujoco.mj_forward(built.model, data)
        data.qacc_warmstart[:] = data.qacc
        return np.stack([torque, friction])

    def advance(self, command: Array, following: Array, step: float) -> None:
        """Go on by a step, from a state that is evaluated."""
        data, model = self.data, self._built.model
        start, rate = data.qpos.copy(), data.qvel.copy()
        v, a = rate, data.qacc.copy()
        mean_v, mean_a = _WEIGHTS[0] * v, _WEIGHTS[0] * a
        for weight, reach in zip(_WEIGHTS[1:], _STAGES[1:], strict=True):
            data.qpos[:] = start
            self._mujoco.mj_integratePos(model, data.qpos, v, reach * step)
            data.qvel[:] = rate + reach * step * a
            self.evaluate((1.0 - reach) * command + reach * following)
            v, a = data.qvel.copy(), data.qacc.copy()
            mean_v, mean_a = mean_v + weight * v, mean_a + weight * a
        data.qpos[:] = start
        self._mujoco.mj_integratePos(model, data.qpos, mean_v, step)
        data.qvel[:] = rate + step * mean_a


class _Notes:
    """What is true at every sample, in MuJoCo's axes, turned into Pinocchio's at the end."""

    def __init__(self, mujoco: Any, legs: Legs, built: LeggedModel, samples: int) -> None:
        n, feet = legs.n_joints, max(len(built.feet), 1)
        self._mujoco, self._legs, self._built = mujoco, legs, built
        self.qpos, self.qvel = np.empty((samples, 7 + n)), np.empty((samples, 6 + n))
        self.qacc = np.empty((samples, 6 + n))
        self.effort, self.friction = np.empty((samples, n)), np.empty((samples, n))
        self.wrenches, self.down = np.zeros((samples, feet, 6)), np.zeros((samples, feet), bool)
        self._foot = {number: i for i, number in enumerate(built.feet)}
        self._force = np.empty(6)

    def take(self, data: Any, torques: Array, k: int) -> None:
        """Note a sample, after MuJoCo's forward dynamics at its state."""
        built = self._built
        self.qpos[k, :7], self.qpos[k, 7:] = data.qpos[:7], data.qpos[built.qpos]
        for noted, values in ((self.qvel, data.qvel), (self.qacc, data.qacc)):
            noted[k, :6], noted[k, 6:] = values[:6], values[built.dof]
        self.effort[k], self.friction[k] = torques
        if not built.feet:
            # What holds the base is all that acts on it: force in world axes, torque in its own.
            self.wrenches[k, 0, :3] = data.qfrc_constraint[:3]
            self.wrenches[k, 0, 3:] = data.xmat[1].reshape(3, 3) @ data.qfrc_constraint[3:6]
            self.down[k] = True
            return
        for number in range(data.ncon):
            contact = data.contact[number]
            if contact.efc_address < 0:
                continue
            foot = self._foot[int(contact.geom[1])]
            self._mujoco.mj_contactForce(built.model, data, number, self._force)
            force = contact.frame.reshape(3, 3).T @ self._force[:3]
            arm = contact.pos - data.site_xpos[built.sites[foot]]
            # MuJoCo's force acts on the second geometry, here the foot.
            self.wrenches[k, foot, :3] += force
            self.wrenches[k, foot, 3:] += np.cross(arm, force)
            self.down[k, foot] = True

    def motion(self) -> Motion:
        """Return all samples in Pinocchio's order and axes."""
        from scipy.spatial.transform import Rotation

        position, velocity, acceleration = self.qpos.copy(), self.qvel.copy(), self.qacc.copy()
        position[:, 3:7] = np.roll(self.qpos[:, 3:7], -1, axis=1)
        inverse = Rotation.from_quat(position[:, 3:7]).inv()
        turning = self.qvel[:, 3:6]
        velocity[:, :3] = inverse.apply(self.qvel[:, :3])
        # The derivative of body-axis components, which Pinocchio calls the acceleration.
        acceleration[:, :3] = inverse.apply(self.qacc[:, :3]) - np.cross(turning, velocity[:, :3])
        effort = np.hstack([np.zeros((len(position), 6)), self.effort])
        return Motion(
            position=frozen(position),
            velocity=frozen(velocity),
            acceleration=frozen(acceleration),
            effort=frozen(effort),
            friction=frozen(self.friction),
            wrenches=frozen(self.wrenches),
            down=frozen_view(self.down),
        )
