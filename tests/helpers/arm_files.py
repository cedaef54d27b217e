"""A small robot and its log, for tests that need files."""

from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.robot.model.load import load_robot
from tests.helpers.motions import sines

ARM_URDF = """<?xml version="1.0"?>
<robot name="arm">
  <!-- two joints, and a tool that does not move -->
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.1 0 0.02" rpy="0 0 0.1"/><mass value="3.0"/>
    <inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.03"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0.15 0.01 0"/><mass value="1.5"/>
    <inertia ixx="0.005" ixy="0" ixz="0" iyy="0.012" iyz="0" izz="0.012"/></inertial></link>
  <link name="tool"><inertial><origin xyz="0 0 0.05"/><mass value="0.4"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
  <joint name="a" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.3" rpy="1.5707963 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="8" effort="100"/><dynamics damping="0.4" friction="0.3"/>
  </joint>
  <joint name="b" type="continuous"><parent link="upper"/><child link="fore"/>
    <origin xyz="0.4 0 0" rpy="0 0.3 0"/><axis xyz="0 0 1"/><limit velocity="9" effort="50"/>
  </joint>
  <joint name="flange" type="fixed"><parent link="fore"/><child link="tool"/>
    <origin xyz="0.3 0 0"/></joint>
</robot>
"""


def arm_log(urdf: Path) -> tuple[Array, Array, Array]:
    """Return time (K,), positions (K, 2) and efforts (K, 2) of a motion that excites it."""
    robot, rng = load_robot(urdf), np.random.default_rng(3)
    t = np.arange(400) / 50.0
    q, v, a = sines(t, rng.uniform(1.0, 5.0, (2, 2)), rng.uniform(0.0, 6.0, (2, 2)))
    tau = robot.inverse_dynamics(robot.prior, q, v, a)
    return t, q, tau + 0.4 * v + 0.02 * rng.standard_normal(tau.shape)


def write_arm(folder: Path, **more: Any) -> tuple[Array, Array, Array]:
    """Write arm.urdf and log.npz, and return what the log holds."""
    (folder / "arm.urdf").write_text(ARM_URDF)
    t, q, tau = arm_log(folder / "arm.urdf")
    np.savez(folder / "log.npz", t=t, q=q, tau=tau, **more)
    return t, q, tau
