"""Conic programs: solutions, attempts, and the derivative of a fit."""

import pickle
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.estimation.conic import solve as conic
from sdpid.estimation.conic.fit_response import FitResponse
from sdpid.estimation.conic.solve import (
    ConicFamily,
    ConicProgram,
    ConicSolution,
    Matrix,
    solve_conic,
    solve_with_retries,
    symmetric_basis,
)

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
    low, high = (np.broadcast_to(np.asarray(side, float), (len(C),)) for side in (lower, upper))
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


def nearest(goal: Array, constant: Array) -> Array:
    """Return what plus a constant is positive semidefinite, nearest to a goal."""
    values, vectors = np.linalg.eigh(goal + constant)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T - constant)


def projection(h: Array, size: int) -> ConicProgram:
    """Return the projection of symmetric matrices, as vectors, onto the semidefinite ones."""
    return program(np.eye(len(h)), -h, blocks=(whole(size),))


@pytest.mark.parametrize(("one", "two"), [(3, 2), (4, 6)])
def test_the_nearest_positive_semidefinite_matrices(one: int, two: int) -> None:
    """Blocks of different sizes that each see some of the variables, moved by their constants.

    Every entry has its place and its weight, in the point and in the multiplier.
    """
    rng = np.random.default_rng(1)
    A, B, D, E = (symmetric(rng, size) for size in (one, two, one, two))
    target = np.concatenate([coordinates(B), coordinates(A)])
    inner = len(coordinates(B))
    first = Matrix(np.arange(inner, len(target)), symmetric_basis(one), D)
    second = Matrix(np.arange(inner), symmetric_basis(two), E)
    found = solve_conic(program(np.eye(len(target)), -target, blocks=(first, second)))
    np.testing.assert_allclose(matrix_of(found.x[inner:], one), nearest(A, D), atol=SOLVED)
    np.testing.assert_allclose(matrix_of(found.x[:inner], two), nearest(B, E), atol=SOLVED)
    # The gradient 2·(X − A) is the multiplier.
    for dual, goal, constant in zip(found.blocks, (A, B), (D, E), strict=True):
        np.testing.assert_allclose(dual, 2.0 * (nearest(goal, constant) - goal), atol=SOLVED)


def test_signs_of_multipliers_and_infinite_limits() -> None:
    """Of ``(x − a)²`` within limits: the gradient at the end, positive at a lower one."""
    goal = np.array([-3.0, 3.0, 0.5, -3.0, 3.0, 7.0])
    lower = np.array([-1.0, -1.0, -1.0, -np.inf, 1.0, -np.inf])
    upper = np.array([1.0, 1.0, 1.0, 1.0, np.inf, np.inf])
    x = np.clip(goal, lower, upper)
    # The same with a linear cost, which counts once.
    for m, cost in ((-goal, None), (0.0 * goal, -2.0 * goal)):
        given_ = {"C": np.eye(6), "lower": lower, "upper": upper, "cost": cost}
        found = solve_conic(program(np.eye(6), m, **given_))
        np.testing.assert_allclose(found.x, x, atol=SOLVED)
        np.testing.assert_allclose(found.rows, 2.0 * (x - goal), atol=SOLVED)
        assert found.rows[0] > 0.0 > found.rows[1]


@pytest.mark.parametrize(("sizes", "weight"), [((4, 1), 0.2), ((3, 2), 3.0)])
def test_log_dets_beside_squares_and_blocks(sizes: tuple[int, int], weight: float) -> None:
    """``‖X − A‖² − w·Σ log det`` of two matrices, one with a constant, eigenvalue by eigenvalue."""
    rng = np.random.default_rng(5)
    A, B, shift = (symmetric(rng, size) for size in (*sizes, sizes[1]))
    first, count = whole(sizes[0]), len(coordinates(A))
    second = Matrix(count + np.arange(len(coordinates(B))), symmetric_basis(sizes[1]), shift)
    target = np.concatenate([coordinates(A), coordinates(B)])
    # Matrices with a log-determinant are inside; another block changes nothing.
    both = {"blocks": (first,), "log_dets": (first, second)}
    found = solve_conic(program(np.eye(len(target)), -target, **both, weight=weight))

    def best(goal: Array) -> Array:
        # 2·(x − a) = w/x.
        values, vectors = np.linalg.eigh(goal)
        values = 0.5 * (values + np.sqrt(values**2 + 2.0 * weight))
        return np.asarray((vectors * values) @ vectors.T)

    ends = (found.x[:count], best(A), 0.0), (found.x[count:], best(B + shift), shift)
    for x, expected, constant in ends:
        np.testing.assert_allclose(matrix_of(x, len(expected)), expected - constant, atol=1e-5)
    np.testing.assert_allclose(found.blocks[0], 0.0, atol=1e-5)


