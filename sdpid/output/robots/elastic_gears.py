"""Put springs between motors and links into an MJCF."""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid.errors import ExportError, ModelError
from sdpid.estimation.elasticity.result import Elasticity
from sdpid.robot.description.mjcf import read_mjcf
from sdpid.robot.description.xml import add_child, numbers

# Where a body is placed, and what its elements inherit.
_PLACE = ("pos", "quat", "axisangle", "euler", "xyaxes", "zaxis")
_KEPT = (*_PLACE, "childclass")
# What of a joint the spring has, too; all else is the motor's, and zero for the spring, whatever
# the defaults of the file are.
_SAME = ("class", "type", "axis", "pos")
_NONE = {
    **dict.fromkeys(("armature", "damping", "frictionloss", "ref", "springref", "margin"), "0"),
    **dict.fromkeys(("limited", "actuatorfrclimited"), "false"),
}
# MuJoCo wants bodies that move to have a mass.
_TINY = {"pos": "0 0 0", "mass": "1e-9", "diaginertia": "1e-9 1e-9 1e-9"}
# Stiffness over identified and stated rotor inertias that differ by less is the same.
_SAME_ROTOR = 1e-3


def add_gears(text: Any, elasticity: Elasticity) -> tuple[str, ...]:
    """Put a motor before the link of every joint with a stiffness, and return notes.

    The text is an `Mjcf` with all else written. The motor's body has the joint, its name, friction,
    armature and actuators; the link's turns against it by a joint with the stiffness, about the
    same axis.

    Raises
    ------
    ExportError
        When a joint stands in a frame of its own, or MuJoCo does not load the result.
    """
    from lxml import etree

    robot, stiff = text.robot, np.isfinite(elasticity.stiffness)
    if elasticity.joint_names != robot.joint_names:
        raise ExportError(f"{text.what}: the elasticity is that of another robot.")
    if not stiff.any():
        return ("no joint of it is elastic: no stiffness was found",)
    excluded = []
    for i, carrier in enumerate(text.carriers, start=1):
        name = str(robot.pin_model.names[i])
        j = robot.joint_names.index(name) if name in robot.joint_names else None
        if j is None or not stiff[j]:
            continue
        joint, body = text.joint_element(name, carrier), text.elements[carrier]
        if joint.getparent() is not body:
            raise ExportError(
                f"{text.what}: joint '{name}' stands in a frame; save the compiled model as one "
                "file and give that."
            )
        parent = body.getparent()
        motor = etree.Element("body", name=f"{text.name(carrier)}_motor")
        motor.attrib.update({key: body.attrib[key] for key in _KEPT if key in body.attrib})
        for key in _PLACE:
            body.attrib.pop(key, None)
        spring = {key: joint.attrib[key] for key in _SAME if key in joint.attrib}
        spring |= {"name": f"{name}_gear", **_NONE, "stiffness": numbers(elasticity.stiffness[j])}
        parent.replace(body, motor)
        motor.extend([etree.Element("inertial", _TINY), joint, body])
        add_child(body, etree.Element("joint", spring))
        # Bodies do not touch what carries them, but by MuJoCo's rules the motor's does now.
        if parent.tag == "body" and parent.get("name") and body.get("name"):
            names = {"body1": parent.get("name"), "body2": body.get("name")}
            excluded.append(etree.Element("exclude", names))
    text.append("contact", excluded)
    notes = [
        "elastic gears of "
        + ", ".join(name for name, own in zip(robot.joint_names, stiff, strict=True) if own)
        + ": joints of stiffness between motors and links; their damping was not identified and "
        "is none"
    ]
    for keyframe in text.root.findall("keyframe"):
        text.root.remove(keyframe)
        notes.append("keyframes left out: they have no positions of the gears")
    etree.indent(text.root, "  ")
    try:
        read_mjcf(text.text(), text.what, folder=text.folder)
    except ModelError as cause:
        raise ExportError(f"with elastic gears: {cause}") from None
    held, stated = text.resistances(), elasticity.rotor_inertia
    armature = held.armature @ held.ways**2
    off = stiff & (np.abs(armature - stated) > _SAME_ROTOR * np.maximum(armature, stated))
    for j in np.flatnonzero(off).tolist():
        notes.append(
            f"armature of {robot.joint_names[j]} is {armature[j]:.4g} kg·m² as identified, not "
            f"{stated[j]:.4g} as stated: links hold the rest; identify it with "
            f"constraints.Fixed({{'Ia{j + 1}': {stated[j]:.4g}}}) to have it at the motor"
        )
    return tuple(notes)
