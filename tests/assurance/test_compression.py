"""The compressed cost and that of the rows, compared without rounding wherever it is claimed."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import sdpid
from sdpid import build_problem, solve_robust
from sdpid._common.arrays import Array, Mask
from sdpid.assurance.certificate.compression import (
    UNPROVEN,
    Compression,
    _Compressed,
    _gram,
    _of_squares,
    _small,
    base_limit,
    enclose_compression,
    prove_compression,
)
from sdpid.assurance.certificate.contact_record import contact_record
from sdpid.assurance.certificate.row_sums import RowSums
from sdpid.assurance.certificate.whitener_errors import WhitenerErrors
from sdpid.errors import CertificateError
from sdpid.estimation.compression.contact_rows import RANK, ContactRows
from sdpid.estimation.compression.covariance import WEIGHTINGS, Weighting
from sdpid.estimation.compression.rows import Rows
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import weights, whiten
from sdpid.estimation.problem import Problem
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples
from sdpid.verifier.exact import positive_semidefinite
from sdpid.verifier.reading import digest
from tests.helpers import world
from tests.helpers.arm import ARM, arm_problem
from tests.helpers.data import (
    brute_force_cost,
    make_samples,
    random_covariance,
    random_links,
    random_theta,
)
from tests.helpers.legged import FEET, NOISE, RADIUS, gait, quadruped

Numbers = list[Fraction]


def fractions(values: Any) -> Any:
    """Return exact values of an array, in nested lists."""
    return [fractions(x) for x in values] if np.ndim(values) else Fraction(float(values))


def times(matrix: Any, vector: Numbers) -> Numbers:
    """Return matrix·vector."""
    return [sum((a * b for a, b in zip(row, vector, strict=True)), Fraction(0)) for row in matrix]


def squared(vector: Numbers) -> Fraction:
    """Return ‖vector‖²."""
    return sum((x * x for x in vector), Fraction(0))


def solve(matrix: Any, vector: Numbers) -> Numbers:
    """Return matrix^-1·vector, by elimination."""
    rows = [[*row, x] for row, x in zip(matrix, vector, strict=True)]
    for k in range(len(rows)):
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i in range(len(rows)):
            if i != k:
                rows[i] = [x - rows[i][k] * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[-1] for row in rows]


@dataclass(frozen=True)
class GivenRows:
    """Rows (K, n, c) that are given as they are, in chunks of any size, and in several pieces."""

    block: Array
    used: Mask
    chunk_size: int
    pieces: int = 1

    @property
    def robot(self) -> Any:
        return SimpleNamespace(n=self.block.shape[1])

    @property
    def base(self) -> Any:
        return SimpleNamespace(count=self.block.shape[2] - 1)

    @property
    def samples(self) -> Any:
        return SimpleNamespace(effort=self.block[:, :, -1])

    def parts(self, size: int) -> Iterator[slice]:
        for start in range(0, len(self.block), size):
            yield slice(start, min(start + size, len(self.block)))

    def mask(self, part: slice) -> Mask:
        return self.used[part]

    def contacts(self, part: slice) -> ContactRows | None:
        return None

    def rows(self, part: slice, out: Array) -> Array:
        found = out[: len(self.block[part])]
        found[:] = self.block[part]
        return found

    def map(self, function: Callable[..., Any], *arguments: object, sigma: Array) -> list[Any]:
        found = []
        for part in np.array_split(np.arange(len(self.block)), self.pieces):
            own = replace(self, block=self.block[part], used=self.used[part])
            found.append(function(own, sigma if sigma.ndim == 2 else sigma[part], *arguments))
        return found

    def cost(self, sigma: Array, weighting: Weighting, base: Array) -> Fraction:
        """Return the cost of the rows without rounding; for eq9 `sigma` is the root."""
        z = [*fractions(base), Fraction(-1)]
        total, normal = Fraction(0), [Fraction(0)] * len(base)
        for k, (block, used) in enumerate(zip(self.block, self.used, strict=True)):
            own = fractions(block[used])
            left = times(own, z)
            covariance = (sigma if sigma.ndim == 2 else sigma[k])[np.ix_(used, used)]
            weighted = solve(fractions(covariance), left)
            total += sum((x * y for x, y in zip(left, weighted, strict=True)), Fraction(0))
            columns = [list(column) for column in zip(*own, strict=True)][:-1]
            if columns:
                added = times(columns, weighted)
                normal = [x + y for x, y in zip(normal, added, strict=True)]
        return total if weighting == "gls" else squared(normal)

    def compressed(self, sigma: Array, weighting: Weighting) -> tuple[Array, Array, float]:
        """Return A, rhs and floor as `build_problem` does."""
        columns = self.block.shape[2]
        exponent = -0.25 if weighting == "eq9" else -0.5
        flat = whiten(self.block.copy(), sigma, self.used, exponent).reshape(-1, columns)
        if weighting != "gls":
            H = flat[:, :-1].T @ flat
            return H[:, :-1], H[:, -1], 0.0
        triangle = Triangle(columns)
        triangle.add(flat)
        return triangle.split()


def compressed_cost(A: Array, rhs: Array, floor: float, base: Array) -> Fraction:
    """Return ``‖A @ base − rhs‖² + floor`` without rounding."""
    reached = times(fractions(A), fractions(base))
    return squared([x - y for x, y in zip(reached, fractions(rhs), strict=True)]) + Fraction(floor)


def holds(found: Compression, of_rows: Fraction, compressed: Fraction) -> bool:
    """Whether the two costs of one point are as near as is claimed."""
    share, constant = Fraction(found.relative), Fraction(found.absolute)
    return abs(of_rows - compressed) <= share * compressed + constant


SEEDS = st.integers(0, 2**32 - 1)


def random_rows(rng: np.random.Generator, *, columns: int, count: int) -> GivenRows:
    """Return rows with columns of very different size, some of which depend on each other."""
    n = int(rng.integers(1, 4))
    scale = 10.0 ** rng.uniform(-4, 4, columns)
    block = rng.standard_normal((count, n, columns))
    if columns > 2 and rng.random() < 0.5:
        block[..., 1] = block[..., 0] + 10.0 ** rng.uniform(-18, 0) * block[..., 1]
    if rng.random() < 0.3:
        block[..., -1] = block[..., :-1] @ rng.standard_normal(columns - 1)
    if rng.random() < 0.2:
        block[..., 0] = 0.0
    used = rng.random((count, n)) < rng.choice([0.7, 1.0])
    size, pieces = int(rng.integers(1, count + 1)), int(rng.integers(1, min(count, 2) + 1))
    return GivenRows(scale * block, used, size, pieces)


def mirrored(matrix: Array) -> Array:
    """Return symmetric matrices with the lower triangles of given ones."""
    return np.asarray(np.tril(matrix) + np.swapaxes(np.tril(matrix, -1), -1, -2))


def covariances(rng: np.random.Generator, rows: GivenRows, weighting: Weighting) -> Array:
    """Return one covariance for all samples, or one a sample, with joints of different size.

    For eq9 their roots, of small integers: then the covariance is right to the last bit.
    """
    count, n = rows.block.shape[:2]
    each = count if rng.random() < 0.5 else None
    if weighting == "eq9":
        root = np.asarray(rng.integers(-3, 4, (n, n) if each is None else (count, n, n)), float)
        return mirrored(root) + 30.0 * np.eye(n) * rng.integers(1, 30, n)
    scale = 10.0 ** rng.uniform(-2, 2, n)
    return mirrored(scale[:, None] * random_covariance(rng, n, each) * scale)


@pytest.mark.parametrize("weighting", ["gls", "eq9", "eq18"])
@given(seed=SEEDS)
def test_no_point_of_the_box_leaves_the_enclosure(weighting: Weighting, seed: int) -> None:
    """Whatever A, rhs and floor are: those of the rows, or spoiled in any digit."""
    rng = np.random.default_rng(seed)
    rows = random_rows(rng, columns=int(rng.integers(2, 5)), count=int(rng.integers(1, 9)))
    given = covariances(rng, rows, weighting)
    if weighting == "eq9":
        # The root of a part of a covariance is no part of the root.
        rows = replace(rows, used=np.repeat(rows.used[:, :1], rows.used.shape[1], axis=1))
    sigma = given @ given if weighting == "eq9" else given
    A, rhs, floor = rows.compressed(sigma, weighting)
    spoil = rng.choice([0.0, 1e-14, 1e-8, 1e-2])
    A = A * (1.0 + spoil * rng.standard_normal(A.shape))
    rhs, floor = rhs * (1.0 + spoil * rng.standard_normal()), floor * (1.0 + spoil * rng.random())
    limit = 10.0 ** rng.uniform(-2, 4, len(rhs)) * rng.choice(
        [1.0, 1e-90, 0.0], len(rhs), p=[0.8, 0.1, 0.1]
    )
    found = enclose_compression(rows, sigma, weighting, A=A, rhs=rhs, floor=floor, base_limit=limit)
    if not found.proven:
        return
    best = np.linalg.lstsq(A, rhs)[0]
    points = [np.zeros(len(limit)), limit, -limit, rng.uniform(-limit, limit), best]
    points += list(best + np.linalg.svd(A)[2] * limit.max())
    for point in points:
        base = np.clip(point, -limit, limit)
        of_rows = rows.cost(given, weighting, base)
        assert holds(found, of_rows, compressed_cost(A, rhs, floor, base))


def test_what_no_parameter_explains_may_be_in_the_right_hand_side() -> None:
    """Beside a column of zeros and one that repeats another a triangle's floor may be zero."""
    rng = np.random.default_rng(0)
    block = rng.standard_normal((300, 2, 5))
    block[..., 1] *= 1e6
    block[..., 2] = block[..., 1]
    block[..., 0] = 0.0
    rows = GivenRows(block, np.ones((300, 2), dtype=bool), 300)
    A, rhs, floor = rows.compressed(np.eye(2), "gls")
    R = np.vstack([np.column_stack([A, rhs]), [0.0, 0.0, 0.0, 0.0, np.sqrt(floor)]])
    U, s, _ = np.linalg.svd(R[:, :-1])
    rank = int(np.count_nonzero(s > 1e-9 * s[0]))
    assert rank == 2
    turned = U.T @ R
    turned[rank:, -1] = np.linalg.norm(turned[rank:, -1]), 0.0, 0.0
    forms = (A, rhs, floor), (turned[:-1, :-1], turned[:-1, -1], 0.0)
    shown, hidden = (
        enclose_compression(
            rows, np.eye(2), "gls", A=A, rhs=rhs, floor=floor, base_limit=np.full(4, 100.0)
        )
        for A, rhs, floor in forms
    )
    assert floor > 100.0
    assert hidden.absolute + floor * hidden.relative < 2.0 * floor * shown.relative + shown.absolute


