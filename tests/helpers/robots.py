"""Robots for the tests: a tree with every kind of joint, and small arms."""

import math

from sdpid import load_robot
from sdpid._common.arrays import Array
from sdpid.robot.description.dh_table import DhJoint, DhTable
from sdpid.robot.model.model import RobotModel

_TREE = """<robot name="tree">
<link name="base"/>
<link name="column"><inertial><origin xyz="0.1 0 0.2" rpy="0.1 0 0.3"/><mass value="3"/>
  <inertia ixx="0.03" iyy="0.04" izz="0.05" ixy="0.001" ixz="0.002" iyz="-0.003"/></inertial></link>
<link name="left_arm"><inertial><origin xyz="0 0.1 0.2"/><mass value="2"/>
  <inertia ixx="0.03" iyy="0.02" izz="0.03" ixy="0" ixz="0" iyz="0.002"/></inertial></link>
<link name="left_slide"><inertial><origin xyz="-0.1 0.1 0"/><mass value="1.5"/>
  <inertia ixx="0.02" iyy="0.02" izz="0.03" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
<link name="right_arm"><inertial><origin xyz="0.2 -0.1 0"/><mass value="1"/>
  <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0.001" iyz="0"/></inertial></link>
<link name="bracket"><inertial><origin xyz="0 0 0.05"/><mass value="0.5"/>
  <inertia ixx="0.002" iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="finger"><inertial><origin xyz="0.03 0 0"/><mass value="0.2"/>
  <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="thumb"><inertial><origin xyz="0 0.03 0"/><mass value="0.2"/>
  <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="lift" type="prismatic"><parent link="base"/><child link="column"/>
  <origin xyz="0.1 -0.2 0.3" rpy="0.3 0.2 -0.5"/><axis xyz="0 0.6 0.8"/>
  <limit lower="-1" upper="1" effort="100" velocity="2"/></joint>
<joint name="left" type="continuous"><parent link="column"/><child link="left_arm"/>
  <origin xyz="0 0.2 0.1" rpy="-1 0.4 2"/><axis xyz="0.6 0 0.8"/></joint>
<joint name="slide" type="prismatic"><parent link="left_arm"/><child link="left_slide"/>
  <origin xyz="0 0 0.4" rpy="2 0 0.3"/><axis xyz="0 -0.8 0.6"/>
  <limit lower="-1" upper="1" effort="50" velocity="1"/></joint>
<joint name="right" type="revolute"><parent link="column"/><child link="right_arm"/>
  <origin xyz="0.3 0 0" rpy="0.1 1.2 0"/><axis xyz="1 0 0"/>
  <limit lower="-2" upper="1.5" effort="30" velocity="3"/></joint>
<joint name="weld" type="fixed"><parent link="right_arm"/><child link="bracket"/>
  <origin xyz="0.2 0 0.1" rpy="0 0 1"/></joint>
<joint name="finger" type="revolute"><parent link="bracket"/><child link="finger"/>
  <origin xyz="0 0.1 0" rpy="0 0.5 0"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="5" velocity="3"/></joint>
<joint name="thumb" type="revolute"><parent link="bracket"/><child link="thumb"/>
  <origin xyz="0 -0.1 0" rpy="0 0 0.7"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" effort="5" velocity="3"/>{mimic}</joint>
</robot>"""

# Branches, prismatic, continuous and fixed joints, axes in any direction.
TREE = _TREE.format(mimic="")

# The same, but the thumb follows the finger.
TREE_MIMIC = _TREE.format(mimic='<mimic joint="finger" multiplier="-0.7" offset="0.2"/>')
TREE_MIMIC_NO_OFFSET = _TREE.format(mimic='<mimic joint="finger" multiplier="-0.7"/>')
MIMIC = {"joint": "thumb", "source": "finger", "multiplier": -0.7, "offset": 0.2}

RIGHT = math.pi / 2


def small_arm(joints: int) -> RobotModel:
    """Return an arm with the given number of revolute joints, axes crossing in turn."""
    rows = [DhJoint(r=0.2)]
    rows += [
        DhJoint(alpha=RIGHT if i % 2 else 0.0, d=0.0 if i % 2 else 0.3) for i in range(1, joints)
    ]
    return RobotModel.from_mdh(DhTable(joints=tuple(rows), name=f"arm{joints}"))


def described_arm(bodies: Array) -> RobotModel:
    """Return an arm whose links are described, axes crossing in turn."""
    rows = tuple({"alpha": RIGHT * (i % 2), "d": 0.3 * i} for i in range(len(bodies)))
    table = DhTable.from_mapping({"joint": rows, "name": "arm"})
    return load_robot(table.to_urdf(bodies))


def pendulum() -> RobotModel:
    """Return one link on a horizontal axis."""
    return RobotModel.from_mdh(DhTable(joints=(DhJoint(alpha=RIGHT),), name="pendulum"))


def planar_arm() -> RobotModel:
    """Return two links with parallel horizontal axes."""
    rows = (DhJoint(alpha=RIGHT), DhJoint(d=0.4))
    return RobotModel.from_mdh(DhTable(joints=rows, name="planar_arm"))


LIFT = """<robot name="arm_on_a_lift"><link name="base"/>
<link name="carriage"><inertial><origin xyz="0 0 0.05"/><mass value="8"/>
  <inertia ixx="0.02" iyy="0.03" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="arm"><inertial><origin xyz="0.15 0 0"/><mass value="2"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="lift" type="prismatic"><parent link="base"/><child link="carriage"/>
  <axis xyz="0 0 1"/><limit effort="500" velocity="0.07" lower="0" upper="0.5"/></joint>
<joint name="arm" type="revolute"><parent link="carriage"/><child link="arm"/>
  <axis xyz="0 1 0"/><limit effort="50" velocity="2" lower="-3" upper="3"/></joint></robot>"""

# The same with two more joints, which carry each other.
LIFTED = LIFT.replace(
    "</robot>",
    """
<link name="forearm"><inertial><origin xyz="0.1 0 0"/><mass value="1.2"/>
  <inertia ixx="0.004" iyy="0.005" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="hand"><inertial><origin xyz="0.06 0 0.01"/><mass value="0.6"/>
  <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="revolute"><parent link="arm"/><child link="forearm"/>
  <origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
  <limit effort="30" velocity="3" lower="-3" upper="3"/></joint>
<joint name="wrist" type="revolute"><parent link="forearm"/><child link="hand"/>
  <origin xyz="0.2 0 0"/><axis xyz="0 1 0"/>
  <limit effort="10" velocity="4" lower="-3" upper="3"/></joint></robot>""",
)
