"""Friction terms as plain values, and back: the same term, number by number."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from sdpid._common.tables import plain
from sdpid.errors import ModelError
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import BY_NAME, Coupling

# The classes whose settings say everything about a term; a class of someone else's may hold code.
_OURS: list[type[FrictionTerm]] = [*BY_NAME.values(), Coupling]
CLASSES = {each.__name__: each for each in _OURS}


def term_to_dict(term: FrictionTerm) -> dict[str, Any]:
    """Return the class and the settings of a term as JSON has them.

    Raises
    ------
    ModelError
        When the term is of a class that this package does not have.
    """
    name = type(term).__name__
    if CLASSES.get(name) is not type(term):
        raise ModelError(
            f"friction: {name} is a class of your own, which no file can hold; its settings alone "
            "do not say what it computes."
        )
    return {"term": name, **{each: plain(getattr(term, each)) for each in _settings(type(term))}}


def term_from_dict(given: Mapping[str, Any]) -> FrictionTerm:
    """Return the term of `term_to_dict`.

    Raises
    ------
    ModelError
        When class, settings or values are none of a term.
    """
    found = CLASSES.get(str(given.get("term")))
    if found is None:
        raise ModelError(
            f"friction: no term is of the class {given.get('term')!r:.80}; there are "
            f"{', '.join(CLASSES)}."
        )
    settings = {name: value for name, value in given.items() if name != "term"}
    if wrong := settings.keys() ^ set(_settings(found)):
        raise ModelError(
            f"friction: {found.__name__} has the settings {', '.join(_settings(found)) or 'none'}; "
            f"missing or not known: {', '.join(sorted(map(repr, wrong)))[:200]}."
        )
    try:
        return found(**{name: _value(value) for name, value in settings.items()})
    except (TypeError, ValueError) as cause:
        raise ModelError(f"friction: {found.__name__}: {cause}.") from None


def _settings(term: type[FrictionTerm]) -> tuple[str, ...]:
    return tuple(each.name for each in fields(term))  # type: ignore[arg-type]


def _value(value: Any) -> Any:
    """Return what JSON holds as a setting is held: numbers as floats, lists as tuples."""
    if isinstance(value, list):
        return tuple(_value(each) for each in value)
    if isinstance(value, bool) or not isinstance(value, (int, float, str, type(None))):
        raise TypeError(f"a setting is {value!r:.80}")
    if isinstance(value, (int, float)):
        number = float(value)
        if not math.isfinite(number):
            raise ValueError(f"a setting is {number}")
        return number
    return value
