"""Arms: refuse what is none, where only fixed open chains are known; find what carries a load."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
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


def carrying_link(robot: RobotModel, name: str | None, *, what: str) -> int:
    """Return the link that carries a load: by default the last one.

    Parameters
    ----------
    robot : RobotModel
        The arm.
    name : str or None
        Name of the link.
    what : str
        What messages begin with.

    Raises
    ------
    ModelError
        When there is no such link, or there are several last ones.
    """
    if name is not None:
        if name not in robot.link_names:
            raise ModelError(
                f"{what}: '{robot.name}' has no link '{name}'; its links are "
                f"{', '.join(robot.link_names)}."
            )
        return robot.link_names.index(name)
    parents = {int(i) for i in list(robot.pin_model.parents)[1:]}
    last = [i for i in range(robot.n_links) if i + 1 not in parents]
    if len(last) > 1:
        raise ModelError(
            f"{what}: '{robot.name}' has {len(last)} last links, "
            f"{', '.join(robot.link_names[i] for i in last)}; say which carries it (link=...)."
        )
    return last[0]


def frame_on_link(
    robot: RobotModel, link: int, name: str | None, *, what: str
) -> tuple[Array, Array, str]:
    """Return rotation and translation of a frame in a link's joint frame, and what to call it.

    Parameters
    ----------
    robot : RobotModel
        The arm.
    link : int
        The link.
    name : str or None
        A frame fixed to it; by default its joint frame.
    what : str
        What messages begin with.

    Raises
    ------
    ModelError
        When no such frame is fixed to the link.
    """
    if name is None:
        joint = str(robot.pin_model.names[link + 1])
        return np.eye(3), np.zeros(3), f"of joint {joint}"
    fixed = [f for f in robot.pin_model.frames if f.parentJoint == link + 1]
    for found in fixed:
        if found.name == name:
            place = found.placement
            return np.array(place.rotation), np.array(place.translation), name
    there = sorted({str(f.name) for f in fixed})
    raise ModelError(
        f"{what}: no frame '{name}' is fixed to link '{robot.link_names[link]}'; there are "
        f"{', '.join(there)}."
    )
