"""The progress bar of a search: by its steps, or by the time that it may take."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from sdpid._common.progress import progress


@contextmanager
def counted_steps(
    total: int, began: float, deadline: float, shown: bool | None
) -> Iterator[Callable[[], None]]:
    """Yield what to call after every step of a search, which moves a progress bar.

    Parameters
    ----------
    total : int
        Largest number of steps.
    began, deadline : float
        Times of `time.monotonic` between which the search runs; an infinite deadline for none.
        With one the bar shows the share of the time.
    shown : bool, optional
        Whether there is a bar; by default on a terminal.
    """
    timed = bool(np.isfinite(deadline))
    last = began
    length = deadline - began if timed else total
    with progress(length, "searching a motion", enabled=shown) as advance:

        def step() -> None:
            nonlocal last
            now = time.monotonic()
            advance(now - last if timed else 1.0)
            last = now

        yield step
