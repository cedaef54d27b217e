"""Refuse robots with loops where only open chains are known."""

from __future__ import annotations

from sdpid.errors import ModelError
from sdpid.robot.model.model import RobotModel

__all__ = ["require_open_chain"]


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
