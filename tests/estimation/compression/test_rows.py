"""Rows in chunks, whitened and compressed, against the same written out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.estimation.compression import rows as module
from sdpid.estimation.compression.covariance import whitener
from sdpid.estimation.compression.rows import CHUNK, RowSource
from sdpid.estimation.compression.whitening import compress, weights, whiten, whitened_chunks
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.terms import Coupling
from sdpid.robot.model import regressor_kernel as kernels
from sdpid.robot.model.base_parameters import structural_base
from tests.helpers.data import make_samples, random_covariance, random_theta
from tests.helpers.robots import small_arm
from tests.helpers.strategies import SEEDS

ARM = small_arm(3)

# Products of the same numbers in another order, relative to the largest.
ORDER = 1e-12


def source(count: int, *, masked: bool = False, per_sample: bool = False, seed: int = 0) -> Any:
    """Return rows, and a covariance for all or one a sample."""
    rng = np.random.default_rng(seed)
    theta = random_theta(ARM, rng, ("coulomb", "viscous"))
    samples = make_samples(ARM, theta, rng, count=count, noise=0.1)
    if masked:
        samples = replace(samples, mask=rng.random(samples.effort.shape) < 0.7)
    friction = FrictionModel.from_terms(("coulomb", "viscous"), ARM.joint_names)
    rows = RowSource(ARM, friction, structural_base(ARM, friction), samples)
    sigma = random_covariance(rng, ARM.n)
    if per_sample:
        sigma = np.stack([random_covariance(rng, ARM.n) for _ in range(count)])
    return rows, sigma


def plain(rows: RowSource) -> Array:
    """Return the base regressor from all columns."""
    s = rows.samples
    every = [
        ARM.regressor(s.position, s.velocity, s.acceleration),
        rows.friction.columns(s.velocity, s.acceleration),
    ]
    return np.concatenate(every, axis=2)[:, :, rows.base.kept]


def plainly_whitened(rows: RowSource, sigma: Array, exponent: float = -0.5) -> Array:
    s = rows.samples
    mask = np.ones(s.effort.shape, dtype=bool) if s.mask is None else s.mask
    weight = whitener(sigma, mask, exponent)
    return weight @ np.concatenate([plain(rows), s.effort[:, :, None]], axis=2)


def near(found: Array, expected: Array) -> None:
    scale = max(float(np.abs(expected).max()), 1e-300)
    np.testing.assert_allclose(found, expected, rtol=0, atol=ORDER * scale)


@pytest.fixture(params=[True, False], ids=["numba", "numpy"])
def numba(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """With and without the compiled loops."""
    if request.param:
        pytest.importorskip("numba")
        monkeypatch.setattr(kernels, "SMALL", 0)
    else:
        monkeypatch.setattr(kernels, "compiled", lambda: None)
    return bool(request.param)


@pytest.mark.usefixtures("numba")
def test_only_the_kept_columns_are_written() -> None:
    rows, _ = source(40)
    near(rows.regressor(slice(None)), plain(rows))
    near(rows.regressor(slice(3, 30, 4)), plain(rows)[3:30:4])
    stacked = rows.rows(slice(5, 25))
    near(stacked[:, :, :-1], plain(rows)[5:25])
    np.testing.assert_array_equal(stacked[:, :, -1], rows.samples.effort[5:25])


@pytest.mark.usefixtures("numba")
def test_memory_is_used_again_whatever_was_in_it() -> None:
    rows, _ = source(40)
    memory = np.full((25, ARM.n, rows.base.count + 1), np.nan)
    found = rows.rows(slice(0, 20), memory)
    assert np.shares_memory(found, memory)
    np.testing.assert_array_equal(found, rows.rows(slice(0, 20)))


def test_terms_across_joints_have_their_columns() -> None:
    terms = ("coulomb", Coupling(ARM.joint_names[1], ARM.joint_names[2]), "offset")
    friction = FrictionModel.from_terms(terms, ARM.joint_names)
    rows, _ = source(30)
    rows = RowSource(ARM, friction, structural_base(ARM, friction), rows.samples)
    near(rows.regressor(slice(None)), plain(rows))


def test_chunks_have_the_bytes_they_should() -> None:
    rows, _ = source(30)
    sample = 8 * ARM.n * (rows.base.count + 1)
    assert module.CHUNK_BYTES - sample < rows.chunk_size * sample <= module.CHUNK_BYTES
    parts = [part for part, *_ in rows.chunks(7)]
    assert [(p.start, p.stop) for p in parts] == [(0, 7), (7, 14), (14, 21), (21, 28), (28, 30)]
    assert len(list(rows.chunks())) == 1
    assert CHUNK > 0


def test_a_chunk_outlives_the_next() -> None:
    rows, _ = source(30)
    near(np.concatenate([W for _, W, _, _ in list(rows.chunks(8))]), plain(rows))


def test_the_last_few_samples_are_computed_like_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("numba")
    monkeypatch.setattr(kernels, "SMALL", 20_000)
    rows, _ = source(60)
    whole = rows.regressor(slice(0, 60))
    np.testing.assert_array_equal(rows.regressor(slice(58, 60)), whole[58:60])


@pytest.mark.usefixtures("numba")
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("per_sample", [False, True])
@pytest.mark.parametrize("exponent", [-0.5, -0.25, -1.0])
def test_whitening(masked: bool, per_sample: bool, exponent: float) -> None:
    rows, sigma = source(50, masked=masked, per_sample=per_sample)
    expected = plainly_whitened(rows, sigma, exponent)
    mask = rows.mask(slice(None))
    near(whiten(rows.rows(slice(None)), sigma, mask, exponent), expected)
    found = [x.copy() for _, x, _ in whitened_chunks(rows, sigma, exponent)]
    near(np.concatenate(found), expected)
    kept = [x for _, x, _ in whitened_chunks(rows, sigma, exponent, size=7, keep=True)]
    assert [len(x) for x in kept] == [7] * 7 + [1]
    near(np.concatenate(kept), expected)
    assert not expected[~mask].any()
    assert not np.concatenate(found)[~mask].any()


@pytest.mark.parametrize("exponent", [-0.5, -1.0])
def test_whitening_by_independent_joints(exponent: float) -> None:
    rows, sigma = source(50)
    sigma = np.diag(np.diagonal(sigma))
    expected = plainly_whitened(rows, sigma, exponent)
    near(np.concatenate([x.copy() for _, x, _ in whitened_chunks(rows, sigma, exponent, size=8)]),
         expected)  # fmt: skip
    W, effort = plain(rows), rows.samples.effort
    before = W.copy()
    near(whiten(np.dstack([W, effort]), sigma, rows.mask(slice(None)), exponent), expected)
    np.testing.assert_array_equal(W, before)


@given(SEEDS, st.integers(1, 20), st.integers(1, 12))
def test_each_sample_has_its_pattern(seed: int, count: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    mask = rng.random((count, n)) < 0.6
    sigma = random_covariance(rng, n)
    powers, index = weights(sigma, mask)
    near(powers[index], whitener(sigma, mask, -0.5))
    assert len(powers) <= len(np.unique(mask, axis=0))


@pytest.mark.usefixtures("numba")
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("per_sample", [False, True])
@pytest.mark.parametrize("size", [1, 9_000, 1 << 21])
def test_compression_takes_every_row_once(
    masked: bool, per_sample: bool, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "CHUNK_BYTES", size)
    rows, sigma = source(700 if size > 1 else 30, masked=masked, per_sample=per_sample)
    triangle, used = compress(rows, sigma)
    flat = plainly_whitened(rows, sigma).reshape(-1, rows.base.count + 1)
    near(triangle.R.T @ triangle.R, flat.T @ flat)
    assert used == int(rows.mask(slice(None)).sum())


def test_the_same_rows_give_the_same_bits() -> None:
    rows, sigma = source(300, masked=True)
    one, other = (compress(rows, sigma)[0].R for _ in range(2))
    np.testing.assert_array_equal(one, other)


def test_the_rows_of_other_samples() -> None:
    rows, _ = source(30)
    other, _ = source(20, seed=1)
    assert rows.on(other.samples).n_samples == 20
    near(rows.on(other.samples).regressor(slice(None)), plain(other))
