"""A robot on legs in MuJoCo: its bodies, the ground, balls or soles for feet, and how it moves.

Motors are continuous: proportional and derivative feedback of the state itself, plus a command
that is interpolated between samples. Friction is a smooth function of speed: MuJoCo's own dry
friction has the wrong sign for some milliseconds where a foot's impact stops a joint. Both are
forces at the stages of the fourth-order Runge-Kutta method, which adds neither inertia nor
damping. The first stage of a step is the sample itself, so that what is noted there obeys the
equation of motion to the solver's tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid._common.extras import require
from sdpid.errors import DataError, ModelError
from sdpid.experiment.plant.legged.motions import LEAD, LeggedPlan
from sdpid.experiment.plant.legged.truth import DryFriction, TrueMotion
from sdpid.experiment.plant.simulate import check_bodies
from sdpid.robot.inertia import physical_parameters
from sdpid.robot.legs import Legs
from sdpid.robot.model.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.regressor_kernel import PRISMATIC

# Time constant of the ground in s: stiff against the gait, and soft against the step.
_GROUND = 0.01
# Impedance of what holds a base in the air: a humanoid that swings its legs moves it by 2 mm, and
# by 50 mm with MuJoCo's default of 0.9.
_HOLD = (0.999, 0.999)
# Coefficient of friction of the ground, and how much stiffer it is along the ground than MuJoCo's
# default, so that feet do not creep.
_GRIP, _IMPEDANCE_RATIO = 1.0, 10.0
# Half the thickness of soles, m.
_SOLE = 0.01
# Newton's method ends below this: the equation of motion then holds to 1e-8 N.
_ITERATIONS, _TOLERANCE = 100, 1e-20
# Without AUTORESET an unstable plant is seen, not silently set back to its start.
_DISABLED = ("LIMIT", "ISLAND", "EULERDAMP", "AUTORESET")
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


@dataclass(frozen=True, eq=False)
class LeggedModel:
    """A compiled model with the addresses of the robot's joints in it.

    Attributes
    ----------
    model : mujoco.MjModel
        Bodies, rotor inertias, ground and feet; torques of motors and friction are applied forces.
    dof, qpos : ndarray of int, shape (joints,)
        Addresses of the joints in MuJoCo's velocities and positions; the base is first in both.
    feet : tuple of int
        Numbers of the feet's geometries.
    sites : tuple of int
        Numbers of the sites at the feet's frames.
    """

    model: Any
    dof: Any
    qpos: Any
    feet: tuple[int, ...]
    sites: tuple[int, ...]


class MotorGears(NamedTuple):
    """How motors move the joints of a robot with as many: factors (n, n), inverse, offset (n,)."""

    gears: Array
    inverse: Array
    offset: Array

    @classmethod
    def of(cls, robot: RobotModel) -> MotorGears:
        """Return those of a robot on a floating base."""
        gears = robot.expansion[6:, 6:]
        return cls(gears, np.asarray(np.linalg.inv(gears)), robot.offset[6:])

    def positions(self, joints: Array) -> Array:
        """Return the motors' positions (K, n) at those of the joints."""
        return np.asarray((joints - self.offset) @ self.inverse.T)


