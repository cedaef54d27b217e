"""Attempts end with the first solution that is good enough; otherwise the best is kept."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.estimation.conic.retry import solve_with_retries
from sdpid.estimation.conic.solve import ConicProgram, ConicSolution, solve_conic

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


def test_all_attempts_are_made_where_none_is_ever_enough() -> None:
    solutions = scripted([0.5, 0.0, 0.25])
    found = solve_with_retries(solutions.__getitem__, range(3), by_error, enough=-np.inf)
    assert (found.value, found.accepted, found.solves) == (1, False, 3)


def test_a_program_is_solved_at_the_first_regularization() -> None:
    nearest = ConicProgram(
        M=np.eye(2),
        m=-np.array([3.0, 1.0]),
        C=np.eye(2),
        lower=np.full(2, -np.inf),
        upper=np.full(2, 2.0),
    )
    tried = []

    def solve(regularization: float) -> ConicSolution:
        tried.append(regularization)
        return solve_conic(nearest, regularization=regularization)

    found = solve_with_retries(
        solve, (1e-10, 1e-8), lambda x, solution: (x, 0.0 if solution.solved else solution.error)
    )
    assert found.accepted
    assert tried == [1e-10]
    # An interior-point method ends at some 1e-9 for a problem of order one.
    assert found.value == pytest.approx([2.0, 1.0], abs=1e-6)


@pytest.mark.parametrize(
    ("status", "solved"),
    [
        ("Solved", True),
        ("AlmostSolved", True),
        ("solved", True),
        ("Unsolved", False),
        ("MaxIterations", False),
        ("PrimalInfeasible", False),
        ("unfinished", False),
    ],
)
def test_what_a_solver_calls_solved(status: str, solved: bool) -> None:
    assert ConicSolution(status, np.zeros(1)).solved is solved
