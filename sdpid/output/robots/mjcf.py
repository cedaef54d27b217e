"""Identified inertias, armature and friction, as an MJCF file for MuJoCo."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.files import atomic_path
from sdpid.errors import ExportError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.output.robots.compiled_mjcf import CompiledMjcf
from sdpid.output.robots.mjcf_skeleton import inertial_markup, mjcf_skeleton, numbers
from sdpid.output.robots.urdf import ExportReport, source_text
from sdpid.output.robots.urdf_tree import FixedChild, UrdfTree
from sdpid.output.robots.written_bodies import (
    add_shapes,
    joint_numbers,
    lifted,
    require_consistent,
    rest_of,
    standard_parameters,
)
from sdpid.robot.description.mjcf import check_compiles
from sdpid.robot.description.xml import encode_xml, is_mjcf, is_xml, parse_xml
from sdpid.robot.description.xml_edits import Document, Element
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import Coulomb, RotorInertia, Viscous
from sdpid.robot.inertia import transform
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.geometry import link_placements
from sdpid.robot.model.model import RobotModel

# The written file is read back; its efforts may differ by this fraction of the largest one.
_READ_BACK = 1e-10
_STATES, _SEED = 8, 20240229

_PLACES: dict[type[FrictionTerm], str] = {
    Coulomb: "frictionloss",
    Viscous: "damping",
    RotorInertia: "armature",
}
_COMPILED = {
    "frictionloss": "dof_frictionloss",
    "damping": "dof_damping",
    "armature": "dof_armature",
}


def write_mjcf(
    estimate: Estimate,
    *,
    target: str | os.PathLike[str],
    source: str | os.PathLike[str] | None = None,
) -> ExportReport:
    """Write an MJCF with identified inertias, armature, damping and friction (extra ``sim``).

    From a URDF a new MJCF is made, with every link as a body under its name and without shapes.
    An MJCF is patched: only ``<inertial>`` elements and the joints' ``armature`` (rotor inertia),
    ``damping`` (viscous friction) and ``frictionloss`` (Coulomb friction) change, and of these
    only what the problem has a term for; all other bytes stay as they are. One exception: where
    the problem has no rotor inertia the links hold that of the rotors, so that an ``armature`` of
    the source becomes zero.

    Bodies fixed to moving ones are treated as `write_urdf` does: they keep their own inertials,
    and the moving one takes the rest; where no body can be the rest it takes all, and theirs
    become zero. The file's joint frames need not be the robot's, but the positions at which joints
    are at zero must, and its world must be the robot's base (or have a body with the name of the
    URDF's root link at its place).

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

    Returns
    -------
    ExportReport

    Raises
    ------
    ExportError
        When the estimate has no standard parameters, a link of it can be no body, friction is
        negative, or the source describes another robot.
    ModelError
        When the source is no XML.
    MissingExtraError
        When MuJoCo is not installed.
    """
    problem = estimate.problem
    robot = problem.robot
    what = f"MJCF of '{robot.name}'"
    theta = standard_parameters(estimate, what, "MJCF")
    bodies = problem.feasible.bodies(theta)
    # MuJoCo loads no others, whatever the problem asked for.
    require_consistent(robot, bodies, "pseudo_inertia", what)
    tail = theta[10 * robot.n_links :]
    written, left_out = joint_numbers(problem.friction, tail, _PLACES, what)
    left_out, notes = add_shapes(problem, tail, written, left_out, "frictionloss", "damping")
    if source is None and robot.urdf is None:
        text, folder = mjcf_skeleton(robot, None)[0], None
    else:
        text, folder = source_text(robot, source, what), _folder(source)
        if is_mjcf(text, what):
            try:
                check_compiles(text, None if folder is None else str(folder), what)
            except ModelError as cause:
                raise ExportError(str(cause)) from None
        else:
            root = parse_xml(text, what)
            text, impossible = mjcf_skeleton(robot, UrdfTree(text))
            if any(root.find(f"link/{shape}") is not None for shape in ("visual", "collision")):
                notes += (
                    "shapes of the URDF are not in it; to keep them, convert the URDF with MuJoCo "
                    "and give that file as the source",
                )
            if impossible:
                notes += (
                    "links fixed to others with inertials that no body can have, now zero and "
                    "counted in where they are fixed: " + ", ".join(impossible),
                )
    patch = _Patch(robot, text, folder, what)
    for link, body in enumerate(bodies):
        patch.body(link, body)
    patch.joints(written, clear_armature="armature" not in _attributes(written))
    result = patch.document.text()
    _read_back(robot, bodies, CompiledMjcf(result, robot, folder, what), what)
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
        left_out=left_out,
        kind="an MJCF",
        notes=notes,
    )


def _attributes(written: dict[str, dict[str, float]]) -> set[str]:
    return {attribute for values in written.values() for attribute in values}


def _folder(source: str | os.PathLike[str] | None) -> Path | None:
    """Return the folder of a source that is a file."""
    if source is None or is_xml(source):
        return None
    return Path(source).resolve().parent


class _Patch:
    """An MJCF text, compiled, and the edits that make it the identified robot."""

    def __init__(self, robot: RobotModel, text: str, folder: Path | None, what: str) -> None:
        parse_xml(text, what)  # refuses document types, so that nothing is expanded below
        self.robot, self.what = robot, what
        self.document = Document(text)
        self.compiled = CompiledMjcf(text, robot, folder, what)
        self.elements = self._elements()
        self.carriers = self.compiled.carriers()
        self.placements = self._placements()
        self.changed: list[str] = []
        self.lumped: list[str] = []
        self.joints_changed: list[str] = []
        self.cleared: list[str] = []

    def _elements(self) -> list[Element]:
        """Return the element of every compiled body, the world's in the first place."""
        root, compiled = self.document.root, self.compiled
        found = [e for world in root.find_all("worldbody") for e in _nested(world)]
        names = [e.attributes.get("name", "") for e in found]
        expected = [compiled.body_name(b) for b in range(1, compiled.model.nbody)]
        if names != expected:
            raise ExportError(
                f"{self.what}: MuJoCo finds {len(expected)} bodies, the text itself has "
                f"{len(names)}, or others (it includes files, replicates or attaches, or merges "
                "static bodies); save the compiled model as one file and give that."
            )
        return [root, *found]

    def _placements(self) -> Array:
        """Return the placements of the robot's joint frames in the file's bodies."""
        compiled, robot = self.compiled, self.robot
        world = np.eye(4)
        placements = compiled.placements()
        base = _root_link(robot)
        for body in range(1, compiled.model.nbody):
            fixed = compiled.model.body_weldid[body] == 0
            if fixed and base is not None and compiled.body_name(body) == base:
                world = placements[body]
        joints = world @ link_placements(robot)
        self.world = world
        return np.asarray(np.linalg.solve(placements[self.carriers], joints))

    def body(self, link: int, identified: Array) -> None:
        """Write the body of a link, given in its joint frame."""
        compiled, carrier = self.compiled, self.carriers[link]
        T = self.placements[link]
        body = transform(identified, T[:3, :3], T[:3, 3])
        # By number: bodies need not have names.
        children = {
            number: FixedChild(compiled.body_name(number), own, R, t)
            for number, R, t in compiled.fixed_bodies(carrier)
            if np.any(own := compiled.body(number))
        }
        rest = rest_of(body, list(children.values()), "pseudo_inertia")
        if rest is not None:
            body = rest
        else:
            self.lumped.append(self._name(carrier))
            for number in children:
                self._write(number, np.zeros(10))
        self._write(carrier, lifted(body, "pseudo_inertia"))

    def _name(self, body: int) -> str:
        return self.compiled.body_name(body) or f"body {body}"

    def _write(self, body: int, values: Array) -> None:
        element, markup = self.elements[body], inertial_markup(values)
        inertial = element.find("inertial")
        if inertial is None:
            self.document.insert_child(element, markup)
        else:
            self.document.replace(inertial, markup)
        self.changed.append(self._name(body))

    def joints(self, written: dict[str, dict[str, float]], *, clear_armature: bool) -> None:
        """Write the joints' numbers; those of joints that mimic another count at that one."""
        model = self.compiled.model
        attributes = _attributes(written)
        for i, number in enumerate(self.compiled.joints):
            name = str(self.robot.pin_model.names[i + 1])
            if self.robot.pin_model.joints[i + 1].nv != 1:
                continue
            dof = int(model.jnt_dofadr[number])
            values = dict(written.get(name, {}))
            if name not in self.robot.joint_names:
                values = {a: 0.0 for a in attributes if getattr(model, _COMPILED[a])[dof] != 0.0}
            if clear_armature and model.dof_armature[dof] != 0.0:
                values["armature"] = 0.0
                self.cleared.append(name)
            if values:
                joint = self._joint(self.carriers[i], name)
                text = {key: numbers([value]) for key, value in values.items()}
                self.document.set_attributes(joint, text)
                self.joints_changed.append(name)

    def _joint(self, body: int, name: str) -> Element:
        for element in _own(self.elements[body], "joint"):
            if element.attributes.get("name") == name:
                return element
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


