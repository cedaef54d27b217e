"""Results that are kept as long as the object that they were computed of is in use."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast
from weakref import WeakKeyDictionary

K = TypeVar("K")
T = TypeVar("T")
M = TypeVar("M", bound=Callable[..., Any])


def kept(function: Callable[[K], T]) -> Callable[[K], T]:
    """Return a function that computes its result once for each object."""
    found: WeakKeyDictionary[K, T] = WeakKeyDictionary()

    @functools.wraps(function)
    def call(of: K) -> T:
        if of not in found:
            found[of] = function(of)
        return found[of]

    return call


def last_kept(method: M) -> M:
    """Return a method of arrays that remembers what it returned last, for each object.

    For functions of a point whose values and derivatives are asked for one after the other.
    """
    found: WeakKeyDictionary[Any, tuple[list[bytes], Any]] = WeakKeyDictionary()

    @functools.wraps(method)
    def call(of: Any, *arrays: Any) -> Any:
        key = [each.tobytes() for each in arrays]
        if of not in found or found[of][0] != key:
            found[of] = key, method(of, *arrays)
        return found[of][1]

    return cast(M, call)