def build_legged(
    legs: Legs, motors: MotorGears, theta: Array, *, held: bool, timestep: float, start: Array
) -> LeggedModel:
    """Build the plant of a robot on legs.

    Parameters
    ----------
    legs : Legs
        The robot and its feet.
    theta : ndarray, shape (10·links + 3·joints,)
        The links' standard parameters, Coulomb and viscous friction, rotor inertias.
    motors : MotorGears
        What the latter three are of.
    held : bool
        Hold the base where it starts, and leave out the ground.
    timestep : float
        Step of the integrator, s.
    start : ndarray, shape (6,)
        Position of the base at the start, and rotation vector.

    Raises
    ------
    ModelError
        When links are not physically consistent, or MuJoCo refuses the model.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).
    """
    from scipy.spatial.transform import Rotation

    mujoco = require("mujoco", extra="sim")
    robot, n = legs.robot, legs.n_joints
    links = 10 * robot.n_links
    bodies = theta[:links].reshape(-1, 10)
    check_bodies(robot, bodies)
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.balanceinertia = False
    set_options(mujoco, spec, robot, timestep)
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = _IMPEDANCE_RATIO
    nodes = add_bodies(mujoco, spec, robot, bodies)
    # Where the free joint starts, and where a held base stays.
    nodes[1].pos, nodes[1].quat = start[:3], _quaternion(Rotation.from_rotvec(start[3:]))
    names = robot.joint_names[6:]
    # Rotors that turn with several joints are tendons.
    shared = np.flatnonzero(np.count_nonzero(motors.inverse, axis=1) > 1).tolist()
    for k in shared:
        tendon = spec.add_tendon(armature=theta[links + 2 * n + k])
        for name, factor in zip(names, motors.inverse[k].tolist(), strict=True):
            if factor:
                tendon.wrap_joint(name, factor)
    if held:
        spec.add_equality(
            name="hold",
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=nodes[1].name,
            solref=[_GROUND, 1.0],
            solimp=[*_HOLD, 1e-3, 0.5, 2.0],
        )
    else:
        _add_ground(mujoco, spec, legs, nodes)
    try:
        model = spec.compile()
    except ValueError as cause:
        raise ModelError(f"plant of '{robot.name}': MuJoCo refuses it ({cause}).") from None
    dof = np.array([model.joint(name).dofadr[0] for name in names])
    qpos = np.array([model.joint(name).qposadr[0] for name in names])
    alone = np.delete(np.arange(n), shared)
    model.dof_armature[dof] = theta[links + 2 * n :][alone] @ motors.inverse[alone] ** 2
    names = () if held else tuple(f"foot:{name}" for name in legs.frames)
    feet, sites = ([named(name).id for name in names] for named in (model.geom, model.site))
    return LeggedModel(model, dof, qpos, tuple(feet), tuple(sites))


def _add_ground(mujoco: Any, spec: Any, legs: Legs, nodes: dict[int, Any]) -> None:
    """Add a plane, and a ball or a sole at every foot; nothing else touches."""
    shared = {"condim": 3, "friction": [_GRIP, 0.0, 0.0], "solref": [_GROUND, 1.0], "density": 0.0}
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        contype=1,
        conaffinity=0,
        **shared,
    )
    model = legs.robot.pin_model
    for name, number in zip(legs.frames, legs.frame_ids, strict=True):
        frame = model.frames[number]
        node = nodes[frame.parentJoint]
        place = frame.placement
        node.add_site(name=f"foot:{name}", pos=place.translation)
        shape = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [legs.radius, 0.0, 0.0]}
        center = np.zeros(3)
        if legs.sole is not None:
            half = 0.5 * (legs.sole[1] - legs.sole[0])
            shape = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": [*half, _SOLE]}
            center = np.array([*legs.sole.mean(axis=0), _SOLE])
        node.add_geom(
            name=f"foot:{name}",
            pos=place.translation + place.rotation @ center,
            quat=_quaternion(place.rotation),
            contype=0,
            conaffinity=1,
            **shape,
            **shared,
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
            quat=_quaternion(placement.rotation),
        )
        # Principal moments by our own decomposition: that of older MuJoCo stops at 1e-7.
        moments, axes = np.linalg.eigh(inertias[i - 1])
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        body.mass = float(masses[i - 1])
        body.ipos = centers[i - 1]
        body.inertia = moments
        body.iquat = _quaternion(axes)
        body.explicitinertial = True
        nodes[i] = body
        if i == 1 and robot.free_flyer:
            body.add_freejoint(name=name)
            continue
        slides = robot.tree.kind[i - 1] == PRISMATIC
        kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(name=name, type=kind, axis=robot.tree.axis[i - 1])
    return nodes


def _quaternion(rotation: Any) -> Array:
    """Return a rotation, or its matrix, as MuJoCo's quaternion, scalar first."""
    from scipy.spatial.transform import Rotation

    turn = rotation if isinstance(rotation, Rotation) else Rotation.from_matrix(rotation)
    return np.roll(turn.as_quat(), 1)


def weight_torques(legs: Legs, plan: LeggedPlan, times: Array) -> Array:
    """Return the joint torques that hold the robot still at every instant of a plan.

    The robot is that of its description: a controller does not know the true one. The feet that
    are down share the weight with the least squared force; torques on soles count as forces at
    half of their smaller half width, so that a foot above which the weight is bears it.

    Returns
    -------
    ndarray, shape (K, joints)
    """
    from scipy.spatial.transform import Rotation

    robot, base = legs.robot, plan.base(times)
    turn = Rotation.from_rotvec(base[:, 3:]).as_quat()
    q = np.hstack([base[:, :3], turn, plan.joints(times)[0]])
    still = np.zeros((len(q), robot.n))
    gravity = robot.inverse_dynamics(robot.prior, q, still, still)
    lever = np.ones(3)
    if legs.sole is not None:
        lever = np.repeat([1.0, 0.25 * float((legs.sole[1] - legs.sole[0]).min())], 3)
    J = lever[:, None] * contact_jacobians(robot, q, legs.frames)[:, :, : len(lever)]
    down, out = plan.down(times), gravity[:, 6:]
    for k in np.flatnonzero(down.any(axis=1) & (not plan.held)):
        own = J[k, down[k]].reshape(-1, robot.n)
        force = np.linalg.lstsq(own[:, :6].T, gravity[k, :6], rcond=None)[0]
        out[k] -= own[:, 6:].T @ force
    return out


