"""A MuJoCo model of a `RobotModel`: the same bodies and joints, another library's physics.

MuJoCo's defaults are made for interactive simulation. What a plant for identification needs
instead, and is set here:

* Dry friction is a soft constraint, whose force at small speeds may be several N·m off. With an
  impedance next to 1 and the shortest time constant that the step allows it is Coulomb friction:
  it saturates from speeds of less than 1e-3 rad/s on.
* Euler's method with MuJoCo's implicit damping adds step·(velocity gain + Fv) to the apparent
  inertia; the explicit one takes the velocity half a step late, which takes step·Fv/2 off. The
  fourth-order Runge-Kutta method is explicit and has neither bias.
* A set-point that is held for a step makes torque fall within each step, as the joint moves
  towards it, so that sampled torque is above the one that acted on average, in proportion to
  speed: a false viscous friction of velocity_gain·proportional_gain·step/2. The drives therefore
  interpolate their set-points linearly, as an actuator with integrator dynamics does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.errors import ModelError
from sdpid.experiment.plant.drives import Drives
from sdpid.robot.inertia import margin, physical_parameters
from sdpid.robot.model.contacts.open_chain import require_fixed_robot, require_open_chain
from sdpid.robot.model.model import RobotModel

# Impedance of the friction constraint: MuJoCo's upper limit is 0.9999 (mjMAXIMP). The residual
# softness is 1e-4 of the joint's own inverse inertia.
_IMPEDANCE = 0.9999
# MuJoCo keeps constraint time constants at two steps or more (refsafe).
_TIME_CONSTANT_STEPS = 2.0
# Newton's method for the friction: it ends after two or three iterations in fact.
_ITERATIONS, _TOLERANCE = 100, 1e-12
# Without AUTORESET an unstable plant is seen, not silently set back to its start.
_DISABLED = ("CONTACT", "LIMIT", "EQUALITY", "ISLAND", "EULERDAMP", "AUTORESET")


@dataclass(frozen=True, eq=False)
class MujocoModel:
    """A compiled model with the addresses of the robot's joints in it.

    Attributes
    ----------
    model : mujoco.MjModel
        Actuator and sensor j belong to joint j of the robot; sensors are positions, velocities
        and actuator torques of all joints, in this order.
    dof, qpos : ndarray of int, shape (n,)
        Addresses of the robot's joints in MuJoCo's velocities and positions, whose order is
        depth first.
    """

    model: Any
    dof: Any
    qpos: Any


def build_mujoco(
    robot: RobotModel, theta: Array, drives: Drives, *, timestep: float
) -> MujocoModel:
    """Build the plant of a robot.

    Parameters
    ----------
    robot : RobotModel
        Kinematics, on a fixed base and without mimic joints.
    theta : ndarray, shape (10·links + 2n,)
        Standard parameters of the links, then Coulomb and viscous friction of all joints.
    drives : Drives
        Gains of the controller.
    timestep : float
        Integrator step in s.

    Returns
    -------
    MujocoModel

    Raises
    ------
    ModelError
        When a joint has more than one variable, the base floats, joints mimic others, or the
        links are not physically consistent.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).
    """
    mujoco = require("mujoco", extra="sim")
    n = robot.n
    require_fixed_robot(robot, "plant", instead="On its legs, sdpid.simulate_legged simulates it.")
    if robot.expansion.shape != (n, n):
        raise ModelError(f"plant of '{robot.name}': mimic joints are not supported.")
    require_open_chain(robot, "plant")
    bodies = theta[: 10 * robot.n_links].reshape(robot.n_links, 10)
    coulomb, viscous = theta[10 * robot.n_links :].reshape(2, n)
    check_bodies(robot, bodies)
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.balanceinertia = False
    set_options(mujoco, spec, robot, timestep)
    add_bodies(mujoco, spec, robot, bodies)
    for j, name in enumerate(robot.joint_names):
        gain = float(drives.velocity_gain[j])
        stiffness = gain * float(drives.proportional_gain[j])
        actuator = spec.add_actuator(name=name, target=name)
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        actuator.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
        actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        # torque = gain·(Kp·(q_d − q) − v), with q_d the integrated command.
        actuator.gainprm[0] = stiffness
        actuator.biasprm[1], actuator.biasprm[2] = -stiffness, -gain
    kinds = mujoco.mjtSensor
    for kind in (kinds.mjSENS_JOINTPOS, kinds.mjSENS_JOINTVEL, kinds.mjSENS_JOINTACTFRC):
        for name in robot.joint_names:
            spec.add_sensor(
                name=f"{kind.name}_{name}",
                type=kind,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=name,
            )
    try:
        model = spec.compile()
    except ValueError as cause:
        raise ModelError(f"plant of '{robot.name}': MuJoCo refuses it ({cause}).") from None
    dof = np.array([model.joint(name).dofadr[0] for name in robot.joint_names])
    qpos = np.array([model.joint(name).qposadr[0] for name in robot.joint_names])
    model.dof_frictionloss[dof] = coulomb
    model.dof_damping[dof] = viscous
    model.dof_solref[:] = _TIME_CONSTANT_STEPS * timestep, 1.0
    model.dof_solimp[:, :2] = _IMPEDANCE
    return MujocoModel(model, dof, qpos)


def check_bodies(robot: RobotModel, bodies: Array) -> None:
    """Refuse links that no body has.

    Raises
    ------
    ModelError
        When one is not physically consistent.
    """
    margins = margin(bodies, "pseudo_inertia")
    for name, body, value in zip(robot.link_names, bodies, margins, strict=True):
        # Not a number where the mass is not positive.
        if not value >= 0.0:
            raise ModelError(
                f"plant of '{robot.name}': no body has the parameters given for {name}: mass "
                f"{body[0]:.3g} kg, smallest second moment about the center of mass {value:.3g} "
                "kg·m² (limits 0); a plant needs physically consistent links."
            )


def set_options(mujoco: Any, spec: Any, robot: RobotModel, timestep: float) -> None:
    """Set the integrator, the solver and what is switched off."""
    option = spec.option
    option.timestep = timestep
    option.gravity = robot.gravity
    option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.iterations, option.tolerance = _ITERATIONS, _TOLERANCE
    for name in _DISABLED:
        flag = getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}", None)
        # Older releases have no switch for islands: they are off unless asked for.
        option.disableflags |= 0 if flag is None else flag.value


def add_bodies(mujoco: Any, spec: Any, robot: RobotModel, bodies: Array) -> dict[int, Any]:
    """Add the links and their joints, and return the bodies by Pinocchio's numbers."""
    model = robot.pin_model
    masses, centers, inertias = physical_parameters(bodies)
    nodes = {0: spec.worldbody}
    for i in range(1, model.njoints):
        name = model.names[i]
        placement = model.jointPlacements[i]
        body = nodes[model.parents[i]].add_body(
            name=f"{i}:{robot.link_names[i - 1]}",
            pos=placement.translation,
            quat=_quaternion(mujoco, placement.rotation),
        )
        # Principal moments by our own decomposition: that of older MuJoCo stops at 1e-7.
        moments, axes = np.linalg.eigh(inertias[i - 1])
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        body.mass = float(masses[i - 1])
        body.ipos = centers[i - 1]
        body.inertia = moments
        body.iquat = _quaternion(mujoco, axes)
        body.explicitinertial = True
        nodes[i] = body
        if i == 1 and robot.free_flyer:
            body.add_freejoint(name=name)
            continue
        kind, axis = joint_axis(model.joints[i])
        joint_type = getattr(
            mujoco.mjtJoint, "mjJNT_HINGE" if kind == "revolute" else "mjJNT_SLIDE"
        )
        body.add_joint(name=name, type=joint_type, axis=axis)
    return nodes


def _quaternion(mujoco: Any, rotation: Array) -> Array:
    """Return a rotation matrix as MuJoCo's quaternion, scalar first."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    return quaternion


def joint_axis(joint: Any) -> tuple[str, Array]:
    """Return the kind of a Pinocchio joint and its axis in the joint's frame.

    Raises
    ------
    ModelError
        When it is not a joint about or along one axis.
    """
    if joint.nv == 1:
        data = joint.createData()
        neutral = np.array([1.0, 0.0]) if joint.nq == 2 else np.zeros(1)
        joint.calc(data, neutral)
        twist = np.asarray(data.S).reshape(6)
        if not twist[:3].any():
            return "revolute", twist[3:]
        if not twist[3:].any():
            return "prismatic", twist[:3]
    raise ModelError(
        f"plant: a joint of kind {joint.shortname()} is not supported; use revolute, continuous "
        "or prismatic joints."
    )
