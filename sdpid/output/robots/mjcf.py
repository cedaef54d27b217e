"""Write identified inertias, armature and friction into an MJCF file."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.files import atomic_path
from sdpid.errors import ExportError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.output.robots.export_report import ExportReport, Written
from sdpid.output.robots.joint_friction import joint_attributes
from sdpid.output.robots.mjcf_skeleton import inertial_markup, mjcf_skeleton, quoted
from sdpid.output.robots.places import Kind, Tendon, couplings_of, tendons_markup
from sdpid.output.robots.urdf import source_text
from sdpid.output.robots.written_bodies import (
    SEED,
    STATES,
    FixedChild,
    UrdfTree,
    possible_body,
    require_consistent,
    require_same_efforts,
    rest_of,
    standard_parameters,
)
from sdpid.robot.description.inertials import NOTHING, rounded
from sdpid.robot.description.mjcf import read_mjcf
from sdpid.robot.description.origin import numbers, relative
from sdpid.robot.description.xml import encode_xml, is_mjcf, is_xml, parse_xml
from sdpid.robot.description.xml_edits import Document, Element
from sdpid.robot.friction.terms import Coulomb, Offset, RotorInertia, Viscous
from sdpid.robot.inertia import transform
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.geometry import link_placements, neutral
from sdpid.robot.model.model import RobotModel

# The attributes that an MJCF has for friction and rotor inertia.
PLACES: dict[Kind, str] = {
    Coulomb: "frictionloss",
    Viscous: "damping",
    RotorInertia: "armature",
}

# MuJoCo's dry friction is the sign of v + a/b, smeared: by default b is 105/s and the smear that of
# a light joint 0.1 rad/s. With these b is 526/s at its own time step, and the smear a hundredth.
STEEP = {"solreffriction": "0.004 1", "solimpfriction": "0.999 0.999 0.001"}


def write_mjcf(
    estimate: Estimate,
    *,
    target: str | os.PathLike[str],
    source: str | os.PathLike[str] | None = None,
    offsets: bool = False,
) -> ExportReport:
    """Write an MJCF with identified inertias, armature, damping and friction (extra ``sim``).

    From a URDF a new MJCF is made, with every link as a body under its name and without shapes.
    An MJCF is patched: only ``<inertial>`` elements and the joints' ``armature`` (rotor inertia),
    ``damping`` (viscous friction) and ``frictionloss`` (Coulomb friction) change, and of these
    only what the problem has a term for; and gravity where the base was found to be tilted. Dry
    friction gets ``solreffriction`` and ``solimpfriction`` that make it steep. One exception: where
    the problem has no rotor inertia the links hold that of the rotors, so that an ``armature`` of
    the source becomes zero. In a new MJCF, drives of two joints become fixed tendons. Bodies fixed
    to moving ones, and terms without a place, are treated as by `write_urdf`.

    The file's joint frames need not be the robot's, but the positions at which joints are at zero
    must, and its world must be the robot's base (or have a body with the name of the URDF's root
    link at its place). See docs/guides/exports.md.

    Parameters
    ----------
    estimate : Estimate
        Parameters to write; it must have `theta`.
    target : str or path
        File to write, whole or not at all; it may be the source. Meshes that the source names
        relative to itself are not copied.
    source : str or path, optional
        MJCF to change or URDF to start from, as a path or its text; by default the URDF that the
        robot was loaded from.
    offsets : bool, optional
        Write offsets as actuators with a constant force, behind those of the source. They are
        left out otherwise: mostly they are zero errors of sensors.

    Returns
    -------
    ExportReport
        What was written, what was left out, and what that costs.

    Raises
    ------
    ExportError
        When the estimate has no standard parameters, a link of it can be no body, friction is
        negative, or the source describes another robot.
    ModelError
        When the source is no XML.
    MissingExtraError
        When MuJoCo is not installed.

    Examples
    --------
    >>> report = sdpid.write_mjcf(estimate, target="identified.xml")
    >>> print(report.describe())
    identified.xml: wrote the inertia of 6 links and the friction of 6 joints
    >>> sdpid.load_robot("identified.xml")
    RobotModel('denso_vp6242', 6 coordinates, 6 links)
    """
    problem = estimate.problem
    # What the file is of: the robot under gravity as a tilt of the base turns it.
    robot = problem.robot.with_gravity(estimate.model().tilted_gravity)
    what = f"MJCF of '{robot.name}'"
    theta = standard_parameters(estimate, what, "MJCF")
    bodies = problem.feasible.bodies(theta)
    # MuJoCo loads no other bodies, whatever consistency the problem has.
    require_consistent(robot, bodies, "pseudo_inertia", what)
    patch, notes = open_source(robot, source, what)
    friction = joint_attributes(problem, theta, PLACES, what, tendons=patch.ours, offsets=offsets)
    written = friction.values
    notes = friction.notes + notes
    if any(lost.term == Offset.__name__ for lost in friction.left_out):
        notes += ("offsets have a place where they are asked for: offsets=True, or --offsets",)
    if not np.array_equal(robot.gravity, problem.robot.gravity):
        notes += (f"gravity is {patch.gravity()} m/s²: its base stands tilted, as found",)
    for link, body in enumerate(bodies):
        patch.body(link, body)
    patch.joints(written, clear_armature="armature" not in _attributes(written))
    patch.tendons(friction.tendons)
    patch.offsets(friction.offsets)
    result = patch.document.text()
    # It has compiled in a child process; only numbers have changed since.
    compiled = Compiled(robot, result, what, folder=patch.folder, ours=True)
    compiled.require_same_efforts(bodies)
    constant = np.array([*friction.offsets.values()]) if friction.offsets else None
    file = Written(estimate, compiled.attributes(), robot, compiled.couplings, constant)
    with atomic_path(target) as temporary:
        temporary.write_bytes(encode_xml(result))
    if patch.cleared:
        notes += (
            "armature of the source that the identified links hold already, now zero: "
            + ", ".join(patch.cleared),
        )
    return ExportReport(
        path=Path(target),
        links_changed=tuple(patch.changed),
        joints_changed=tuple(patch.joints_changed),
        lumped=tuple(patch.lumped),
        left_out=friction.left_out,
        friction_fitted=friction.fitted,
        kind="an MJCF",
        notes=notes,
        training=file.errors(),
        _written=file,
    )


def open_source(
    robot: RobotModel, source: str | os.PathLike[str] | None, what: str
) -> tuple[Patch, tuple[str, ...]]:
    """Return the MJCF to change, made from a URDF where the source is none, and notes on it."""
    if source is None and robot.urdf is None:
        text = mjcf_skeleton(robot, None)[0]
        return Patch(robot, text, what, folder=None, ours=True), ()
    text, folder = source_text(robot, source, what), _folder(source)
    if is_mjcf(text, what):
        return Patch(robot, text, what, folder=folder, ours=False), ()
    notes: tuple[str, ...] = ()
    root = parse_xml(text, what)
    text, impossible = mjcf_skeleton(robot, UrdfTree(text))
    if any(root.find(f"link/{shape}") is not None for shape in ("visual", "collision")):
        notes += (
            "shapes of the URDF are not in it; to keep them, convert the URDF with MuJoCo and give "
            "that file as the source",
        )
    if impossible:
        notes += (
            "links fixed to others with inertials that no body can have, now zero and counted in "
            "where they are fixed: " + ", ".join(impossible),
        )
    return Patch(robot, text, what, folder=folder, ours=True), notes


def _attributes(written: dict[str, dict[str, float]]) -> set[str]:
    return {attribute for values in written.values() for attribute in values}


def _folder(source: str | os.PathLike[str] | None) -> Path | None:
    """Return the folder of a source file, None for text."""
    if source is None or is_xml(source):
        return None
    return Path(source).resolve().parent


class Compiled:
    """A compiled MJCF text whose joints are matched with a robot's."""

    def __init__(
        self, robot: RobotModel, text: str, what: str, *, folder: Path | None, ours: bool
    ) -> None:
        self.robot, self.what, self.folder = robot, what, folder
        try:
            found = read_mjcf(text, what, folder=folder, trusted=ours)
        except ModelError as cause:
            raise ExportError(str(cause)) from None
        self.bodies, self.values = found.bodies, found.joint_values
        self.couplings = couplings_of(found.tendons, robot.joint_names)
        self._tendons = found.tendons
        self.model = RobotModel.from_pinocchio(found.pin_model)
        self.matched = self._match()
        owners = {joint: k for k, body in enumerate(self.bodies) for joint in body.joints}
        # The body that each of the robot's joints moves.
        self.carriers = [owners[joint] for joint in self.matched]
        self.placements = self._placements(self._states(neutral(robot)[None])[0][0])
        base = _root_link(robot)
        named = [k for k, body in enumerate(self.bodies) if base is not None and body.name == base]
        fixed = [k for k in named if self.bodies[k].carrier == 0]
        # The robot's base in the file's world.
        self.base = self.placements[fixed[0]] if fixed else np.eye(4)

    def _match(self) -> list[int]:
        """Return Pinocchio's joint of the file for each joint of the robot."""
        names, found = [str(name) for name in self.model.pin_model.names], []
        for i, name in enumerate(list(self.robot.pin_model.names)[1:], start=1):
            floating = i == 1 and self.robot.free_flyer
            if (floating and not self.model.free_flyer) or (not floating and name not in names):
                raise ExportError(
                    f"{self.what}: the source has no joint '{'free joint' if floating else name}'; "
                    "give the MJCF of the same robot."
                )
            found.append(1 if floating else names.index(name))
        others = [name for k, name in enumerate(names) if k and k not in found]
        if others:
            raise ExportError(
                f"{self.what}: the source has joints that the robot '{self.robot.name}' lacks: "
                f"{', '.join(others)}; identify the robot with them, or remove them."
            )
        return found

    def _states(self, q: Array, *rates: Array) -> list[Array]:
        """Return positions and rates (K, …) of the robot in the order of the file's joints."""
        robot, model = self.robot, self.model.pin_model
        configurations = robot.configuration(q)
        rates = tuple(rate @ robot.expansion.T for rate in rates)
        out = [np.zeros((len(q), model.nq)), *(np.zeros((len(q), model.nv)) for _ in rates)]
        for joint, number in zip(list(robot.pin_model.joints)[1:], self.matched, strict=True):
            to = model.joints[number]
            x = configurations[:, joint.idx_q : joint.idx_q + joint.nq]
            if joint.nq == 2:
                x = np.arctan2(x[:, 1:], x[:, :1])
            out[0][:, to.idx_q : to.idx_q + to.nq] = x
            for target, rate in zip(out[1:], rates, strict=True):
                target[:, to.idx_v : to.idx_v + to.nv] = rate[:, joint.idx_v : joint.idx_v + to.nv]
        return out

    def attributes(self) -> tuple[Array, Array, Array]:
        """Return dry friction, damping and armature (n,) of the robot's coordinates."""
        robot = self.robot
        found = {key: np.zeros(robot.pin_model.nv) for key in PLACES.values()}
        for i, name in enumerate(list(robot.pin_model.names)[1:], start=1):
            joint = robot.pin_model.joints[i]
            if joint.nv == 1:
                for key, values in found.items():
                    values[joint.idx_v] = self.values[name][key]
        # Beside what acts crosswise, a tendon adds to each of its joints.
        for each in self._tendons:
            for name, factor in zip(each.joints, each.factors, strict=True):
                if name in robot.joint_names:
                    at = robot.pin_model.joints[robot.pin_model.getJointId(name)].idx_v
                    found["armature"][at] += factor**2 * each.armature
                    found["damping"][at] += factor**2 * each.damping
        # Those of a joint that mimics another act on that one through the gear between them.
        ratio = np.abs(robot.expansion)
        return (
            found["frictionloss"] @ ratio,
            found["damping"] @ ratio**2,
            found["armature"] @ ratio**2,
        )

    def _placements(self, position: Array) -> Array:
        """Return the placements (bodies, 4, 4) in the world at a position (nq,)."""
        joints = [np.eye(4), *link_placements(self.model, position)]
        return np.stack([joints[body.carrier] @ body.placement for body in self.bodies])

    def require_same_efforts(self, bodies: Array) -> None:
        """Refuse a text whose rigid bodies need other efforts than the identified ones.

        Raises
        ------
        ExportError
            With the difference.
        """
        robot = self.robot
        gravity = self.base[:3, :3] @ robot.gravity
        model = RobotModel.from_pinocchio(self.model.pin_model, gravity=gravity.tolist())
        states = generic_states(robot, STATES, SEED)
        raw = model.inverse_dynamics(model.prior, *self._states(*states))
        order = np.concatenate(
            [
                np.arange(self.model.pin_model.joints[k].nv) + self.model.pin_model.joints[k].idx_v
                for k in self.matched
            ]
        )
        require_same_efforts(
            robot.inverse_dynamics(bodies, *states),
            raw[:, order] @ robot.expansion,
            self.what,
            "the source's joints are placed, turned or counted differently, or it overrides "
            "inertials (inertiafromgeom, boundmass, settotalmass). Give the MJCF of the robot "
            "that was identified.",
        )


