"""Match the joints of a recording with the joints of a robot, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import takewhile
from typing import Any

from sdpid._common.text import printable
from sdpid.errors import DataError
from sdpid.experiment.recording.loops.passive_joints import lacking, with_passive_joints
from sdpid.experiment.recording.recording import Recording, channels, renamed
from sdpid.experiment.recording.stored import transformed
from sdpid.robot.model.model import RobotModel


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
    if not robot.passive:
        return _picked(robot, log, wanted)
    missing = lacking(robot, log)
    return with_passive_joints(
        robot, _picked(robot, log, tuple(name for name in wanted if name not in missing))
    )


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
    picked = partial(transformed, function=lambda values: values[:, order])
    tables: dict[str, Any] = {name: picked(table) for name, table in channels(log).items()}
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
    return _ways(_without_affixes(wanted), names)


def _without_affixes(names: Sequence[str]) -> list[str]:
    """Return names without their longest common prefix and suffix."""
    if len(names) == 1:
        return list(names)
    start = _common(names)
    rest = [name[start:] for name in names]
    end = _common([name[::-1] for name in rest])
    return [name[: len(name) - end] for name in rest]


def _common(names: Sequence[str]) -> int:
    """Return the length of the longest common prefix."""
    shared = takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))
    return sum(1 for _ in shared)


def _ways(cores: Sequence[str], names: Sequence[str]) -> set[tuple[str, ...]]:
    """Return all choices of names ``prefix + core + suffix`` with one prefix and one suffix."""
    there = set(names)
    ways = set()
    first = cores[0]
    for name in names:
        for start in range(len(name) - len(first) + 1):
            if not name.startswith(first, start):
                continue
            prefix, suffix = name[:start], name[start + len(first) :]
            way = tuple(f"{prefix}{core}{suffix}" for core in cores)
            if there.issuperset(way):
                ways.add(way)
    return ways