def exact_gram(matrix: Array) -> Any:
    """Return matrix^T·matrix without rounding."""
    columns = [list(column) for column in zip(*fractions(matrix), strict=True)]
    return [times(columns, column) for column in columns]


def test_products_that_cancel_are_added_up_in_pairs() -> None:
    """Columns that all but repeat each other, made orthonormal: numbers of 1e9 leave one."""
    rng = np.random.default_rng(2)
    factor = rng.standard_normal((5, 3))
    factor[:, 1] = factor[:, 0] + 1e-9 * factor[:, 1]
    M = np.linalg.inv(np.linalg.qr(factor)[1])
    found, error = _gram(factor, M)
    product = [times(fractions(factor), column) for column in fractions(M.T)]
    exact = [
        [sum((a * b for a, b in zip(x, y, strict=True)), Fraction(0)) for y in product]
        for x in product
    ]
    off = squared(
        [
            Fraction(x) - y
            for own, row in zip(found.tolist(), exact, strict=True)
            for x, y in zip(own, row, strict=True)
        ]
    )
    assert off <= Fraction(error) ** 2
    assert error < 1e-14


@given(seed=SEEDS)
def test_the_quadratic_forms_are_enclosed_for_every_vector(seed: int) -> None:
    """All vectors at once: ``share·(R^T·R + D²) ± (X^T·X − R^T·R)`` are positive semidefinite."""
    rng = np.random.default_rng(seed)
    rows = random_rows(rng, columns=int(rng.integers(2, 5)), count=int(rng.integers(1, 30)))
    joints, columns = rows.block.shape[1:]
    A, rhs, floor = rows.compressed(np.eye(joints), "gls")
    limit = 10.0 ** rng.uniform(-2, 4, len(rhs))
    compressed = _Compressed.of(A, rhs, floor, limit)
    if compressed is None:
        return
    sums = RowSums.of(cast(Rows, rows), np.eye(joints), -0.5, compressed.M)
    share = Fraction(_of_squares(sums, compressed))
    D = _small(compressed.R, np.append(limit, 1.0))
    own = exact_gram(rows.block[rows.used] if rows.used.any() else np.zeros((1, columns)))
    kept = exact_gram(np.column_stack([A, rhs]))
    kept[-1][-1] += Fraction(floor)
    size = range(columns)
    bound = [[share * x for x in row] for row in kept]
    for i in size:
        bound[i][i] += share * Fraction(D[i]) ** 2
    for sign in (1, -1):
        difference = [[bound[i][j] + sign * (own[i][j] - kept[i][j]) for j in size] for i in size]
        assert positive_semidefinite(difference)


