"""Frames whose speed is that of the tool."""

from __future__ import annotations

import numpy as np

from sdpid.errors import ModelError
from sdpid.robot.model.model import RobotModel


def tool_frames(robot: RobotModel, tool: str | None = None) -> tuple[int, ...]:
    """Return the indices of the frames whose speed is limited as the tool's.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    tool : str, optional
        One frame of the description; by default, of every last link, the frame that is farthest
        from its joint.

    Raises
    ------
    ModelError
        When the robot has no such frame.
    """
    model = robot.pin_model
    frames = dict(enumerate(model.frames))
    if tool is not None:
        for index, frame in frames.items():
            if frame.name == tool:
                return (index,)
        names = dict.fromkeys(str(frame.name) for frame in frames.values())
        raise ModelError(
            f"'{robot.name}' has no frame '{tool}' for the tool; it has {', '.join(names)}."
        )
    last = set(range(1, model.njoints)) - {model.parents[i] for i in range(1, model.njoints)}
    found = []
    for link in sorted(last):
        lengths = {
            index: float(np.linalg.norm(frame.placement.translation))
            for index, frame in frames.items()
            if frame.parentJoint == link
        }
        found.append(max(lengths, key=lambda index: lengths[index]))
    return tuple(found)
