"""Robots with known parameters for the tests of simulation."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

import sdpid
from sdpid._common.arrays import Array
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.dynamics import RobotDynamics

SLIDER = """<robot name="slider"><link name="base"/>
<link name="mass"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="mass"/><axis xyz="1 0 0"/>
<limit lower="-9" upper="9" effort="100" velocity="9"/></joint></robot>"""


def model_of(
    robot: sdpid.RobotModel,
    terms: Sequence[str | FrictionTerm] = (),
    values: ArrayLike = (),
    bodies: Array | None = None,
) -> RobotDynamics:
    """Return a robot with these bodies, by default its own, and friction parameters."""
    friction = FrictionModel.from_terms(terms, robot.joint_names)
    own = robot.prior if bodies is None else bodies
    return RobotDynamics(
        robot=robot,
        terms=friction,
        theta=np.concatenate([np.ravel(own), np.asarray(values, dtype=np.float64)]),
    )


def slider(friction: Sequence[str | FrictionTerm], values: ArrayLike) -> RobotDynamics:
    """Return a mass of 2 kg on a horizontal rail."""
    return model_of(sdpid.load_robot(SLIDER), friction, values)