@given(seed=SEEDS)
def test_sums_of_products_are_off_by_what_is_said(seed: int) -> None:
    """Weights are one, so that the rows are exact and their sums are not."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(100, 400))
    rows = GivenRows(rng.standard_normal((count, 1, 2)), np.ones((count, 1), bool), 300)
    sums = RowSums.of(cast(Rows, rows), np.eye(1), -0.5)
    exact = exact_gram(rows.block[:, 0])
    for i, j in ((0, 0), (0, 1), (1, 1)):
        off = abs(Fraction(sums.gram[i, j]) - exact[i][j])
        sizes = Fraction(sums.lengths[i]) * Fraction(sums.lengths[j])
        assert off <= Fraction(sums.rounding) * sizes
    assert sums.rounding < 1e-13
    assert sums.weight < 1e-28
    assert np.all(sums.moved < 1e-15 * sums.lengths)


@pytest.mark.parametrize("exponent", [-0.5, -0.25])
@given(seed=SEEDS)
def test_the_error_of_a_whitener_covers_the_exact_one(exponent: float, seed: int) -> None:
    """A diagonal covariance that is a fourth power: its powers have no rounding but our own."""
    rng = np.random.default_rng(seed)
    root = 2.0 ** rng.integers(-8, 9, (1, 3))
    used = rng.random((1, 3)) < 0.8
    sigma = np.eye(3) * root[:, :, None] ** 4
    spoil = rng.choice([0.0, 1e-15, 1e-8, 1e-2]) * rng.standard_normal((1, 3))
    V = np.eye(3) * (used * root ** (4 * exponent) * (1.0 + spoil))[:, :, None]
    errors = WhitenerErrors.of(V, sigma, used, exponent)
    # The exact weight is (E + J) times that of V.
    exact = [
        Fraction(s) ** int(8 * exponent) / Fraction(v) ** 2 - 1
        for s, v, u in zip(root[0], np.diagonal(V[0]), used[0], strict=True)
        if u
    ]
    known = np.diagonal(errors.nearly[0])[used[0]]
    assert all(abs(value) <= Fraction(errors.weight[0]) for value in exact)
    rest = Fraction(errors.rest[0])
    assert all(abs(x - Fraction(y)) <= rest for x, y in zip(exact, known, strict=True))
    largest = np.abs(spoil * used).max()
    assert errors.weight <= 30.0 * largest + 1e-15
    assert errors.rest <= 1e3 * largest**2 + 1e-15
    assert 1e-16 < errors.rounding < 1e-14


def problem_of(weighting: Weighting, **others: Any) -> Problem:
    """Return a problem of noisy samples of the small arm, with masked rows."""
    rng = np.random.default_rng(5)
    theta = random_theta(ARM, rng)
    each = 300 if weighting in ("gls_per_sample", "eq9", "eq18") else None
    fields: dict[str, Any] = {
        "count": 300,
        "noise": 0.05,
        "covariance": None if weighting == "residual" else random_covariance(rng, 2, each),
        "mask": rng.random((300, 2)) < 0.9,
        **others,
    }
    return build_problem(ARM, make_samples(ARM, theta, rng, **fields), weighting=weighting)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_what_a_problem_was_compressed_to_is_near_its_rows(weighting: Weighting) -> None:
    problem = problem_of(weighting)
    found = prove_compression(problem)
    # Normal equations square the condition number.
    limit = 1e-7 if weighting in ("eq9", "eq18") else 1e-10
    least = max(problem.floor, 1e-6 * float(problem.rhs @ problem.rhs))
    assert 0.0 < found.relative < limit
    assert 0.0 < found.absolute < 2.0 * limit * least


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_efforts_without_noise_and_directions_without_data(weighting: Weighting) -> None:
    """Costs next to zero, a joint without rows, and a base parameter that nothing shows."""
    mask = np.ones((300, 2), dtype=bool)
    mask[:, 1] = False
    assert prove_compression(problem_of(weighting, noise=0.0)) is not None
    samples, _ = world.samples(ARM, 6, count=300, noise=0.0, mask=mask)
    weighting_known = "gls" if weighting == "gls_per_sample" else weighting
    blind = build_problem(ARM, samples, weighting=weighting_known, check_excitation=False)
    assert np.linalg.matrix_rank(blind.A) < blind.base.count
    found = prove_compression(blind)
    assert found.relative < 1e-6


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_the_arm_of_the_case_study_is_certified_with_its_rows(
    denso: sdpid.RobotModel, weighting: Weighting
) -> None:
    """With covariances of twelve periods, some of which are far from round."""
    rng = np.random.default_rng(7)
    theta = random_theta(denso, rng)
    theta[: 10 * denso.n_links] = random_links(rng, denso.n_links, points=1).ravel()
    deviations = 10.0 ** rng.uniform(-1.5, 0.0, denso.n)
    errors = deviations * rng.standard_normal((500, 12, denso.n))
    covariance = np.array([np.cov(each, rowvar=False) for each in errors])
    samples = make_samples(
        denso, theta, rng, count=500, noise=errors.mean(axis=1), covariance=covariance
    )
    constraints = sdpid.Constraints(margin=1e-3)
    problem = build_problem(denso, samples, weighting=weighting, constraints=constraints)
    certificate = sdpid.certify(sdpid.solve_sdp(problem))
    assert certificate.to_dict()["compression"] is not None
    assert certificate.passed, certificate.summary()


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_clean_efforts_and_a_covariance_far_from_round(
    denso: sdpid.RobotModel, weighting: Weighting
) -> None:
    """No double precision power is near enough for normal equations that cost next to nothing."""
    rng = np.random.default_rng(8)
    deviations = 10.0 ** np.linspace(-2.5, 0.5, denso.n)
    covariance = deviations[:, None] * random_covariance(rng, denso.n) * deviations
    theta = random_theta(denso, rng)
    samples = make_samples(denso, theta, rng, count=500, noise=1e-6, covariance=covariance)
    problem = build_problem(denso, samples, weighting=weighting)
    found = prove_compression(problem)
    scale = max(problem.floor, 1e-6 * float(problem.rhs @ problem.rhs))
    assert found.relative < 2e-7
    assert found.absolute < 2e-7 * scale


def enclosed(problem: Problem, **others: Any) -> Compression:
    """Return the enclosure of a problem's rows by another compressed cost."""
    feasible = problem.feasible
    given: dict[str, Any] = {
        "A": problem.A,
        "rhs": problem.rhs,
        "floor": problem.floor,
        "base_limit": base_limit(problem.base.matrix, feasible.lower, feasible.upper),
        **others,
    }
    assert problem.rows is not None
    return enclose_compression(problem.rows, problem.sigma, problem.weighting, **given)


