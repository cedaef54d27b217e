"""Refuse robots that are no arms, where only fixed open chains are known."""

from __future__ import annotations

from sdpid.errors import ModelError
from sdpid.robot.model.model import RobotModel


def require_fixed_robot(robot: RobotModel, what: str, *, instead: str = "") -> None:
    """Refuse a robot with a floating base.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    what : str
        What asks for it, as the beginning of the message.
    instead : str, optional
        What else there is, as its last sentence.

    Raises
    ------
    ModelError
        Saying how a robot that hangs by its base is loaded.
    """
    if robot.free_flyer:
        raise ModelError(
            f"{what}: '{robot.name}' has a floating base, and only robots that are fixed to the "
            "ground are known here. Where its base is held, load its URDF without "
            "root='free_flyer', or an MJCF without <freejoint/>, and give recordings without a "
            f"base.{instead and ' ' + instead}"
        )


def require_open_chain(robot: RobotModel, what: str) -> None:
    """Refuse a robot whose loops close, or with joints without motors.

    Raises
    ------
    ModelError
        Saying what is not known of it.
    """
    if robot.loops:
        raise ModelError(
            f"{what}: '{robot.name}' has loops that close "
            f"({', '.join(loop.name for loop in robot.loops)}); this is known for open chains only."
        )
    if robot.passive:
        raise ModelError(
            f"{what}: joints of '{robot.name}' have no motors ({', '.join(robot.passive)}); this "
            "is known for robots with a motor at every joint only."
        )
