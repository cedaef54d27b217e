"""The one way to make bodies consistent: what it promises, on bodies that cannot exist."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sdpid._common.arrays import Array
from sdpid.robot.consistent import raise_eigenvalues, raise_second_moments
from sdpid.robot.inertia import Consistency, central_moments, margin
from sdpid.verifier.bodies import has_margin
from tests.helpers.strategies import LEAST_MARGIN, bodies, reals

KINDS = st.sampled_from(["pseudo_inertia", "spatial_inertia"])
LEAST = st.sampled_from([0.0, 1e-9, 1e-3, 0.5])


@st.composite
def broken(draw: st.DrawFn) -> Array:
    """A body (10,) with a positive mass and any inertia at all."""
    body = draw(bodies())
    body[4:] += draw(hnp.arrays(float, 6, elements=reals(-1.0, 1.0)))
    return body


@given(broken(), KINDS, LEAST)
def test_the_margin_is_reached_and_mass_and_center_stay(
    body: Array, kind: Consistency, least: float
) -> None:
    found = raise_second_moments(body, least, consistency=kind)
    assert margin(found, kind) >= least
    np.testing.assert_array_equal(found[:4], body[:4])


@given(bodies(), KINDS)
def test_consistent_bodies_are_returned_to_the_bit(body: Array, kind: Consistency) -> None:
    found = raise_second_moments(body, 0.5 * LEAST_MARGIN, consistency=kind)
    np.testing.assert_array_equal(found, body)


@given(broken(), broken(), KINDS, LEAST)
def test_no_other_consistent_body_is_nearer(
    body: Array, other: Array, kind: Consistency, least: float
) -> None:
    # Any feasible moments about the same center, made from another body.
    given_moments = central_moments(body, kind)[2]
    nearest = central_moments(raise_second_moments(body, least, consistency=kind), kind)[2]
    rival = raise_eigenvalues(central_moments(other, kind)[2], least)
    distance = np.linalg.norm(nearest - given_moments)
    # Rounding of moments of order one.
    assert distance <= np.linalg.norm(rival - given_moments) + 1e-13


@given(broken(), KINDS)
def test_an_exact_test_makes_the_result_exact(body: Array, kind: Consistency) -> None:
    least = 1e-3

    def holds(trial: Array) -> bool:
        return bool(has_margin(trial.tolist(), least, kind))

    assert holds(raise_second_moments(body, least, consistency=kind, holds=holds))


@given(broken())
def test_moments_can_be_limited_above(body: Array) -> None:
    found = raise_second_moments(body, 1e-3, most=1e-2)
    values = np.linalg.eigvalsh(central_moments(found, "pseudo_inertia")[2])
    # Rounding of the shift between the frame and the center of mass, both of order one.
    assert values.min() >= 1e-3
    assert values.max() <= 1e-2 + 1e-14


def test_every_link_has_its_own_limit_and_massless_ones_stay() -> None:
    three = np.zeros((3, 10))
    three[:2, 0] = 2.0
    three[2, 4:] = -1.0
    found = raise_second_moments(three, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(margin(found[:2], "pseudo_inertia"), [0.1, 0.2], rtol=1e-15)
    np.testing.assert_array_equal(found[2], three[2])


def test_a_center_of_mass_far_away_costs_no_margin() -> None:
    far = np.array([3.0, 3e4, -2e4, 1e4, 0, 0, 0, 0, 0, 0.0])
    assert margin(raise_second_moments(far, 1e-6), "pseudo_inertia") >= 1e-6


@pytest.mark.parametrize("least", [0.0, 1e-6])
def test_a_diagonal_matrix_stays_one(least: float) -> None:
    found = raise_eigenvalues(np.diag([-1.0, 0.3, 1e-9]), least)
    np.testing.assert_array_equal(found, np.diag([least, 0.3, max(least, 1e-9)]))