def test_forged_compressions_are_far_from_the_rows() -> None:
    problem = arm_problem()
    honest = enclosed(problem)
    assert honest.relative < 1e-9
    # Optimal for other rows: the cost at a bad theta is right, and nowhere else.
    bad = problem.base_of(np.full(problem.n_theta, 0.3))
    forged = enclosed(problem, rhs=problem.A @ bad, floor=problem.cost(bad))
    assert forged == UNPROVEN
    # One digit of A.
    A = np.array(problem.A)
    A[0, 0] *= 1.0 + 1e-6
    changed = enclosed(problem, A=A)
    assert changed.relative > 1e-7
    # Another log's rows.
    assert enclosed(problem_of("gls"), A=problem.A, rhs=problem.rhs).relative > 1e-2
    for name, value in (("floor", -1.0), ("floor", np.nan), ("rhs", problem.rhs * np.inf)):
        assert enclosed(problem, **{name: value}) == UNPROVEN


def test_a_compression_holds_in_chunks_and_pieces_of_every_size() -> None:
    problem = problem_of("gls")
    s = problem.samples
    block = problem.rows.rows(slice(None))  # type: ignore[attr-defined]
    found = [
        enclosed(replace(problem, rows=GivenRows(block, s.mask, size, pieces)))
        for size in (1, 7, 300)
        for pieces in (1, 3)
    ]
    assert all(0.0 < each.relative < 1e-10 for each in found)


