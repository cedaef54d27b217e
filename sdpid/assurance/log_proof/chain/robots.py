"""Find the robot of a results folder, and say what is known of it."""

from __future__ import annotations

import os

from sdpid.assurance.log_proof.chain.links import Link, State
from sdpid.assurance.log_proof.chain.sealed import Sealed
from sdpid.assurance.log_proof.recipe import RobotRecipe
from sdpid.errors import ModelError
from sdpid.robot.description.catalog import bundled_robots, example_robots
from sdpid.robot.description.level import without_level
from sdpid.robot.description.xacro import is_xacro
from sdpid.robot.description.xml import read_description
from sdpid.robot.model.digest import kinematics_digest
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from sdpid.verifier.reading import shown

# The file in a results folder that has the robot's kinematics.
URDF = "identified.urdf"


def find_robot(
    sealed: Sealed, given: RobotModel | str | os.PathLike[str] | None
) -> tuple[RobotModel | None, Link]:
    """Return the robot, and whether it is the one of the run.

    Rows depend on the kinematics alone. Without a given robot, identified.urdf has them if they
    are, number for number, those that the manifest names; so has a robot that a catalog names.
    """
    recipe = sealed.recipe.robot
    if given is not None:
        loaded = isinstance(given, RobotModel)
        robot = given if isinstance(given, RobotModel) else load_robot(given, **recipe.arguments)
        return robot, _judged(sealed, robot, "the given robot" if loaded else shown(str(given)))
    if (ours := _of_folder(sealed)) is not None:
        text = (
            f"the kinematics of {URDF} in the folder are, number for number, those that the "
            f"manifest names (SHA-256 {recipe.kinematics}){_taken(recipe)}"
        )
        return ours, Link("robot", "proven", text)
    if recipe.catalog and recipe.source is not None and _installed(recipe.source):
        robot = load_robot(recipe.source, **recipe.arguments)
        return robot, _judged(sealed, robot, shown(recipe.source))
    named = "" if recipe.source is None else f" {shown(recipe.source)}"
    how = "the model in Python (robot=)" if recipe.source is None else f"{named.strip()} (--robot)"
    text = f"the robot's description{named} is not in the folder: give {how}"
    return None, Link("robot", "not proven", text)


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
    same = kinematics is not None and kinematics == recipe.kinematics
    sealed_text = None if entry is None or recipe.source is None else entry["sha256"]
    text = None if robot.source is None else robot.source.sha256
    state: State = "not proven"
    if kinematics is not None and recipe.kinematics is None:
        said = f"the recipe names no kinematics, and {name} has some: SHA-256 {kinematics}"
    elif text is not None and text == sealed_text:
        state = "proven"
        said = f"{name} has the SHA-256 of the manifest, {text}{_taken(recipe)}"
        if not same:
            said += (
                "; its kinematics have another SHA-256 than the manifest names, as they have where "
                "a processor rounds otherwise: rows and robots are compared with those read here"
            )
    elif same:
        state = "proven"
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
