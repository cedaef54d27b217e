"""Make the MJCF of a robot's kinematics, into which identified numbers are then written.

MuJoCo loads URDF itself, but welds fixed links into what carries them and saves six digits. Here
every link stays a body under its name, and every number is written in full.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.plant.mujoco_model import joint_axis
from sdpid.output.robots.written_bodies import FixedChild, UrdfTree, possible, possible_body
from sdpid.robot.description.inertials import Inertial, rounded, tensor
from sdpid.robot.description.mjcf import quaternion_of
from sdpid.robot.description.origin import numbers
from sdpid.robot.model.model import RobotModel

# Of two balls that stand for a pin one is this share of the robot's reach along its axis.
_ALONG = 0.1


def quoted(text: str) -> str:
    """Return text as an attribute with its quotes."""
    from xml.sax.saxutils import quoteattr

    return quoteattr(text)


def _body(link: str) -> str:
    """Return the name of a link's body as an attribute; MuJoCo keeps ``world`` for itself."""
    return quoted("world_link" if link == "world" else link)


def inertial_markup(body: Inertial) -> str:
    """Return the <inertial> of a body.

    Principal moments and their axes rather than ``fullinertia``: releases of MuJoCo differ in how
    exactly they take a full tensor apart.
    """
    if not body.mass:
        return '<inertial pos="0 0 0" mass="0" diaginertia="0 0 0"/>'
    moments, axes = np.linalg.eigh(np.array(tensor(body.moments), dtype=np.float64))
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    # Readers would refuse a body that misses the triangle inequality by a rounding.
    moments[2] = min(moments[2], moments[0] + moments[1])
    return (
        f'<inertial pos="{numbers(body.com)}" quat="{numbers(quaternion_of(axes))}" '
        f'mass="{numbers(body.mass)}" diaginertia="{numbers(moments)}"/>'
    )


def mjcf_skeleton(robot: RobotModel, tree: UrdfTree | None) -> tuple[str, tuple[str, ...]]:
    """Return the MJCF of a robot's kinematics, without shapes.

    Links fixed to moving ones are bodies with the description's own inertials. Moving bodies have
    unit inertials, to be replaced. The second result names the fixed links whose inertials no body
    can have: MuJoCo would not load them, and they are zero.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    tree : UrdfTree or None
        Its URDF, where there is one: for fixed links and names.
    """
    model = robot.pin_model
    names = robot.link_names if tree is None else tuple(tree.moving_links(robot))
    columns = {name: j for j, name in enumerate(robot.joint_names)}
    impossible: list[str] = []
    children: dict[int, list[int]] = {}
    for i in range(1, model.njoints):
        children.setdefault(int(model.parents[i]), []).append(i)

    def body(i: int, depth: int) -> list[str]:
        pad = "  " * depth
        place = model.jointPlacements[i]
        out = [f"{pad}<body name={_body(names[i - 1])}{_pose(place.homogeneous)}>"]
        out.append(f'{pad}  <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>')
        out.append(f"{pad}  {_joint(robot, i, columns.get(model.names[i]))}")
        out += [f"{pad}  {site}" for site in _sites(robot, i)]
        for child in [] if tree is None else tree.fixed_children(names[i - 1]):
            inertial = child.body
            if inertial is not None and not _possible(inertial):
                impossible.append(child.name)
                inertial = None
            out += _fixed(replace(child, body=inertial), depth + 1)
        for k in children.get(i, ()):
            out += body(k, depth + 1)
        return [*out, f"{pad}</body>"]

    lines = [
        f"<mujoco model={quoted(robot.name)}>",
        '  <compiler angle="radian" autolimits="true" inertiafromgeom="false"/>',
        f'  <option gravity="{numbers(robot.gravity)}"/>',
        "  <worldbody>",
    ]
    lines += [f"    {site}" for site in _sites(robot, 0)]
    for i in children.get(0, ()):
        lines += body(i, 2)
    lines.append("  </worldbody>")
    followers = [i for i in range(1, model.njoints) if _follows(robot, i)]
    if followers or robot.loops:
        lines.append("  <equality>")
        lines += [f"    {_equality(robot, i)}" for i in followers]
        lines += [f"    {closure}" for closure in _closures(robot)]
        lines.append("  </equality>")
    return "\n".join([*lines, "</mujoco>", ""]), tuple(impossible)