@pytest.mark.parametrize("weighting", ["gls", "gls_per_sample", "residual"])
def test_weighted_rows_of_a_robust_loss_are_near_their_compression(weighting: Weighting) -> None:
    """With what the loss adds to them; without it the floor would be another one."""
    problem = solve_robust(problem_of(weighting, noise=1.0)).problem
    assert problem.constant > 1e-3 * problem.floor
    found = prove_compression(problem)
    assert found.relative < 1e-10
    base = problem.base_of(np.ones(problem.n_theta))
    of_rows = brute_force_cost(problem, base, problem.sigma) + problem.constant
    assert of_rows == pytest.approx(problem.cost(base), rel=1e-9)
    wrong = prove_compression(replace(problem, constant=0.5 * problem.constant))
    assert wrong is None or wrong.relative > 1e-4


def test_a_problem_without_rows_proves_nothing() -> None:
    assert prove_compression(arm_problem().without_rows()) is None


# ---- The compressed cost of samples in contact against that of their rows, without rounding.


def independent(A: Array, covariance: Array) -> Array:
    """Return as many columns of A (n, m) as count, those furthest from the others' span first.

    Their number is that of singular values above `RANK` of the strongest, columns whitened and
    scaled to unit length; the choice is that of a pivoted factor of the Gram matrix, exactly.
    """
    if not A.size:
        return A
    white = np.linalg.solve(np.linalg.cholesky(covariance), A)
    size = np.linalg.svd(white / np.sqrt(np.sum(white**2, axis=0)), compute_uv=False)
    rank = int(np.count_nonzero(size > RANK * size[0]))
    if rank == A.shape[1]:
        return A
    columns = fractions(A.T)
    weighted = [solve(fractions(covariance), column) for column in columns]
    gram = [times(columns, column) for column in weighted]
    length = [gram[j][j] for j in range(len(gram))]
    kept: list[int] = []
    for _ in range(rank):
        j = max(set(range(len(gram))) - set(kept), key=lambda i: gram[i][i] / length[i])
        kept.append(j)
        gram = [
            [x - row[j] * y / gram[j][j] for x, y in zip(row, gram[j], strict=True)] for row in gram
        ]
    return A[:, sorted(kept)]


