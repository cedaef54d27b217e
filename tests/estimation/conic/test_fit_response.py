"""The derivative of a constrained fit against differences, and projections whose own is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.estimation.conic.fit_response import FitResponse
from sdpid.estimation.conic.solve import ConicFamily, ConicProgram, Matrix, solve_conic
from sdpid.estimation.conic.standard_form import symmetric_basis

# Where constraints are strictly active or not at all, an interior point's derivative is that of
# the optimum up to the root of its tolerance.
EXACT = 1e-4

# Differences over 1e-4 of solutions that are good to some 1e-9.
DIFFERENCES = 1e-3
STEP = 1e-4


def projection(h: Array, size: int) -> ConicProgram:
    """Return the projection of symmetric matrices, as vectors, onto the semidefinite ones."""
    basis = symmetric_basis(size)
    matrix = Matrix(np.arange(len(basis)), basis, np.zeros((size, size)))
    return ConicProgram(
        M=np.eye(len(basis)),
        m=-h,
        C=np.zeros((0, len(basis))),
        lower=np.zeros(0),
        upper=np.zeros(0),
        blocks=(matrix,),
    )


def response(program: ConicProgram) -> Array:
    """Return the derivative at the optimum."""
    found = solve_conic(program)
    assert found.x is not None
    return FitResponse(program).at(found.x, found.rows, found.blocks)


@pytest.mark.parametrize("eigenvalues", [(2.0, 1.0, 0.5), (2.0, 1.0, -0.5), (1.0, -0.3, -2.0)])
def test_the_trace_is_that_of_the_projection_onto_semidefinite_matrices(
    eigenvalues: tuple[float, ...],
) -> None:
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    matrix = turn @ np.diag(eigenvalues) @ turn.T
    h = np.einsum("kij,ij->k", symmetric_basis(3), matrix)
    # A pair of eigenvalues moves with the share of the positive one in their distance.
    up = [value for value in eigenvalues if value > 0.0]
    down = [-value for value in eigenvalues if value < 0.0]
    expected = len(up) * (len(up) + 1) / 2 + sum(a / (a + b) for a in up for b in down)
    assert np.trace(response(projection(h, 3))) == pytest.approx(expected, abs=EXACT)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_the_derivative_is_that_of_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    M, h = rng.standard_normal((4, 3)), 2.0 * rng.standard_normal(4)

    def fitted(h: Array) -> tuple[ConicProgram, Array]:
        matrix = Matrix(np.arange(3), symmetric_basis(2), 0.3 * np.eye(2))
        program = ConicProgram(
            M=M,
            m=-h,
            C=np.eye(3)[:1],
            lower=np.array([-0.2]),
            upper=np.array([0.5]),
            blocks=(matrix,),
        )
        found = solve_conic(program)
        assert found.x is not None
        return program, M @ found.x

    numbers = [
        (fitted(h + STEP * unit)[1] - fitted(h - STEP * unit)[1]) / (2.0 * STEP)
        for unit in np.eye(4)
    ]
    found = response(fitted(h)[0])
    # Where the active constraints change within the step there is no derivative to compare with.
    if np.abs(np.array(numbers) - np.array(numbers).T).max() < DIFFERENCES:
        assert np.abs(found - np.array(numbers).T).max() < 30.0 * DIFFERENCES
    values = np.linalg.eigvalsh(found)
    assert values[0] > -EXACT
    assert values[-1] < 1.0 + EXACT


def test_a_held_function_costs_one_degree_inside_and_all_at_an_apex() -> None:
    inside = projection(np.array([3.0, 1.0, 0.5, 0.2, 0.1, 2.0]), 3)
    trace = np.einsum("kii->k", symmetric_basis(3))
    for program, lost in ((inside, 1.0), (projection(-inside.m, 3), 6.0)):
        free, family = response(program), ConicFamily(replaced(program))
        # The least trace within a ball: a little smaller than the point's, or none.
        radius = 0.1 if lost == 1.0 else 10.0
        found = family.solve(trace, radius)
        assert found.x is not None
        held = FitResponse(program).at(
            found.x, found.rows, found.blocks, weight=2.0 * radius / found.ball[0], held=trace
        )
        if lost == 1.0:
            assert np.trace(free - held) == pytest.approx(1.0, abs=EXACT)
        else:
            # Nothing is left but what the rim of the ball holds.
            assert np.trace(held) < 0.1


def replaced(program: ConicProgram) -> ConicProgram:
    """Return the program with its squares in a ball instead of the cost."""
    from dataclasses import replace

    return replace(program, radius=1.0)
