"""The tree of a URDF for writing: moving links, the links fixed to them, and their elements."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from sdpid._common.arrays import Array
from sdpid.errors import ExportError, ModelError
from sdpid.robot.description.bodies import read_urdf_bodies
from sdpid.robot.description.urdf import check_urdf
from sdpid.robot.description.xml_edits import Document, Element
from sdpid.robot.model.model import RobotModel

# What a joint has once; of two, readers might take either.
_OF_JOINTS = ("origin", "axis", "limit", "dynamics", "mimic")


@dataclass(frozen=True, eq=False)
class FixedChild:
    """A link that is fixed to a moving one, directly or through others.

    Attributes
    ----------
    name : str
        The link.
    body : ndarray, shape (10,), or None
        Its inertial in its own frame; None where it has none.
    placement : ndarray, shape (4, 4)
        Its frame in that of the moving link.
    """

    name: str
    body: Array | None
    placement: Array


class UrdfTree:
    """Links and joints of a URDF, with their positions in its text.

    Parameters
    ----------
    text : str
        The URDF.

    Raises
    ------
    ModelError
        When it is not a URDF.
    """

    def __init__(self, text: str) -> None:
        # Also refuses document types, so that nothing is expanded below.
        _, mimics = check_urdf(text, "URDF", floating=True)
        self.document = Document(text)
        root = self.document.root
        self.links = {e.attributes.get("name", ""): e for e in root.find_all("link")}
        self.joints = {e.attributes.get("name", ""): e for e in root.find_all("joint")}
        self._child = {name: _end(joint, "child") for name, joint in self.joints.items()}
        # As they are written, in document order.
        _, self.bodies = read_urdf_bodies(text, "URDF")
        sources = {mimic.joint: mimic.source for mimic in mimics}
        self.mimics = {name: _last(sources, name) for name in sources}

    def root_link(self) -> str:
        """Return the link that is no joint's child."""
        children = set(self._child.values())
        roots = [name for name in self.links if name not in children]
        if len(roots) != 1:
            raise ModelError(f"URDF: {len(roots)} links have no parent, there must be one.")
        return roots[0]

    def moving_links(self, robot: RobotModel) -> list[str]:
        """Return the link that each joint of the robot moves, in Pinocchio's order.

        Raises
        ------
        ExportError
            When this URDF lacks a joint of the robot.
        """
        model = robot.pin_model
        names = []
        for i in range(1, model.njoints):
            if i == 1 and robot.free_flyer:
                names.append(self.root_link())
            elif model.names[i] in self.joints:
                names.append(self._child[model.names[i]])
            else:
                raise ExportError(
                    f"URDF of '{robot.name}': the source has no joint '{model.names[i]}'; give "
                    "the URDF of the same robot."
                )
        for name in names:
            if name not in self.links:
                raise ModelError(f"URDF: a joint's child is '{name}', which is no link.")
        return names

    def fixed_children(self, link: str) -> list[FixedChild]:
        """Return the links fixed to a link, directly or through others, in document order.

        Raises
        ------
        ModelError
            When a number of theirs cannot be read.
        """
        children = []
        for body in self.bodies:
            if body.carrier != link or body.name == link:
                continue
            if body.problems:
                raise ModelError(f"URDF: link '{body.name}': {body.problems[0]}.")
            theta = body.theta if body.described else None
            children.append(FixedChild(body.name, theta, body.placement))
        return children

    def require_unambiguous(self, links: Sequence[str], what: str) -> None:
        """Refuse a URDF in which readers might see different joints or bodies.

        Raises
        ------
        ExportError
            Naming what it has several of.
        """
        root = self.document.root
        several = [
            f"its {tag}s have the same name"
            for tag, found in (("link", self.links), ("joint", self.joints))
            if len(found) < len(root.find_all(tag))
        ]
        for name, joint in self.joints.items():
            several += _several(joint, f"<joint> '{name}'", _OF_JOINTS)
        family = [name for link in links for name in (link, *self._fixed_to(link))]
        for name in family:
            several += _several(self.links[name], f"<link> '{name}'", ("inertial",))
            for inertial in self.links[name].find_all("inertial"):
                tags = {child.name for child in inertial.children}
                several += _several(inertial, f"<inertial> of '{name}'", sorted(tags))
        if several:
            raise ExportError(f"{what}: readers may differ on the source: {several[0]}.")

    def _fixed_to(self, link: str) -> list[str]:
        """Return the names of the links fixed to a link."""
        return [body.name for body in self.bodies if body.carrier == link and body.name != link]


def _several(element: Element, what: str, tags: Iterable[str]) -> list[str]:
    """Return what an element has several of: readers might take either."""
    return [f"{what} has several <{tag}>" for tag in tags if len(element.find_all(tag)) > 1]


def _end(joint: Element, which: str) -> str:
    element = joint.find(which)
    return element.attributes.get("link", "") if element is not None else ""


def _last(sources: dict[str, str], name: str) -> str:
    """Return the joint at the end of a chain of mimic joints."""
    seen = {name}
    while name in sources and sources[name] not in seen:
        name = sources[name]
        seen.add(name)
    return name
