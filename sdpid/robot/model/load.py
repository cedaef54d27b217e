"""Load robots from names, files and texts of URDF, MJCF and xacro, and Pinocchio models."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sdpid._common.files import Source
from sdpid.errors import ModelError
from sdpid.robot.description.catalog import bundled_folder, bundled_robots, find_robot
from sdpid.robot.description.dh_table import DhTable
from sdpid.robot.description.mjcf import read_mjcf
from sdpid.robot.description.urdf import add_loops, pinocchio_from_urdf, urdf_closures, urdf_passive
from sdpid.robot.description.xml import Description, expand_xacro, is_mjcf, is_xml, read_description
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.transmission import Transmission, following, of_elements, of_lengths

Root = Literal["free_flyer"]

# The word for the transmission that a description has itself, and the ending of a file beside it.
DESCRIBED, _BESIDE = "description", ".transmission.toml"
# Lengths of tendons that are kept agree with a transmission to this, rad or m.
_KEPT = 1e-9


def load_robot(
    source: Any,
    *,
    root: Root | None = None,
    gravity: Sequence[float] | None = None,
    xacro_args: Mapping[str, str] | None = None,
    transmission: Any = None,
) -> RobotModel:
    """Load a robot.

    Loops that close are read with it: elements ``<loop_joint>`` of a URDF, and equalities of kind
    connect and weld of an MJCF; and joints without motors, ``<passive_joint name="..."/>`` of a
    URDF, and of an MJCF with a loop what no actuator moves (docs/guides/loops.md).

    Parameters
    ----------
    source : str, path, or pinocchio.Model
        One of

        * name of a bundled robot (``"denso_vp6242"``), of a robot of example-robot-data (file
          stem, or folder/stem where ambiguous), or of robot_descriptions, which downloads it
          (``"ur5e_description"``, extra ``descriptions``);
        * path or text of a URDF, an MJCF (extra ``sim``) or a xacro file (extra ``xacro``);
        * a model.
    root : {"free_flyer"}, optional
        Let the base float; its link is then identified too. An MJCF says so itself, and is
        refused where it says otherwise.
    gravity : sequence of 3 floats, optional
        Gravity in the base link; by default (0, 0, -9.81) m/s², or the model's or the MJCF's own.
    xacro_args : mapping, optional
        Values of the arguments of a xacro file.
    transmission : Transmission, mapping, path of a TOML file, or "description", optional
        How the joints follow the motors, where recordings are of these: by default what a file
        ``ROBOT.transmission.toml`` beside ``ROBOT.urdf`` says, if there is one. ``"description"``
        takes the motors of an MJCF's fixed tendons, or of the elements ``<transmission>`` that ROS
        reads of a URDF (see docs/guides/transmissions.md).

    Returns
    -------
    RobotModel

    Raises
    ------
    ModelError
        When nothing is found under the name, the text is no description, a joint kind is not
        supported, a mass is negative, or nothing moves.
    MissingExtraError
        When the source needs an extra that is not installed.

    Examples
    --------
    >>> sdpid.load_robot("ur5_robot")
    RobotModel('ur5', 6 coordinates, 6 links)
    >>> floating = sdpid.load_robot("solo12", root="free_flyer")
    >>> floating.n, floating.n_base
    (18, 6)
    """
    if root not in (None, "free_flyer"):
        raise ModelError(f"root is {root!r}; use None or 'free_flyer'.")
    described = isinstance(transmission, str) and transmission == DESCRIBED
    if not isinstance(source, (str, os.PathLike)):
        if root is not None:
            raise ModelError("root: a pinocchio.Model already has its root; leave it out.")
        robot = RobotModel.from_pinocchio(source, gravity=gravity)
        if described:
            raise ModelError(f"transmission: '{robot.name}' is no URDF and no MJCF; give numbers.")
        return _behind(robot, transmission)
    found, default_gravity = _find(source)
    if gravity is None:
        gravity = default_gravity
    origin = _origin(source, found, root, xacro_args)
    folder = None if found.path is None else found.path.parent
    found = expand_xacro(found, xacro_args)
    facts: dict[str, Any] = {"source": origin, "folder": folder}
    mjcf: Any = None
    if is_mjcf(found.text, found.what):
        mjcf = read_mjcf(found.text, found.what, path=found.path)
        if mjcf.others:
            raise ModelError(
                f"{found.what}: has a {mjcf.others[0]} equality, which is not supported; supported "
                "are linear equalities of two joints, and connect and weld of two bodies. Remove "
                "it, or set active='false'."
            )
        facts["loops"] = loops = add_loops(mjcf.pin_model, mjcf.closures, found.what)
        plain = RobotModel.from_pinocchio(mjcf.pin_model, gravity=gravity)
        robot = following(plain, mjcf.kept)
        if root is not None and not robot.free_flyer:
            raise ModelError(
                f"{found.what}: an MJCF says itself whether its base floats, and this one's is "
                "fixed; give its first body a <freejoint/>, or leave root out."
            )
        facts["actuators"] = tuple(mjcf.actuators())
        # Joints that no actuator moves have none at all in most files: a loop tells that they
        # matter. Where the file's joints are zero its loops are closed.
        passive = {name: 0.0 for name in mjcf.passive() if loops and name in robot.joint_names}
        if described:
            transmission = of_lengths(plain, mjcf.kept, mjcf.motors())
    else:
        model, kept, tree = pinocchio_from_urdf(found.text, found.what, floating=root is not None)
        facts["loops"] = add_loops(model, urdf_closures(tree, found.what), found.what)
        plain = RobotModel.from_pinocchio(model, gravity=gravity, urdf=found.text)
        robot = following(plain, kept)
        passive = urdf_passive(tree, found.what)
        if described:
            transmission = of_elements(tree, found.what)
    robot = replace(robot, **facts, passive=tuple(passive), assembled=tuple(passive.values()))
    if transmission is None and found.path is not None:
        beside = found.path.with_name(f"{found.path.stem}{_BESIDE}")
        transmission = beside if beside.is_file() else None
    moved = _behind(robot, transmission)
    if mjcf is None:
        return moved
    for lengths, value, follower in mjcf.kept:
        change, length = moved.way(lengths)
        if follower is None and np.abs([*change, length - value]).max() > _KEPT:
            raise ModelError(
                f"{found.what}: an equality keeps a tendon over {', '.join(lengths)} at a length "
                "that changes by the given transmission; say there how these joints follow."
            )
    return replace(moved, springs=tuple(mjcf.springs(moved)), forces=tuple(mjcf.forces(moved)))


def _behind(robot: RobotModel, transmission: Any) -> RobotModel:
    """Return a robot behind a transmission, if there is one."""
    return robot if transmission is None else Transmission.of(transmission).applied(robot)


def _find(source: str | os.PathLike[str]) -> tuple[Description, Sequence[float] | None]:
    """Return the description under a name or path, and the gravity of a bundled robot."""
    if isinstance(source, str) and not is_xml(source):
        if source in bundled_robots():
            table = DhTable.from_toml(bundled_folder(source) / "kinematics.toml")
            return replace(read_description(find_robot(source)), what=source), table.gravity
        # A name may be too long for a path, which is then no file.
        if not os.path.isfile(source):  # noqa: PTH113
            return read_description(find_robot(source)), None
    return read_description(source), None


def _origin(
    source: str | os.PathLike[str],
    found: Description,
    root: Root | None,
    xacro_args: Mapping[str, str] | None,
) -> Source | None:
    """Return the description's file or catalog name, and the options that load it again."""
    if found.source is None:
        return None
    options: dict[str, Any] = {} if root is None else {"root": root}
    if xacro_args:
        options["xacro_args"] = {str(key): str(value) for key, value in xacro_args.items()}
    if found.path is None or found.path == Path(source):
        return replace(found.source, options=options)
    # A name in a catalog: whoever has the catalog needs no file.
    return replace(found.source, name=str(source), options={**options, "catalog": True})