def _read_back(robot: RobotModel, bodies: Array, written: CompiledMjcf, what: str) -> None:
    """Check that the written text is the identified robot, by its efforts at generic states.

    Raises
    ------
    ExportError
        When it is not.
    """
    states = generic_states(robot, _STATES, _SEED)
    gravity = _turned(robot, written)
    expected = robot.inverse_dynamics(bodies, *states)
    found = written.efforts(states, gravity)
    error, scale = float(np.abs(found - expected).max()), float(np.abs(expected).max())
    if not error <= _READ_BACK * max(scale, 1.0):
        raise ExportError(
            f"{what}: the efforts of the written robot differ from the identified ones by "
            f"{error:.3g} of {scale:.3g} N·m (limit {_READ_BACK:.0e} of it); the source's joints "
            "are placed, turned or counted differently, or it overrides inertials "
            "(inertiafromgeom, boundmass, settotalmass). Give the MJCF of the robot that was "
            "identified."
        )


def _turned(robot: RobotModel, written: CompiledMjcf) -> Array:
    """Return the robot's gravity in the file's world."""
    base = _root_link(robot)
    placements = written.placements()
    for body in range(1, written.model.nbody):
        if base is not None and written.body_name(body) == base:
            return np.asarray(placements[body][:3, :3] @ robot.gravity)
    return robot.gravity