def test_what_has_no_solution_says_so() -> None:
    one = np.eye(1)
    lower, upper = np.array([1.0, -np.inf]), np.array([np.inf, 0.0])
    apart = program(one, np.zeros(1), C=np.ones((2, 1)), lower=lower, upper=upper)
    assert "infeasible" in solve_conic(apart).status.lower()
    endless = program(np.zeros((0, 1)), np.zeros(0), cost=np.ones(1), C=one, upper=0.0)
    status = solve_conic(endless).status.lower()
    assert "dualinfeasible" in status or "unbounded" in status


def family_member(rng: np.random.Generator) -> ConicProgram:
    """Return one of a family: the matrix (a, b; b, c) nearest to a target in some norm."""
    units = np.array([[[1.0, 0], [0, 0]], [[0, 1.0], [1.0, 0]], [[0, 0], [0, 1.0]]])
    M, m = np.triu(rng.standard_normal((3, 3))) + 2.0 * np.eye(3), rng.standard_normal(3)
    lower, block = np.array([-np.inf, -np.inf, 0.1]), Matrix(np.arange(3), units, np.zeros((2, 2)))
    return program(M, m, C=np.eye(3), lower=lower, upper=4.0, blocks=(block,))


def test_a_family_solves_each_as_if_it_were_alone() -> None:
    rng = np.random.default_rng(5)
    members = [family_member(rng) for _ in range(5)]
    family = ConicFamily(members[0], pattern=np.triu(np.ones((3, 3), dtype=bool)))
    found = [family.solve(squares=(each.M, each.m)) for each in members]
    for each, solution in zip(members, found, strict=True):
        expected = solve_conic(each)
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


# ---- Attempts end with the first solution that is good enough; otherwise the best is kept.


ERRORS = st.lists(
    st.one_of(st.none(), st.floats(0.0, 1.0), st.sampled_from([np.inf, np.nan])), max_size=6
)


def scripted(errors: Sequence[float | None]) -> list[ConicSolution]:
    """Return solutions of given errors, without a point for None, that took a second each."""
    return [
        ConicSolution("NumericalError", None, seconds=1.0)
        if error is None
        else ConicSolution(f"number {i}", np.array([float(i)]), seconds=1.0, error=error)
        for i, error in enumerate(errors)
    ]


def by_error(x: Array, solution: ConicSolution) -> tuple[int, float]:
    return int(x[0]), solution.error


@given(ERRORS, st.floats(0.0, 1.0))
def test_the_first_that_is_good_enough_or_the_best_is_returned(
    errors: list[float | None], enough: float
) -> None:
    solutions = scripted(errors)
    found = solve_with_retries(solutions.__getitem__, range(len(errors)), by_error, enough=enough)
    sizes = [np.inf if error is None or np.isnan(error) else error for error in errors]
    good = [i for i, size in enumerate(sizes) if size <= enough]
    with_point = [i for i, error in enumerate(errors) if error is not None]
    assert found.accepted == bool(good)
    assert found.solves == found.seconds == (good[0] + 1 if good else len(errors))
    expected = good[0] if good else min(with_point, key=sizes.__getitem__, default=None)
    assert found.value == expected
    if expected is not None:
        assert found.status == f"number {expected}"


