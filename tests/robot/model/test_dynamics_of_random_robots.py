"""The robot in use against two other libraries, each of which reads the random URDF itself.

Pinocchio and MuJoCo know bodies, armature and gravity. Friction, couplings and the gears of joints
that follow others are added here, from their formulas.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.friction import Coulomb, Coupling, Offset, RotorInertia, Tilt, Viscous
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel
from tests.helpers.data import friction_model
from tests.helpers.random_trees import random_tree
from tests.helpers.strategies import SEEDS, random_states

# Three implementations of the same recursions over at most seven links, relative to the largest
# entry of a matrix or effort.
SAME = 1e-9

# Accelerations, times the condition of the mass matrix by which rounding may grow.
SOLVED = 1e-12

SHAPES = ("chain", "tree", "follower", "floating")


@dataclass(frozen=True)
class Case:
    """A random robot with known parameters, what they are, and random states."""

    robot: RobotModel
    model: RobotDynamics
    urdf: str
    shape: str
    coulomb: Array
    viscous: Array
    offset: Array
    rotors: Array
    coupling: Array
    gravity: Array
    q: Array
    v: Array
    a: Array

    @property
    def drives(self) -> Array:
        """Rotor inertias and, across the first two joints, that of their common motor."""
        n, first = self.robot.n, self.model.terms.first
        found = np.zeros((n, n))
        found[range(first, n), range(first, n)] = self.rotors
        if self.coupling.size:
            found[first, first + 1] = found[first + 1, first] = self.coupling[0]
        return found

    def friction(self, v: Array) -> Array:
        first = self.model.terms.first
        own = v[first:]
        out = self.coulomb * np.sign(own) + self.viscous * own + self.offset
        if self.coupling.size:
            _, viscous, coulomb = self.coupling
            out[:2] += viscous * own[1::-1] + coulomb * np.sign(own[0] + own[1])
        return np.concatenate([np.zeros(first), out])


def case(seed: int, shape: str) -> Case:
    rng = np.random.default_rng(seed)
    urdf, _ = random_tree(
        rng, int(rng.integers(1, 7)), chain=shape == "chain", follower=shape == "follower"
    )
    robot = sdpid.load_robot(urdf, **({"root": "free_flyer"} if shape == "floating" else {}))
    count = robot.n - robot.n_base
    terms: tuple[FrictionTerm, ...] = (Coulomb(), Viscous(), Offset(), RotorInertia())
    numbers = [rng.uniform(0.1, 2.0, count) for _ in terms]
    coupling, tilt = np.zeros(0), np.zeros(2)
    if count > 1:
        terms += (Coupling(*robot.joint_names[robot.n_base :][:2]),)
        coupling = np.array([0.05, rng.uniform(-0.1, 0.1), rng.uniform(0.0, 1.0)])
        numbers.append(coupling)
    if shape != "floating":
        terms += (Tilt(tuple(map(tuple, robot.prior.tolist()))),)
        tilt = rng.uniform(-0.05, 0.05, 2)
        numbers.append(tilt)
    theta = np.concatenate([robot.prior.ravel(), *numbers])
    model = RobotDynamics(robot=robot, terms=friction_model(robot, terms), theta=theta)
    q, v, a = random_states(rng, robot.n, 2)
    if shape == "floating":
        full = robot.pin_model
        q = np.stack([pin.integrate(full, pin.neutral(full), x) for x in q])
    gravity = robot.gravity + np.cross([*tilt, 0.0], robot.gravity)
    return Case(robot, model, urdf, shape, *numbers[:4], coupling, gravity, q, v, a)


def same(actual: Array, expected: Array) -> None:
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(actual, expected, rtol=0, atol=SAME * scale)


def check(
    each: Case, k: int, M: Array, rest: Array, velocity: Array, gravity: Array | None = None
) -> None:
    """Compare all of the model at a state with mass matrix, effort at rest, velocity terms."""
    model, q, v, a = each.model, each.q[k], each.v[k], each.a[k]
    M = M + each.drives
    friction = each.friction(v)
    effort = M @ a + velocity + rest + friction
    same(model.mass_matrix(q), M)
    same(model.gravity(q), rest)
    same(model.coriolis(q, v) @ v, velocity)
    same(model.friction(v), friction)
    same(model.inverse_dynamics(q, v, a), effort)
    found, worst = model.forward_dynamics(q, v, effort), float(np.linalg.cond(M))
    limit = (SAME + SOLVED * worst) * max(1.0, float(np.abs(a).max()))
    np.testing.assert_allclose(found, a, rtol=0, atol=limit)
    np.testing.assert_allclose(
        found, np.linalg.solve(M, effort - velocity - rest - friction), rtol=0, atol=limit
    )


@given(SEEDS, st.sampled_from(SHAPES))
def test_it_is_pinocchio_with_all_that_the_links_do_not_have(seed: int, shape: str) -> None:
    each = case(seed, shape)
    free = [pin.JointModelFreeFlyer()] if shape == "floating" else []
    own = pin.buildModelFromXML(each.urdf, *free)
    own.gravity.linear = each.gravity
    data = own.createData()
    E = each.robot.expansion
    for k, configuration in enumerate(each.robot.configuration(each.q)):
        upper = np.triu(pin.crba(own, data, configuration))
        v = E @ each.v[k]
        rest = np.array(pin.computeGeneralizedGravity(own, data, configuration))
        velocity = pin.rnea(own, data, configuration, v, np.zeros(own.nv)) - rest
        M = upper + np.triu(upper, 1).T
        check(each, k, E.T @ M @ E, E.T @ rest, E.T @ velocity)


@given(SEEDS, st.sampled_from(SHAPES))
def test_it_is_mujoco_with_all_that_the_links_do_not_have(seed: int, shape: str) -> None:
    mujoco = pytest.importorskip("mujoco", reason="the extra sim is not installed")
    each = case(seed, shape)
    own = mujoco_of(mujoco, each)
    data = mujoco.MjData(own)
    E = each.robot.expansion
    for k, configuration in enumerate(each.robot.configuration(each.q)):
        T = placed(mujoco, own, data, each.robot, configuration)
        J = T @ E
        mujoco.mj_forward(own, data)
        M = np.zeros((own.nv, own.nv))
        for column, unit in zip(M, np.eye(own.nv), strict=True):
            mujoco.mj_mulM(own, data, column, unit)
        data.qvel[:] = data.qacc[:] = 0.0
        mujoco.mj_inverse(own, data)
        rest = np.array(data.qfrc_inverse)
        # MuJoCo has the base's linear velocity along the axes of the world: it turns there.
        turning = np.zeros(own.nv)
        if shape == "floating":
            R, (linear, angular) = T[:3, :3], each.v[k][:6].reshape(2, 3)
            turning[:3] = R @ np.cross(angular, linear)
        data.qvel[:], data.qacc[:] = J @ each.v[k], turning
        mujoco.mj_inverse(own, data)
        check(each, k, J.T @ M @ J, J.T @ rest, J.T @ (data.qfrc_inverse - rest))
        if shape != "follower":
            data.qfrc_applied[:] = np.linalg.solve(
                T.T,
                each.model.inverse_dynamics(each.q[k], each.v[k], each.a[k])
                - each.friction(each.v[k])
                - each.drives @ each.a[k],
            )
            mujoco.mj_forward(own, data)
            limit = (SAME + SOLVED * float(np.linalg.cond(M))) * float(np.abs(each.a[k]).max())
            np.testing.assert_allclose(data.qacc, J @ each.a[k] + turning, rtol=0, atol=limit)


def mujoco_of(mujoco: Any, each: Case) -> Any:
    """Return what MuJoCo's own reader makes of the URDF, with nothing but bodies and gravity."""
    spec = mujoco.MjSpec.from_string(each.urdf)
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = False
    spec.option.gravity = each.gravity
    for flag in ("CONTACT", "LIMIT", "EQUALITY", "FRICTIONLOSS", "DAMPER"):
        bit = getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}", None)
        spec.option.disableflags |= 0 if bit is None else bit.value
    if each.shape == "floating":
        spec.body("l0").add_freejoint()
    return spec.compile()


