"""An MJCF text compiled by MuJoCo, as an arm: where its bodies are and what efforts it needs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.errors import ExportError
from sdpid.robot.inertia import theta_from_physical
from sdpid.robot.model.model import RobotModel


class CompiledMjcf:
    """A compiled MJCF text and the joints of a robot in it.

    Parameters
    ----------
    text : str
        The MJCF.
    robot : RobotModel
        Whose joints it must have, and no others.
    folder : Path or None
        Where relative file names start.
    what : str
        What it is called in messages.

    Attributes
    ----------
    model : mujoco.MjModel
    joints : list of int
        MuJoCo's joint for each of Pinocchio's joints but the universe.

    Raises
    ------
    ExportError
        When MuJoCo does not compile it, or its joints are not the robot's.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).
    """

    def __init__(self, text: str, robot: RobotModel, folder: Path | None, what: str) -> None:
        self._mujoco = mujoco = require("mujoco", extra="sim")
        self.robot, self.what = robot, what
        try:
            spec = mujoco.MjSpec.from_string(text)
            if folder is not None:
                spec.modelfiledir = str(folder)
            self.model = spec.compile()
        except (ValueError, RuntimeError) as cause:
            reason = str(cause).strip().replace("\n", " ")
            raise ExportError(f"{what}: MuJoCo does not compile it ({reason}).") from None
        self.joints = self._match()

    def _match(self) -> list[int]:
        mujoco, model, robot = self._mujoco, self.model, self.robot
        free = [j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
        found = []
        for i, name in enumerate(list(robot.pin_model.names)[1:], start=1):
            if i == 1 and robot.free_flyer:
                number = free[0] if len(free) == 1 else -1
                name = "free joint"
            else:
                number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
            if number < 0:
                raise ExportError(
                    f"{self.what}: the source has no joint '{name}'; give the MJCF of the same "
                    "robot."
                )
            found.append(int(number))
        if model.njnt > len(found):
            others = [model.joint(j).name or f"number {j}" for j in range(model.njnt)]
            others = [name for j, name in enumerate(others) if j not in found]
            raise ExportError(
                f"{self.what}: the source has joints that the robot '{robot.name}' lacks: "
                f"{', '.join(others)}; identify the robot with them, or remove them."
            )
        return found

    def carriers(self) -> list[int]:
        """Return the body that each of Pinocchio's joints moves."""
        return [int(self.model.jnt_bodyid[j]) for j in self.joints]

    def body_name(self, body: int) -> str:
        """Return a body's name, empty where it has none."""
        return str(self.model.body(body).name)

    def body(self, body: int) -> Array:
        """Return the ten parameters of a compiled body in its own frame; zero without mass."""
        model = self.model
        mass = float(model.body_mass[body])
        if mass == 0.0:
            return np.zeros(10)
        R = _rotation(self._mujoco, model.body_iquat[body])
        inertia = R @ np.diag(model.body_inertia[body]) @ R.T
        return theta_from_physical(mass, model.body_ipos[body], inertia)

    def fixed_bodies(self, carrier: int) -> list[tuple[int, Array, Array]]:
        """Return the bodies fixed to a moving one, with rotation and translation in its frame."""
        model = self.model
        out = []
        for body in range(carrier + 1, model.nbody):
            if model.body_weldid[body] != carrier:
                continue
            R, t = np.eye(3), np.zeros(3)
            at = body
            while at != carrier:
                own = _rotation(self._mujoco, model.body_quat[at])
                R, t = own @ R, own @ t + model.body_pos[at]
                at = int(model.body_parentid[at])
            out.append((body, R, t))
        return out

    def placements(self) -> Array:
        """Return the placements (nbody, 4, 4) in the world where the robot's positions are zero."""
        mujoco, model = self._mujoco, self.model
        data = mujoco.MjData(model)
        for i, at in enumerate(model.jnt_qposadr[self.joints]):
            if i == 0 and self.robot.free_flyer:
                data.qpos[at : at + 7] = 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
            else:
                data.qpos[at] = self.robot.offset[self.robot.pin_model.joints[i + 1].idx_v]
        mujoco.mj_kinematics(model, data)
        out = np.tile(np.eye(4), (model.nbody, 1, 1))
        out[:, :3, :3] = data.xmat.reshape(-1, 3, 3)
        out[:, :3, 3] = data.xpos
        return out

    def efforts(
        self, states: tuple[Array, Array, Array], gravity: Array, *, drives: bool = False
    ) -> Array:
        """Return the efforts (K, n) of inverse dynamics at states (q, v, a) of the robot.

        Parameters
        ----------
        states : tuple of ndarray
            As `RobotModel.inverse_dynamics` takes them.
        gravity : ndarray, shape (3,)
            In the world, m/s²; the option of the file is not looked at.
        drives : bool, optional
            Count armature and damping in. Contacts, limits, dry friction, springs and what else
            is no rigid body's never count.
        """
        import copy

        mujoco, robot = self._mujoco, self.robot
        model = copy.deepcopy(self.model)
        model.opt.gravity[:] = gravity
        model.opt.density = model.opt.viscosity = 0.0
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        for name in ("jnt_stiffness", "tendon_stiffness", "tendon_damping", "body_gravcomp"):
            getattr(model, name)[...] = 0.0
        if not drives:
            model.dof_damping[...] = 0.0
            model.dof_armature[...] = 0.0
        data = mujoco.MjData(model)
        q, v, a = states
        configurations = robot.configuration(q)
        out = np.empty((len(q), robot.n))
        for k, configuration in enumerate(configurations):
            rate, change = robot.expansion @ v[k], robot.expansion @ a[k]
            for i, number in enumerate(self.joints):
                joint = robot.pin_model.joints[i + 1]
                at, dof = model.jnt_qposadr[number], model.jnt_dofadr[number]
                own = slice(joint.idx_v, joint.idx_v + joint.nv)
                x = configuration[joint.idx_q : joint.idx_q + joint.nq]
                if joint.nv == 6:
                    # Velocity in the world, rates of turning in the body; Pinocchio has all in
                    # the body, and the acceleration of a spatial vector.
                    w, linear = rate[own][3:], rate[own][:3]
                    quaternion = np.roll(x[3:], 1)
                    R = _rotation(mujoco, quaternion)
                    data.qpos[at : at + 3], data.qpos[at + 3 : at + 7] = x[:3], quaternion
                    data.qvel[dof : dof + 3], data.qvel[dof + 3 : dof + 6] = R @ linear, w
                    data.qacc[dof : dof + 3] = R @ (change[own][:3] + np.cross(w, linear))
                    data.qacc[dof + 3 : dof + 6] = change[own][3:]
                    continue
                data.qpos[at] = x[0] if joint.nq == 1 else np.arctan2(x[1], x[0])
                data.qvel[dof], data.qacc[dof] = rate[own][0], change[own][0]
            mujoco.mj_inverse(model, data)
            force = np.empty(robot.pin_model.nv)
            for i, number in enumerate(self.joints):
                joint = robot.pin_model.joints[i + 1]
                dof = model.jnt_dofadr[number]
                force[joint.idx_v : joint.idx_v + joint.nv] = data.qfrc_inverse[
                    dof : dof + joint.nv
                ]
                if joint.nv == 6:
                    R = _rotation(mujoco, data.qpos[model.jnt_qposadr[number] + 3 :][:4])
                    force[joint.idx_v : joint.idx_v + 3] = R.T @ data.qfrc_inverse[dof : dof + 3]
            out[k] = robot.expansion.T @ force
        return out


def _rotation(mujoco: Any, quaternion: Array) -> Array:
    """Return the rotation matrix of MuJoCo's quaternion, scalar first."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.ascontiguousarray(quaternion, dtype=np.float64))
    return matrix.reshape(3, 3)


def quaternion_of(rotation: Array) -> Array:
    """Return a rotation matrix as MuJoCo's quaternion, scalar first."""
    mujoco = require("mujoco", extra="sim")
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    return quaternion / np.linalg.norm(quaternion)
