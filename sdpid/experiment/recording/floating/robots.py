"""Robots for recordings with a base."""

from __future__ import annotations

import os
from collections.abc import Sequence

from sdpid.errors import DataError
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel


def require_fixed_base(log: Recording, what: str) -> None:
    """Refuse a recording of a robot with a floating base.

    Parameters
    ----------
    log : Recording
        What was measured.
    what : str
        What asks for it, as the beginning of the message.

    Raises
    ------
    DataError
        When the recording has a base.
    """
    if log.base is not None:
        raise DataError(
            f"{what}: this recording has a floating base (log.base), and only robots that are "
            "fixed to the ground are known here. Where the base stood still, read the log with "
            "columns={'base_orientation': None}, or drop it with dataclasses.replace(log, "
            "base=None, contacts=None)."
        )


def robot_of(robot: RobotModel | str | os.PathLike[str], logs: Sequence[object] = ()) -> RobotModel:
    """Return a robot as it is, or load it: with a floating base where a recording has one.

    Parameters
    ----------
    robot : RobotModel, name or path
        As for `load_robot`.
    logs : sequence
        What was measured; what is no recording, such as the path of one, says nothing.
    """
    if isinstance(robot, RobotModel):
        return robot
    floats = any(isinstance(log, Recording) and log.base is not None for log in logs)
    return load_robot(robot, root="free_flyer" if floats else None)


def require_its_base(robot: RobotModel, log: Recording) -> None:
    """Refuse a recording with a base for a robot that is fixed, and one without for another.

    Raises
    ------
    DataError
        Saying what to do.
    """
    if log.base is not None and not robot.free_flyer:
        raise DataError(
            f"robot: '{robot.name}' is fixed to the ground, and the recording has a floating base; "
            "give the description's name or path itself, or sdpid.load_robot(path, "
            "root='free_flyer')."
        )
    if log.base is None and robot.free_flyer:
        raise DataError(
            f"base: the recording has no motion of the base, and '{robot.name}' has a floating "
            "one; give sdpid.Recording(base=sdpid.BaseMotion(orientation=...)), "
            "log.with_held_base(link) where it was held, or a robot with a fixed base (load_robot "
            "without root)."
        )
