"""Bodies and placements without rounding: their laws, and libraries in floating point."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from sdpid.output.robots.principal_axes import principal_axes
from sdpid.robot.description.origin import rpy_matrix
from sdpid.robot.inertia import physical_parameters, transform
from sdpid.verifier.reading import MalformedError
from sdpid.verifier.results.inertials import (
    Inertial,
    about_origin,
    body_of,
    central,
    exists,
    inside,
    less,
    moved,
    rounded,
)
from sdpid.verifier.results.markup import Node, parse
from sdpid.verifier.results.placements import (
    HERE,
    Placement,
    from_quaternion,
    from_rpy,
    sine_and_cosine,
)
from tests.helpers.strategies import bodies, reals

ANGLES = st.tuples(*[reals(-7.0, 7.0)] * 3)
POINTS = st.tuples(*[reals(-2.0, 2.0)] * 3)


def exactly(body: np.ndarray) -> list[Fraction]:
    return [Fraction(x) for x in body.tolist()]


@given(st.floats(-1e12, 1e12))
@example(math.pi / 2)
def test_sines(angle: float) -> None:
    """The identity holds to the digits that are promised, and libm agrees."""
    sine, cosine = sine_and_cosine(angle)
    assert abs(sine**2 + cosine**2 - 1) < Fraction(1, 2**250)
    assert float(sine) == pytest.approx(math.sin(angle), rel=1e-15, abs=2.0**-250)
    assert float(cosine) == pytest.approx(math.cos(angle), rel=1e-15, abs=2.0**-250)
    turned = sine_and_cosine(-angle)
    assert max(abs(turned[0] + sine), abs(turned[1] - cosine)) < Fraction(1, 2**250)


def test_no_angle_is_no_rotation() -> None:
    assert from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) == HERE
    assert from_quaternion((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) == HERE


@given(bodies(), ANGLES, POINTS)
def test_moved_as_in_floating_point(
    body: np.ndarray, rpy: tuple[float, ...], at: tuple[float, ...]
) -> None:
    found = moved(exactly(body), from_rpy(rpy, at))
    expected = transform(body, rpy_matrix(rpy), at)
    assert np.abs(np.array(found, dtype=float) - expected).max() <= 1e-13 * np.abs(expected).max()


@given(bodies(), POINTS, POINTS, st.tuples(*[st.integers(-5, 5)] * 4).filter(any))
def test_moving_twice_is_moving_once(
    body: np.ndarray, one: tuple[float, ...], two: tuple[float, ...], q: tuple[int, ...]
) -> None:
    """Exactly, but for the last of 256 binary places."""
    first, second = from_quaternion(q, one), Placement(HERE.rotation, [Fraction(x) for x in two])
    there = moved(moved(exactly(body), second), first)
    once = moved(exactly(body), first.then(second))
    assert max(abs(a - b) for a, b in zip(there, once, strict=True)) < Fraction(1, 2**240)


@given(bodies())
def test_about_the_center_and_back(body: np.ndarray) -> None:
    exact = exactly(body)
    assert about_origin(*central(exact)) == exact
    assert less(exact, [exact]) == [0] * 10
    mass, com, inertia = physical_parameters(body)
    written = rounded(exact)
    assert written.mass == mass
    assert written.com == tuple(com)
    size = np.abs(body[4:]).max()
    assert (
        np.abs(np.array(written.moments) - inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]).max()
        <= 1e-14 * size
    )


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
        assert found is not None
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
    quaternion, (xx, yy, zz) = principal_axes(exact)
    written = Inertial(1.0, (0.0,) * 3, (xx, 0.0, yy, 0.0, 0.0, zz))
    axes = from_quaternion(quaternion, (0.0,) * 3)
    limit = Fraction(1e-14) * max(map(abs, exact))
    assert all(abs(a - b) <= limit for a, b in zip(body_of(written, axes)[4:], exact, strict=True))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "<a>",
        "<a/><b/>",
        "<!DOCTYPE a><a/>",
        '<!DOCTYPE a [<!ENTITY x "y">]><a b="&x;"/>',
        '<a b="&x;"/>',
        '<?xml version="1.0" encoding="nonsense"?><a/>',
        "<a>" * 1100 + "</a>" * 1100,
        "<a b='1' b='2'/>",
    ],
)
def test_xml_that_is_refused(text: str) -> None:
    with pytest.raises(MalformedError):
        parse(text.encode())


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_encodings(encoding: str) -> None:
    declared = {"utf-8-sig": "utf-8"}.get(encoding, encoding)
    text = f'<?xml version="1.0" encoding="{declared}"?><a b="é"/>'
    assert parse(text.encode(encoding)).attributes == {"b": "é"}


@pytest.mark.parametrize(
    "text", ["", "1 2", "x", "nan", "inf", "1_0", "0x1", "1e13", "1e99999", "٣"]
)
def test_numbers_that_are_refused(text: str) -> None:
    with pytest.raises(MalformedError):
        Node("mass", {"value": text}).number("value")
