"""Rows: whitened and compressed, in chunks, threads and pieces, as the same written out."""

import itertools
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid import Prior, Samples, build_problem, solve_sdp, validate
from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.closed_loop.instruments import InstrumentalRows
from sdpid.estimation.closed_loop.rounds import SensitivityRows
from sdpid.estimation.compression import covariance as noise_module
from sdpid.estimation.compression import rows as rows_module
from sdpid.estimation.compression import triangle as module
from sdpid.estimation.compression import whitening
from sdpid.estimation.compression.covariance import WEIGHTINGS, LaggedSums, Weighting, power
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import compress, weights, whiten, whitened_chunks
from sdpid.robot.friction.terms import AsymmetricCoulomb, Coupling
from sdpid.robot.model import regressor_kernel as kernels
from tests.helpers import world
from tests.helpers.arm import ARM
from tests.helpers.data import make_samples, random_covariance, random_theta, raw_rows, row_source
from tests.helpers.legged import NOISE, gait, quadruped
from tests.helpers.robots import small_arm
from tests.helpers.strategies import SEEDS

ARM3 = small_arm(3)

# Products of the same numbers in another order, relative to the largest.
ORDER = 1e-12


def source(count: int, *, masked: bool = False, per_sample: bool = False, seed: int = 0) -> Any:
    """Return rows, and a covariance for all or one a sample."""
    rng = np.random.default_rng(seed)
    samples, _ = world.samples(ARM3, seed, count=count, noise=0.1)
    if masked:
        samples = replace(samples, mask=rng.random(samples.effort.shape) < 0.7)
    rows = row_source(ARM3, samples)
    sigma = random_covariance(rng, ARM3.n)
    if per_sample:
        sigma = np.stack([random_covariance(rng, ARM3.n) for _ in range(count)])
    return rows, sigma


def plain(rows: RowSource) -> Array:
    """Return the base regressor from all columns."""
    return raw_rows(rows)[0]


def each_weight(sigma: Array, mask: Array, exponent: float = -0.5) -> Array:
    return np.take(*weights(sigma, mask, exponent), axis=0)


def plainly_whitened(rows: RowSource, sigma: Array, exponent: float = -0.5) -> Array:
    W, effort, mask = raw_rows(rows)
    return each_weight(sigma, mask, exponent) @ np.dstack([W, effort])


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
@pytest.mark.parametrize("across", [False, True])
def test_only_the_kept_columns_are_written(across: bool) -> None:
    rows, _ = source(40)
    if across:
        coupling = Coupling(ARM3.joint_names[1], ARM3.joint_names[2])
        rows = row_source(ARM3, rows.samples, ("coulomb", coupling, "offset"))
    near(rows.regressor(slice(None)), plain(rows))
    near(rows.regressor(slice(3, 30, 4)), plain(rows)[3:30:4])
    stacked = rows.rows(slice(5, 25))
    near(stacked[:, :, :-1], plain(rows)[5:25])
    np.testing.assert_array_equal(stacked[:, :, -1], rows.samples.effort[5:25])