def _possible(inertial: Array) -> bool:
    """Return whether there is nothing, or a body that MuJoCo loads."""
    return not np.any(inertial) or possible(inertial, "pseudo_inertia")


def _pose(placement: Array) -> str:
    quaternion = quaternion_of(placement[:3, :3])
    return f' pos="{numbers(placement[:3, 3])}" quat="{numbers(quaternion)}"'


def _fixed(child: FixedChild, depth: int) -> list[str]:
    pad = "  " * depth
    opening = f"{pad}<body name={_body(child.name)}{_pose(child.placement)}"
    if child.body is None or not np.any(child.body):
        return [opening + "/>"]
    body = [Fraction(x) for x in child.body.tolist()]
    possible = possible_body(body, "pseudo_inertia", child.name, "MJCF")
    markup = inertial_markup(rounded(possible))
    return [opening + ">", f"{pad}  {markup}", f"{pad}</body>"]


def _joint(robot: RobotModel, i: int, column: int | None) -> str:
    joint, name = robot.pin_model.joints[i], str(robot.pin_model.names[i])
    if joint.nv == 6:
        return f"<freejoint name={quoted(name)}/>"
    kind, axis = joint_axis(joint)
    mark = "hinge" if kind == "revolute" else "slide"
    out = f'<joint name={quoted(name)} type="{mark}" axis="{numbers(axis)}"'
    if column is not None:
        lower, upper = robot.position_limits[column]
        if lower < upper < np.inf:
            out += f' range="{numbers([lower, upper])}"'
        effort = robot.effort_limits[column]
        if np.isfinite(effort):
            out += f' actuatorfrcrange="{numbers([-effort, effort])}"'
    return out + "/>"


def _sites(robot: RobotModel, i: int) -> Iterator[str]:
    """Yield the sites on a joint's body at which loops close, for an axis another one along it."""
    model = robot.pin_model
    for loop in robot.loops:
        for name in (loop.frame, loop.against):
            frame = model.frames[robot.frame_numbers[name]]
            if frame.parentJoint != i:
                continue
            place = frame.placement
            yield f"<site name={quoted(name)}{_pose(place.homogeneous)}/>"
            if loop.kind == "line":
                along = place.translation + _ALONG * robot.reach * place.rotation[:, 1]
                yield f'<site name={quoted(name + "/axis")} pos="{numbers(along)}"/>'


def _closures(robot: RobotModel) -> Iterator[str]:
    """Yield the equalities that close the loops: a pin is two balls on its axis."""
    for loop in robot.loops:
        mark = "weld" if loop.kind == "plane" else "connect"
        for end in ("", "/axis") if loop.kind == "line" else ("",):
            name, own, other = (quoted(f"{x}{end}") for x in (loop.name, loop.frame, loop.against))
            yield f"<{mark} name={name} site1={own} site2={other}/>"


def _follows(robot: RobotModel, i: int) -> bool:
    """Return whether a joint mimics another."""
    return robot.pin_model.joints[i].nv == 1 and robot.pin_model.names[i] not in robot.joint_names


def _equality(robot: RobotModel, i: int) -> str:
    row = robot.pin_model.joints[i].idx_v
    source = int(np.flatnonzero(robot.expansion[row])[0]) if robot.expansion[row].any() else 0
    coefficients = [robot.offset[row], robot.expansion[row, source], 0.0, 0.0, 0.0]
    return (
        f"<joint joint1={quoted(str(robot.pin_model.names[i]))} "
        f'joint2={quoted(robot.joint_names[source])} polycoef="{numbers(coefficients)}"/>'
    )
