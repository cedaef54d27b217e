"""Bodies to be written for every format of robot, and the tree of a URDF that they go into."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import ExportError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.robot.description.bodies import read_urdf_bodies
from sdpid.robot.description.inertials import inside
from sdpid.robot.description.urdf import check_urdf
from sdpid.robot.description.xml_edits import Document, Element
from sdpid.robot.inertia import Consistency, margin, transform
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


# Rounding in the inertia about the center of mass, as a fraction of the size of the inertia that
# it is the difference of. A margin negative by no more than this is not negative.
_ROUNDING = 1e-14
# Readers reject a body that rounding has put on the edge (MuJoCo: principal moments below 1e-14
# kg·m², or a triangle inequality missed by one bit). Written bodies are at least this far inside,
# kg·m²; it changes efforts by some 1e-13 N·m.
_INSIDE = 1e-13
# The written file is read back at generic states; its efforts may differ by this fraction of the
# largest one.
_READ_BACK = 1e-10
STATES, SEED = 8, 20240229


def standard_parameters(estimate: Estimate, what: str, kind: str) -> Array:
    """Return theta of an estimate, or refuse an estimate without it.

    Raises
    ------
    ExportError
        When it has base parameters only.
    """
    if estimate.theta is None:
        raise ExportError(
            f"{what}: the estimate by {estimate.method} has base parameters only, "
            f"which no {kind} can hold; use solve_sdp or another solver that returns theta."
        )
    return estimate.theta


def _rounding(bodies: Array) -> Array:
    """Return the rounding error of the inertia about the center of mass, in kg·m²."""
    return np.asarray(_ROUNDING * np.abs(bodies[..., 4:]).max(axis=-1))


def require_consistent(
    robot: RobotModel, bodies: Array, consistency: Consistency, what: str
) -> None:
    """Raise where a body (links, 10) has no mass or violates the consistency.

    Raises
    ------
    ExportError
        With the link's name and its margin.
    """
    margins = margin(bodies, consistency)
    for name, body, value, error in zip(
        robot.link_names, bodies, margins, _rounding(bodies), strict=True
    ):
        if not body[0] > 0.0:
            raise ExportError(
                f"{what}: link '{name}' has a mass of {body[0]:.6g} kg, it must "
                "be positive; solve with a consistency."
            )
        if value < -error:
            raise ExportError(
                f"{what}: link '{name}' is not consistent, its margin is "
                f"{value:.3g} kg·m² and the least is 0; solve with a consistency, or with a "
                "positive Constraints.margin if the solver stopped just outside."
            )


def require_same_efforts(expected: Array, found: Array, what: str, reason: str) -> None:
    """Refuse a written robot whose efforts differ from those of the identified bodies.

    Raises
    ------
    ExportError
        With the difference and a reason.
    """
    error, scale = float(np.abs(found - expected).max()), float(np.abs(expected).max())
    if not error <= _READ_BACK * max(scale, 1.0):
        raise ExportError(
            f"{what}: the efforts of the written robot differ from the identified ones by "
            f"{error:.3g} of {scale:.3g} N·m (limit {_READ_BACK:.0e} of it); {reason}"
        )


def possible(bodies: Array, consistency: Consistency) -> bool:
    """Return whether bodies (..., 10) satisfy a consistency, but for rounding."""
    return bool(np.all(margin(bodies, consistency) >= -_rounding(bodies)))


def rest_of(body: Array, children: Sequence[FixedChild], consistency: Consistency) -> Array | None:
    """Return a body minus its fixed children's bodies, None where that is impossible.

    None also where a child's own inertial is impossible.
    """
    if not children:
        return body
    own = np.array([child.body for child in children])
    if not possible(own, consistency):
        return None
    inside = [
        transform(c.body, c.placement[:3, :3], c.placement[:3, 3])
        for c in children
        if c.body is not None
    ]
    rest = body - np.sum(inside, axis=0)
    enough = rest[0] > 0.0 and margin(rest, consistency) >= _INSIDE + _rounding(rest)
    return rest if enough else None


def possible_body(
    body: Sequence[Fraction], consistency: Consistency, link: str, what: str
) -> list[Fraction]:
    """Return a body off the edge of the consistent set by a few roundings, exactly.

    Raises
    ------
    ExportError
        When it is further outside than rounding.
    """
    found = inside(body, consistency)
    if found is None:
        raise ExportError(
            f"{what}: link '{link}' is not consistent; solve with a consistency, or with a "
            "positive Constraints.margin if the solver stopped just outside."
        )
    return found
