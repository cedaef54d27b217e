"""Tiny programs whose solutions are known."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from sdpid._common.arrays import Array
from sdpid.estimation.conic import solve as conic
from sdpid.estimation.conic.solve import ConicFamily, ConicProgram, Matrix, solve_conic
from sdpid.estimation.conic.standard_form import symmetric_basis

# Solutions of problems of order one: an interior-point method ends at some 1e-9, and where the
# optimum is flat at its square root.
SOLVED = 1e-6


def program(
    M: Array,
    m: Array,
    *,
    C: Array | None = None,
    lower: Array | float = -np.inf,
    upper: Array | float = np.inf,
    **rest: object,
) -> ConicProgram:
    """Return a program, by default without linear inequalities."""
    C = np.zeros((0, M.shape[1])) if C is None else C
    sides = (np.broadcast_to(np.asarray(side, float), (len(C),)) for side in (lower, upper))
    low, high = sides
    return ConicProgram(M=M, m=m, C=C, lower=low, upper=high, **rest)  # type: ignore[arg-type]


def whole(size: int) -> Matrix:
    """Return the matrix whose coordinates in the symmetric basis are x."""
    basis = symmetric_basis(size)
    return Matrix(np.arange(len(basis)), basis, np.zeros((size, size)))


def coordinates(matrix: Array) -> Array:
    return np.asarray(np.einsum("aij,ij->a", symmetric_basis(len(matrix)), matrix))


def matrix_of(x: Array, size: int) -> Array:
    return np.asarray(np.einsum("a,aij->ij", x, symmetric_basis(size)))


def symmetric(rng: np.random.Generator, size: int) -> Array:
    root = rng.standard_normal((size, size))
    return root + root.T


def positive(rng: np.random.Generator, size: int) -> Array:
    root = rng.standard_normal((size, size))
    return root @ root.T + np.eye(size)


@pytest.mark.parametrize("size", [2, 3, 4, 6])
def test_the_nearest_positive_semidefinite_matrix(size: int) -> None:
    """Every entry has its place and its weight, in the point and in the multiplier."""
    A = symmetric(np.random.default_rng(size), size)
    count = len(symmetric_basis(size))
    found = solve_conic(program(np.eye(count), -coordinates(A), blocks=(whole(size),)))
    assert found.x is not None
    values, vectors = np.linalg.eigh(A)
    nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    np.testing.assert_allclose(matrix_of(found.x, size), nearest, atol=SOLVED)
    # The gradient 2·(X − A) is the multiplier.
    np.testing.assert_allclose(found.blocks[0], 2.0 * (nearest - A), atol=SOLVED)


def test_constants_and_several_blocks() -> None:
    """Blocks of different sizes that each see some of the variables, moved by their constants."""
    rng = np.random.default_rng(1)
    A, B, D, E = symmetric(rng, 3), symmetric(rng, 2), symmetric(rng, 3), symmetric(rng, 2)
    first = Matrix(3 + np.arange(6), symmetric_basis(3), D)
    second = Matrix(np.arange(3), symmetric_basis(2), E)
    target = np.concatenate([coordinates(B), coordinates(A)])
    found = solve_conic(program(np.eye(9), -target, blocks=(first, second)))
    assert found.x is not None

    def nearest(goal: Array, constant: Array) -> Array:
        values, vectors = np.linalg.eigh(goal + constant)
        return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T - constant)

    np.testing.assert_allclose(matrix_of(found.x[3:], 3), nearest(A, D), atol=SOLVED)
    np.testing.assert_allclose(matrix_of(found.x[:3], 2), nearest(B, E), atol=SOLVED)
    for dual, goal, constant in zip(found.blocks, (A, B), (D, E), strict=True):
        np.testing.assert_allclose(dual, 2.0 * (nearest(goal, constant) - goal), atol=SOLVED)


def test_signs_of_multipliers_and_infinite_limits() -> None:
    """Of ``(x − a)²`` within limits: the gradient at the end, positive at a lower one."""
    goal = np.array([-3.0, 3.0, 0.5, -3.0, 3.0, 7.0])
    lower = np.array([-1.0, -1.0, -1.0, -np.inf, 1.0, -np.inf])
    upper = np.array([1.0, 1.0, 1.0, 1.0, np.inf, np.inf])
    found = solve_conic(program(np.eye(6), -goal, C=np.eye(6), lower=lower, upper=upper))
    assert found.x is not None
    x = np.clip(goal, lower, upper)
    np.testing.assert_allclose(found.x, x, atol=SOLVED)
    np.testing.assert_allclose(found.rows, 2.0 * (x - goal), atol=SOLVED)
    assert found.rows[0] > 0.0 > found.rows[1]


def test_multipliers_are_derivatives() -> None:
    """Of the optimal cost, with respect to each limit of random rows."""
    rng = np.random.default_rng(2)
    M, m, C = rng.standard_normal((8, 5)), rng.standard_normal(8), rng.standard_normal((4, 5))
    lower = np.array([0.3, -np.inf, -0.2, -5.0])
    upper = np.array([np.inf, -0.4, 0.1, 5.0])

    def optimum(shift: Array) -> tuple[float, Array]:
        found = solve_conic(program(M, m, C=C, lower=lower + shift, upper=upper + shift))
        assert found.x is not None
        return float(np.sum((M @ found.x + m) ** 2)), found.rows

    rows = optimum(np.zeros(4))[1]
    assert np.count_nonzero(np.abs(rows) > SOLVED) >= 2
    step = 1e-3
    for k in range(4):
        shift = step * np.eye(4)[k]
        slope = (optimum(shift)[0] - optimum(-shift)[0]) / (2.0 * step)
        # A quadratic program is piecewise quadratic: central differences are exact.
        assert slope == pytest.approx(rows[k], abs=1e-4)


@pytest.mark.parametrize(("size", "weight"), [(1, 0.7), (2, 3.0), (4, 0.2)])
def test_log_det(size: int, weight: float) -> None:
    """``⟨C, X⟩ − w·log det X`` is least at ``w·C^(-1)``."""
    C = positive(np.random.default_rng(size), size)
    count = len(symmetric_basis(size))
    found = solve_conic(
        program(
            np.zeros((0, count)),
            np.zeros(0),
            cost=coordinates(C),
            log_dets=(whole(size),),
            weight=weight,
        ),
    )
    assert found.x is not None
    X = matrix_of(found.x, size)
    np.testing.assert_allclose(X, weight * np.linalg.inv(C), atol=1e-4 * weight)
    # The point is known to the square root of what the cost is known to.
    cost = np.sum(C * X) - weight * np.linalg.slogdet(X)[1]
    best = weight * size - weight * np.linalg.slogdet(weight * np.linalg.inv(C))[1]
    assert cost == pytest.approx(best, abs=SOLVED * weight)


def test_log_dets_beside_squares_and_blocks() -> None:
    """``‖X − A‖² − w·Σ log det`` of two matrices, one with a constant, eigenvalue by eigenvalue."""
    rng = np.random.default_rng(5)
    A, B = symmetric(rng, 3), symmetric(rng, 2)
    shift = symmetric(rng, 2)
    first = Matrix(np.arange(6), symmetric_basis(3), np.zeros((3, 3)))
    second = Matrix(6 + np.arange(3), symmetric_basis(2), shift)
    weight = 0.4
    found = solve_conic(
        program(
            np.eye(9),
            -np.concatenate([coordinates(A), coordinates(B)]),
            # Matrices with a log-determinant are inside; another block changes nothing.
            blocks=(first,),
            log_dets=(first, second),
            weight=weight,
        ),
    )
    assert found.x is not None

    def best(goal: Array) -> Array:
        # 2·(x − a) = w/x.
        values, vectors = np.linalg.eigh(goal)
        values = 0.5 * (values + np.sqrt(values**2 + 2.0 * weight))
        return np.asarray((vectors * values) @ vectors.T)

    np.testing.assert_allclose(matrix_of(found.x[:6], 3), best(A), atol=1e-5)
    np.testing.assert_allclose(matrix_of(found.x[6:], 2), best(B + shift) - shift, atol=1e-5)
    np.testing.assert_allclose(found.blocks[0], 0.0, atol=1e-5)


def test_the_linear_cost_counts_once() -> None:
    """``‖x‖² + c·x`` is least at −c/2."""
    cost = np.array([2.0, -4.0])
    found = solve_conic(program(np.eye(2), np.zeros(2), cost=cost))
    assert found.x is not None
    np.testing.assert_allclose(found.x, -0.5 * cost, atol=SOLVED)


def test_what_has_no_solution_says_so() -> None:
    one = np.eye(1)
    apart = program(
        one,
        np.zeros(1),
        C=np.array([[1.0], [1.0]]),
        lower=np.array([1.0, -np.inf]),
        upper=np.array([np.inf, 0.0]),
    )
    assert "infeasible" in solve_conic(apart).status.lower()
    endless = program(np.zeros((0, 1)), np.zeros(0), cost=np.ones(1), C=one, upper=0.0)
    status = solve_conic(endless).status.lower()
    assert "dualinfeasible" in status or "unbounded" in status


def family_member(rng: np.random.Generator) -> ConicProgram:
    """Return one of a family: the matrix (a, b; b, c) nearest to a target in some norm."""
    units = np.array([[[1.0, 0], [0, 0]], [[0, 1.0], [1.0, 0]], [[0, 0], [0, 1.0]]])
    return ConicProgram(
        M=np.triu(rng.standard_normal((3, 3))) + 2.0 * np.eye(3),
        m=rng.standard_normal(3),
        C=np.eye(3),
        lower=np.array([-np.inf, -np.inf, 0.1]),
        upper=np.full(3, 4.0),
        blocks=(Matrix(np.arange(3), units, np.zeros((2, 2))),),
    )


def test_a_family_solves_each_as_if_it_were_alone() -> None:
    rng = np.random.default_rng(5)
    members = [family_member(rng) for _ in range(5)]
    family = ConicFamily(members[0], pattern=np.triu(np.ones((3, 3), dtype=bool)))
    found = [family.solve(squares=(each.M, each.m)) for each in members]
    for each, solution in zip(members, found, strict=True):
        expected = solve_conic(each)
        assert expected.x is not None
        np.testing.assert_allclose(solution.x, expected.x, atol=SOLVED)
        np.testing.assert_allclose(solution.rows, expected.rows, atol=SOLVED)
        # Nearly singular multipliers are less well determined, by processors' rounding to 2e-6.
        np.testing.assert_allclose(solution.blocks[0], expected.blocks[0], atol=10.0 * SOLVED)
        np.testing.assert_allclose(solution.residual, each.M @ solution.x + each.m, atol=1e-8)
        assert solution.error < 1e-9
    # The same bits in another order, after a trip elsewhere, and without other squares.
    elsewhere = pickle.loads(pickle.dumps(family))
    for each, solution in reversed(list(zip(members, found, strict=True))):
        for other in (family, elsewhere):
            again = other.solve(squares=(each.M, each.m))
            np.testing.assert_array_equal(again.x, solution.x)
    np.testing.assert_array_equal(family.solve().x, found[0].x)


def test_a_family_serves_several_threads() -> None:
    rng = np.random.default_rng(6)
    members = [family_member(rng) for _ in range(40)]
    family = ConicFamily(members[0], pattern=np.triu(np.ones((3, 3), dtype=bool)))

    def solve(program: ConicProgram) -> Array:
        x = family.solve(squares=(program.M, program.m)).x
        assert x is not None
        return x

    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(solve, members))
    for program, x in zip(members, found, strict=True):
        np.testing.assert_array_equal(x, solve(program))


def test_a_family_without_updates_of_the_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(7)
    members = [family_member(rng) for _ in range(3)]
    pattern = np.triu(np.ones((3, 3), dtype=bool))
    expected = ConicFamily(members[0], pattern=pattern)
    made: list[Any] = []

    class Old:
        """A Clarabel that takes no other numbers."""

        def __init__(self, solver: Any) -> None:
            made.append(self)
            self.solve = solver.solve

    new = conic._clarabel_solver
    monkeypatch.setattr(conic, "_clarabel_solver", lambda *a, **k: Old(new(*a, **k)))
    family = ConicFamily(members[0], pattern=pattern)
    found = [family.solve(squares=(each.M, each.m)) for each in members]
    assert len(made) == 3
    monkeypatch.undo()
    for each, solution in zip(members, found, strict=True):
        again = expected.solve(squares=(each.M, each.m))
        np.testing.assert_allclose(solution.x, again.x, atol=1e-9)