def test_without_a_usable_solution_the_last_status_says_why() -> None:
    solutions = [
        ConicSolution("PrimalInfeasible", np.zeros(1)),
        ConicSolution("MaxIterations", None),
    ]
    found = solve_with_retries(solutions.__getitem__, (0, 1), lambda x, solution: None)
    assert (found.value, found.accepted, found.status) == (None, False, "MaxIterations")
    assert solve_with_retries(solutions.__getitem__, (), by_error).status == "not attempted"


def test_what_a_solver_calls_solved() -> None:
    solved = ("Solved", "AlmostSolved", "solved")
    for status in (*solved, "Unsolved", "MaxIterations", "PrimalInfeasible", "unfinished"):
        assert ConicSolution(status, np.zeros(1)).solved is (status in solved)


# ---- The derivative of a constrained fit against differences, and projections whose own is known.


# Where constraints are strictly active or not at all, an interior point's derivative is that of
# the optimum up to the root of its tolerance.
EXACT = 1e-4

# Differences over 1e-4 of solutions that are good to some 1e-9.
DIFFERENCES = 1e-3
STEP = 1e-4


def response(program: ConicProgram) -> Array:
    """Return the derivative at the optimum."""
    found = solve_conic(program)
    return FitResponse(program).at(found.x, found.rows, found.blocks)


@pytest.mark.parametrize("eigenvalues", [(2.0, 1.0, 0.5), (2.0, 1.0, -0.5), (1.0, -0.3, -2.0)])
def test_the_trace_is_that_of_the_projection_onto_semidefinite_matrices(
    eigenvalues: tuple[float, ...],
) -> None:
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    matrix = turn @ np.diag(eigenvalues) @ turn.T
    # A pair of eigenvalues moves with the share of the positive one in their distance.
    up = [value for value in eigenvalues if value > 0.0]
    down = [-value for value in eigenvalues if value < 0.0]
    expected = len(up) * (len(up) + 1) / 2 + sum(a / (a + b) for a in up for b in down)
    found = response(projection(coordinates(matrix), 3))
    assert np.trace(found) == pytest.approx(expected, abs=EXACT)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_the_derivative_is_that_of_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    M, h = rng.standard_normal((4, 3)), 2.0 * rng.standard_normal(4)

    def fitted(h: Array) -> tuple[ConicProgram, Array]:
        matrix = Matrix(np.arange(3), symmetric_basis(2), 0.3 * np.eye(2))
        own = program(M, -h, C=np.eye(3)[:1], lower=-0.2, upper=0.5, blocks=(matrix,))
        return own, M @ solve_conic(own).x

    ends = [[fitted(h + side * unit)[1] for unit in STEP * np.eye(4)] for side in (1.0, -1.0)]
    numbers = (np.array(ends[0]) - ends[1]) / (2.0 * STEP)
    found = response(fitted(h)[0])
    # Where the active constraints change within the step there is no derivative to compare with.
    if np.abs(numbers - numbers.T).max() < DIFFERENCES:
        assert np.abs(found - numbers.T).max() < 30.0 * DIFFERENCES
    values = np.linalg.eigvalsh(found)
    assert values[0] > -EXACT
    assert values[-1] < 1.0 + EXACT


def test_a_held_function_costs_one_degree_inside_and_all_at_an_apex() -> None:
    inside = projection(np.array([3.0, 1.0, 0.5, 0.2, 0.1, 2.0]), 3)
    trace = np.einsum("kii->k", symmetric_basis(3))
    for program, lost in ((inside, 1.0), (projection(-inside.m, 3), 6.0)):
        # With its squares in a ball instead of the cost.
        free, family = response(program), ConicFamily(replace(program, radius=1.0))
        # The least trace within a ball: a little smaller than the point's, or none.
        radius = 0.1 if lost == 1.0 else 10.0
        found = family.solve(trace, radius)
        held = FitResponse(program).at(
            found.x, found.rows, found.blocks, weight=2.0 * radius / found.ball[0], held=trace
        )
        if lost == 1.0:
            assert np.trace(free - held) == pytest.approx(1.0, abs=EXACT)
        else:
            # Nothing is left but what the rim of the ball holds.
            assert np.trace(held) < 0.1
