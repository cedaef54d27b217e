"""Orders of a robot's joints in which whole legs, or joints of all legs, are exchanged."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations

from sdpid._common.arrays import Mask
from sdpid.robot.model.model import RobotModel

# Orders of more legs are not tried.
MOST_LEGS = 4


def exchanges(order: tuple[int, ...], poor: Mask) -> bool:
    """Return whether an order exchanges two joints of these, or moves more."""
    moved = [joint for joint, place in enumerate(order) if joint != place]
    return len(moved) > 2 or bool(poor[moved].all())


def leg_orders(robot: RobotModel) -> Iterator[tuple[int, ...]]:
    """Yield orders in which legs, or the joints of all legs, are exchanged."""
    legs = _legs_of(robot)
    n = sum(len(leg) for leg in legs)
    by_size: dict[int, list[list[int]]] = {}
    for leg in legs:
        by_size.setdefault(len(leg), []).append(leg)
    for size, alike in by_size.items():
        if not 1 < len(alike) <= MOST_LEGS:
            continue
        flat = [joint for leg in alike for joint in leg]
        turned = [alike[k // size][k % size] for k in range(len(flat))]
        ways = [[joint for leg in way for joint in leg] for way in permutations(alike)]
        # All first joints of legs, then all second ones; and the way back.
        by_joint = [leg[k] for k in range(size) for leg in alike]
        back = [flat[by_joint.index(joint)] for joint in flat]
        for way in (*ways, by_joint, back, [joint for leg in alike for joint in reversed(leg)]):
            order = list(range(n))
            for place, joint in zip(turned, way, strict=True):
                order[place] = joint
            if order != list(range(n)):
                yield tuple(order)


def _legs_of(robot: RobotModel) -> list[list[int]]:
    """Return the joints that hang on the base one after another, counted from 0 behind it."""
    parents = list(robot.pin_model.parents)
    legs: dict[int, list[int]] = {}
    first: dict[int, int] = {}
    for joint in range(2, len(parents)):
        first[joint] = joint if parents[joint] == 1 else first[parents[joint]]
        legs.setdefault(first[joint], []).append(joint - 2)
    return list(legs.values())