def test_chunks_have_the_bytes_they_should_and_outlive_the_next(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rows, _ = source(60)
    # The last few samples are computed like the others.
    monkeypatch.setattr(kernels, "SMALL", 20_000)
    whole = rows.regressor(slice(0, 60))
    np.testing.assert_array_equal(rows.regressor(slice(58, 60)), whole[58:60])
    rows, _ = source(30)
    near(np.concatenate([W for _, W, _, _ in list(rows.chunks(8))]), plain(rows))
    sample = 8 * ARM3.n * (rows.base.count + 1)
    assert rows_module.CHUNK_BYTES - sample < rows.chunk_size * sample <= rows_module.CHUNK_BYTES
    parts = [part for part, *_ in rows.chunks(7)]
    assert [(p.start, p.stop) for p in parts] == [(0, 7), (7, 14), (14, 21), (21, 28), (28, 30)]
    assert len(list(rows.chunks())) == 1


@pytest.mark.usefixtures("numba")
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("which", ["common", "per_sample", "diagonal"])
@pytest.mark.parametrize("exponent", [-0.5, -0.25, -1.0])
def test_whitening(masked: bool, which: str, exponent: float) -> None:
    rows, sigma = source(50, masked=masked, per_sample=which == "per_sample")
    sigma = np.diag(np.diagonal(sigma)) if which == "diagonal" else sigma
    expected = plainly_whitened(rows, sigma, exponent)
    mask = rows.mask(slice(None))
    near(whiten(rows.rows(slice(None)), sigma, mask, exponent), expected)
    found = [x for _, x, _ in whitened_chunks(rows, sigma, exponent)]
    near(np.concatenate(found), expected)
    kept = [x for _, x, _ in whitened_chunks(rows, sigma, exponent, size=7)]
    assert [len(x) for x in kept] == [7] * 7 + [1]
    near(np.concatenate(kept), expected)
    assert not expected[~mask].any()
    assert not np.concatenate(found)[~mask].any()


@pytest.mark.usefixtures("numba")
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("per_sample", [False, True])
@pytest.mark.parametrize("size", [1, 9_000, 1 << 21])
def test_compression_takes_every_row_once(
    masked: bool, per_sample: bool, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rows_module, "CHUNK_BYTES", size)
    rows, sigma = source(700 if size > 1 else 30, masked=masked, per_sample=per_sample)
    triangle, used = compress(rows, sigma)
    flat = plainly_whitened(rows, sigma).reshape(-1, rows.base.count + 1)
    near(triangle.R.T @ triangle.R, flat.T @ flat)
    assert used == int(rows.mask(slice(None)).sum())


@pytest.mark.parametrize("flying", [False, True])
def test_threads_change_no_bit(monkeypatch: pytest.MonkeyPatch, flying: bool) -> None:
    pytest.importorskip("numba")
    monkeypatch.setattr(kernels, "WORTH", 0)
    monkeypatch.setattr(rows_module, "CHUNK_BYTES", 1 << 19)
    samples = gait(240).samples
    rows = row_source(quadruped(), replace(samples, contacts=None) if flying else samples)
    found = []
    for count in (1, 2):
        monkeypatch.setattr(whitening, "threads", lambda count=count: count)
        found.append(whitening.compress(rows, np.diag(NOISE**2)))
    (one, used), (two, again) = found
    np.testing.assert_array_equal(one.R, two.R)
    assert used == again


def test_an_error_arrives_where_its_result_would() -> None:
    found = whitening.ahead((np.zeros(0), 1 // (i - 2)) for i in (0, 1, 2))
    assert [next(found)[1], next(found)[1]] == [-1, -1]
    with pytest.raises(ZeroDivisionError):
        next(found)


# ---- Rows of other motions, and of simulated ones, are compressed joint by joint as together.


@pytest.mark.parametrize("kind", ["plain", "instrumental", "sensitivities"])
def test_no_product_of_rows_is_lost(kind: str) -> None:
    rng, samples = np.random.default_rng(2), replace(gait(20).samples, contacts=None)
    rows = row_source(quadruped(), samples, (AsymmetricCoulomb(), "offset"))
    b, source = rows.base.count, (rows.robot, rows.friction, rows.base, samples)
    if kind == "instrumental":
        link, fit = rng.standard_normal((b, b)), rng.standard_normal(b)
        rows = InstrumentalRows(*source, instruments=samples, link=link, fit=fit, shift=0.0 * fit)
    elif kind == "sensitivities":
        slopes = rng.standard_normal((*samples.effort.shape, b))
        rows = SensitivityRows(*source, slopes=slopes, target=samples.effort)
    variance = rng.uniform(0.5, 2.0, rows.robot.n)
    whole = (rows.rows(slice(None)) / np.sqrt(variance)[:, None]).reshape(-1, b + 1)
    scale = np.linalg.norm(whole, axis=0) + 1e-300
    for R in (
        noise_module.JointRows.of(rows).joined(variance).R,
        compress(rows, np.diag(variance))[0].R,
    ):
        np.testing.assert_allclose(*((x / scale).T @ (x / scale) for x in (R, whole)), atol=1e-13)


# ---- Residual weighting, and covariances of masked joints.


COUNT = 4000
SPREAD = np.array([0.5, 2.0, 1.0])

# A share of the overall effort is added to every variance, as a floor (see
# `sdpid.estimation.compression.covariance`).
EFFORT_SHARE = 0.01


def autoregressive(rng: np.random.Generator, count: int, n: int, memory: float) -> Array:
    """Return unit-variance AR(1) noise whose neighbors correlate by `memory`."""
    noise = rng.standard_normal((count, n))
    for k in range(1, count):
        noise[k] = memory * noise[k - 1] + np.sqrt(1.0 - memory**2) * noise[k]
    return noise


def noisy(seed: int, memory: float) -> tuple[Samples, Array]:
    """Return samples with colored noise, and the variances that the weighting is to find."""
    rng = np.random.default_rng(seed)
    theta = random_theta(ARM3, rng)
    noise = SPREAD * autoregressive(rng, COUNT, 3, memory)
    samples = make_samples(ARM3, theta, rng, count=COUNT, noise=noise)
    floor = EFFORT_SHARE**2 * float(np.mean(np.square(samples.effort)))
    return samples, SPREAD**2 + floor


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_residual_weighting_finds_variances_and_correlation_time(memory: float) -> None:
    samples, variance = noisy(0, memory)
    sigma = build_problem(ARM3, samples, weighting="residual").sigma
    diagonal = np.diag(sigma)
    np.testing.assert_array_equal(sigma, np.diag(diagonal), strict=True)
    # The variance of a sample variance: some 1 + 2·m²/(1 − m²) per sample are independent.
    np.testing.assert_allclose(diagonal / diagonal[0], variance / variance[0], rtol=0.25)
    # 1 + 2·Σ m^k of an autoregressive process; cutting the sum at the first sign change, where
    # noise takes over, leaves some tens of percent.
    time = (1.0 + memory) / (1.0 - memory)
    np.testing.assert_allclose(diagonal / variance, time, rtol=0.35)


def test_masked_residuals_do_not_count() -> None:
    samples, variance = noisy(2, 0.0)
    mask = np.random.default_rng(3).random((COUNT, 3)) < 0.6
    spoiled = replace(samples, effort=np.where(mask, samples.effort, 1e3), mask=mask)
    sigma = build_problem(ARM3, spoiled, weighting="residual").sigma
    np.testing.assert_allclose(np.diag(sigma), variance, rtol=0.2)


@given(SEEDS)
def test_powers(seed: int) -> None:
    covariance = random_covariance(np.random.default_rng(seed), 3, 4)
    root = power(covariance, -0.5)
    np.testing.assert_allclose(root @ covariance @ root, np.tile(np.eye(3), (4, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(power(covariance, -1.0), np.linalg.inv(covariance), atol=1e-9)


@given(SEEDS)
def test_whitening_masked_rows_is_whitening_the_rest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    covariance = random_covariance(rng, 4)
    mask = rng.random((6, 4)) < 0.6
    each = each_weight(np.tile(covariance, (6, 1, 1)), mask, -1.0)
    np.testing.assert_allclose(each_weight(covariance, mask, -1.0), each, atol=1e-10)
    for weight, used in zip(each, mask, strict=True):
        index = np.flatnonzero(used)
        assert not weight[~used].any()
        assert not weight[:, ~used].any()
        inverse = np.linalg.inv(covariance[np.ix_(index, index)])
        np.testing.assert_allclose(weight[np.ix_(index, index)], inverse, atol=1e-9)


@given(SEEDS)
def test_masked_covariances_are_no_worse_conditioned(seed: int) -> None:
    rng = np.random.default_rng(seed)
    covariance = 1e-13 * random_covariance(rng, 4)
    mask = rng.random((6, 4)) < 0.6
    values = np.linalg.eigvalsh(noise_module.masked_covariance(covariance, mask))
    whole = np.linalg.eigvalsh(covariance)
    worst = (values[:, -1] / values[:, 0]).max()
    assert worst <= whole[-1] / whole[0] * (1.0 + 1e-9)


@pytest.mark.parametrize("believed", [False, True])
def test_a_joint_with_next_to_no_effort_is_predicted_better_than_by_a_constant(
    believed: bool,
) -> None:
    rng = np.random.default_rng(0)
    theta = random_theta(ARM3, rng)
    # The last link and its joint's friction: efforts 1e4 times smaller than the others'.
    theta[20:30] *= 1e-4
    theta[[32, 35]] *= 1e-4
    samples = make_samples(ARM3, theta, rng, count=1000)
    spread = samples.effort.std(axis=0)
    assert spread[2] < 1e-3 * spread[:2].min()
    # Friction that grows with the load, which the model lacks: 5 % of every joint's effort.
    more = 0.05 * np.abs(samples.effort) * np.sign(samples.velocity)
    samples = replace(samples, effort=samples.effort + more)
    prior = Prior(bodies=1.3 * theta[:30].reshape(3, 10)) if believed else None
    problem = build_problem(ARM3, samples, weighting="residual", prior=prior)
    assert np.min(validate(solve_sdp(problem)).r2) > 0.9


def test_efforts_that_are_all_zero_are_refused() -> None:
    samples, _ = world.samples(ARM3, 0, count=60)
    samples = replace(samples, effort=np.zeros((60, 3)))
    with pytest.raises(DataError, match=r"efforts that count are zero.*effort was recorded"):
        build_problem(ARM3, samples, weighting="residual")


def test_the_integrated_time_is_that_of_geyers_sequence() -> None:
    lags = np.arange(400.0)
    for memory in (0.0, 0.3, 0.9):
        expected = (1.0 + memory) / (1.0 - memory)
        assert noise_module.integrated_time(memory**lags) == pytest.approx(expected, rel=1e-12)
    # One negative value does not end the sum, a pair does.
    found = noise_module.integrated_time(np.array([1.0, -0.2, 0.5, 0.1, -0.3, 0.2, 0.9, 0.9]))
    assert found == pytest.approx(1.8)
    assert noise_module.integrated_time(np.array([1.0])) == 1.0
    assert noise_module.integrated_time(np.array([1.0, -0.9])) == 1.0


# ---- Several recordings in one problem: pieces add up, and no pair of samples reaches across.


class Together(RowSource):
    """Rows that are looked at without regard to their pieces."""

    def map(self, function: Callable[..., Any], *args: object, sigma: Any = None) -> list[Any]:
        """Return what a function says of all rows."""
        return [function(self, *(() if sigma is None else (sigma,)), *args)]


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("masked", [False, True])
def test_a_sequence_of_samples_is_one_problem(weighting: Weighting, masked: bool) -> None:
    rng, theta = np.random.default_rng(1), random_theta(ARM, np.random.default_rng(0))
    made = [
        make_samples(ARM, theta, rng, count=k, noise=0.1, covariance=random_covariance(rng, 2, k))
        for k in (90, 40, 70)
    ]
    if masked:
        made = [replace(p, mask=rng.random(p.effort.shape) < 0.8) for p in made]
    together = build_problem(ARM, made, weighting=weighting)
    assert together.samples.starts == (0, 90, 130)
    assert together.n_rows == sum(p.n_rows for p in made)
    whole = together.rows
    once = Factor.of(Together(whole.robot, whole.friction, whole.base, whole.samples), weighting)
    near(once.sigma, together.sigma)
    near(once.A.T @ once.A, together.A.T @ together.A)
    near(once.A.T @ once.rhs, together.A.T @ together.rhs)
    near(np.array(once.floor), np.array(together.floor))
    assert once.used == together.n_rows


@given(SEEDS, st.lists(st.integers(1, 60), min_size=1, max_size=4))
def test_lagged_pairs_stay_inside_their_piece(seed: int, counts: list[int]) -> None:
    rng = np.random.default_rng(seed)
    ends = np.cumsum([0, *counts])
    parts = [slice(int(a), int(b)) for a, b in pairwise(ends)]
    signal, mask = rng.standard_normal((ends[-1], 2)), rng.random((ends[-1], 2)) < 0.7
    found = LaggedSums.of(signal, mask, parts)
    products, pairs = np.zeros((2, 2, max(counts)))
    for part in parts:
        for j in range(2):
            x, m = signal[part, j] * mask[part, j], mask[part, j].astype(float)
            for lag in range(len(x)):
                products[j, lag] += x[: len(x) - lag] @ x[lag:]
                pairs[j, lag] += m[: len(m) - lag] @ m[lag:]
    np.testing.assert_allclose(found.products, products, atol=1e-12 * ends[-1])
    np.testing.assert_array_equal(found.pairs, pairs)
    alone = [LaggedSums.of(signal[p], mask[p], [slice(0, p.stop - p.start)]) for p in parts]
    merged = LaggedSums.merged(alone)
    np.testing.assert_allclose(merged.products, found.products, atol=1e-12 * ends[-1])
    np.testing.assert_array_equal(merged.pairs, found.pairs)


# ---- Compression of rows, against a Householder QR of all of them in extended precision.


# An orthogonal factorization in double precision moves scaled rows by this many roundings at most;
# here numpy moves them by 1 to 3, the triangle by 5 to 15.
ROUNDINGS = 20
EPS = np.finfo(float).eps
COLUMNS = 10
ROWS = 1500
wide = pytest.mark.skipif(
    np.finfo(np.longdouble).eps > EPS / 1000, reason="no extended precision to compare with"
)


def exact(rows: Array) -> Any:
    """Return R of a Householder QR in extended precision."""
    A = np.array(rows, dtype=np.longdouble)
    for j in range(min(A.shape)):
        x = A[j:, j].copy()
        size = np.sqrt(x @ x)
        if size == 0.0:
            continue
        x[0] += np.copysign(size, x[0])
        A[j:, j:] -= np.outer(x, (2 / (x @ x)) * (x @ A[j:, j:]))
    R = np.zeros((A.shape[1],) * 2, dtype=np.longdouble)
    R[: len(A)] = np.triu(A[: len(R)])
    return R


def fit(R: Any) -> tuple[Any, Any]:
    """Return the least-squares solution and the norm of its residual."""
    b = R.shape[1] - 1
    wide = R.astype(np.longdouble)
    x = np.zeros(b, dtype=np.longdouble)
    for i in reversed(range(b)):
        x[i] = (wide[i, b] - wide[i, i + 1 : b] @ x[i + 1 :]) / wide[i, i]
    return x, np.abs(wide[b, b])


def make(
    rng: np.random.Generator, condition: float, noise: float, decades: float, late: bool
) -> Array:
    """Return rows with a right-hand side, columns scaled over many decades.

    Late: half of the directions appear only in the second half of the rows.
    """
    count = COLUMNS - 1
    U = np.linalg.qr(rng.standard_normal((ROWS, count)))[0]
    V = np.linalg.qr(rng.standard_normal((count, count)))[0]
    X = U * np.logspace(0.0, -np.log10(condition), count) @ V.T
    if late:
        X[: ROWS // 2] = X[: ROWS // 2] @ V[:, : count // 2] @ V[:, : count // 2].T
    y = X @ rng.standard_normal(count) + noise * rng.standard_normal(ROWS) / np.sqrt(ROWS)
    return np.column_stack([X * 10.0 ** rng.uniform(-decades, decades, count), y])


def folded(rows: Array, sizes: Any) -> Triangle:
    out, start = Triangle(rows.shape[1]), 0
    for size in itertools.cycle(sizes):
        if start >= len(rows):
            return out
        out.add(rows[start : start + size])
        start += size
    raise AssertionError


def check(found: Array, rows: Array) -> None:
    """Hold a triangle to the accuracy of an orthogonal factorization."""
    reference = exact(rows)
    norms = np.sqrt((reference**2).sum(axis=0))
    scale = np.where(norms > 0, norms, 1)
    full = np.zeros((rows.shape[1],) * 2)
    full[: len(found)] = found
    np.testing.assert_array_equal(full, np.triu(full))
    # Their own rounding is one of these many.
    s, expected = (np.linalg.svd((R / scale).astype(float))[1] for R in (full, reference))
    limit = ROUNDINGS * EPS * np.sqrt(rows.shape[1])
    assert np.abs(s - expected).max() <= limit
    # Perturbing rows by that much changes the fit by as much times the condition number.
    inner = np.linalg.svd((reference / scale)[:, :-1].astype(float))[1]
    if inner[-1] > 100 * limit:
        (x, residual), (x0, residual0) = fit(full), fit(reference)
        size = float(np.linalg.norm(((x0 * scale[:-1]) / scale[-1]).astype(float)))
        error = float(np.linalg.norm(((x - x0) * scale[:-1] / scale[-1]).astype(float)))
        smallest, rest = float(inner[-1]), float(residual0 / scale[-1])
        bound = limit / smallest * (size + 1.0 + rest / smallest)
        assert error <= bound
        assert abs(float((residual - residual0) / scale[-1])) <= limit * (1.0 + size)


@wide
@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("decades", [0.0, 6.0])
@pytest.mark.parametrize("noise", [0.0, 1e-8, 1e-2])
@pytest.mark.parametrize("condition", [10.0, 1e4, 1e8, 1e12, 1e14])
def test_accuracy(condition: float, noise: float, decades: float, late: bool) -> None:
    rng = np.random.default_rng([int(np.log10(condition)), int(decades), int(late)])
    rows = make(rng, condition, noise, decades, late)
    for sizes in ((ROWS,), (150,), (7, 90, 0, 300)):
        check(folded(rows, sizes).R, rows)


@wide
@pytest.mark.parametrize("late", ["column", "direction", "size", "never"])
@given(seed=SEEDS, sizes=st.lists(st.integers(1, 400), min_size=1, max_size=4))
def test_any_pieces_and_rank(late: str, seed: int, sizes: list[int]) -> None:
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((int(rng.integers(1, 800)), COLUMNS))
    rows[:, rng.random(COLUMNS) < 0.2] = 0.0
    rows[:, rng.random(COLUMNS) < 0.1] = 1.0
    # What comes later: a column that was nothing, next to nothing or another's, or a direction or
    # a size that none had before.
    first, last = len(rows) // 3, 3 * len(rows) // 4
    rows[:first, 4] *= 1e-14
    if late == "column":
        rows[:first, 2] = 0.0
        rows[:first, 6] = rows[:first, 5]
    elif late == "direction":
        rows[last:] += 1e4 * np.outer(rows[last:, 0], rows[0])
    elif late == "size":
        rows[last:] *= 1e9
    elif late == "never":
        rows[:, 3] = rows[:, 1]
        rows[:, 5] = 2.0 * rows[:, 0] - rows[:, 2]
    rows *= 10.0 ** rng.uniform(-6.0, 6.0, COLUMNS)
    triangle = folded(rows, sizes)
    check(triangle.R, rows)
    zero = ~rows.any(axis=0)
    assert not triangle.R[:, zero].any()


def test_nothing_and_little() -> None:
    triangle = Triangle(4)
    triangle.add(np.zeros((0, 4)))
    assert triangle.R.shape == (0, 4)
    assert triangle.split()[2] == 0.0
    rows = np.arange(8.0).reshape(2, 4)
    triangle.add(rows[:1])
    triangle.add(rows[1:])
    np.testing.assert_allclose(triangle.R.T @ triangle.R, rows.T @ rows, atol=1e-13)
    triangle.scale(0.5)
    np.testing.assert_allclose(triangle.R.T @ triangle.R, 0.25 * rows.T @ rows, atol=1e-13)
    zeros = Triangle(3)
    for _ in range(5):
        zeros.add(np.zeros((50, 3)))
    assert not zeros.R.any()


def test_to_look_changes_nothing_and_rows_are_not_kept() -> None:
    rows = np.random.default_rng(1).standard_normal((900, 5))
    quiet, watched = Triangle(5), Triangle(5)
    for part in np.split(rows, 90):
        own = part.copy()
        quiet.add(own)
        own[:] = np.nan
        watched.add(part)
        assert np.isfinite(watched.R).all()
    np.testing.assert_array_equal(quiet.R, watched.R)
    with pytest.raises(ValueError, match="read-only"):
        quiet.R[0, 0] = 1.0


@wide
def test_merging_is_folding_the_others_rows() -> None:
    rows = make(np.random.default_rng(2), 1e10, 1e-6, 6.0, False)
    one = folded(rows[:705], (700, 5))
    one.merge(folded(rows[705:], (100,)))
    check(one.R, rows)
    one.merge(Triangle(COLUMNS))
    check(one.R, rows)


def test_memory_does_not_grow_with_the_rows() -> None:
    rows = np.random.default_rng(6).standard_normal((5_000, 20))
    triangle = Triangle(20)
    for count in (2, 40):
        tracemalloc.start()
        for _ in range(count):
            triangle.add(rows)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        # The products of two pieces, the old one not yet let go, and some small matrices.
        assert peak < 3 * module.PIECE < rows.nbytes * 2
