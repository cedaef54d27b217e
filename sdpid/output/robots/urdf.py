"""Write identified inertias and friction into a URDF."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid._common.files import atomic_path
from sdpid.errors import ExportError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.output.robots.export_report import PLACES, ExportReport, Written
from sdpid.output.robots.joint_friction import joint_attributes
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
from sdpid.robot.description.inertials import exists, rounded
from sdpid.robot.description.level import LINK, base_turn, stand_on_level, without_level
from sdpid.robot.description.urdf import inertial_values, written_values
from sdpid.robot.description.xacro import expand_xacro
from sdpid.robot.description.xml import encode_xml, read_description
from sdpid.robot.description.xml_edits import Document, Element
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.load import Root, load_robot
from sdpid.robot.model.model import RobotModel

# How a body is split among a moving link and those fixed to it.
Fixed: TypeAlias = Literal["keep", "merge"] | Mapping[str, ArrayLike]


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
    joints), friction with a Coulomb term (N·m, N). All other bytes stay as they are. A base that
    was found to be tilted stands on a new root link that is level. Where the problem has terms
    that a URDF has no place for, damping and friction are fitted to its rows anew, with the
    identified links held. See docs/guides/exports.md.

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
    text = without_level(source_text(robot, source, what))
    bodies = problem.feasible.bodies(theta)
    consistency = problem.consistency
    require_consistent(robot, bodies, consistency, what)
    tree = UrdfTree(text)
    links = tree.moving_links(robot)
    document = tree.document
    changed: list[str] = []
    lumped: list[str] = []
    flat: list[str] = []
    rests: list[Array] = []
    families = {link: _asked(tree.fixed_children(link), fixed) for link in links}
    _require_known(fixed, [child.name for family in families.values() for child in family])
    for link, body in zip(links, bodies, strict=True):
        children = [c for c in families[link] if c.body is not None and np.any(c.body)]
        merged = fixed == "merge" and bool(children)
        rest = None if merged else rest_of(body, children, consistency)
        given = () if isinstance(fixed, str) else [c for c in families[link] if c.name in fixed]
        if given and rest is None:
            names = ", ".join(child.name for child in children)
            raise ExportError(
                f"{what}: link '{link}' cannot be split as asked: no body can be the rest of its "
                f"{body[0]:.6g} kg without {names}, or one of those cannot exist; give less, or "
                "fixed='keep'."
            )
        for child in given:
            write_inertial(
                document, tree.links[child.name], inertial_values(np.asarray(child.body))
            )
            changed.append(child.name)
        if rest is None:
            lumped.append(link)
            for child in children:
                write_inertial(document, tree.links[child.name], inertial_values(np.zeros(10)))
                changed.append(child.name)
        rests.append(body if rest is None else rest)
    tree.require_unambiguous(links, what)
    for link, own in zip(links, rests, strict=True):
        written = rounded(possible_body([*map(Fraction, own.tolist())], consistency, link, what))
        if not exists(written.mass, written.moments, "pseudo_inertia"):
            flat.append(link)
        write_inertial(document, tree.links[link], written_values(written))
        changed.append(link)
    friction = joint_attributes(problem, theta, PLACES, what)
    write_dynamics(tree, document, friction.values)
    notes, turn = friction.notes, base_turn(robot.gravity, estimate.model().tilted_gravity)
    if not np.array_equal(turn, np.eye(3)):
        stand_on_level(document, tree.root_link(), turn)
        angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
        notes += (f"its base stands tilted by {angle:.3g}° on a new root link '{LINK}', as found",)
    result = document.text()
    seen = robot.with_gravity(turn.T @ robot.gravity)
    damping, dry = read_back(robot, bodies, result, seen=seen).described_friction()
    file = Written(estimate, (dry, damping, np.zeros(robot.n)), seen)
    with atomic_path(target) as temporary:
        temporary.write_bytes(encode_xml(result))
    return ExportReport(
        path=Path(target),
        links_changed=tuple(changed),
        joints_changed=tuple(friction.values),
        lumped=tuple(lumped),
        left_out=friction.left_out,
        friction_fitted=friction.fitted,
        triangle_violations=tuple(flat),
        notes=notes,
        training=file.errors(),
        _written=file,
    )


def _asked(children: Sequence[FixedChild], fixed: Fixed) -> list[FixedChild]:
    """Return fixed links with the bodies that they are to have."""
    if isinstance(fixed, str):
        return list(children)
    return [
        replace(child, body=real_array(fixed[child.name], f"fixed: {child.name}", ndim=1))
        if child.name in fixed
        else child
        for child in children
    ]


def _require_known(fixed: Fixed, names: Sequence[str]) -> None:
    """Refuse an option `fixed` that names no link fixed to a moving one."""
    if isinstance(fixed, str):
        if fixed not in ("keep", "merge"):
            raise ExportError(
                f"fixed: is {fixed!r}; use 'keep', 'merge', or bodies by the names of links."
            )
        return
    unknown = [name for name in fixed if name not in names]
    if unknown:
        raise ExportError(
            f"fixed: {unknown[0]!r} is no link that is fixed to a moving one: "
            f"{', '.join(names) or 'there are none'}."
        )
    short = [name for name, body in fixed.items() if np.shape(body) != (10,)]
    if short:
        raise ExportError(
            f"fixed: the body of {short[0]!r} has shape {np.shape(fixed[short[0]])}, expected the "
            "ten parameters (10,) about the link's own frame."
        )


def source_text(robot: RobotModel, source: str | os.PathLike[str] | None, what: str) -> str:
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
        return expand_xacro(read_description(source)).text
    except ModelError as cause:
        raise ExportError(f"{what}: {cause}") from None


def write_inertial(
    document: Document, link: Element, values: Mapping[str, Mapping[str, str]]
) -> None:
    """Write the attributes of an ``<inertial>`` by tag into a link, which may lack one."""
    inertial = link.find("inertial")
    lines = [
        f"  <{tag} " + " ".join(f'{key}="{value}"' for key, value in attributes.items()) + "/>"
        for tag, attributes in values.items()
    ]
    if inertial is None:
        document.insert_child(link, "\n".join(["<inertial>", *lines, "</inertial>"]))
        return
    for tag, line in zip(values, lines, strict=True):
        element = inertial.find(tag)
        if element is None:
            document.insert_child(inertial, line.strip())
        else:
            document.set_attributes(element, values[tag])


def write_dynamics(
    tree: UrdfTree, document: Document, written: dict[str, dict[str, float]]
) -> None:
    """Write the attributes of ``<dynamics>`` by joint; those of mimic joints become zero."""
    for joint, source in tree.mimics.items():
        # The friction identified at the source joint includes that of its followers.
        if source in written and tree.joints[joint].find("dynamics") is not None:
            written[joint] = dict.fromkeys(written[source], 0.0)
    for name, numbers in written.items():
        attributes = {key: repr(value + 0.0) for key, value in numbers.items()}
        element = tree.joints[name].find("dynamics")
        if element is not None:
            document.set_attributes(element, attributes)
        elif attributes:
            line = "<dynamics " + " ".join(f'{k}="{v}"' for k, v in attributes.items()) + "/>"
            document.insert_child(tree.joints[name], line, last=True)


def read_back(
    robot: RobotModel, bodies: Array, text: str, *, seen: RobotModel | None = None
) -> RobotModel:
    """Return the robot of the written text, which must need the efforts of the identified one.

    Where its base is turned, `seen` is the robot under gravity as it is then.

    Raises
    ------
    ExportError
        When it is not: the source describes other joints or other lengths.
    """
    what = f"URDF of '{robot.name}'"
    root: Root | None = "free_flyer" if robot.free_flyer else None
    try:
        written = load_robot(text, root=root, gravity=robot.gravity.tolist())
    except ModelError as cause:
        raise ExportError(f"{what}: the changed file cannot be read back ({cause}).") from None
    if written.joint_names != robot.joint_names:
        raise ExportError(
            f"{what}: the source has the joints {', '.join(written.joint_names)}, the robot has "
            f"{', '.join(robot.joint_names)}; give the URDF of the same robot."
        )
    states = generic_states(robot, STATES, SEED)
    require_same_efforts(
        (seen or robot).inverse_dynamics(bodies, *states),
        written.inverse_dynamics(written.prior, *states),
        what,
        "the source's joints are placed differently. Give the URDF that the robot was identified "
        "with.",
    )
    return written