@dataclass(frozen=True)
class TouchingRows(GivenRows):
    """Rows of samples in contact, with the efforts (K, n, m) of forces that nobody measured."""

    directions: Array = None  # type: ignore[assignment]
    active: Mask = None  # type: ignore[assignment]

    def contacts(self, part: slice) -> ContactRows | None:
        return ContactRows(self.directions[part], self.active[part], None, None)

    def map(self, function: Any, *arguments: object, sigma: Array) -> list[Any]:
        return [function(self, sigma, *arguments)]

    def cost(self, sigma: Array, weighting: Weighting, base: Array) -> Fraction:
        """Return the least cost over all forces: ``[C A; A^T 0]·(x, f) = (r, 0)`` and r·x.

        Of directions that all but repeat each other as many count as theory's rule says.
        """
        z = [*fractions(base), Fraction(-1)]
        total = Fraction(0)
        for k, (block, used) in enumerate(zip(self.block, self.used, strict=True)):
            own = fractions(block[used])
            r = [sum((a * b for a, b in zip(row, z, strict=True)), Fraction(0)) for row in own]
            covariance = (sigma if sigma.ndim == 2 else sigma[k])[np.ix_(used, used)]
            directions = independent(self.directions[k][used][:, self.active[k]], covariance)
            A, C, m = fractions(directions), fractions(covariance), directions.shape[1]
            if not r or m >= len(r):
                continue
            upper = [[*c, *a] for c, a in zip(C, A, strict=True)]
            lower = [[*[a[j] for a in A], *[Fraction(0)] * m] for j in range(m)]
            x = solve(upper + lower, r + [Fraction(0)] * m)
            total += sum((a * b for a, b in zip(r, x, strict=False)), Fraction(0))
        return total

    def compressed(self, sigma: Array, weighting: Weighting) -> tuple[Array, Array, float]:
        touching = self.contacts(slice(None))
        X = touching.independent(*weights(sigma, self.used), self.block)[0]
        triangle = Triangle(self.block.shape[2])
        triangle.add(X)
        return triangle.split()


