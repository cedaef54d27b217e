"""Ways to edit any certificate without a thought of what it means: half of what forgeries.py does.

Numbers are changed by a digit, a sign or a scale, lists lose their order, numbers become something
else. A mutation changes the data in place and returns whether it found something to change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from random import Random
from typing import Any

Data = dict[str, Any]
Mutation = Callable[[Random, Data, dict[str, Data]], bool]

# What proves something, or is proven; origin and metadata are described elsewhere.
SECTIONS = ("problem", "theta", "multipliers", "claims")
HUGE = (1e308, -1e308, 1e30, 5e-324, 1e-300, -0.0, 0.0, 2**53 + 1, 10**25)


def walk(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Yield path and value of everything, what is outside first."""
    yield path, value
    if isinstance(value, (dict, list)):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from walk(item, (*path, key))


def inside(value: Any, *kinds: type) -> list[Any]:
    """Return everything of some types, what is outside first."""
    return [item for _, item in walk(value) if type(item) in kinds]


def at(data: Any, path: tuple[Any, ...]) -> Any:
    """Return what is at a path."""
    for key in path:
        data = data[key]
    return data


def number(rng: Random, data: Data, nonzero: bool = True) -> tuple[Any, Any, float] | None:
    """Return a random number: its container, its key, and its value. Every field is as likely."""
    fields = [(section, key) for section in SECTIONS for key in _keys(data.get(section))]
    rng.shuffle(fields)
    for section, key in fields:
        field = data[section] if key is None else data[section][key]
        found = [
            path
            for path, value in walk(field)
            if type(value) in (int, float) and (value or not nonzero)
        ]
        if found:
            path = (section, *(() if key is None else (key,)), *rng.choice(found))
            where = at(data, path[:-1])
            return where, path[-1], where[path[-1]]
    return None


def _keys(section: Any) -> list[Any]:
    return list(section) if isinstance(section, dict) else [] if section is None else [None]


def numeric(change: Callable[[Random, float], float]) -> Mutation:
    """Return a mutation that changes one number."""

    def apply(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
        found = number(rng, data)
        if found is None:
            return False
        where, key, value = found
        new = change(rng, value)
        if key == "links" or key == "link" or type(value) is int:
            new = round(new) if math.isfinite(new) and abs(new) < 1e6 else value + 1
        where[key] = new
        return bool(new != value)

    return apply


def digit(rng: Random, value: float) -> float:
    """Return a number with another digit."""
    text = repr(value)
    k = rng.choice([k for k, c in enumerate(text) if c.isdigit()])
    changed = text[:k] + rng.choice([c for c in "0123456789" if c != text[k]]) + text[k + 1 :]
    try:
        new = float(changed)
    except ValueError:
        return value
    return new if math.isfinite(new) else value


def last_digits(rng: Random, value: float) -> float:
    """Return a neighbor among the doubles, or one some steps further."""
    for _ in range(rng.choice([1, 1, 1, 3, 10])):
        value = math.nextafter(value, rng.choice([-math.inf, math.inf]))
    return value


def swap(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Swap two neighbors of a list: numbers, rows of a matrix, links."""
    found = number(rng, data, nonzero=False)
    if found is None:
        return False
    lists = [each for each in inside(data[rng.choice(SECTIONS)], list) if len(each) > 1]
    if not lists:
        return False
    chosen = rng.choice(lists)
    i, j = rng.sample(range(len(chosen)), 2)
    same = chosen[i] == chosen[j]
    chosen[i], chosen[j] = chosen[j], chosen[i]
    return not same


def extreme(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Put a number at the end of what doubles can be."""
    found = number(rng, data, nonzero=False)
    if found is None:
        return False
    where, key, _ = found
    where[key] = rng.choice(HUGE)
    return True


def odd_type(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Put something that is no number where a number belongs, or another empty thing."""
    found = number(rng, data, nonzero=False)
    if found is None:
        return False
    if rng.random() < 0.3:
        data["problem"][rng.choice(["rows", "cones", "prior_matrix"])] = rng.choice(["", {}, None])
    else:
        where, key, _ = found
        where[key] = rng.choice([True, "1", None, [], {}, [1.0]])
    return True


def odd_key(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Add a key that no format knows, somewhere."""
    rng.choice(inside(data, dict))["approved"] = rng.choice([True, "by all", {}])
    return True


EDITS: dict[str, Mutation] = {
    "digit": numeric(digit),
    "last digits": numeric(last_digits),
    "sign": numeric(lambda rng, value: -value),
    "scale": numeric(
        lambda rng, value: value * rng.choice([2.0, 0.5, 10.0, 1e-3, 1e6, 1.0 + 1e-9])
    ),
    "swap": swap,
    "extreme number": extreme,
    "odd type": odd_type,
    "odd key": odd_key,
}
