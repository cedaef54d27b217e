"""A recording and its robot: which base it has, and which column is which joint."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid._common.files import printable
from sdpid.errors import DataError
from sdpid.experiment.recording.recording import OPTIONAL, Recording, channels, renamed
from sdpid.experiment.recording.stored import transformed
from sdpid.robot.model.closure import close_loops
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel

# Gears give way by far less than this share of the motion.
FOLLOWS = 0.05
# What differs by a smaller share is the same encoder, rounded.
_REPEATS = 1e-5


def two_encoders(log: Recording) -> Mask:
    """Return which joints have an encoder at the link that follows the motor's, (n,)."""
    if log.link_position is None:
        return np.zeros(log.n, dtype=bool)
    motor, link = np.asarray(log.position), np.asarray(log.link_position)
    off, moved = (motor - link).std(axis=0), motor.std(axis=0)
    return np.asarray((off > _REPEATS * moved) & (unlike(motor, link) < FOLLOWS))


def unlike(motor: Array, link: Array) -> Array:
    """Return what of positions of links motors' do not explain, late or not, (n,).

    It is a share of the motion; infinite without any.
    """
    moved, rate = motor - motor.mean(axis=0), np.gradient(motor, axis=0)
    off, power = (motor - link) - (motor - link).mean(axis=0), np.sum(rate**2, axis=0)
    late = np.sum(rate * off, axis=0) / np.where(power > 0.0, power, 1.0)
    size = moved.std(axis=0)
    left = (off - late * rate).std(axis=0)
    return np.where(size > 0.0, left / np.where(size > 0.0, size, 1.0), np.inf)


def match_joints(robot: RobotModel, log: Recording) -> Recording:
    """Return a recording with the robot's joints, in the robot's order.

    Columns are found by name, and columns of other joints (a gripper's) are left out. Names may
    differ from the robot's by one common prefix and one common suffix: ``left_elbow_joint`` is
    ``elbow_joint`` and ``fer_joint1`` is ``panda_joint1``. Only a recording without names is
    taken column by column. Joints without motors (`RobotModel.passive`) need no column where loops
    tell their positions, and their efforts are zero.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    log : Recording
        What was measured.

    Returns
    -------
    Recording

    Raises
    ------
    DataError
        When a joint of the robot has no column or could have several, or when there are no names
        and another number of columns.
    """
    # A recording's names are without what a terminal would obey; so are the robot's, to be matched.
    wanted = tuple(map(printable, robot.joint_names[robot.n_base :]))
    missing = lacking(robot, log)
    picked = _picked(robot, log, tuple(name for name in wanted if name not in missing))
    return _with_passive_joints(robot, picked, missing) if robot.passive else picked


def _picked(robot: RobotModel, log: Recording, wanted: tuple[str, ...]) -> Recording:
    """Return a recording of some joints of a robot, in this order."""
    names = log.joint_names
    if log.n < len(wanted) or (names is None and log.n != len(wanted)):
        raise DataError(
            f"the recording has {log.n} joints, the robot '{robot.name}' has {len(wanted)}: "
            f"{', '.join(wanted)}. Give a column for each of them and, where there are "
            "others, the columns' joint_names."
        )
    if names is None or log.n == 1:
        return renamed(log, wanted)
    order = joint_columns(robot, names, wanted)
    if order == list(range(log.n)):
        return renamed(log, wanted)
    tables: dict[str, Any] = {
        name: transformed(table, lambda values: values[:, order])
        for name, table in channels(log).items()
    }
    gains = None if log.gains is None else log.gains.picked(order, wanted)
    return replace(log, **tables, joint_names=wanted, gains=gains)


def joint_columns(
    robot: RobotModel, names: Sequence[str], wanted: Sequence[str] | None = None
) -> list[int]:
    """Return the column of each of the robot's joints, or of some of them.

    Raises
    ------
    DataError
        When a joint has no column, or could have several.
    """
    wanted = tuple(map(printable, robot.joint_names[robot.n_base :] if wanted is None else wanted))
    ways = ways_to_match(wanted, names)
    if len(ways) == 1:
        (way,) = ways
        return [list(names).index(name) for name in way]
    here = f"joint names of the recording ({', '.join(names)})"
    if ways:
        listed = "; ".join(", ".join(way) for way in sorted(ways))
        raise DataError(
            f"{here} match those of the robot '{robot.name}' in {len(ways)} ways: {listed}. Leave "
            "out the columns of other joints, or rename the columns."
        )
    common = set(names) & set(wanted)
    missing = [name for name in wanted if name not in common]
    lacks = f", which lack {', '.join(missing)}" if common else ""
    raise DataError(
        f"{here}{lacks} are not those of the robot '{robot.name}' "
        f"({', '.join(wanted)}), not even with another prefix or suffix. Say which "
        "joint each column is, in the columns' order, with joint_names=[...] or, for the robot's "
        f"order, --joint-names {','.join(wanted)}."
    )


def ways_to_match(wanted: Sequence[str], names: Sequence[str]) -> set[tuple[str, ...]]:
    """Return the names that may stand for those wanted: they themselves, or with other affixes."""
    if set(wanted) <= set(names):
        return {tuple(wanted)}
    cores = list(wanted)
    if len(wanted) > 1:
        start = len(os.path.commonprefix(cores))  # noqa: RUF071 (names are no paths)
        cores = [name[start:] for name in wanted]
        end = len(os.path.commonprefix([core[::-1] for core in cores]))  # noqa: RUF071
        cores = [core[: len(core) - end] for core in cores]
    ways = set()
    # One prefix and one suffix of all names: those around the first one, wherever it stands.
    for name in names:
        for start in range(len(name) - len(cores[0]) + 1):
            if name.startswith(cores[0], start):
                prefix, suffix = name[:start], name[start + len(cores[0]) :]
                ways.add(tuple(f"{prefix}{core}{suffix}" for core in cores))
    return {way for way in ways if set(way) <= set(names)}


def lacking(robot: RobotModel, log: Recording) -> tuple[str, ...]:
    """Return the joints without motors that a recording has no column for."""
    count = robot.n - robot.n_base
    if log.joint_names is None:
        return robot.passive if log.n == count - len(robot.passive) else ()
    # With other prefixes none of them has a name of its own, and all or none are there.
    if log.n >= count and not set(robot.passive) & set(log.joint_names):
        return ()
    return tuple(name for name in robot.passive if name not in log.joint_names)


def _with_passive_joints(robot: RobotModel, log: Recording, missing: tuple[str, ...]) -> Recording:
    """Return a recording of all joints, made of one that lacks some of those without motors.

    Efforts of joints without motors are zero, whatever was recorded. Where positions are those
    that close loops, there is no velocity and no reference.
    """
    if log.currents or log.gains is not None:
        raise DataError(
            f"gains: errors of drive gains are not known for robots with joints without motors "
            f"({', '.join(robot.passive)}); read the recording with torques (effort_scale)."
        )
    names = robot.joint_names[robot.n_base :]
    tables: dict[str, Any] = {}
    for quantity, table in channels(log).items():
        tables[quantity] = np.zeros((log.n_samples, len(names)))
        tables[quantity][:, [names.index(name) for name in log.names]] = table
    tables["effort"][:, [names.index(name) for name in robot.passive]] = 0.0
    if missing:
        tables["position"] = close_loops(robot, tables["position"], list(missing))
        tables |= dict.fromkeys(("velocity", *OPTIONAL))
    return replace(log, joint_names=names, **tables)


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
