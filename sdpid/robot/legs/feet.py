"""The feet of a robot on legs as its description shows them."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.robot.description.xml import parse_xml
from sdpid.robot.model.geometry import collision_points
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.shapes import link_shapes

# Of feet that the description shows no shape of, m: those of most quadrupeds of a metre or less.
_RADIUS = 0.02
# Of soles that the description shows no shape of, m: to the back, to the front, to both sides.
_BACK, _FRONT, _SIDE = -0.1, 0.1, 0.06
# What is this near to the lowest point of a foot is its sole, m.
_THICK = 0.01


def foot_radius(robot: RobotModel, frames: tuple[str, ...], standing: Array) -> float:
    """Return how far the feet reach below their frames when the robot stands, m.

    That of balls is their radius. The largest of all feet; 0.02 m where the description has no
    collision geometry of them.
    """
    import pinocchio as pin

    model = robot.pin_model
    data = model.createData()
    q = pin.neutral(model)
    q[7:] = standing
    pin.framesForwardKinematics(model, data, q)
    depths = []
    for element in [] if robot.urdf is None else parse_xml(robot.urdf, robot.name).findall("link"):
        name = element.get("name")
        if name not in frames:
            continue
        down = -data.oMf[model.getFrameId(name)].rotation[2]
        try:
            shapes = link_shapes(element, "collision", robot.name, [])
        except ModelError:
            # A mesh that is not at hand.
            continue
        for shape in shapes:
            if shape.kind == "sphere":
                depths.append(float(shape.placement[:3, 3] @ down + shape.sizes[0]))
            else:
                depths.append(float(np.max(shape.points() @ down)))
    return max(depths, default=_RADIUS)


def sole_corners(robot: RobotModel, frames: tuple[str, ...]) -> Array:
    """Return the lower and the upper corner of all soles in their frames, m, (2, 2).

    The rectangle that every foot's collision geometry has, about the plane that the frame lies
    in; 0.2 m by 0.12 m where the description has none.
    """
    model = robot.pin_model
    lower, upper = [], []
    for name in frames:
        frame = model.frames[model.getFrameId(name)]
        try:
            points = collision_points(robot, robot.link_names[frame.parentJoint - 1])
        except ModelError:
            continue
        own = (points - frame.placement.translation) @ frame.placement.rotation
        own = own[own[:, 2] < own[:, 2].min() + _THICK]
        lower.append(own[:, :2].min(axis=0))
        upper.append(own[:, :2].max(axis=0))
    if not lower:
        return np.array([[_BACK, -_SIDE], [_FRONT, _SIDE]])
    return np.array([np.max(lower, axis=0), np.min(upper, axis=0)])
