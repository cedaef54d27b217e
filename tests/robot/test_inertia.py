"""Algebra of single bodies, and the one way to make bodies consistent."""

from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sdpid._common.arrays import Array
from sdpid.robot.consistent import raise_eigenvalues, raise_second_moments
from sdpid.robot.inertia import (
    Consistency,
    central_moments,
    from_pseudo_inertia,
    inertia_tensor,
    margin,
    margin_shift,
    matrix_of,
    physical_parameters,
    point_masses,
    pseudo_inertia,
    skew,
    spatial_inertia,
    theta_from_physical,
    transform,
)
from sdpid.verifier.bodies import has_margin
from tests.helpers.strategies import LEAST_MARGIN, bodies, links, reals, rotations
from tests.helpers.tolerances import ALGEBRA, assert_same

BOTH: tuple[Consistency, ...] = ("pseudo_inertia", "spatial_inertia")
any_vector = hnp.arrays(float, 10, elements=reals(-5.0, 5.0))


assert_close = partial(assert_same, tolerance=ALGEBRA)


@given(any_vector, bodies())
def test_parameters_are_found_again(theta: Array, body: Array) -> None:
    assert_close(from_pseudo_inertia(pseudo_inertia(theta)), theta)
    assert_close(theta_from_physical(*physical_parameters(body)), body)


@given(links(3))
def test_leading_axes_are_bodies(three: Array) -> None:
    for function in (pseudo_inertia, spatial_inertia, inertia_tensor):
        np.testing.assert_array_equal(function(three), [function(body) for body in three])
    for consistency in BOTH:
        together = margin(three.reshape(3, 1, 10), consistency)
        assert_close(together[:, 0], [margin(body, consistency) for body in three])


@given(bodies())
def test_point_masses_give_positive_definite_matrices(body: Array) -> None:
    for consistency in BOTH:
        assert np.linalg.eigvalsh(matrix_of(body, consistency)).min() > 0.0
    # The core alone accounts for this much; rounding of the parallel-axis shift is far below.
    least = margin(body, "pseudo_inertia")
    assert least >= LEAST_MARGIN * (1 - 1e-6)
    assert margin(body, "spatial_inertia") >= 2.0 * least - ALGEBRA


def test_spatial_inertia_of_a_point_mass_pushes_back() -> None:
    body = point_masses([2.0], [[0.3, -0.2, 0.5]])
    # Turned about the origin with w the mass moves with w × r, and f = m·(w × r).
    w, r = np.array([0.4, -1.0, 0.7]), np.array([0.3, -0.2, 0.5])
    np.testing.assert_allclose(skew(w) @ r, np.cross(w, r), atol=1e-15)
    force = 2.0 * np.cross(w, r)
    wrench = spatial_inertia(body) @ np.append(w, np.zeros(3))
    np.testing.assert_allclose(wrench, [*np.cross(r, force), *force], atol=1e-15)


@given(any_vector)
def test_tensor_entries_are_pinocchios(theta: Array) -> None:
    theta[0] = abs(theta[0]) + 0.1
    inertia = pin.Inertia.FromDynamicParameters(theta)
    mass, com, about = physical_parameters(theta)
    assert_close(mass, np.float64(inertia.mass))
    assert_close(com, inertia.lever, tolerance=1e-11)
    # The shift to the center of mass can be much larger than what is left.
    assert_close(about, inertia.inertia, tolerance=1e-10)
    assert_close(
        theta_from_physical(mass, com, about), inertia.toDynamicParameters(), tolerance=1e-10
    )


@given(bodies(), rotations(), hnp.arrays(float, 3, elements=reals(-1.0, 1.0)))
def test_transform_is_pinocchios_se3_action(body: Array, R: Array, t: Array) -> None:
    moved = pin.SE3(R, t).act(pin.Inertia.FromDynamicParameters(body))
    assert_close(transform(body, R, t), moved.toDynamicParameters())