def placed(mujoco: Any, own: Any, data: Any, robot: RobotModel, configuration: Array) -> Array:
    """Put MuJoCo's robot where Pinocchio's is; return its rates (nv, nv) from Pinocchio's."""
    model = robot.pin_model
    T = np.zeros((own.nv, model.nv))
    for i in range(1, model.njoints):
        joint, x = model.joints[i], configuration[model.joints[i].idx_q :]
        if joint.nv == 6:
            data.qpos[:3], data.qpos[3:7] = x[:3], x[[6, 3, 4, 5]]
            R = pin.Quaternion(x[3:7]).toRotationMatrix()
            T[:3, :3], T[3:6, 3:6] = R, np.eye(3)
            continue
        own_joint = own.joint(model.names[i])
        data.qpos[own_joint.qposadr[0]] = np.arctan2(x[1], x[0]) if joint.nq == 2 else x[0]
        T[own_joint.dofadr[0], joint.idx_v] = 1.0
    return T


@given(SEEDS, st.sampled_from(SHAPES))
def test_many_states_are_each_of_them(seed: int, shape: str) -> None:
    each = case(seed, shape)
    model, (q, v, a) = each.model, (each.q, each.v, each.a)
    tau = model.inverse_dynamics(q, v, a)
    for method, states in (
        (model.mass_matrix, (q,)),
        (model.coriolis, (q, v)),
        (model.gravity, (q,)),
        (model.friction, (v,)),
        (model.inverse_dynamics, (q, v, a)),
        (model.forward_dynamics, (q, v, tau)),
    ):
        many = method(*states)
        assert method(*(x[:0] for x in states)).shape == (0, *many.shape[1:])
        for k in range(len(q)):
            same(method(*(x[k] for x in states)), many[k])