# Once whitened, two directions of a sample repeat each other to 5e-9: the rows lose one of them.
@example(seed=273)
@given(seed=SEEDS)
def test_no_point_of_the_box_leaves_the_enclosure_in_contact(seed: int) -> None:
    """Whatever A, rhs and floor are: those of the rows, or spoiled in any digit."""
    rng = np.random.default_rng(seed)
    n, columns, count = (int(rng.integers(*ends)) for ends in ((2, 5), (2, 5), (1, 7)))
    m = int(rng.integers(0, n + 1))
    block = 10.0 ** rng.uniform(-3, 3, columns) * rng.standard_normal((count, n, columns))
    directions = 10.0 ** rng.uniform(-2, 2, m) * rng.standard_normal((count, n, m))
    if m > 1 and rng.random() < 0.4:
        # A leg that is all but straight.
        directions[..., 1] = directions[..., 0] + 10.0 ** rng.uniform(-6, -2) * directions[..., 1]
    rows = TouchingRows(
        block=block,
        used=rng.random((count, n)) < rng.choice([0.7, 1.0]),
        chunk_size=int(rng.integers(1, count + 1)),
        directions=directions,
        active=rng.random((count, m)) < 0.6,
    )
    scale = 10.0 ** rng.uniform(-2, 2, n)
    each = count if rng.random() < 0.5 else None
    sigma = mirrored(scale[:, None] * random_covariance(rng, n, each) * scale)
    A, rhs, floor = rows.compressed(sigma, "gls")
    spoil = rng.choice([0.0, 1e-14, 1e-8, 1e-2])
    A = A * (1.0 + spoil * rng.standard_normal(A.shape))
    limit = 10.0 ** rng.uniform(-2, 4, len(rhs))
    found = enclose_compression(rows, sigma, "gls", A=A, rhs=rhs, floor=floor, base_limit=limit)
    if not found.proven:
        return
    best = np.clip(np.linalg.lstsq(A, rhs)[0], -limit, limit)
    for base in (np.zeros(len(limit)), limit, rng.uniform(-limit, limit), best):
        of_rows = rows.cost(sigma, "gls", base)
        assert holds(found, of_rows, compressed_cost(A, rhs, floor, base))


def legged_problem(samples: sdpid.Samples, **given: Any) -> Problem:
    settings: dict[str, Any] = {"friction": (), "weighting": "residual", "prior": sdpid.Prior()}
    return sdpid.build_problem(quadruped(), samples, **{**settings, **given})


def with_contacts(samples: sdpid.Samples, **given: Any) -> sdpid.Samples:
    assert samples.contacts is not None
    return replace(samples, contacts=replace(samples.contacts, **given))


def samples_of(kind: str) -> sdpid.Samples:
    """Return samples of a quadruped with forces that are known in several ways."""
    made, rng = gait(240), np.random.default_rng(1)
    noisy = replace(made.noisy(), mask=rng.random((240, 18)) < 0.9)
    if kind == "measured":
        return replace(made.measured(0.01 * np.eye(6)), effort=noisy.effort)
    if kind == "kinds":
        return with_contacts(noisy, kind=("point", "line", "plane", "point"))
    if kind == "repeated":
        order = [2, 0, 3, 1, 2]
        down = noisy.contacts.down[:, order]
        again = ContactSamples(frames=[FEET[i] for i in order], offset=RADIUS, down=down)
        return replace(noisy, contacts=again)
    return noisy


