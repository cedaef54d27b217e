"""A quadruped that crawls: motion as chosen, efforts and forces by Pinocchio's inverse dynamics."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin

import sdpid
from sdpid._common.arrays import Array, Mask
from tests.helpers.legged import FEET, contact_jacobians

RADIUS = np.array([0.0, 0.0, -0.0184])
LEVER = np.array([0.06, -0.02, 0.03])
TURN = pin.rpy.rpyToMatrix(0.3, -0.2, 1.1)
# Step of the differences that make velocities and accelerations of the chosen motion, s: errors of
# its square and of rounding over its square are both some 1e-8.
_DELTA = 2e-4


@dataclass(frozen=True, kw_only=True)
class Crawl:
    """States and efforts in Pinocchio's order, forces at the contact points, and flags."""

    robot: sdpid.RobotModel
    time: Array
    q: Array
    v: Array
    a: Array
    effort: Array
    forces: Array
    down: Mask

    @property
    def world_velocity(self) -> Array:
        return self._turned(self.v[:, :3])

    @property
    def specific_force(self) -> Array:
        """Of the base's origin, in its axes."""
        rows = []
        for q, v, a in zip(self.q, self.v, self.a, strict=True):
            R = pin.Quaternion(q[3:7]).toRotationMatrix()
            rows.append(a[:3] + np.cross(v[3:6], v[:3]) - R.T @ [0.0, 0.0, -9.81])
        return np.array(rows)

    def imu(self) -> sdpid.Imu:
        """Of a sensor that sits off the origin and askew."""
        w, alpha = self.v[:, 3:6], self.a[:, 3:6]
        there = self.specific_force + np.cross(alpha, LEVER) + np.cross(w, np.cross(w, LEVER))
        return sdpid.Imu(
            gyroscope=w @ TURN, accelerometer=there @ TURN, translation=LEVER, rotation=TURN
        )

    def base(self, kind: str) -> sdpid.BaseMotion:
        """Of the source that is named, without the others."""
        pose: dict[str, Any] = {"orientation": self.q[:, 3:7], "position": self.q[:, :3]}
        if kind == "imu":
            pose["imu"] = self.imu()
        elif kind == "twist":
            pose |= {"linear_velocity": self.world_velocity, "velocity_frame": "world"}
            pose["angular_velocity"] = self._turned(self.v[:, 3:6])
        elif kind == "own_twist":
            pose |= {"linear_velocity": self.v[:, :3], "velocity_frame": "base"}
            pose["angular_velocity"] = self.v[:, 3:6]
        return sdpid.BaseMotion(**pose)

    def log(self, kind: str = "imu", **contacts: Any) -> sdpid.Recording:
        known: dict[str, Any] = {"down": self.down, "forces": self.forces, **contacts}
        return sdpid.Recording(
            time=self.time,
            position=self.q[:, 7:],
            effort=self.effort[:, 6:],
            joint_names=self.robot.joint_names[6:],
            base=self.base(kind),
            contacts=sdpid.Contacts(frames=FEET, kind="point", offset=RADIUS, **known),
        )

    def _turned(self, vectors: Array) -> Array:
        turns = [pin.Quaternion(q[3:7]).toRotationMatrix() for q in self.q]
        return np.einsum("kij,kj->ki", np.array(turns), vectors)


def configuration(model: Any, t: float) -> Array:
    """Return the chosen configuration at a time."""
    q = pin.neutral(model)
    s = np.sin(2.0 * np.pi * t * np.array([0.9, 1.3, 0.7, 1.1, 0.8, 1.7]) + np.arange(6.0))
    q[:3] = np.array([0.3 * t, 0.0, 0.24]) + 0.02 * s[:3]
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(*(np.array([0.1, 0.12, 0.2]) * s[3:]))).coeffs()
    n = model.nq - 7
    phase = 2.0 * np.pi * t * (0.8 + 0.1 * np.arange(n)) + 0.7 * np.arange(n)
    q[7:] = np.tile([0.0, 0.7, -1.4], n // 3) + 0.25 * np.sin(phase)
    return np.asarray(q)


@lru_cache(maxsize=2)
def crawl(duration: float = 4.0, rate_hz: float = 500.0) -> Crawl:
    """Return a crawl of Solo12, three feet or four down at any time, as its description has it."""
    robot = sdpid.load_robot("solo12", root="free_flyer")
    model = robot.pin_model.copy()
    model.armature[:] = 0.0
    data = model.createData()
    time = np.arange(round(duration * rate_hz)) / rate_hz
    phase = np.mod(time[:, None] / 0.8 - 0.25 * np.arange(4), 1.0)
    down = phase > 0.2
    q, v, a, effort, forces = [], [], [], [], []
    for t, closed in zip(time, down, strict=True):
        here = [configuration(model, t + k * _DELTA) for k in (-1, 0, 1)]
        before = pin.difference(model, here[0], here[1]) / _DELTA
        after = pin.difference(model, here[1], here[2]) / _DELTA
        speed, rate = (before + after) / 2.0, (after - before) / _DELTA
        wanted = pin.rnea(model, data, here[1], speed, rate)
        J = contact_jacobians(model, data, here[1], RADIUS) * closed[:, None, None]
        pushed = np.linalg.pinv(J[:, :, :6].reshape(12, 6).T) @ wanted[:6]
        q.append(here[1]), v.append(speed), a.append(rate)
        effort.append(wanted - J.reshape(12, -1).T @ pushed)
        forces.append(pushed.reshape(4, 3))
    return Crawl(
        robot=robot, time=time, q=np.array(q), v=np.array(v), a=np.array(a),
        effort=np.array(effort), forces=np.array(forces), down=down,
    )  # fmt: skip