def run_plan(
    legs: Legs,
    motors: MotorGears,
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
    motors : MotorGears
        What moves its joints.
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
    from scipy.spatial.transform import Rotation

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
    start = plan.base(np.zeros(1))[0]
    built = build_legged(legs, motors, theta, held=plan.held, timestep=step, start=start)
    coulomb, viscous, _ = theta[10 * legs.robot.n_links :].reshape(3, -1)
    model, data, dof = built.model, mujoco.MjData(built.model), built.dof
    data.qpos[built.qpos] = desired[0]

    def evaluate(told: Array) -> Array:
        """Solve for the acceleration; return torques at the joints and of friction, (2, joints)."""
        speed = data.qvel[dof]
        torque = told - stiffness * data.qpos[built.qpos] - damping * speed
        turning = motors.inverse @ speed
        rubbing = coulomb * friction(turning) + viscous * turning
        data.qfrc_applied[dof] = torque - rubbing @ motors.inverse
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

    noted = []
    for k in range(total):
        applied = evaluate(command[k])
        if k >= first:
            state = (each.copy() for each in (data.qpos, data.qvel, data.qacc))
            noted.append((*state, *applied, *_contacts(mujoco, built, data)))
        advance(command[k], command[k + 1])
        if k % 100 == 0 and not 1.0 - 2.0 * (data.qpos[4] ** 2 + data.qpos[5] ** 2) > _FALLEN:
            raise DataError(
                f"legged plant of '{legs.robot.name}': the robot falls at {times[k] - LEAD:.2f} s "
                "of the motion; change its parameters less, or take another motion."
            )
    position, velocity, acceleration, torque, rubbing, wrenches, down = (
        np.array(each) for each in zip(*noted, strict=True)
    )
    # In Pinocchio's order and axes.
    rows = [*range(6), *dof]
    position = position[:, [0, 1, 2, 4, 5, 6, 3, *built.qpos]]
    velocity, acceleration = velocity[:, rows], acceleration[:, rows]
    inverse = Rotation.from_quat(position[:, 3:7]).inv()
    velocity[:, :3] = inverse.apply(velocity[:, :3])
    position[:, 7:] = motors.positions(position[:, 7:])
    velocity[:, 6:], acceleration[:, 6:] = (
        x[:, 6:] @ motors.inverse.T for x in (velocity, acceleration)
    )
    # The derivative of body-axis components, which Pinocchio calls the acceleration.
    turning = np.cross(velocity[:, 3:6], velocity[:, :3])
    acceleration[:, :3] = inverse.apply(acceleration[:, :3]) - turning
    motion = TrueMotion(
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        effort=np.pad(torque @ motors.gears, ((0, 0), (6, 0))),
        friction=rubbing,
        wrenches=wrenches,
        down=down,
    )
    return np.asarray(times[first:total] - LEAD), motion


def _contacts(mujoco: Any, built: LeggedModel, data: Any) -> tuple[Array, Mask]:
    """Return forces and torques (c, 6) in world axes, and which contacts are closed."""
    if not built.feet:
        # What holds the base is all that acts on it: force in world axes, torque in its own.
        force, torque = data.qfrc_constraint[:3], data.qfrc_constraint[3:6]
        held = np.concatenate([force, data.xmat[1].reshape(3, 3) @ torque])
        return held[None], np.ones(1, bool)
    wrenches, down = np.zeros((len(built.feet), 6)), np.zeros(len(built.feet), bool)
    local = np.empty(6)
    for number, contact in enumerate(data.contact):
        if contact.efc_address < 0:
            continue
        foot = built.feet.index(int(contact.geom[1]))
        mujoco.mj_contactForce(built.model, data, number, local)
        # MuJoCo's force acts on the second geometry, here the foot.
        force = contact.frame.reshape(3, 3).T @ local[:3]
        wrenches[foot, :3] += force
        wrenches[foot, 3:] += np.cross(contact.pos - data.site_xpos[built.sites[foot]], force)
        down[foot] = True
    return wrenches, down