@pytest.mark.parametrize("kind", ["eliminated", "measured", "kinds", "repeated"])
def test_what_a_quadruped_was_compressed_to_is_near_its_rows(kind: str) -> None:
    problem = legged_problem(samples_of(kind))
    found = prove_compression(problem)
    assert 0.0 < found.relative < 1e-8
    assert 0.0 < found.absolute < 1e-8 * problem.floor
    certificate = sdpid.certify(sdpid.solve_sdp(problem))
    assert certificate.passed, certificate.summary()


@cache
def certified() -> dict[str, Any]:
    """Return a certificate of a quadruped's samples."""
    return sdpid.certify(sdpid.solve_sdp(legged_problem(samples_of("measured")))).to_dict()


def checked(data: dict[str, Any], tmp_path: Path, *, sealed: bool = True) -> Any:
    again = {**data, "sha256": digest(data)} if sealed else data
    path = tmp_path / "certificate.json"
    path.write_text(json.dumps(again), encoding="utf-8")
    return sdpid.verify(path)


def with_record(data: dict[str, Any], **given: Any) -> dict[str, Any]:
    record = {**data["origin"]["contacts"], **given}
    return {**data, "origin": {**data["origin"], "contacts": record}}


def test_a_certificate_names_its_contacts(tmp_path: Path) -> None:
    data, samples = certified(), samples_of("measured")
    found, contacts = data["origin"]["contacts"], samples.contacts
    assert found["frames"] == list(FEET)
    assert found["kinds"] == ["point"] * 4
    assert found["closed"] == contacts.down.sum(axis=0).tolist()
    assert found["ranks"] == [[0, 240]]
    assert found["base_rows"] == 6
    eliminated = contact_record(legged_problem(samples_of("kinds")).rows, np.eye(18))
    assert eliminated["force_deviations"] is None
    assert sum(count for _, count in eliminated["ranks"]) == 240
    assert max(rank for rank, _ in eliminated["ranks"]) == 3 + 5 + 6 + 3
    result = checked(data, tmp_path)
    assert result.passed
    said = next(line for line in result.statements if "Contacts" in line)
    assert "point 'FL_FOOT' 55.8 %" in said
    assert "0 in 240 samples" in said
    # What versions before said nothing of.
    origin = {key: value for key, value in data["origin"].items() if key != "contacts"}
    assert checked({**data, "version": 4, "origin": origin}, tmp_path).passed


@pytest.mark.parametrize(
    "given",
    [
        {"frames": ["FL_FOOT"]},
        {"kinds": ["ball"] * 4},
        {"closed": [241, 0, 0, 0]},
        {"ranks": [[0, 239]]},
        {"ranks": [[0, 120], [0, 120]]},
        {"widened_s": "long"},
        {"force_deviations": [[0.1] * 6]},
        {"effort_deviations": [1.0] * 17},
        {"more": 1},
    ],
)
def test_a_changed_record_of_contacts_is_refused(given: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(CertificateError):
        checked(with_record(certified(), **given), tmp_path)


def test_a_record_of_contacts_is_under_the_digest(tmp_path: Path) -> None:
    forged = with_record(certified(), widened_s=0.25)
    result = checked(forged, tmp_path, sealed=False)
    assert not result.passed
    assert "digest" in result.problems[0]
    nothing = {**certified()["origin"], "contacts": None}
    assert not checked({**certified(), "origin": nothing}, tmp_path, sealed=False).passed


@pytest.mark.parametrize("change", ["flags", "offset", "sigma"])
def test_rows_with_other_contacts_have_another_compression(change: str) -> None:
    """A compression of the same log with feet, flags or weights that are not those of the rows."""
    samples = samples_of("eliminated")
    given = replace(samples, covariance=np.diag(NOISE**2))
    changed = {
        "flags": with_contacts(given, down=~samples.contacts.down),
        "offset": with_contacts(given, offset=(0.0, 0.0, -0.0181)),
        "sigma": replace(given, covariance=np.diag(NOISE**2 * 1.001)),
    }[change]
    problem = legged_problem(given, weighting="gls", prior=None, check_excitation=False)
    other = legged_problem(changed, weighting="gls", prior=None, check_excitation=False)
    forged = prove_compression(replace(problem, rows=other.rows, sigma=other.sigma))
    assert forged is None or forged.relative > 1e-6
