"""A base that was found to be tilted, in a URDF: a root link that is level, and a fixed joint."""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.robot.description.origin import matrix_rpy, numbers
from sdpid.robot.description.xml import add_child, parse_xml, xml_text

# Names of the link and of the joint; of others, no file is taken to be ours.
LINK, JOINT = "level_ground", "level_ground_to_base"


def base_turn(gravity: Array, found: Array) -> Array:
    """Return how a base stands (3, 3) in which gravity is `found` in place of `gravity`."""
    if np.array_equal(gravity, found):
        return np.eye(3)
    wanted, own = (each / np.linalg.norm(each) for each in (gravity, found))
    across, along = np.cross(own, wanted), own @ wanted
    # Rodrigues' formula for the least turn of the one into the other.
    K = np.array([np.cross(across, e) for e in np.eye(3)]).T
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + along))


def stand_on_level(robot: Any, root: str, turn: Array) -> None:
    """Put the root link of a ``<robot>``, as it is turned, on a new one that is level."""
    from lxml import etree

    joint = etree.Element("joint", name=JOINT, type="fixed")
    etree.SubElement(joint, "origin", xyz="0 0 0", rpy=numbers(matrix_rpy(turn)))
    etree.SubElement(joint, "parent", link=LINK)
    etree.SubElement(joint, "child", link=root)
    for element in (etree.Element("link", name=LINK), joint):
        add_child(robot, element, last=True)


def without_level(text: str) -> str:
    """Return a URDF without the link and the joint of `stand_on_level`, where it has them."""
    root = parse_xml(text, "URDF")
    names = {"link": LINK, "joint": JOINT}
    ours = [e for e in root.iterchildren("link", "joint") if e.get("name") == names[e.tag]]
    if [each.tag for each in ours] != ["link", "joint"]:
        return text
    for each in ours:
        if (before := each.getprevious()) is not None:
            before.tail = each.tail
        root.remove(each)
    return xml_text(root, text)
