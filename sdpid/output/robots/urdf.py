"""Write identified inertias and friction into a URDF."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, real_array
from sdpid.assurance.diagnostics.described import Resistances
from sdpid.errors import ExportError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.output.robots.export_report import PLACES, ExportReport, file_errors
from sdpid.output.robots.joint_friction import joint_attributes
from sdpid.output.robots.written_bodies import (
    Fixed,
    FixedChild,
    RobotText,
    child_of,
    source_text,
    standard_parameters,
    write_inertial,
)
from sdpid.robot.description.bodies import DescribedBody, Inertial, read_urdf_bodies, written_values
from sdpid.robot.description.urdf import (
    LINK,
    base_turn,
    check_urdf,
    stand_on_level,
    without_level,
)
from sdpid.robot.model.load import Root, load_robot
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.transmission import followers

# What a joint has once; of two, readers might take either.
_OF_JOINTS = ("origin", "axis", "limit", "dynamics", "mimic")
# Where a transmission is, that the file lacks.
_ASIDE = "load it with load_robot(..., transmission=)"


def write_urdf(
    estimate: Estimate,
    *,
    target: str | os.PathLike[str],
    source: str | os.PathLike[str] | None = None,
    fixed: Fixed = "keep",
) -> ExportReport:
    """Write the URDF with identified inertias and friction.

    Only the ``<inertial>`` of moving links and the damping and friction of joints change, and of
    joints only what the problem has: damping with a viscous term (N·m·s/rad, N·s/m for sliding
    joints), friction with a Coulomb term (N·m, N). All else stays as it is, but for white space and
    quotes within tags. A base that was found to be tilted stands on a new root link that is level.
    Where the problem has terms that a URDF has no place for, damping and friction are fitted to its
    rows anew, with the identified links held. See docs/guides/exports.md.

    Parameters
    ----------
    estimate : Estimate
        Parameters to write; it must have `theta`.
    target : str or path
        File to write, whole or not at all; it may be the source.
    source : str or path, optional
        URDF to change, as a path or its text; by default the one the robot was loaded from.
    fixed : {"keep", "merge"} or mapping, optional
        How an identified body is split among the link that moves and the links fixed to it.
        ``keep``: those keep their inertials and the moving link takes the rest; where no body can
        be the rest it takes all, and theirs become zero. ``merge``: it takes all. A mapping from
        names of fixed links to ten parameters, about their own frames, gives theirs; the others
        keep their own.

    Returns
    -------
    ExportReport
        What was written, what was left out, and what that costs.

    Raises
    ------
    ExportError
        When the estimate has no standard parameters, a link of it is not consistent, friction is
        negative, the source describes another robot, or a body cannot be split as asked.
    ModelError
        When the source is not a URDF.

    Examples
    --------
    >>> report = sdpid.write_urdf(estimate, target="identified.urdf")
    >>> print(report.describe())
    identified.urdf: wrote the inertia of 6 links and the friction of 6 joints
    >>> identified = sdpid.load_robot("identified.urdf")
    >>> bool(np.allclose(identified.prior.ravel(), estimate.theta[:60], atol=1e-6))
    True
    """
    problem = estimate.problem
    robot = problem.robot
    what = f"URDF of '{robot.name}'"
    theta = standard_parameters(estimate, what, "URDF")
    text = Urdf(robot, without_level(source_text(robot, source, what)))
    bodies = problem.feasible.bodies(theta)
    text.write_bodies(bodies, problem.consistency, _asked(fixed, text))
    text.require_unambiguous()
    friction = joint_attributes(problem, theta, PLACES, what)
    text.write_mimics()
    text.write_joints(friction.values)
    notes, turn = friction.notes, base_turn(robot.gravity, estimate.model().tilted_gravity)
    if not np.array_equal(turn, np.eye(3)):
        stand_on_level(text.root, text.root_link, turn)
        angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
        notes += (f"its base stands tilted by {angle:.3g}° on a new root link '{LINK}', as found",)
    seen = robot.with_gravity(turn.T @ robot.gravity)
    held = Resistances.of_joints(text.read_back(bodies, seen=seen))
    errors = partial(file_errors, estimate, robot=seen, held=held)
    if robot.transmission is not None:
        notes += (f"of the transmission a URDF has place for mimic joints alone: {_ASIDE}",)
    return text.save(target, friction, notes, errors)


def _asked(fixed: Fixed, text: Urdf) -> Fixed:
    """Return an option `fixed`; refuse one that names no link fixed to a moving one."""
    if isinstance(fixed, str):
        if fixed not in ("keep", "merge"):
            raise ExportError(
                f"fixed: is {fixed!r}; use 'keep', 'merge', or bodies by the names of links."
            )
        return fixed
    names = [child.name for k in text.carriers for child in text.children(k).values()]
    for name, body in fixed.items():
        if name not in names:
            raise ExportError(
                f"fixed: {name!r} is no link that is fixed to a moving one: "
                f"{', '.join(names) or 'there are none'}."
            )
        if np.shape(body) != (10,):
            raise ExportError(
                f"fixed: the body of {name!r} has shape {np.shape(body)}, expected the ten "
                "parameters (10,) about the link's own frame."
            )
    return {name: real_array(body, f"fixed: {name}", ndim=1) for name, body in fixed.items()}


class Urdf(RobotText):
    """A URDF.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    text : str
        The URDF.

    Raises
    ------
    ModelError
        When it is not a URDF.
    ExportError
        When it lacks a joint of the robot.
    """

    kind = "URDF"
    bodies: tuple[DescribedBody, ...]

    def __init__(self, robot: RobotModel, text: str) -> None:
        super().__init__(robot, f"URDF of '{robot.name}'", text)
        check_urdf(text, "URDF", floating=True)
        # As they are written, in document order.
        self.root, self.bodies = read_urdf_bodies(text, "URDF")
        self.elements = self.root.findall("link")
        self._joints = {joint.get("name", ""): joint for joint in self.root.findall("joint")}
        own = {k: body for k, body in enumerate(self.bodies) if body.carrier == body.name}
        roots = [k for k, body in own.items() if not body.moving]
        if len(roots) != 1:
            raise ModelError(f"URDF: {len(roots)} links have no parent, there must be one.")
        self.root_link = self.bodies[roots[0]].name
        self.carriers = self.match({str(b.joint): k for k, b in own.items() if b.moving}, roots[0])

    def children(self, carrier: int) -> dict[int, FixedChild]:
        """Return the links fixed to one, directly or through others, by number.

        Raises
        ------
        ModelError
            When a number of theirs cannot be read.
        """
        found = super().children(carrier)
        for body in (self.bodies[k] for k in found):
            if body.problems:
                raise ModelError(f"URDF: link '{body.name}': {body.problems[0]}.")
        return found

    def require_unambiguous(self) -> None:
        """Refuse a URDF in which readers might see different joints or bodies.

        Raises
        ------
        ExportError
            Naming what it has several of.
        """
        several = []
        if len(self._joints) < len(self.root.findall("joint")):
            several.append("its joints have the same name")
        for name, joint in self._joints.items():
            several += _several(joint, f"<joint> '{name}'", _OF_JOINTS)
        for k in (k for carrier in self.carriers for k in (carrier, *self.children(carrier))):
            several += _several(self.elements[k], f"<link> '{self.name(k)}'", ("inertial",))
            for inertial in self.elements[k].findall("inertial"):
                tags = {child.tag for child in inertial.iterchildren("*")}
                several += _several(inertial, f"<inertial> of '{self.name(k)}'", sorted(tags))
        if several:
            raise ExportError(f"{self.what}: readers may differ on the source: {several[0]}.")

    def write(self, body: int, inertial: Inertial) -> None:
        """Write the ``<inertial>`` of a link by number."""
        write_inertial(self.elements[body], written_values(inertial))
        self.changed.append(self.name(body))

    def write_joints(self, values: Mapping[str, Mapping[str, float]]) -> None:
        """Write the attributes of ``<dynamics>`` by joint; those of followers become zero."""
        written, held = dict(values), {key for each in values.values() for key in each}
        for joint, _, _ in followers(self.robot):
            # The friction identified at the joints that it follows includes its own.
            described = self._joints[joint].find("dynamics") is not None
            if held and joint not in values and described:
                written[joint] = dict.fromkeys(sorted(held), 0.0)
        for name, numbers in written.items():
            attributes = {key: repr(value + 0.0) for key, value in numbers.items()}
            if attributes:
                child_of(self._joints[name], "dynamics", last=True).attrib.update(attributes)
        self.joints_changed.extend(written)

    def write_mimics(self) -> None:
        """Write which joints behind the transmission follow one other."""
        if self.robot.transmission is None:
            return
        for element in self._joints.values():
            for mimic in element.findall("mimic"):
                element.remove(mimic)
        for joint, sources, value in followers(self.robot):
            if len(sources) == 1:
                ((source, ratio),) = sources.items()
                given = {"joint": source, "multiplier": repr(ratio), "offset": repr(value)}
                child_of(self._joints[joint], "mimic", last=True).attrib.update(given)

    def read_back(self, bodies: Array, *, seen: RobotModel | None = None) -> RobotModel:
        """Return the robot of the written text, which must need the efforts of the identified one.

        Where its base is turned, `seen` is the robot under gravity as it is then.

        Raises
        ------
        ExportError
            When it is not: the source describes other joints or other lengths.
        """
        robot = self.robot
        root: Root | None = "free_flyer" if robot.free_flyer else None
        try:
            written = load_robot(
                self.text(),
                root=root,
                gravity=robot.gravity.tolist(),
                transmission=robot.transmission,
            )
        except ModelError as cause:
            raise ExportError(
                f"{self.what}: the changed file cannot be read back ({cause})."
            ) from None
        if written.joint_names != robot.joint_names:
            raise ExportError(
                f"{self.what}: the source has the joints {', '.join(written.joint_names)}, the "
                f"robot has {', '.join(robot.joint_names)}; give the URDF of the same robot."
            )
        self.require_same_efforts(
            seen or robot,
            bodies,
            written,
            "the source's joints are placed differently. Give the URDF that the robot was "
            "identified with.",
        )
        return written


def _several(element: Any, what: str, tags: Iterable[str]) -> list[str]:
    """Return what an element has several of: readers might take either."""
    return [f"{what} has several <{tag}>" for tag in tags if len(element.findall(tag)) > 1]
