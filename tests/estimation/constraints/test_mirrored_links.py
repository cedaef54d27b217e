"""Pairs of left and right links, found by their names, and what they say about described robots."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.constraints import Layout, equal_friction, mirror_pairs
from sdpid.errors import DataError, ModelError
from sdpid.robot.friction.model import FrictionModel


@pytest.mark.parametrize(("name", "count"), [("a1", 6), ("go2", 6), ("talos_reduced", 14)])
def test_pairs_are_found_by_name(name: str, count: int) -> None:
    robot = sdpid.load_robot(name, root="free_flyer")
    pairs = mirror_pairs(robot)
    assert len(pairs) == count
    assert len({link for pair in pairs for link in (pair.first, pair.second)}) == 2 * count


def test_legs_that_are_described_as_mirror_images_obey() -> None:
    robot = sdpid.load_robot("a1", root="free_flyer")
    friction = FrictionModel.from_terms((), robot.joint_names, first=robot.n_base)
    layout, theta = Layout(robot, friction), robot.prior.reshape(-1)
    rows = [row for pair in mirror_pairs(robot) for row in pair.compile(layout)]
    assert len(rows) == 60
    assert max(abs(float(row.coefficients @ theta)) for row in rows) < 1e-12


def test_what_are_no_mirror_images_is_refused() -> None:
    robot = sdpid.load_robot("a1", root="free_flyer")
    with pytest.raises(ModelError, match=r"'FL_hip' is 0\.[0-9]+ m away from that of 'RR_hip'"):
        mirror_pairs(robot, [("FL_hip", "RR_hip")])
    with pytest.raises(ModelError, match="has no link left_foot"):
        mirror_pairs(robot, [("left_foot", "FR_hip")])
    with pytest.raises(DataError, match="differ in a word for a side"):
        mirror_pairs(sdpid.load_robot("ur5_robot"))


FRONT = ("FL_hip", "FR_hip")


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ("FL_hip", "pairs is 'FL_hip'; give"),
        (3, "pairs is 3; give"),
        ([], "pairs is empty"),
        (["FL", "FR"], "pairs holds 'FL'; give"),
        ([("FL_hip",)], r"pairs holds \('FL_hip',\); give"),
        ([(*FRONT, "RL_hip")], "pairs holds .*'RL_hip'"),
        ([("FL_hip", 1)], r"pairs holds \('FL_hip', 1\)"),
        ([("FL_hip", "FL_hip")], "'FL_hip' twice in a pair"),
        ([FRONT, FRONT], "'FL_hip' and 'FR_hip' is given twice"),
        ([FRONT, FRONT[::-1]], "'FR_hip' and 'FL_hip' is given twice"),
    ],
)
def test_pairs_that_are_none_are_refused(pairs: Any, message: str) -> None:
    robot = sdpid.load_robot("a1", root="free_flyer")
    with pytest.raises(DataError, match=rf"mirror_pairs: .*{message}"):
        mirror_pairs(robot, pairs)


@pytest.mark.parametrize("asked", [mirror_pairs, equal_friction])
@pytest.mark.parametrize(
    ("normal", "message"),
    [
        ((0.0, 0.0, 0.0), " is zero"),
        ((0.0, np.nan, 0.0), ": 1 of 3 values are not finite"),
        ((0.0, 1.0), ": 2 numbers, give 3"),
    ],
)
def test_a_normal_is_a_direction(asked: Any, normal: Any, message: str) -> None:
    robot = sdpid.load_robot("a1", root="free_flyer")
    with pytest.raises(DataError, match=f"{asked.__name__}: normal{message}"):
        asked(robot, normal=normal)


@pytest.mark.parametrize("size", [1e-300, 3.0, 1e300])
def test_a_normal_has_any_length(size: float) -> None:
    robot = sdpid.load_robot("a1", root="free_flyer")
    pairs = mirror_pairs(robot, normal=(0.0, size, 0.0))
    assert [list(np.asarray(pair.normal)) for pair in pairs] == [[0.0, 1.0, 0.0]] * 6
