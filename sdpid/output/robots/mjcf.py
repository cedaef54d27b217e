"""Write identified inertias, armature and friction into an MJCF file."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.assurance.diagnostics.described import Resistances
from sdpid.errors import ExportError, ModelError
from sdpid.estimation.elasticity.result import Elasticity
from sdpid.estimation.estimate import Estimate
from sdpid.output.robots.elastic_gears import add_gears
from sdpid.output.robots.export_report import ExportReport, file_errors
from sdpid.output.robots.joint_friction import Kind, Role, Tendon, joint_attributes, of_position
from sdpid.output.robots.mjcf_skeleton import add_tendon, inertial_values, mjcf_skeleton
from sdpid.output.robots.position_tendons import BentFriction, tendon_elements
from sdpid.output.robots.urdf import Urdf
from sdpid.output.robots.written_bodies import (
    RobotText,
    child_of,
    source_text,
    standard_parameters,
)
from sdpid.robot.description.bodies import Inertial
from sdpid.robot.description.mjcf import read_mjcf
from sdpid.robot.description.xml import add_child, is_mjcf, is_xml, numbers, parse_xml, relative
from sdpid.robot.friction.position import Spring, way_of
from sdpid.robot.friction.terms import Coulomb, Offset, RotorInertia, Viscous
from sdpid.robot.model.geometry import link_placements
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.transmission import factors_of

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
    tendons: bool = False,
    steep: bool = True,
    elasticity: Elasticity | None = None,
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
    tendons : bool, optional
        Write friction over position (`PositionFriction`) as tendons with dry friction, into a new
        MJCF; else dry friction is constant.
    steep : bool, optional
        Whether dry friction is made steep, or is MuJoCo's by default, as fits of positions have it.
    elasticity : Elasticity, optional
        Of `identify_elasticity`: joints with a stiffness become two, that of the motor under the
        old name, with its friction, armature and actuators, and ``<name>_gear`` behind it.

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
    text, notes = open_source(robot, source, what)
    # MuJoCo loads no other bodies, whatever consistency the problem has.
    text.write_bodies(bodies, "pseudo_inertia")
    places: dict[Role, bool] = {"spring": True, "offset": offsets, "coupled": text.ours}
    places["bent"] = text.ours and tendons
    also = [role for role, asked in places.items() if asked]
    friction = joint_attributes(problem, theta, PLACES, what, also)
    notes = friction.notes + notes
    if any(lost.term == Offset.__name__ for lost in friction.left_out):
        notes += ("offsets have a place where they are asked for: offsets=True, or --offsets",)
    if not np.array_equal(robot.gravity, problem.robot.gravity):
        notes += (f"gravity is {text.write_gravity()} m/s²: its base stands tilted, as found",)
    text.dry = STEEP if steep else {}
    text.write_joints(friction.values)
    text.write_tendons(friction.tendons)
    text.write_bent(friction.bent)
    text.write_offsets(friction.offsets)
    written = text.read_back(bodies)
    # Of friction over position its mean: a description has no more.
    ways = zip(problem.friction.joint_names, np.eye(robot.n - robot.n_base), strict=True)
    means = [(way, friction.bent[x].mean, 0.0, 0.0) for x, way in ways if x in friction.bent]
    held = written.resistances().beside(means)
    errors = partial(
        file_errors,
        estimate,
        robot=robot,
        held=held,
        springs=written.springs(),
        offsets=text.constant(friction.offsets) if friction.offsets else None,
    )
    if text.cleared:
        notes += (
            "armature of the source that the identified links hold already, now zero: "
            + ", ".join(text.cleared),
        )
    if elasticity is not None:
        notes += add_gears(text, elasticity)
    return text.save(target, friction, notes, errors)


def open_source(
    robot: RobotModel, source: str | os.PathLike[str] | None, what: str
) -> tuple[Mjcf, tuple[str, ...]]:
    """Return the MJCF to change, made from a URDF where the source is none, and notes on it."""
    if source is None and robot.urdf is None:
        return Mjcf(robot, mjcf_skeleton(robot, None)[0], what, ours=True), ()
    text = source_text(robot, source, what)
    if is_mjcf(text, what):
        folder = None if source is None or is_xml(source) else Path(source).resolve().parent
        return Mjcf(robot, text, what, folder=folder), ()
    notes: tuple[str, ...] = ()
    root = parse_xml(text, what)
    if any(root.find(f"link/{shape}") is not None for shape in ("visual", "collision")):
        notes += (
            "shapes of the URDF are not in it; to keep them, convert the URDF with MuJoCo and give "
            "that file as the source",
        )
    text, impossible = mjcf_skeleton(robot, Urdf(robot, text))
    if impossible:
        notes += (
            "links fixed to others with inertials that no body can have, now zero and counted in "
            "where they are fixed: " + ", ".join(impossible),
        )
    return Mjcf(robot, text, what, ours=True), notes


class Mjcf(RobotText):
    """An MJCF, and its compiled model.

    Attributes
    ----------
    model : RobotModel
        The compiled model, its joints turned by the robot's coordinates.
    cleared : list of str
        Joints whose armature the identified links hold.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    text : str
        The MJCF.
    what : str
        What it is called in messages.
    folder : Path, optional
        Where the names of its meshes start.
    ours : bool, optional
        Whether its bodies are the robot's links, frame by frame.

    Raises
    ------
    ModelError
        When it is no XML.
    ExportError
        When MuJoCo does not load it, or it is of another robot.
    """

    kind = "MJCF"

    def __init__(
        self,
        robot: RobotModel,
        text: str,
        what: str,
        *,
        folder: Path | None = None,
        ours: bool = False,
    ) -> None:
        super().__init__(robot, what, text)
        self.folder, self.ours = folder, ours
        self.dry: Mapping[str, str] = STEEP
        self.cleared: list[str] = []
        self.root = parse_xml(text, what)
        try:
            found = read_mjcf(text, what, folder=folder)
        except ModelError as cause:
            raise ExportError(str(cause)) from None
        self.bodies, self._source, self._values = found.bodies, found, found.joint_values()
        self.elements = self._elements()
        model = RobotModel.from_pinocchio(found.pin_model)
        names = {str(name): k for k, name in enumerate(found.pin_model.names) if k}
        matched = self.match(names, 1 if model.free_flyer else None)
        if others := [name for name, k in names.items() if k not in matched]:
            raise ExportError(
                f"{what}: the source has joints that the robot '{robot.name}' lacks: "
                f"{', '.join(others)}; identify the robot with them, or remove them."
            )
        owners = {joint: k for k, body in enumerate(self.bodies) for joint in body.joints}
        self.carriers = [owners[joint] for joint in matched]
        for k in self.carriers:
            if self.carriers.count(k) > 1:
                raise ExportError(
                    f"{what}: body '{self.name(k)}' has several joints, and the links between "
                    "them have inertia; give each joint a body of its own, or leave source out."
                )
        joints = [model.pin_model.joints[k] for k in matched]
        self._order = np.concatenate([joint.idx_v + np.arange(joint.nv) for joint in joints])
        expansion, offset = np.zeros_like(robot.expansion), np.zeros_like(robot.offset)
        expansion[self._order], offset[self._order] = robot.expansion, robot.offset
        self.model = replace(
            model, joint_names=robot.joint_names, expansion=frozen(expansion), offset=frozen(offset)
        )
        placed = [np.eye(4), *link_placements(self.model)]
        self._placements = [placed[body.carrier] @ body.placement for body in self.bodies]
        # The robot's base in the file's world.
        self._base = np.eye(4)
        if not robot.free_flyer and robot.urdf is not None:
            root = Urdf(robot, robot.urdf).root_link
            named = [k for k, b in enumerate(self.bodies) if b.name == root and b.carrier == 0]
            self._base = self._placements[named[0]] if named else self._base

    def _elements(self) -> list[Any]:
        """Return the element of every compiled body, the world's in the first place."""
        found = [e for world in self.root.findall("worldbody") for e in _nested(world)]
        names = [e.get("name", "") for e in found]
        if names != [body.name for body in self.bodies[1:]]:
            raise ExportError(
                f"{self.what}: MuJoCo finds {len(self.bodies) - 1} bodies, the text itself has "
                f"{len(names)}, or others (it includes files, replicates or attaches, or merges "
                "static bodies); save the compiled model as one file and give that."
            )
        return [self.root, *found]

    def frame(self, link: int) -> Array:
        """Return the placement of a link's joint frame in that of the text's body."""
        if self.ours:
            return np.eye(4)
        joint = self._base @ link_placements(self.robot)[link]
        return relative(self._placements[self.carriers[link]], joint)

    def write(self, body: int, inertial: Inertial) -> None:
        """Write the ``<inertial>`` of a body by number."""
        own = child_of(self.elements[body], "inertial")
        own.attrib.clear()
        own.attrib.update(inertial_values(inertial))
        self.changed.append(self.name(body))

    def write_joints(self, values: Mapping[str, Mapping[str, float]]) -> None:
        """Write the joints' numbers, and how dry friction acts.

        Those of joints that mimic another count at that one. Where there is no armature, the links
        hold that of the rotors.
        """
        attributes = {attribute for each in values.values() for attribute in each}
        model = self.robot.pin_model
        for i, carrier in enumerate(self.carriers, start=1):
            if model.joints[i].nv != 1:
                continue
            name = str(model.names[i])
            before, new = self._values[name], dict(values.get(name, {}))
            if name not in values:
                new = {key: 0.0 for key in attributes if before.get(key)}
            if "armature" not in attributes and before["armature"] != 0.0:
                new["armature"] = 0.0
                self.cleared.append(name)
            if new:
                text = {key: numbers(value) for key, value in new.items()}
                how = self.dry if new.get("frictionloss") else {}
                self.joint_element(name, carrier).attrib.update({**text, **how})
                self.joints_changed.append(name)

    def joint_element(self, name: str, body: int) -> Any:
        """Return the element of a joint, which need not have a name."""
        elements = list(_own(self.elements[body], "joint"))
        if len(elements) == 1 and elements[0].get("name", name) == name:
            return elements[0]
        raise ExportError(f"{self.what}: joint '{name}' is not written where its body is.")

    def write_bent(self, bent: Mapping[str, BentFriction]) -> None:
        """Write friction over position."""
        elements, model = [], self.robot.pin_model
        for name, each in bent.items():
            i = model.getJointId(name)
            child = self.elements[self.carriers[i - 1]]
            parent = child.getparent()
            elements += tendon_elements(self.robot, i, each, child, parent)
        self.append("tendon", elements)

    def write_tendons(self, tendons: Mapping[str, Tendon]) -> None:
        """Write what moves no joint alone as tendons; the length of a motor's is its position."""
        from lxml import etree

        robot, found, drives = self.robot, etree.Element("tendon"), []
        motors = robot.joint_names[robot.n_base :]
        # Tendons that the source has for a motor keep their factors.
        there = {
            robot.joint_names[j]: (self.root.find(f"tendon/fixed[@name='{name}']"), gear, shift)
            for i, (j, gear, shift) in self._source.moved(robot).items()
            if (name := self._source.model.tendon(i).name)
        }
        for name, (way, attributes) in tendons.items():
            tendon, gear, shift = there.get(name, (None, 1.0, 0.0))
            if tendon is None:
                factors = factors_of(robot, way)
                tendon, shift = add_tendon(found, {"name": name}, factors), robot.way(factors)[1]
                gear = 1.0
            given = of_position(attributes, gear, shift)
            if "springref" in given:
                given["springlength"] = given.pop("springref")
            steep = STEEP if name in motors and given.get("frictionloss") else {}
            tendon.attrib.update({key: numbers(value) for key, value in given.items()} | steep)
        self.append("tendon", list(found))
        seats = {motor: robot.seat(motor) for motor in motors}
        if self.ours and any(seat != (motor, 1.0) for motor, seat in seats.items()):
            for motor, (joint, factor) in seats.items():
                at = {"joint": joint, "gear": numbers(1.0 / factor)} if joint else {"tendon": motor}
                drives.append(etree.Element("motor", name=motor, **at))
        self.append("actuator", drives)

    def write_offsets(self, offsets: Mapping[str, float]) -> None:
        """Write constant efforts: what a drive gives beside them moves the joint."""
        from lxml import etree

        elements = []
        for motor, value in offsets.items():
            joint, factor = self.robot.seat(motor)
            at = {"joint": joint} if joint else {"tendon": motor}
            bias = {"biastype": "affine", "biasprm": numbers([-value / factor, 0.0, 0.0])}
            elements.append(etree.Element("general", **at, gainprm="0", **bias))
        self.append("actuator", elements)

    def constant(self, offsets: Mapping[str, float]) -> Array:
        """Return the constant efforts (joints,) of motors and joints on the coordinates."""
        names = self.robot.joint_names[self.robot.n_base :]
        ways = (way_of("offset", each, self.robot, names)[0] for each in offsets)
        return np.asarray(
            sum(value * way for value, way in zip(offsets.values(), ways, strict=True))
        )

    def append(self, name: str, elements: Sequence[Any]) -> None:
        """Write an element behind all others, if there is anything in it."""
        from lxml import etree

        if elements:
            whole = etree.Element(name)
            whole.extend(elements)
            add_child(self.root, whole, last=True)

    def write_gravity(self) -> str:
        """Write gravity in the file's world and return it in words."""
        found = self._base[:3, :3] @ self.robot.gravity
        values = {"gravity": numbers(found)}
        options = self.root.findall("option") or [child_of(self.root, "option")]
        max(options, key=lambda each: "gravity" in each.attrib).attrib.update(values)
        return f"({', '.join(f'{each:.4g}' for each in found)})"

    def read_back(self, bodies: Array) -> Mjcf:
        """Return the written text, whose rigid bodies must need the efforts of the identified ones.

        Raises
        ------
        ExportError
            With the difference.
        """
        written = Mjcf(self.robot, self.text(), self.what, folder=self.folder, ours=True)
        self.require_same_efforts(
            self.robot,
            bodies,
            written.model.with_gravity(written._base[:3, :3] @ self.robot.gravity),
            "the source's joints are placed, turned or counted differently, or it overrides "
            "inertials (inertiafromgeom, boundmass, settotalmass). Give the MJCF of the robot "
            "that was identified.",
        )
        return written

    def resistances(self) -> Resistances:
        """Return dry friction, damping and armature of joints and fixed tendons."""
        robot, tendons = self.robot, self._source.tendons()
        found = ((robot.way(factors)[0][robot.n_base :], *own) for factors, own in tendons)
        return Resistances.of_joints(self.model).beside(found)

    def springs(self) -> tuple[Spring, ...]:
        """Return the springs of the file."""
        return tuple(self._source.springs(self.robot))


def _own(element: Any, tag: str) -> Iterator[Any]:
    """Yield an element's children of a tag, those in frames included."""
    for child in element.iterchildren(tag, "frame"):
        if child.tag == tag:
            yield child
        else:
            yield from _own(child, tag)


def _nested(element: Any) -> Iterator[Any]:
    """Yield all bodies within an element, parents first."""
    for body in _own(element, "body"):
        yield body
        yield from _nested(body)
