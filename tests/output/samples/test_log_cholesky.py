"""The log-Cholesky form of a change: round trips, and what each of its numbers does."""

import numpy as np
from hypothesis import given
from hypothesis.extra import numpy as hnp

from sdpid._common.arrays import Array
from sdpid.output.samples.log_cholesky import NAMES, changed, changes
from sdpid.robot.inertia import margin, physical_parameters, transform
from tests.helpers.strategies import bodies, reals, rotations

# Bodies of the strategies have condition numbers up to some 1e5.
ROUNDING = 1e-8

CHANGES = hnp.arrays(float, 10, elements=reals(-1.0, 1.0))


def close(found: Array, expected: Array) -> bool:
    return bool(np.abs(found - expected).max() <= ROUNDING * max(1.0, np.abs(expected).max()))


@given(bodies(), CHANGES)
def test_a_change_is_found_again(body: Array, change: Array) -> None:
    assert close(changes(changed(body, change), body), change)


@given(bodies(), bodies())
def test_a_body_is_found_again(body: Array, reference: Array) -> None:
    assert close(changed(reference, changes(body, reference)), body)


@given(bodies(), CHANGES)
def test_every_change_leaves_a_body(body: Array, change: Array) -> None:
    assert margin(changed(body, change), "pseudo_inertia") > 0.0


@given(bodies(), reals(-1.0, 1.0), hnp.arrays(float, 3, elements=reals(-0.3, 0.3)))
def test_density_and_shift_do_what_they_say(body: Array, alpha: float, shift: Array) -> None:
    change = np.zeros(10)
    change[0], change[7:] = alpha, shift
    mass, com, inertia = physical_parameters(body)
    new_mass, new_com, new_inertia = physical_parameters(changed(body, change))
    assert np.isclose(new_mass, mass * np.exp(2.0 * alpha))
    assert close(new_com, com + shift)
    assert close(new_inertia, inertia * np.exp(2.0 * alpha))


@given(bodies(), CHANGES, rotations())
def test_the_numbers_belong_to_a_frame(body: Array, change: Array, rotation: Array) -> None:
    """In a turned frame the same change of shape has other numbers, alpha apart."""
    after = changed(body, change)
    turned = [transform(each, rotation, np.zeros(3)) for each in (after, body)]
    there = changes(*turned)
    assert close(changed(turned[1], there), turned[0])
    assert np.isclose(there[0], change[0], atol=ROUNDING)


def test_names_are_those_of_the_form() -> None:
    """Each number alone moves one entry of the factor of a unit body about its center."""
    body = np.array([1.0, 0, 0, 0, 2.0, 0, 2.0, 0, 0, 2.0])
    for k, name in enumerate(NAMES):
        change = np.zeros(10)
        change[k] = 0.1
        found = changed(body, change)
        if name.startswith("t"):
            assert np.isclose(found[int(name[1])], 0.1)
        if name.startswith("d"):
            axis = int(name[1]) - 1
            # The second moment along the axis, ½·tr(I) − I_ii.
            diagonal = found[[4, 6, 9]]
            assert np.isclose(0.5 * diagonal.sum() - diagonal[axis], np.exp(0.2))
        if name.startswith("s"):
            i, j = int(name[1]), int(name[2])
            entry = {(1, 2): 5, (1, 3): 7, (2, 3): 8}[i, j]
            assert np.isclose(found[entry], -0.1)
