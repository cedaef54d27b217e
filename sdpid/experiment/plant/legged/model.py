"""A MuJoCo model of a robot on legs: its bodies, the ground, and balls or soles for feet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.errors import ModelError
from sdpid.experiment.plant.drives import check_bodies
from sdpid.robot.inertia import physical_parameters
from sdpid.robot.legs.legs import Legs
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


def build_legged(
    legs: Legs,
    theta: Array,
    *,
    held: bool,
    timestep: float,
    start: Array,
) -> LeggedModel:
    """Build the plant of a robot on legs.

    Parameters
    ----------
    legs : Legs
        The robot and its feet.
    theta : ndarray, shape (10·links + 3·joints,)
        The links' standard parameters, Coulomb and viscous friction, rotor inertias.
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
    model.dof_armature[dof] = theta[links + 2 * n :]
    names = () if held else tuple(f"foot:{name}" for name in legs.frames)
    feet, sites = ([named(name).id for name in names] for named in (model.geom, model.site))
    return LeggedModel(model, dof, qpos, tuple(feet), tuple(sites))


def _add_ground(mujoco: Any, spec: Any, legs: Legs, nodes: dict[int, Any]) -> None:
    """Add a plane, and a ball or a sole at every foot; nothing else touches."""
    shared = {
        "condim": 3,
        "friction": [_GRIP, 0.0, 0.0],
        "solref": [_GROUND, 1.0],
        "density": 0.0,
    }
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
