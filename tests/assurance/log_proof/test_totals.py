"""Bounds of the rows' cost hold whatever the rows are, within the premises."""

from __future__ import annotations

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from sdpid.assurance.log_proof.chain.totals import of_rows, of_true_rows
from sdpid.verifier.exact import root_below
from tests.helpers.strategies import reals

SIZES = st.one_of(st.just(0.0), reals(1e-12, 1e6))
SHARES = st.fractions(0, 1, max_denominator=1000)


def compressed(cost: Fraction, prior: Fraction) -> Any:
    """Return the parts of `Recomputed` at a point where the bound is sharp."""
    return SimpleNamespace(
        theta=[0.0],
        lower=[-1.0],
        upper=[1.0],
        problem={"floor": 0.0},
        broken=[],
        data_cost=cost,
        prior_cost=prior,
        lower_bound=cost + prior,
        scale=Fraction(1, 10**6),
    )


@given(SIZES, SIZES, reals(0.0, 0.999), SIZES, SIZES, SHARES, SHARES)
def test_every_cost_that_the_premises_allow_is_between_the_bounds(
    root: float,
    prior: float,
    relative: float,
    absolute: float,
    error: float,
    of_rows_share: Fraction,
    of_error_share: Fraction,
) -> None:
    # The rows' cost is a square, so that its root is a number.
    rows_root = Fraction(root)
    rows_cost = rows_root**2
    # A compressed cost that is near enough, anywhere between the ends.
    share, constant = Fraction(relative), Fraction(absolute)
    least = max((rows_cost - constant) / (1 + share), Fraction(0))
    most = (rows_cost + constant) / (1 - share)
    found = compressed(least + of_rows_share * (most - least), Fraction(prior))
    rows = of_rows(found, relative, absolute)
    assert rows.cost is not None
    assert rows.lower_bound <= rows_cost + found.prior_cost <= rows.cost
    true_root = max(rows_root + (2 * of_error_share - 1) * Fraction(error), Fraction(0))
    true = of_true_rows(rows, error, error)
    assert true.cost is not None
    assert true.lower_bound <= true_root**2 + found.prior_cost <= true.cost
    assert true.gap is not None
    assert true.gap >= 0


@given(st.fractions(0, 10**20) | st.fractions(0, 1, max_denominator=10**60))
def test_a_root_below_is_just_below(value: Fraction) -> None:
    root = root_below(value)
    assert root**2 <= value
    assert value < (root + Fraction(1, 2**80)) ** 2


def test_parameters_outside_their_bounds_have_no_cost() -> None:
    found = compressed(Fraction(3), Fraction(1))
    found.theta = [2.0]
    assert of_rows(found, 0.5, 0.0).cost is None


def test_without_parameters_there_is_a_bound_and_no_cost() -> None:
    found = compressed(Fraction(3), Fraction(1))
    found.theta = None
    true = of_true_rows(of_rows(found, 0.5, 0.0), 0.0, 0.0)
    assert true.cost is None
    assert true.gap is None
    assert Fraction(19, 10) < true.lower_bound <= 2
