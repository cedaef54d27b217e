"""Compression of rows, against a Householder QR of all of them in extended precision."""

import itertools
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.estimation.compression import triangle as module
from sdpid.estimation.compression.triangle import Triangle
from tests.helpers.strategies import SEEDS

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


def singular_values(R: Any) -> Any:
    """Return singular values by one-sided Jacobi rotations, in the precision of R."""
    U, count = np.array(R), R.shape[1]
    for _ in range(20):
        rotated = False
        for p, q in itertools.combinations(range(count), 2):
            a, b, g = U[:, p] @ U[:, p], U[:, q] @ U[:, q], U[:, p] @ U[:, q]
            if np.abs(g) <= np.finfo(U.dtype).eps * np.sqrt(a * b):
                continue
            z = (b - a) / (2 * g)
            t = np.copysign(1, z) / (np.abs(z) + np.sqrt(1 + z * z))
            c = 1 / np.sqrt(1 + t * t)
            turned = [c * (U[:, p] - t * U[:, q]), c * (t * U[:, p] + U[:, q])]
            U[:, [p, q]] = np.stack(turned, axis=1)
            rotated = True
        if not rotated:
            break
    return np.sort(np.sqrt((U**2).sum(axis=0)))[::-1]


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
    s, expected = singular_values(full / scale), singular_values(reference / scale)
    limit = ROUNDINGS * EPS * np.sqrt(rows.shape[1])
    assert float(np.abs(s - expected).max()) <= limit
    # Perturbing rows by that much changes the fit by as much times the condition number.
    inner = singular_values((reference / scale)[:, :-1])
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
@given(SEEDS, st.lists(st.integers(1, 400), min_size=1, max_size=4), st.booleans())
def test_any_pieces_and_rank(seed: int, sizes: list[int], repeated: bool) -> None:
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((int(rng.integers(1, 800)), COLUMNS))
    rows[:, rng.random(COLUMNS) < 0.2] = 0.0
    rows[:, rng.random(COLUMNS) < 0.1] = 1.0
    if repeated:
        rows[:, 3] = rows[:, 1]
        rows[:, 5] = 2.0 * rows[:, 0] - rows[:, 2]
    rows *= 10.0 ** rng.uniform(-6.0, 6.0, COLUMNS)
    triangle = folded(rows, sizes)
    check(triangle.R, rows)
    zero = ~rows.any(axis=0)
    assert not triangle.R[:, zero].any()


@wide
@pytest.mark.parametrize("what", ["zero", "tiny", "equal", "direction", "size"])
def test_what_comes_later(what: str) -> None:
    rows = np.random.default_rng(0).standard_normal((1200, COLUMNS))
    if what == "zero":
        rows[:600, 2] = 0.0
    elif what == "tiny":
        rows[:300, 4] *= 1e-14
    elif what == "equal":
        rows[:450, 6] = rows[:450, 5]
    elif what == "direction":
        rows[900:] += 1e4 * np.outer(rows[900:, 0], rows[0])
    else:
        rows[900:] *= 1e9
    check(folded(rows, (100,)).R, rows)


@wide
@pytest.mark.parametrize("rate", [3.0, 30.0, 1e3, 1e5])
def test_directions_that_grow(rate: float) -> None:
    """Half of the directions, across all columns, are `rate` times larger in every piece."""
    rng = np.random.default_rng(1)
    V = np.linalg.qr(rng.standard_normal((COLUMNS, COLUMNS)))[0]
    pieces = rng.standard_normal((6, 200, COLUMNS))
    pieces[:, :, COLUMNS // 2 :] *= rate ** (np.arange(6.0) - 5.0)[:, None, None]
    rows = (pieces @ V.T).reshape(-1, COLUMNS)
    check(folded(rows, (200,)).R, rows)


def test_nothing_and_little() -> None:
    triangle = Triangle(4)
    triangle.add(np.zeros((0, 4)))
    assert triangle.R.shape == (0, 4)
    assert triangle.split()[2] == 0.0
    rows = np.arange(8.0).reshape(2, 4)
    triangle.add(rows[:1])
    triangle.add(rows[1:])
    np.testing.assert_allclose(triangle.R.T @ triangle.R, rows.T @ rows, atol=1e-13)
    zeros = Triangle(3)
    for _ in range(5):
        zeros.add(np.zeros((50, 3)))
    assert not zeros.R.any()


def test_to_look_changes_nothing_and_rows_are_not_kept() -> None:
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((900, 5))
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
    rng = np.random.default_rng(2)
    rows = make(rng, 1e10, 1e-6, 6.0, False)
    one, other = Triangle(COLUMNS), Triangle(COLUMNS)
    one.add(rows[:700])
    one.add(rows[700:705])
    for start in range(705, ROWS, 100):
        other.add(rows[start : start + 100])
    one.merge(other)
    check(one.R, rows)
    one.merge(Triangle(COLUMNS))
    check(one.R, rows)


def test_scaling_is_that_of_all_rows() -> None:
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((400, 6))
    triangle = Triangle(6)
    triangle.add(rows[:300])
    triangle.scale(0.5)
    triangle.add(rows[300:])
    expected = np.vstack([0.5 * rows[:300], rows[300:]])
    np.testing.assert_allclose(triangle.R.T @ triangle.R, expected.T @ expected, rtol=1e-12)


@wide
def test_where_the_new_matrix_is_not_near_rows_are_factorized(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(4)
    rows = make(rng, 1e6, 1e-3, 0.0, True)
    plainly = []
    original = Triangle._fold_plainly
    monkeypatch.setattr(
        Triangle, "_fold_plainly", lambda self, rows: (plainly.append(1), original(self, rows))[1]
    )
    monkeypatch.setattr(module, "_NEAR", 0.0)
    check(folded(rows, (100,)).R, rows)
    assert plainly


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


def test_few_rows_are_factorized_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows like those before them are only multiplied."""
    seen = []
    original = module._triangle
    monkeypatch.setattr(module, "_triangle", lambda x: (seen.append(len(x)), original(x))[1])
    rng = np.random.default_rng(5)
    triangle = Triangle(8)
    for _ in range(50):
        triangle.add(rng.standard_normal((400, 8)))
    assert sum(seen) < 1000
