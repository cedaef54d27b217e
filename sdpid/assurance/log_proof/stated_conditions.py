"""Conditions on parameters as plain values, and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from sdpid._common.tables import plain
from sdpid.estimation.constraints.condition import Condition
from sdpid.estimation.constraints.equal_friction import EqualFriction
from sdpid.estimation.constraints.equalities import (
    EqualLinks,
    Fixed,
    FixedLink,
    MirrorPair,
    MirrorSymmetry,
)
from sdpid.estimation.constraints.mass import CenterOfMassInEllipsoid, MassInEllipsoid, TotalMass

# Those that names and finite numbers say whole; a hull reads meshes, a box may have no end.
_KINDS: dict[str, type[Condition]] = {
    kind.__name__: kind
    for kind in (
        CenterOfMassInEllipsoid,
        EqualFriction,
        EqualLinks,
        Fixed,
        FixedLink,
        MassInEllipsoid,
        MirrorPair,
        MirrorSymmetry,
        TotalMass,
    )
}


def can_be_stated(conditions: Iterable[Condition]) -> bool:
    """Return whether all conditions are of a kind that plain values say whole."""
    return all(_KINDS.get(type(each).__name__) is type(each) for each in conditions)


def conditions_to_list(conditions: Iterable[Condition]) -> list[dict[str, Any]]:
    """Return plain values for JSON."""
    return [{"condition": type(each).__name__, **plain(each)} for each in conditions]


def conditions_from_list(given: Any) -> tuple[Condition, ...]:
    """Return what `conditions_to_list` wrote.

    Raises
    ------
    ValueError, TypeError, SdpidError
        Where it is none.
    """
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise TypeError(f"conditions are {given!r:.80}")
    found = []
    for each in given:
        if not isinstance(each, Mapping) or each.get("condition") not in _KINDS:
            raise ValueError(f"no condition is {each!r:.200}")
        found.append(
            _KINDS[each["condition"]](**{k: v for k, v in each.items() if k != "condition"})
        )
    return tuple(found)


def in_words(conditions: Sequence[Condition]) -> str:
    """Return how many there are of each kind."""
    names = [type(each).__name__ for each in conditions]
    return ", ".join(f"{names.count(name)} {name}" for name in dict.fromkeys(names))
