"""A base that was found to be tilted, in a URDF: a root link that is level, and a fixed joint."""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

import numpy as np

from sdpid._common.arrays import Array
from sdpid.robot.description.origin import matrix_rpy, numbers
from sdpid.robot.description.xml import parse_xml
from sdpid.robot.description.xml_edits import Document, Element

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


def stand_on_level(document: Document, root: str, turn: Array) -> None:
    """Put the root link, as it is turned, on a new one that is level."""
    document.insert_child(
        document.root,
        f'<link name="{LINK}"/>\n'
        f'<joint name="{JOINT}" type="fixed">\n'
        f'  <origin xyz="0 0 0" rpy="{numbers(matrix_rpy(turn))}"/>\n'
        f'  <parent link="{LINK}"/>\n'
        f"  <child link={quoteattr(root)}/>\n"
        "</joint>",
        last=True,
    )


def without_level(text: str) -> str:
    """Return a URDF without the link and the joint of `stand_on_level`, where it has them."""
    parse_xml(text, "URDF")  # refuses document types, so that nothing is expanded below
    document = Document(text)
    ours = [e for e in document.root.children if _is_ours(e)]
    if [each.name for each in ours] != ["link", "joint"]:
        return text
    for each in ours:
        document.remove(each)
    return document.text()


def _is_ours(element: Element) -> bool:
    """Return whether an element is one that `stand_on_level` writes."""
    names = {"link": LINK, "joint": JOINT}
    return element.attributes.get("name") == names.get(element.name)
