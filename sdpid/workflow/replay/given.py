"""A folder of results, and the logs and the robot that it is held against."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sdpid.assurance.recipe.inputs import log_entry, recording_digest
from sdpid.assurance.recipe.recipe import Recipe, RobotRecipe
from sdpid.errors import CertificateError, DataError, ModelError
from sdpid.experiment.preparation.prepare import Logs
from sdpid.experiment.readers.read import is_frame, read_recording
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.description.catalog import bundled_robots, example_robots
from sdpid.robot.description.urdf import without_level
from sdpid.robot.description.xacro import is_xacro
from sdpid.robot.description.xml import read_description
from sdpid.robot.model.base_parameters import kinematics_digest
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from sdpid.verifier import certificate, manifest
from sdpid.verifier.folder import CERTIFICATE
from sdpid.verifier.reading import REFUSED, read_bytes, shown
from sdpid.workflow.replay.compare import Link, State
from sdpid.workflow.replay.numbers import URDF


@dataclass(frozen=True, eq=False)
class Sealed:
    """The parts of a results folder that say how it was made.

    Attributes
    ----------
    folder : Path
        The folder.
    files : tuple of str
        Names of the files that the manifest lists.
    logs : tuple of dict
        Name, bytes and SHA-256 of each log, in order.
    robot : dict or None
        The same of the robot's description; None where the manifest names none.
    recipe : Recipe
        How rows are made of the logs.
    data : dict
        The certificate.
    """

    folder: Path
    files: tuple[str, ...]
    logs: tuple[dict[str, Any], ...]
    robot: dict[str, Any] | None
    recipe: Recipe
    data: dict[str, Any]

    @classmethod
    def read(cls, folder: str | os.PathLike[str]) -> Sealed:
        """Read manifest.json and certificate.json.

        Raises
        ------
        CertificateError
            When a file is missing or damaged, or the manifest has no recipe.
        """
        whole = Path(folder)
        if not whole.is_dir():
            raise CertificateError(
                f"{folder}: is no folder; a log is checked against the whole folder that "
                "'sdpid identify' wrote."
            )
        where = whole / manifest.NAME
        sealed, data = _read(where, manifest.load), _read(whole / CERTIFICATE, certificate.load)
        if sealed["recipe"] is None:
            raise CertificateError(
                f"{where}: has no recipe, so that the rows cannot be made again from the log: the "
                "run was not one of 'identify', or had friction terms of a class of its own."
            )
        recipe = Recipe.from_dict(sealed["recipe"])
        logs, robots = (
            tuple(entry for entry in sealed["inputs"] if entry["role"] == role)
            for role in ("log", "robot")
        )
        if len(logs) != len(recipe.reading):
            raise CertificateError(
                f"{where}: names {len(logs)} logs and how {len(recipe.reading)} are read."
            )
        return cls(whole, tuple(sealed["files"]), logs, next(iter(robots), None), recipe, data)


def _read(path: Path, load: Callable[[bytes], dict[str, Any]]) -> dict[str, Any]:
    """Return the object in a JSON file."""
    try:
        return load(read_bytes(path))
    except OSError as cause:
        raise CertificateError(f"cannot read {path}: {cause.strerror}.") from None
    except REFUSED as cause:
        raise CertificateError(f"{path}: {cause}.") from None


def several(logs: Logs) -> list[Any]:
    """Return logs as a list.

    Raises
    ------
    DataError
        When there is no such file.
    """
    alone = isinstance(logs, (Recording, str, os.PathLike)) or is_frame(logs)
    given = list(logs) if isinstance(logs, Iterable) and not alone else [logs]
    for log in given:
        if isinstance(log, (str, os.PathLike)) and not os.path.exists(log):  # noqa: PTH110
            raise DataError(f"{log}: there is no such file.")
    return given


def read_log(log: Any, how: dict[str, Any] | None) -> Recording:
    """Read a log as the recipe says.

    Raises
    ------
    DataError
        When it cannot be read so.
    CertificateError
        When these are no options.
    """
    if isinstance(log, Recording):
        return log
    try:
        recording: Recording = read_recording(log, mapping=False, **(how or {}))
    except REFUSED as cause:
        raise CertificateError(
            f"manifest.json: its recipe cannot be followed: {log} is not read with "
            f"{_options(how or {})} ({cause})."
        ) from None
    return recording


def log_links(sealed: Sealed, logs: list[Recording]) -> Iterator[Link]:
    """Yield whether logs have the SHA-256 of the manifest, each in its place."""
    order = [each["sha256"] for each in sealed.logs]
    entries = zip(logs, sealed.logs, sealed.recipe.reading, strict=True)
    for number, (log, entry, how) in enumerate(entries, 1):
        found = log_entry(log, "log")
        if entry["bytes"] is None:
            found = {**found, "bytes": None, "sha256": recording_digest(log)}
        name = "the recording in memory" if found["name"] is None else shown(found["name"])
        if found["sha256"] == entry["sha256"]:
            text = f"{name} has the SHA-256 of the manifest, {entry['sha256']}"
            text += f"; its columns are taken, scaled or left out by {_options(how)}" if how else ""
            state: State = "made again"
            if found["bytes"] != entry["bytes"]:
                text += f"; but {found['bytes']} bytes, where the manifest has {entry['bytes']}"
                state = "not made again"
            yield Link("log", state, text)
            continue
        text = (
            f"{name} has the SHA-256 {found['sha256']}, the manifest names "
            f"{shown(entry['name'] or 'a recording in memory')} with {entry['sha256']}"
        )
        if found["sha256"] in order:
            where = order.index(found["sha256"]) + 1
            text += f"; it is log {where} of the run, not log {number}: give them in that order"
        yield Link("log", "not made again", text)


def _options(how: dict[str, Any]) -> str:
    """Return how a log is read, in words."""
    said = []
    for name, value in how.items():
        if name == "gains" and isinstance(value, dict):
            # Their errors stand in the recipe, and change no row.
            value = {key: value.get(key) for key in ("file", "joint_names", "gains")}
        # In full: what is cut off could take other columns, or scale them.
        said.append(f"{name}={json.dumps(value)}")
    return ", ".join(said)


def find_robot(
    sealed: Sealed, given: RobotModel | str | os.PathLike[str] | None
) -> tuple[RobotModel | None, Link, bool]:
    """Return the robot, whether it is the one of the run, and whether it is from the folder.

    Rows depend on the kinematics alone. Without a given robot, identified.urdf has them if they
    are, number for number, those that the manifest names; so has a robot that a catalog names.
    """
    recipe = sealed.recipe.robot
    if isinstance(given, RobotModel):
        return given, _judged(sealed, given, "the given robot"), False
    if given is None and (ours := _of_folder(sealed)) is not None:
        return ours, _judged(sealed, ours, f"{URDF} in the folder"), True
    if given is None and recipe.catalog and recipe.source and _installed(recipe.source):
        given = recipe.source
    if given is not None:
        robot = load_robot(given, **recipe.arguments)
        return robot, _judged(sealed, robot, shown(str(given))), False
    named = "" if recipe.source is None else f" {shown(recipe.source)}"
    how = f"{named.strip()} (--robot)" if named else "the model in Python (robot=)"
    text = f"the robot's description{named} is not in the folder: give {how}"
    return None, Link("robot", "not made again", text), False


def _of_folder(sealed: Sealed) -> RobotModel | None:
    """Return the robot of identified.urdf, None where its kinematics are not the manifest's."""
    recipe = sealed.recipe.robot
    if recipe.kinematics is None or not (sealed.folder / URDF).is_file():
        return None
    try:
        # No run writes xacro, and its expressions are run; the folder may be anybody's.
        description = read_description(sealed.folder / URDF)
        if is_xacro(description):
            return None
        text = without_level(description.text)
        robot = load_robot(text, root=recipe.root, gravity=recipe.gravity)
    except ModelError:
        return None
    return robot if kinematics_digest(robot) == recipe.kinematics else None


