"""Compute what comes next while the last result is used.

Rows are made by compiled loops and folded by matrix products, which let other threads run. Two
cores do both at once; results and their order are the same as on one, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def one_ahead(
    function: Callable[[T, int], R], items: Sequence[T], *, ahead: bool = True
) -> Iterator[R]:
    """Yield ``function(item, turn)`` in order, the next one computed meanwhile in a thread.

    Parameters
    ----------
    function : callable
        Of an item and of whose turn it is: 0 or 1 in turn, for memory of its own. What one turn
        left is no longer used when the next one but one begins.
    items : sequence
        The items.
    ahead : bool, optional
        Whether to use a thread.
    """
    if not ahead or len(items) < 2:
        for i, item in enumerate(items):
            yield function(item, i % 2)
        return
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(function, items[0], 0)
        for i, item in enumerate(items[1:], start=1):
            found = coming.result()
            # Only now: what the consumer had before this is used up, and its memory free.
            coming = pool.submit(function, item, i % 2)
            yield found
        yield coming.result()
