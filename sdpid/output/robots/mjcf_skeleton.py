"""Make the MJCF of a robot's kinematics, into which identified numbers are then written.

MuJoCo loads URDF itself, but welds fixed links into what carries them and saves six digits. Here
every link stays a body under its name, and every number is written in full.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import ExportError
from sdpid.output.robots.urdf import Urdf
from sdpid.output.robots.written_bodies import possible, possible_body
from sdpid.robot.description.bodies import Inertial, tensor_rows
from sdpid.robot.description.mjcf import quaternion_of
from sdpid.robot.description.xml import numbers
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.regressor_kernel import PRISMATIC
from sdpid.robot.model.transmission import followers

# Of two balls that stand for a pin one is this share of the robot's reach along its axis.
_ALONG = 0.1


def inertial_values(body: Inertial) -> dict[str, str]:
    """Return the attributes of the <inertial> of a body.

    Principal moments and their axes rather than ``fullinertia``: releases of MuJoCo differ in how
    exactly they take a full tensor apart.
    """
    if not body.mass:
        return {"pos": "0 0 0", "mass": "0", "diaginertia": "0 0 0"}
    moments, axes = np.linalg.eigh(np.array(tensor_rows(body.moments), dtype=np.float64))
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    # Readers would refuse a body that misses the triangle inequality by a rounding.
    moments[2] = min(moments[2], moments[0] + moments[1])
    return {
        "pos": numbers(body.com),
        "quat": numbers(quaternion_of(axes)),
        "mass": numbers(body.mass),
        "diaginertia": numbers(moments),
    }


def mjcf_skeleton(robot: RobotModel, urdf: Urdf | None) -> tuple[str, tuple[str, ...]]:
    """Return the MJCF of a robot's kinematics, without shapes.

    Links fixed to moving ones are bodies with the description's own inertials. Moving bodies have
    unit inertials, to be replaced. The second result names the fixed links whose inertials no body
    can have: MuJoCo would not load them, and they are zero.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    urdf : Urdf or None
        Its URDF, where there is one: for fixed links and names.

    Raises
    ------
    ExportError
        When a name has characters that no XML can hold.
    """
    try:
        return _skeleton(robot, urdf)
    except ValueError as cause:
        raise ExportError(f"MJCF of '{robot.name}': {cause}") from None


def _skeleton(robot: RobotModel, urdf: Urdf | None) -> tuple[str, tuple[str, ...]]:
    from lxml import etree

    model, add, impossible = robot.pin_model, etree.SubElement, []
    root = etree.Element("mujoco", model=robot.name)
    add(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    add(root, "option", gravity=numbers(robot.gravity))
    bodies = [add(root, "worldbody")]
    _add_sites(robot, 0, bodies[0])
    for i, (name, placement) in enumerate(zip(model.names, model.jointPlacements, strict=True)):
        if i == 0:
            continue
        link = robot.link_names[i - 1] if urdf is None else urdf.name(urdf.carriers[i - 1])
        body = add(bodies[model.parents[i]], "body", _placed(link, placement.homogeneous))
        bodies.append(body)
        add(body, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
        if model.joints[i].nv == 6:
            add(body, "freejoint", name=name)
        else:
            add(body, "joint", _joint(robot, i))
        _add_sites(robot, i, body)
        children = {} if urdf is None else urdf.children(urdf.carriers[i - 1])
        for child in children.values():
            fixed = add(body, "body", _placed(child.name, child.placement))
            if not np.any(child.body):
                continue
            if not possible(child.body, "pseudo_inertia"):
                impossible.append(child.name)
                continue
            own = possible_body(child.body, "pseudo_inertia", child.name, "MJCF")
            add(fixed, "inertial", inertial_values(own))
    _add_equalities(robot, root)
    etree.indent(root, "  ")
    return etree.tostring(root, encoding="unicode") + "\n", tuple(impossible)


def _placed(link: str, placement: Array) -> dict[str, str]:
    """Return the attributes of a link's body; MuJoCo keeps the name ``world`` for itself."""
    return {"name": "world_link" if link == "world" else link, **_pose(placement)}


def _pose(placement: Array) -> dict[str, str]:
    quaternion = quaternion_of(placement[:3, :3])
    return {"pos": numbers(placement[:3, 3]), "quat": numbers(quaternion)}


def _joint(robot: RobotModel, i: int) -> dict[str, str]:
    """Return the attributes of a joint."""
    name = str(robot.pin_model.names[i])
    mark = "slide" if robot.tree.kind[i - 1] == PRISMATIC else "hinge"
    values = {"name": name, "type": mark, "axis": numbers(robot.tree.axis[i - 1])}
    if robot.seats().get(name) == (name, 1.0):
        column = robot.joint_names.index(name)
        lower, upper = robot.position_limits[column]
        if lower < upper < np.inf:
            values["range"] = numbers([lower, upper])
        effort = robot.effort_limits[column]
        if np.isfinite(effort):
            values["actuatorfrcrange"] = numbers([-effort, effort])
    return values


def _add_sites(robot: RobotModel, i: int, body: Any) -> None:
    """Add the sites on a joint's body at which loops close, for an axis another one along it."""
    from lxml import etree

    model = robot.pin_model
    for loop in robot.loops:
        for name in (loop.frame, loop.against):
            frame = model.frames[robot.frame_numbers[name]]
            if frame.parentJoint == i:
                place = frame.placement
                etree.SubElement(body, "site", {"name": name, **_pose(place.homogeneous)})
                if loop.kind == "line":
                    along = place.translation + _ALONG * robot.reach * place.rotation[:, 1]
                    etree.SubElement(body, "site", name=f"{name}/axis", pos=numbers(along))


def _add_equalities(robot: RobotModel, root: Any) -> None:
    """Add what joints that mimic others follow, and what closes the loops."""
    from lxml import etree

    found, tendons = etree.Element("equality"), etree.Element("tendon")
    anchor = robot.tree_joints[next(k for k in robot.independent() if k >= robot.n_base)]
    for joint, sources, value in followers(robot):
        if len(sources) > 1:
            # A length that stays what it is; of two joints there is an equality of their own.
            length = {**{name: -x for name, x in sources.items()}, joint: 1.0}
            add_tendon(tendons, {"name": f"{joint}_follows"}, length)
            kept = numbers([value, 0.0, 0.0, 0.0, 0.0])
            etree.SubElement(found, "tendon", tendon1=f"{joint}_follows", polycoef=kept)
        else:
            source, factor = next(iter(sources.items()), (anchor, 0.0))
            follows = numbers([value, factor, 0.0, 0.0, 0.0])
            etree.SubElement(found, "joint", joint1=joint, joint2=source, polycoef=follows)
    if len(tendons):
        root.append(tendons)
    for loop in robot.loops:
        mark = "weld" if loop.kind == "plane" else "connect"
        # A pin is two balls on its axis.
        for end in ("", "/axis") if loop.kind == "line" else ("",):
            ends = {"name": loop.name, "site1": loop.frame, "site2": loop.against}
            etree.SubElement(found, mark, {key: each + end for key, each in ends.items()})
    if len(found):
        root.append(found)


def add_tendon(parent: Any, attributes: Mapping[str, str], factors: Mapping[str, float]) -> Any:
    """Add a fixed tendon, whose length is a sum of joints' positions times factors."""
    from lxml import etree

    tendon = etree.SubElement(parent, "fixed", attributes)
    for joint, factor in factors.items():
        etree.SubElement(tendon, "joint", joint=joint, coef=numbers(factor))
    return tendon
