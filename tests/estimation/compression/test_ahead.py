"""What is computed ahead is what would be computed in turn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sdpid._common.arrays import Array
from sdpid.estimation.compression import rows as rows_module
from sdpid.estimation.compression import whitening
from sdpid.estimation.compression.ahead import one_ahead
from sdpid.estimation.compression.rows import RowSource
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model import regressor_kernel as kernels
from sdpid.robot.model.base_parameters import structural_base
from tests.helpers.legged import NOISE, gait, quadruped


@pytest.mark.parametrize("ahead", [False, True])
@pytest.mark.parametrize("count", [0, 1, 2, 7])
def test_results_come_in_order_and_memory_of_one_turn_lasts_until_the_next(
    ahead: bool, count: int
) -> None:
    memory = np.zeros(2, dtype=int)

    def write(item: int, turn: int) -> Array:
        memory[turn] = item
        return memory[turn : turn + 1]

    assert [int(found[0]) for found in one_ahead(write, range(count), ahead=ahead)] == [
        *range(count)
    ]


def test_an_error_arrives_where_its_result_would() -> None:
    found = one_ahead(lambda i, _: 1 // (i - 2), range(5))
    assert [next(found), next(found)] == [-1, -1]
    with pytest.raises(ZeroDivisionError):
        next(found)


@pytest.mark.parametrize("flying", [False, True])
def test_threads_change_no_bit_and_branches_no_product(
    monkeypatch: pytest.MonkeyPatch, flying: bool
) -> None:
    pytest.importorskip("numba")
    monkeypatch.setattr(kernels, "WORTH", 0)
    monkeypatch.setattr(rows_module, "CHUNK_BYTES", 1 << 19)
    robot, samples = quadruped(), gait(240).samples
    if flying:
        samples = replace(samples, contacts=None)
    friction = FrictionModel.from_terms(("viscous",), robot.joint_names, first=robot.n_base)
    rows = RowSource(robot, friction, structural_base(robot, friction), samples)
    assert len(rows.branches.columns) == 4
    sigma = np.diag(NOISE**2)
    found = []
    for count in (1, 2):
        monkeypatch.setattr(whitening, "threads", lambda count=count: count)
        found.append(whitening.compress(rows, sigma))
    (one, used), (two, again) = found
    np.testing.assert_array_equal(one.R, two.R)
    assert used == again
    chunks = whitening.whitened_chunks(rows, sigma, keep=True)
    whole = np.concatenate([block.reshape(-1, one.columns) for _, block, _ in chunks])
    scale = np.linalg.norm(whole, axis=0) + 1e-300
    R, W = one.R / scale, whole / scale
    np.testing.assert_allclose(R.T @ R, W.T @ W, atol=1e-13)
