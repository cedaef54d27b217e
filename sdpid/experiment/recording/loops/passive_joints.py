"""Joints without motors: their efforts are zero, their positions recorded or what closes loops."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sdpid.errors import DataError
from sdpid.experiment.recording.recording import Recording, channels
from sdpid.robot.model.contacts.closure import close_loops
from sdpid.robot.model.model import RobotModel


def driven_joints(robot: RobotModel) -> tuple[str, ...]:
    """Return the joints of a robot that have motors, in its order."""
    return tuple(n for n in robot.joint_names[robot.n_base :] if n not in robot.passive)


def lacking(robot: RobotModel, log: Recording) -> tuple[str, ...]:
    """Return the joints without motors that a recording has no column for."""
    if log.joint_names is None:
        alone = log.n == len(driven_joints(robot))
        return robot.passive if alone else ()
    # With other prefixes none of them has a name of its own, and all or none are there.
    if log.n >= robot.n - robot.n_base and not set(robot.passive) & set(log.joint_names):
        return ()
    return tuple(name for name in robot.passive if name not in log.joint_names)


def with_passive_joints(robot: RobotModel, log: Recording) -> Recording:
    """Return a recording of all joints, made of one of those with motors and perhaps some others.

    Parameters
    ----------
    robot : RobotModel
        With `passive` joints.
    log : Recording
        Its joints have the robot's names.

    Returns
    -------
    Recording
        In the robot's order. Efforts of joints without motors are zero, whatever was recorded.
        Where positions are those that close loops, there is no velocity and no reference.

    Raises
    ------
    DataError
        When efforts are currents or have gains, or the loops do not determine the positions that
        are not recorded.
    """
    if log.currents or log.gains is not None:
        raise DataError(
            f"gains: errors of drive gains are not known for robots with joints without motors "
            f"({', '.join(robot.passive)}); read the recording with torques (effort_scale)."
        )
    names = robot.joint_names[robot.n_base :]
    own = log.names
    at = [names.index(name) for name in own]
    tables: dict[str, Any] = {}
    for quantity, table in channels(log).items():
        tables[quantity] = np.zeros((log.n_samples, len(names)))
        tables[quantity][:, at] = table
    tables["effort"][:, [names.index(name) for name in robot.passive]] = 0.0
    if missing := [name for name in robot.passive if name not in own]:
        tables["position"] = close_loops(robot, tables["position"], missing)
        tables |= dict.fromkeys(("velocity", "reference"))
    return replace(log, joint_names=names, **tables)
