"""Robots from names, files, URDF text and Pinocchio models."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sdpid._arrays import Array, frozen, real_array
from sdpid.errors import ModelError
from sdpid.robot.library import (
    bundled_folder,
    bundled_robots,
    example_robots,
    find_example_robot,
)
from sdpid.robot.mdh import DhTable
from sdpid.robot.model import RobotModel
from sdpid.robot.quiet import Caught, caught_stderr
from sdpid.robot.urdf import Mimic, check_urdf

Root = Literal["free_flyer"]

# Places in the parser's own source, which help nobody.
_LINES = re.compile(r"\s*at line \d+ in \S+")


def load_robot(
    source: Any, *, root: Root | None = None, gravity: Sequence[float] | None = None
) -> RobotModel:
    """Load a robot.

    Parameters
    ----------
    source : str, path, or pinocchio.Model
        Name of a bundled robot (``"denso_vp6242"``), path of a URDF, its text, name of a robot of
        example-robot-data (file stem, or folder/stem where ambiguous), or a model.
    root : {"free_flyer"}, optional
        Let the base float; its link is then identified too.
    gravity : sequence of 3 floats, optional
        Gravity in the base link; by default (0, 0, -9.81) m/s², or the model's own.

    Returns
    -------
    RobotModel

    Raises
    ------
    ModelError
        When nothing is found under the name, the text is no URDF, a joint kind is not supported,
        or nothing moves.
    """
    if root not in (None, "free_flyer"):
        raise ModelError(f"root is {root!r}; use None or 'free_flyer'.")
    if not isinstance(source, (str, os.PathLike)):
        if root is not None:
            raise ModelError("root: a pinocchio.Model already has its root; leave it out.")
        return _from_pinocchio(source, None, (), gravity)
    text, what, default_gravity = _find_text(source)
    name, mimics = check_urdf(text, what, floating=root is not None)
    import pinocchio as pin

    free = () if root is None else (pin.JointModelFreeFlyer(),)
    said = Caught()
    try:
        # The parser of URDF says what is wrong on standard error, not in its error.
        with caught_stderr() as said:
            model = pin.buildModelFromXML(text, *free)
    except (RuntimeError, ValueError) as cause:
        raise ModelError(
            f"{what}: Pinocchio cannot read it ({_LINES.sub('', said.text) or cause})."
        ) from None
    model.name = name
    if gravity is None:
        gravity = default_gravity
    return _from_pinocchio(model, text, mimics, gravity)


def _find_text(source: str | os.PathLike[str]) -> tuple[str, str, Sequence[float] | None]:
    """Return the URDF text, what to call it, and the gravity of a bundled robot."""
    if isinstance(source, str) and source.lstrip().startswith("<"):
        return source, "URDF text", None
    if isinstance(source, str) and source in bundled_robots():
        folder = bundled_folder(source)
        table = DhTable.from_toml(folder / "kinematics.toml")
        text = (folder / f"{source}.urdf").read_text(encoding="utf-8")
        return text, source, table.gravity
    path = Path(source)
    if isinstance(source, str) and not _is_file(path):
        found = find_example_robot(source)
        if found is None:
            known = ", ".join((*bundled_robots(), *example_robots()))
            shown = source if len(source) <= 80 else source[:77] + "..."
            raise ModelError(
                f"no robot {shown!r}: not a file, and not one of {known or 'the bundled robots'}."
            )
        path = found
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as cause:
        raise ModelError(f"cannot read {path}: {cause}.") from None
    return text, path.name, None


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # such as a name that is too long to be one
        return False


def _from_pinocchio(
    model: Any, urdf: str | None, mimics: Sequence[Mimic], gravity: Sequence[float] | None
) -> RobotModel:
    import pinocchio as pin

    if not isinstance(model, pin.Model):
        raise ModelError(
            f"robot: got {type(model).__name__}; give a name, a path, URDF text or a "
            "pinocchio.Model."
        )
    model = model.copy()
    if model.njoints < 2:
        raise ModelError(f"robot '{model.name}': no moving joint; nothing can be identified.")
    if gravity is not None:
        values = real_array(gravity, "gravity", ndim=1, error=ModelError)
        if values.shape != (3,):
            raise ModelError(f"gravity: {values.size} numbers, give 3 (m/s²).")
        model.gravity.linear = values
    coordinates = []
    for i in range(1, model.njoints):
        joint, name = model.joints[i], model.names[i]
        if joint.nv == 1 and joint.nq in (1, 2) and joint.shortname() != "JointModelMimic":
            coordinates.append(name)
        elif i == 1 and joint.nv == 6 and joint.nq == 7:
            axes = ("vx", "vy", "vz", "wx", "wy", "wz")
            coordinates += [f"{name}/{axis}" for axis in axes]
        else:
            raise ModelError(
                f"joint '{name}' is a {joint.shortname()}, which is not supported; "
                "supported are revolute, continuous and prismatic joints."
            )
    expansion, offset, names = _expand_mimics(coordinates, mimics)
    if any(m.offset for m in mimics) and model.joints[1].nv == 6:
        raise ModelError("mimic joints with an offset are not supported on a floating base.")
    prior = [model.inertias[i].toDynamicParameters() for i in range(1, model.njoints)]
    return RobotModel(
        name=model.name,
        pin_model=model,
        joint_names=names,
        link_names=_link_names(model),
        prior=frozen(prior),
        expansion=frozen(expansion),
        offset=frozen(offset),
        urdf=urdf,
    )


def _expand_mimics(
    coordinates: Sequence[str], mimics: Sequence[Mimic]
) -> tuple[Array, Array, tuple[str, ...]]:
    rules = {mimic.joint: mimic for mimic in mimics}
    names = tuple(name for name in coordinates if name not in rules)
    expansion = np.zeros((len(coordinates), len(names)))
    offset = np.zeros(len(coordinates))
    for row, name in enumerate(coordinates):
        multiplier, shift, source, seen = 1.0, 0.0, name, {name}
        while source in rules:
            rule = rules[source]
            shift += multiplier * rule.offset
            multiplier *= rule.multiplier
            source = rule.source
            if source in seen:
                raise ModelError(f"mimic joints repeat each other in a circle at '{source}'.")
            seen.add(source)
        if source not in names:
            raise ModelError(f"joint '{name}' mimics '{source}', which is no moving joint.")
        expansion[row, names.index(source)] = multiplier
        offset[row] = shift
    return expansion, offset, names


def _link_names(model: Any) -> tuple[str, ...]:
    """Return the first body of each joint: the URDF link that the joint moves."""
    import pinocchio as pin

    bodies: dict[int, str] = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            bodies.setdefault(frame.parentJoint, frame.name)
    return tuple(bodies.get(i, model.names[i]) for i in range(1, model.njoints))
