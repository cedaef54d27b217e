"""Bodies as files have them: exact laws, and libraries in floating point."""

import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given

from sdpid.output.robots.principal_axes import along, principal_axes, rotation
from sdpid.robot.description.inertials import central, exists, inside, rounded, tensor
from sdpid.robot.inertia import physical_parameters
from tests.helpers.strategies import bodies


def about_origin(
    mass: Fraction, com: Sequence[Fraction], moments: Sequence[Fraction]
) -> list[Fraction]:
    """Return the ten parameters of a mass, a center of mass and moments about it, exactly."""
    square = sum(c * c for c in com)
    places = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
    return [mass, *(mass * c for c in com)] + [
        value + mass * ((square if i == j else 0) - com[i] * com[j])
        for value, (i, j) in zip(moments, places, strict=True)
    ]


def exactly(body: np.ndarray) -> list[Fraction]:
    return [Fraction(x) for x in body.tolist()]


@given(bodies())
def test_about_the_center_and_back(body: np.ndarray) -> None:
    exact = exactly(body)
    assert about_origin(*central(exact)) == exact
    mass, com, inertia = physical_parameters(body)
    written = rounded(exact)
    assert written.mass == mass
    assert written.com == tuple(com)
    found = np.array(written.moments) - inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    assert np.abs(found).max() <= 1e-14 * np.abs(body[4:]).max()


@given(bodies())
def test_each_written_number_is_the_nearest(body: np.ndarray) -> None:
    exact, found = central(exactly(body)), rounded(exactly(body))
    numbers = zip(
        (found.mass, *found.com, *found.moments), (exact[0], *exact[1], *exact[2]), strict=True
    )
    for number, value in numbers:
        assert abs(Fraction(number) - value) <= Fraction(math.ulp(number)) / 2


@pytest.mark.parametrize("consistency", ["pseudo_inertia", "spatial_inertia"])
def test_the_edge(consistency: str) -> None:
    """A point, a rod and a plate are raised, a ball is not, and what is no body stays none."""
    m = Fraction(1)
    point = about_origin(m, [m / 2, m, m], [Fraction(0)] * 6)
    rod = about_origin(m, [m / 2, m, m], [m, m * 0, m, m * 0, m * 0, m * 0])
    plate = about_origin(m, [m / 2, m, m], [m, m * 0, m, m * 0, m * 0, 2 * m])
    ball = about_origin(m, [m / 2, m, m], [m, m * 0, m, m * 0, m * 0, m])
    for body in (point, rod):
        found = inside(body, consistency)
        assert 0 < found[4] - body[4] < Fraction(1e-12)
        written = rounded(found)
        assert exists(written.mass, written.moments, consistency)
    raised = inside(plate, consistency)
    assert raised is not None
    assert (raised != plate) == (consistency == "pseudo_inertia")
    assert inside(ball, consistency) == ball
    assert inside(about_origin(m, [m, m, m], [-m, m * 0, m, m * 0, m * 0, m]), consistency) is None
    assert inside([Fraction(0)] * 10, consistency) is None


@given(bodies())
def test_principal_axes(body: np.ndarray) -> None:
    """Moments and quaternion give the tensor back to its rounding."""
    exact = central(exactly(body))[2]
    quaternion, moments = principal_axes(exact)
    R = rotation([Fraction(x) for x in quaternion])
    diagonal = np.diag([Fraction(x) for x in moments]).tolist()
    turned, wanted = along(diagonal, np.transpose(R).tolist()), tensor(exact)
    limit = Fraction(1e-14) * max(map(abs, exact))
    assert all(abs(turned[i][j] - wanted[i][j]) <= limit for i in range(3) for j in range(3))