def test_the_factor_two_is_sharp_and_the_sets_are_nested_strictly() -> None:
    ball = theta_from_physical(1.0, np.zeros(3), 0.02 * np.eye(3))
    assert margin(ball, "pseudo_inertia") == pytest.approx(0.01)
    assert margin(ball, "spatial_inertia") == pytest.approx(0.02)
    # Positive inertia, but no body: the largest moment exceeds the sum of the others.
    impossible = theta_from_physical(1.0, np.zeros(3), np.diag([1.0, 1.0, 3.0]))
    assert margin(impossible, "spatial_inertia") == pytest.approx(1.0)
    assert margin(impossible, "pseudo_inertia") == pytest.approx(-0.5)


@given(bodies(), reals(-0.5, 0.5))
def test_margin_is_the_schur_complement(body: Array, shift: float) -> None:
    """The matrix with t·D taken off is definite exactly when t is below the margin."""
    for consistency in BOTH:
        t = float(margin(body, consistency)) + shift
        matrix = matrix_of(body, consistency) - t * margin_shift(consistency)
        smallest = np.linalg.eigvalsh(matrix).min()
        # By congruence the sign is that of −shift; near zero it is rounding's.
        if abs(shift) > 1e-9:
            assert (smallest > 0.0) == (shift < 0.0)
        # And exactly at the margin the determinant vanishes.
        at = matrix + shift * margin_shift(consistency)
        assert abs(np.linalg.eigvalsh(at).min()) < 1e-11 * max(1.0, np.abs(at).max())


@pytest.mark.parametrize("mass", [0.0, -1.0])
@pytest.mark.parametrize("consistency", BOTH)
def test_no_margin_without_mass(mass: float, consistency: Consistency) -> None:
    assert np.isnan(margin(np.array([mass, *[0.0] * 3, 1, 0, 1, 0, 0, 1]), consistency))
    mixed = np.array([[mass, *[0.0] * 3, 1, 0, 1, 0, 0, 1], [1.0, *[0.0] * 3, 1, 0, 1, 0, 0, 1]])
    np.testing.assert_array_equal(np.isfinite(margin(mixed, consistency)), [False, True])


# The one way to make bodies consistent: what it promises, on bodies that cannot exist.


KINDS = st.sampled_from(["pseudo_inertia", "spatial_inertia"])
LEAST = st.sampled_from([0.0, 1e-9, 1e-3, 0.5])


@st.composite
def broken(draw: st.DrawFn) -> Array:
    """A body (10,) with a positive mass and any inertia at all."""
    body = draw(bodies())
    body[4:] += draw(hnp.arrays(float, 6, elements=reals(-1.0, 1.0)))
    return body


@given(broken(), broken(), bodies(), KINDS, LEAST)
def test_the_nearest_body_with_the_margin_is_found(
    body: Array, other: Array, right: Array, kind: Consistency, least: float
) -> None:
    found = raise_second_moments(body, least, consistency=kind)
    assert margin(found, kind) >= least
    # Mass and center stay, and what has the margin stays to the bit.
    np.testing.assert_array_equal(found[:4], body[:4])
    same = raise_second_moments(right, 0.5 * LEAST_MARGIN, consistency=kind)
    np.testing.assert_array_equal(same, right)
    # No other is nearer: any feasible moments about the same center, made from another body.
    given_moments, nearest = (central_moments(each, kind)[2] for each in (body, found))
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
    # A center of mass far away costs no margin.
    far = np.array([3.0, 3e4, -2e4, 1e4, 0, 0, 0, 0, 0, 0.0])
    assert margin(raise_second_moments(far, 1e-6), "pseudo_inertia") >= 1e-6


@pytest.mark.parametrize("least", [0.0, 1e-6])
def test_a_diagonal_matrix_stays_one(least: float) -> None:
    found = raise_eigenvalues(np.diag([-1.0, 0.3, 1e-9]), least)
    np.testing.assert_array_equal(found, np.diag([least, 0.3, max(least, 1e-9)]))
