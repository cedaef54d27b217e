"""Rows of branches have the columns that they are said to have, and no others."""

from __future__ import annotations

import numpy as np
import pytest

import sdpid
from sdpid.estimation.compression.branches import Branches
from sdpid.estimation.compression.rows import RowSource
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import structural_base
from tests.helpers.legged import gait, quadruped


@pytest.mark.parametrize(
    "terms", [(), ("coulomb", "viscous"), (sdpid.friction.AsymmetricCoulomb(), "offset")]
)
def test_rows_of_a_branch_are_zero_outside_its_columns(terms: tuple[object, ...]) -> None:
    robot, samples = quadruped(), gait(20).samples
    friction = FrictionModel.from_terms(terms, robot.joint_names, first=robot.n_base)  # type: ignore[arg-type]
    rows = RowSource(robot, friction, structural_base(robot, friction), samples)
    assert len(rows.branches.columns) == 4
    np.testing.assert_array_equal(
        rows.branches.of_row, [-1] * 6 + [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]
    )
    block = rows.rows(slice(None))
    for i, own in enumerate(rows.branches.of_row):
        if own >= 0:
            others = np.delete(block[:, i], rows.branches.columns[own], axis=1)
            assert not others.any()


def test_rows_that_have_most_columns_are_of_no_branch() -> None:
    found = Branches.of(np.tri(4, dtype=bool))
    assert found.of_row.tolist() == [0, 0, -1, -1]
    assert [own.tolist() for own in found.columns] == [[0, 1]]