def _installed(name: str) -> bool:
    """Return whether a name is that of a robot on this machine: a manifest may name any file."""
    known = (*bundled_robots(), *example_robots())
    return name in known or name in {each.split("/")[-1] for each in known}


def _judged(sealed: Sealed, robot: RobotModel, name: str) -> Link:
    """Compare text and kinematics of a robot with those of the manifest."""
    recipe, entry = sealed.recipe.robot, sealed.robot
    kinematics = kinematics_digest(robot)
    sealed_text = None if entry is None or recipe.source is None else entry["sha256"]
    text = None if robot.source is None else robot.source.sha256
    state: State = "not made again"
    if recipe.kinematics is None:
        said = f"the recipe names no kinematics, and {name} has some: SHA-256 {kinematics}"
    elif text is not None and text == sealed_text:
        state = "made again"
        said = f"{name} has the SHA-256 of the manifest, {text}{_taken(recipe)}"
        if kinematics != recipe.kinematics:
            said += (
                "; its kinematics have another SHA-256 than the manifest names, as they have where "
                "a processor rounds otherwise: rows and robots are compared with those read here"
            )
    elif kinematics == recipe.kinematics:
        state = "made again"
        said = (
            f"the kinematics of {name} are, number for number, those that the manifest names "
            f"(SHA-256 {kinematics}){_taken(recipe)}"
        )
    else:
        said = (
            f"{name} is another robot: SHA-256 {text or kinematics}, the manifest names "
            f"{shown(recipe.source or recipe.name)} with {sealed_text or recipe.kinematics}"
        )
    return Link("robot", state, said)


def _taken(recipe: RobotRecipe) -> str:
    """Return what the recipe takes of the robot beside its description, in words."""
    gravity = "({:g}, {:g}, {:g})".format(*recipe.gravity)
    said = f"; gravity is taken to be {gravity} m/s² in the base"
    given = ", ".join(f"{shown(k)}={shown(v)}" for k, v in sorted(recipe.xacro_args.items()))
    return f"{said}; its macros are given {given}" if given else said
