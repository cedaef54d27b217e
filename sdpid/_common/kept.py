"""Results that are kept as long as the object that they were computed of is in use."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TypeVar
from weakref import WeakKeyDictionary

K = TypeVar("K")
T = TypeVar("T")


def kept(function: Callable[[K], T]) -> Callable[[K], T]:
    """Return a function that computes its result once for each object."""
    found: WeakKeyDictionary[K, T] = WeakKeyDictionary()

    @functools.wraps(function)
    def call(of: K) -> T:
        if of not in found:
            found[of] = function(of)
        return found[of]

    return call