class Patch(Compiled):
    """An MJCF text, compiled, and the edits that make it the identified robot."""

    def __init__(
        self, robot: RobotModel, text: str, what: str, *, folder: Path | None, ours: bool
    ) -> None:
        parse_xml(text, what)  # refuses document types, so that nothing is expanded below
        super().__init__(robot, text, what, folder=folder, ours=ours)
        self.document = Document(text)
        self.ours = ours
        self.elements = self._elements()
        for k in self.carriers:
            if self.carriers.count(k) > 1:
                raise ExportError(
                    f"{what}: body '{self.name(k)}' has several joints, and the links between "
                    "them have inertia; give each joint a body of its own, or leave source out."
                )
        self.changed: list[str] = []
        self.lumped: list[str] = []
        self.joints_changed: list[str] = []
        self.cleared: list[str] = []

    def _elements(self) -> list[Element]:
        """Return the element of every compiled body, the world's in the first place."""
        root = self.document.root
        found = [e for world in root.find_all("worldbody") for e in _nested(world)]
        names = [e.attributes.get("name", "") for e in found]
        if names != [body.name for body in self.bodies[1:]]:
            raise ExportError(
                f"{self.what}: MuJoCo finds {len(self.bodies) - 1} bodies, the text itself has "
                f"{len(names)}, or others (it includes files, replicates or attaches, or merges "
                "static bodies); save the compiled model as one file and give that."
            )
        return [root, *found]

    def body(self, link: int, identified: Array) -> None:
        """Write the body of a link, given in its joint frame."""
        carrier, T = self.carriers[link], self.frame(link)
        # In a text of our own, frames are those of the links.
        body = identified if self.ours else transform(identified, T[:3, :3], T[:3, 3])
        children = self.children(carrier)
        rest, name = rest_of(body, list(children.values()), "pseudo_inertia"), self.name(carrier)
        if rest is None:
            self.lumped.append(name)
            for number in children:
                self.write(number, inertial_markup(NOTHING))
        exact = [Fraction(x) for x in (body if rest is None else rest).tolist()]
        possible = possible_body(exact, "pseudo_inertia", name, self.what)
        self.write(carrier, inertial_markup(rounded(possible)))

    def frame(self, link: int) -> Array:
        """Return the placement of a link's joint frame in that of the file's body."""
        joint = self.base @ link_placements(self.robot)[link]
        return relative(self.placements[self.carriers[link]], joint)

    def children(self, carrier: int) -> dict[int, FixedChild]:
        """Return the bodies with mass that are fixed to one, by number: names may be missing."""
        own = self.bodies[carrier]
        return {
            k: FixedChild(other.name, other.theta, relative(own.placement, other.placement))
            for k, other in enumerate(self.bodies)
            if k != carrier and other.carrier == own.carrier and np.any(other.theta)
        }

    def name(self, body: int) -> str:
        """Return the name of a body by number, for messages where it has none."""
        return self.bodies[body].name or f"body {body}"

    def write(self, body: int, markup: str) -> None:
        """Write the <inertial> of a body by number."""
        element = self.elements[body]
        inertial = element.find("inertial")
        if inertial is None:
            self.document.insert_child(element, markup)
        else:
            self.document.replace(inertial, markup)
        self.changed.append(self.name(body))

    def joints(self, written: dict[str, dict[str, float]], *, clear_armature: bool) -> None:
        """Write the joints' numbers; those of joints that mimic another count at that one."""
        attributes = _attributes(written)
        model = self.robot.pin_model
        for i, carrier in enumerate(self.carriers):
            name = str(model.names[i + 1])
            if model.joints[i + 1].nv != 1:
                continue
            before, values = self.values[name], dict(written.get(name, {}))
            if name not in self.robot.joint_names:
                values = {a: 0.0 for a in attributes if before[a] != 0.0}
            if clear_armature and before["armature"] != 0.0:
                values["armature"] = 0.0
                self.cleared.append(name)
            if values:
                joint = self._joint(carrier, i)
                text = {key: numbers([value]) for key, value in values.items()}
                if values.get("frictionloss"):
                    text |= STEEP
                self.document.set_attributes(joint, text)
                self.joints_changed.append(name)

    def tendons(self, tendons: Sequence[Tendon]) -> None:
        """Write drives of two joints."""
        if tendons:
            markup = tendons_markup(tendons)
            self.document.insert_child(self.document.root, markup, last=True)

    def offsets(self, offsets: Mapping[str, float]) -> None:
        """Write constant efforts: what a drive gives beside them moves the joint."""
        lines = [
            f'  <general joint={quoted(joint)} gainprm="0" biastype="affine" '
            f'biasprm="{numbers([-value, 0.0, 0.0])}"/>'
            for joint, value in offsets.items()
        ]
        if lines:
            markup = "\n".join(["<actuator>", *lines, "</actuator>"])
            self.document.insert_child(self.document.root, markup, last=True)

    def gravity(self) -> str:
        """Write gravity in the file's world and return it in words."""
        found = self.base[:3, :3] @ self.robot.gravity
        options = self.document.root.find_all("option")
        if options:
            option = max(options, key=lambda each: "gravity" in each.attributes)
            self.document.set_attributes(option, {"gravity": numbers(found)})
        else:
            line = f'<option gravity="{numbers(found)}"/>'
            self.document.insert_child(self.document.root, line)
        return f"({', '.join(f'{each:.4g}' for each in found)})"

    def _joint(self, body: int, i: int) -> Element:
        """Return the element of a joint, which need not have a name."""
        name = str(self.robot.pin_model.names[i + 1])
        elements = list(_own(self.elements[body], "joint"))
        if len(elements) == 1 and elements[0].attributes.get("name", name) == name:
            return elements[0]
        raise ExportError(f"{self.what}: joint '{name}' is not written where its body is.")


def _own(element: Element, tag: str) -> Iterator[Element]:
    """Yield an element's children of a tag, those in frames included."""
    for child in element.children:
        if child.name == tag:
            yield child
        elif child.name == "frame":
            yield from _own(child, tag)


def _nested(element: Element) -> Iterator[Element]:
    """Yield all bodies within an element, parents first."""
    for body in _own(element, "body"):
        yield body
        yield from _nested(body)


def _root_link(robot: RobotModel) -> str | None:
    """Return the name of the link that the robot stands on, None where it floats or is unknown."""
    if robot.free_flyer or robot.urdf is None:
        return None
    return UrdfTree(robot.urdf).root_link()
