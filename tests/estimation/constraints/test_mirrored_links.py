"""Pairs of left and right links, found by their names, and what they say about described robots."""

from __future__ import annotations

import pytest

import sdpid
from sdpid.constraints import Layout, mirror_pairs
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
