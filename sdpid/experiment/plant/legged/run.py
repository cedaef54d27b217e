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

from sdpid._common.arrays import Array, Mask, frozen, frozen_view
from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.experiment.plant.legged.model import LeggedModel, build_legged
from sdpid.experiment.plant.legged.motions import LEAD, LeggedPlan
from sdpid.experiment.plant.legged.truth import DryFriction, TrueMotion
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


def weight_torques(legs: Legs, plan: LeggedPlan, times: Array) -> Array:
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
    plan: LeggedPlan,
    theta: Array,
    *,
    friction: DryFriction,
    rate_hz: float,
    before: int = 0,
) -> tuple[Array, TrueMotion]:
    """Simulate a plan.

    Parameters
    ----------
    legs : Legs
        The robot.
    plan : LeggedPlan
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
    motion : TrueMotion

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
    mass, lever = legs.loads
    stiffness = _STIFFNESS * _GRAVITY * mass * lever
    damping = _DAMPING * stiffness
    coarse: Array = times[::_COMMAND_STRIDE]
    weight = weight_torques(legs, plan, coarse) if plan.effort is None else plan.effort(coarse)
    weight = np.stack([np.interp(times, coarse, each) for each in weight.T], axis=1)
    command = stiffness * desired + damping * speeds + weight
    start = np.hstack([each[0] for each in plan.base(np.zeros(1))])
    built = build_legged(legs, theta, held=plan.held, timestep=step, start=start)
    coulomb, viscous, _ = theta[10 * legs.robot.n_links :].reshape(3, -1)
    model, data, dof = built.model, mujoco.MjData(built.model), built.dof
    data.qpos[built.qpos] = desired[0]

    def evaluate(told: Array) -> Array:
        """Solve for the acceleration, and return torques of motors and friction, (2, joints)."""
        speed = data.qvel[dof]
        torque = told - stiffness * data.qpos[built.qpos] - damping * speed
        rubbing = coulomb * friction(speed) + viscous * speed
        data.qfrc_applied[dof] = torque - rubbing
        mujoco.mj_forward(model, data)
        data.qacc_warmstart[:] = data.qacc
        return np.stack([torque, rubbing])

    def advance(told: Array, following: Array) -> None:
        """Go on by a step, from a state that is evaluated."""
        position, rate = data.qpos.copy(), data.qvel.copy()
        v, a = rate, data.qacc.copy()
        mean_v, mean_a = _WEIGHTS[0] * v, _WEIGHTS[0] * a
        for share, reach in zip(_WEIGHTS[1:], _STAGES[1:], strict=True):
            data.qpos[:] = position
            mujoco.mj_integratePos(model, data.qpos, v, reach * step)
            data.qvel[:] = rate + reach * step * a
            evaluate((1.0 - reach) * told + reach * following)
            v, a = data.qvel.copy(), data.qacc.copy()
            mean_v, mean_a = mean_v + share * v, mean_a + share * a
        data.qpos[:] = position
        mujoco.mj_integratePos(model, data.qpos, mean_v, step)
        data.qvel[:] = rate + step * mean_a

    samples, n, feet = total - first, legs.n_joints, max(len(built.feet), 1)
    states = [np.empty((samples, size)) for size in (7 + n, 6 + n, 6 + n)]
    torques = np.empty((samples, 2, n))
    wrenches, down = np.zeros((samples, feet, 6)), np.zeros((samples, feet), bool)
    for k in range(total):
        applied = evaluate(command[k])
        if k >= first:
            torques[k - first] = applied
            for noted, values in zip(states, (data.qpos, data.qvel, data.qacc), strict=True):
                noted[k - first] = values
            _note_wrenches(mujoco, built, data, wrenches[k - first], down[k - first])
        advance(command[k], command[k + 1])
        if k % 100 == 0 and not 1.0 - 2.0 * (data.qpos[4] ** 2 + data.qpos[5] ** 2) > _FALLEN:
            raise DataError(
                f"legged plant of '{legs.robot.name}': the robot falls at {times[k] - LEAD:.2f} s "
                "of the motion; change its parameters less, or take another motion."
            )
    rows = np.concatenate([np.arange(6), dof])
    position = states[0][:, np.concatenate([np.arange(7), built.qpos])]
    rates = states[1][:, rows], states[2][:, rows]
    motion = _in_pinocchio(position, *rates, torques, wrenches, down)
    return np.asarray(times[first:total] - LEAD), motion


def _note_wrenches(mujoco: Any, built: LeggedModel, data: Any, wrenches: Array, down: Mask) -> None:
    """Write forces and torques (c, 6) in world axes, and which contacts are closed."""
    if not built.feet:
        # What holds the base is all that acts on it: force in world axes, torque in its own.
        wrenches[0, :3] = data.qfrc_constraint[:3]
        wrenches[0, 3:] = data.xmat[1].reshape(3, 3) @ data.qfrc_constraint[3:6]
        down[0] = True
    local = np.empty(6)
    for number in range(data.ncon if built.feet else 0):
        contact = data.contact[number]
        if contact.efc_address < 0:
            continue
        foot = built.feet.index(int(contact.geom[1]))
        mujoco.mj_contactForce(built.model, data, number, local)
        # MuJoCo's force acts on the second geometry, here the foot.
        force = contact.frame.reshape(3, 3).T @ local[:3]
        wrenches[foot, :3] += force
        wrenches[foot, 3:] += np.cross(contact.pos - data.site_xpos[built.sites[foot]], force)
        down[foot] = True


def _in_pinocchio(
    position: Array,
    velocity: Array,
    acceleration: Array,
    torques: Array,
    wrenches: Array,
    down: Mask,
) -> TrueMotion:
    """Return MuJoCo's states in Pinocchio's order and axes."""
    from scipy.spatial.transform import Rotation

    position[:, 3:7] = np.roll(position[:, 3:7], -1, axis=1)
    inverse = Rotation.from_quat(position[:, 3:7]).inv()
    velocity[:, :3] = inverse.apply(velocity[:, :3])
    # The derivative of body-axis components, which Pinocchio calls the acceleration.
    turning = np.cross(velocity[:, 3:6], velocity[:, :3])
    acceleration[:, :3] = inverse.apply(acceleration[:, :3]) - turning
    return TrueMotion(
        position=frozen(position),
        velocity=frozen(velocity),
        acceleration=frozen(acceleration),
        effort=frozen(np.pad(torques[:, 0], ((0, 0), (6, 0)))),
        friction=frozen(torques[:, 1]),
        wrenches=frozen(wrenches),
        down=frozen_view(down),
    )
