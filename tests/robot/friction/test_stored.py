"""A friction term is the same term after it was plain values."""

import json
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given

from sdpid.errors import ModelError
from sdpid.robot.friction.stored import term_from_dict, term_to_dict
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import Coulomb
from tests.helpers.refusals import refuses
from tests.helpers.strategies import friction_terms_of


@given(friction_terms_of(3))
def test_a_term_that_was_json_is_the_same_term(term: FrictionTerm) -> None:
    given = json.loads(json.dumps(term_to_dict(term), allow_nan=False))
    assert term_from_dict(given) == term


@dataclass(frozen=True)
class _Own(Coulomb):
    """A class that no file can hold."""


def test_a_class_of_ones_own_is_refused() -> None:
    refuses(ModelError, "_Own is a class of your own", term_to_dict, _Own())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"term": "Own"}, "no term is of the class 'Own'"),
        ({}, "no term is of the class None"),
        ({"term": "Offset", "width": 1.0}, "has the settings none; missing or not known: 'width'"),
        ({"term": "Coulomb", "width": 0.1}, "missing or not known: 'dead_zone'"),
        ({"term": "Coulomb", "width": -1.0, "dead_zone": 0.0}, "width is -1.0"),
        ({"term": "Coulomb", "width": {}, "dead_zone": 0.0}, "Coulomb: a setting is {}"),
        ({"term": "Coulomb", "width": "x", "dead_zone": 0.0}, "Coulomb: "),
        ({"term": "SigmoidFriction", "velocity": 1e999}, "a setting is inf"),
    ],
)
def test_what_is_no_term_is_refused_in_words(given: dict[str, Any], message: str) -> None:
    refuses(ModelError, message, term_from_dict, given)
