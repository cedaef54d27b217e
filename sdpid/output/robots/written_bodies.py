"""Texts of robots whose bodies are those of a `RobotModel`'s links, and what is written into them.

Every format has bodies, some fixed to others, and joints that move them. `RobotText` matches these
with the robot's and splits each identified body among the one that moves and those fixed to it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid._common.files import PathLike, atomic_path
from sdpid.errors import ExportError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.output.robots.export_report import ExportReport, FileErrors
from sdpid.output.robots.joint_friction import JointAttributes
from sdpid.robot.description.bodies import NOTHING, DescribedBody, Inertial, exists, inside, rounded
from sdpid.robot.description.mjcf import MjcfBody
from sdpid.robot.description.xml import add_child, encode_xml, read_expanded, relative, xml_text
from sdpid.robot.inertia import Consistency, margin, transform
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.model import RobotModel

# How a body is split among a moving link and those fixed to it.
Fixed: TypeAlias = Literal["keep", "merge"] | Mapping[str, ArrayLike]

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
_STATES, _SEED = 8, 20240229


class FixedChild(NamedTuple):
    """A body that is fixed to a moving one, in its own frame; all zero where it has no inertial."""

    name: str
    body: Array
    placement: Array


class RobotText(ABC):
    """A text of a robot, and the edits that make it the identified one.

    Attributes
    ----------
    robot : RobotModel
        The robot.
    what : str
        What it is called in messages.
    root : element
        The text's root element, which is edited in place.
    bodies, elements : sequence
        All bodies of the text, and their elements.
    carriers : list of int
        The body that each of the robot's joints moves, by its number.
    changed, joints_changed, lumped, flat : list of str
        Bodies and joints that were written, bodies that took over those fixed to them, and bodies
        that violate the triangle inequality.
    """

    kind: ClassVar[str]
    root: Any
    bodies: Sequence[DescribedBody | MjcfBody]
    elements: Sequence[Any]
    carriers: list[int]

    def __init__(self, robot: RobotModel, what: str, text: str) -> None:
        self.robot, self.what, self._given = robot, what, text
        self.changed, self.joints_changed, self.lumped, self.flat = (list[str]() for _ in range(4))

    def text(self) -> str:
        """Return the text with all edits."""
        return xml_text(self.root, self._given)

    def match(self, moved: Mapping[str, int], root: int | None) -> list[int]:
        """Return the body that each of the robot's joints moves, given those of the text's joints.

        Raises
        ------
        ExportError
            When the text lacks a joint, or a floating base.
        """
        found = []
        for i, name in enumerate(map(str, list(self.robot.pin_model.names)[1:])):
            floating = i == 0 and self.robot.free_flyer
            if (body := root if floating else moved.get(name)) is None:
                raise ExportError(
                    f"{self.what}: the source has no joint '{'free joint' if floating else name}'; "
                    f"give the {self.kind} of the same robot."
                )
            found.append(body)
        return found

    def name(self, body: int) -> str:
        """Return the name of a body by number, for messages where it has none."""
        return self.bodies[body].name or f"body {body}"

    def frame(self, link: int) -> Array:
        """Return the placement of a link's joint frame in that of the text's body."""
        return np.eye(4)

    def children(self, carrier: int) -> dict[int, FixedChild]:
        """Return the bodies fixed to one, directly or through others, by number."""
        own = self.bodies[carrier]
        return {
            k: FixedChild(
                other.name,
                np.zeros(10) if other.theta is None else other.theta,
                relative(own.placement, other.placement),
            )
            for k, other in enumerate(self.bodies)
            if k != carrier and other.carrier == own.carrier
        }

    @abstractmethod
    def write(self, body: int, inertial: Inertial) -> None:
        """Write the inertial of a body by number."""

    @abstractmethod
    def write_joints(self, values: Mapping[str, Mapping[str, float]]) -> None:
        """Write attributes of joints by name."""

    def write_bodies(self, bodies: Array, consistency: Consistency, fixed: Fixed = "keep") -> None:
        """Write the links' identified bodies (links, 10), given in their joint frames.

        Raises
        ------
        ExportError
            When one can be no body, or cannot be split as asked.
        """
        asked = {} if isinstance(fixed, str) else fixed
        for each, body in zip(self.robot.link_names, bodies, strict=True):
            possible_body(body, consistency, each, self.what)
        for link, (carrier, body) in enumerate(zip(self.carriers, bodies, strict=True)):
            T = self.frame(link)
            if not np.array_equal(T, np.eye(4)):
                body = transform(body, T[:3, :3], T[:3, 3])
            children, name = self.children(carrier), self.name(carrier)
            given = {
                k: child._replace(body=np.asarray(asked[child.name]))
                for k, child in children.items()
                if child.name in asked
            }
            heavy = {k: c for k, c in (children | given).items() if np.any(c.body)}
            merged = fixed == "merge" and bool(heavy)
            rest = None if merged else rest_of(body, list(heavy.values()), consistency)
            if rest is None and given:
                raise ExportError(
                    f"{self.what}: link '{name}' cannot be split as asked: no body can be the rest "
                    f"of its {body[0]:.6g} kg without {', '.join(c.name for c in heavy.values())}, "
                    "or one of those cannot exist; give less, or fixed='keep'."
                )
            for k, child in given.items():
                self.write(k, rounded(child.body.tolist()))
            if rest is None:
                self.lumped.append(name)
                for k in heavy:
                    self.write(k, NOTHING)
            own = body if rest is None else rest
            written = possible_body(own, consistency, name, self.what)
            if not exists(written.mass, written.moments, "pseudo_inertia"):
                self.flat.append(name)
            self.write(carrier, written)

    def require_same_efforts(
        self, robot: RobotModel, bodies: Array, written: RobotModel, reason: str
    ) -> None:
        """Refuse a written robot whose efforts differ from those of the identified bodies.

        Raises
        ------
        ExportError
            With the difference and a reason.
        """
        states = generic_states(self.robot, _STATES, _SEED)
        expected = robot.inverse_dynamics(bodies, *states)
        found = written.inverse_dynamics(written.prior, *states)
        error, scale = float(np.abs(found - expected).max()), float(np.abs(expected).max())
        if not error <= _READ_BACK * max(scale, 1.0):
            raise ExportError(
                f"{self.what}: the efforts of the written robot differ from the identified ones by "
                f"{error:.3g} of {scale:.3g} N·m (limit {_READ_BACK:.0e} of it); {reason}"
            )

    def save(
        self,
        target: PathLike,
        friction: JointAttributes,
        notes: tuple[str, ...],
        errors: FileErrors,
    ) -> ExportReport:
        """Write the text to a file, whole or not at all, and return what it holds."""
        with atomic_path(target) as temporary:
            temporary.write_bytes(encode_xml(self.text()))
        return ExportReport(
            path=Path(target),
            links_changed=tuple(self.changed),
            joints_changed=tuple(self.joints_changed),
            lumped=tuple(self.lumped),
            left_out=friction.left_out,
            friction_fitted=friction.fitted,
            triangle_violations=tuple(self.flat),
            kind=f"{'an' if self.kind == 'MJCF' else 'a'} {self.kind}",
            notes=notes,
            training=errors(None),
            _errors=errors,
        )


def child_of(parent: Any, name: str, *, last: bool = False) -> Any:
    """Return the first child of that tag, which is added where there is none."""
    from lxml import etree

    if (child := parent.find(name)) is None:
        add_child(parent, child := etree.Element(name), last=last)
    return child


def write_inertial(link: Any, values: Mapping[str, Mapping[str, str]]) -> None:
    """Write the attributes of an ``<inertial>`` by tag into a link, which may lack one."""
    inertial = child_of(link, "inertial")
    for name, attributes in values.items():
        child_of(inertial, name, last=True).attrib.update(attributes)


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


def source_text(robot: RobotModel, source: PathLike | None, what: str) -> str:
    """Return the text to change: of a file, the source itself, or the robot's own URDF.

    Raises
    ------
    ExportError
        When there is none, or it cannot be read.
    """
    if source is None:
        if robot.urdf is None:
            raise ExportError(
                f"{what}: the robot was not loaded from a URDF; give the file to change as source."
            )
        return robot.urdf
    try:
        return read_expanded(source).text
    except ModelError as cause:
        raise ExportError(f"{what}: {cause}") from None


def _rounding(bodies: Array) -> Array:
    """Return the rounding error of the inertia about the center of mass, in kg·m²."""
    return np.asarray(_ROUNDING * np.abs(bodies[..., 4:]).max(axis=-1))


def possible(bodies: Array, consistency: Consistency) -> bool:
    """Return whether bodies (..., 10) satisfy a consistency, but for rounding."""
    return bool(np.all(margin(bodies, consistency) >= -_rounding(bodies)))


def rest_of(body: Array, children: Sequence[FixedChild], consistency: Consistency) -> Array | None:
    """Return a body minus its fixed children's bodies, None where that is impossible.

    None also where a child's own inertial is impossible.
    """
    if not children:
        return body
    if not possible(np.array([child.body for child in children]), consistency):
        return None
    parts = [transform(x, place[:3, :3], place[:3, 3]) for _, x, place in children]
    rest = body - np.sum(parts, axis=0)
    enough = rest[0] > 0.0 and margin(rest, consistency) >= _INSIDE + _rounding(rest)
    return rest if enough else None


def possible_body(body: Array, consistency: Consistency, link: str, what: str) -> Inertial:
    """Return the numbers of a body, off the edge of the consistent set by a few roundings.

    Raises
    ------
    ExportError
        When it has no mass, or is further outside than rounding, with its margin.
    """
    if not body[0] > 0.0:
        raise ExportError(
            f"{what}: link '{link}' has a mass of {body[0]:.6g} kg, it must be positive; solve "
            "with a consistency."
        )
    exact = [*map(Fraction, body.tolist())]
    found = inside(exact, consistency) if possible(body, consistency) else None
    if found is None:
        raise ExportError(
            f"{what}: link '{link}' is not consistent, its margin is "
            f"{margin(body, consistency):.3g} kg·m² and the least is 0; solve with a consistency, "
            "or with a positive Constraints.margin if the solver stopped just outside."
        )
    return rounded(found)
