"""A progress bar for long work, drawn on standard error and only on a terminal."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from contextvars import ContextVar

# Whether a bar is shown, or must not be.
_shown: ContextVar[bool] = ContextVar("_shown", default=False)


@contextlib.contextmanager
def hidden_progress(hidden: bool = True) -> Iterator[None]:
    """Show no bar within the block, as long as `hidden` is true."""
    token = _shown.set(hidden or _shown.get())
    try:
        yield
    finally:
        _shown.reset(token)


@contextlib.contextmanager
def progress(
    total: float, description: str, *, enabled: bool | None = None
) -> Iterator[Callable[[float], None]]:
    """Yield a function that advances a bar by a number of units of work.

    One bar is shown at a time: while there is one, those of the work within it are not.

    Parameters
    ----------
    total : float
        Units of work in all.
    description : str
        Text beside the bar.
    enabled : bool, optional
        Show it or not; by default only when standard error is a terminal that can draw it.
    """
    if enabled is None:
        enabled = _can_draw()
    if not enabled or _shown.get():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=total)
        token = _shown.set(True)
        try:
            yield lambda step: bar.advance(task, step)
        finally:
            _shown.reset(token)


def _can_draw() -> bool:
    """Return whether standard error is a terminal that takes back what was written.

    The cells of a notebook (``!sdpid ...``) give commands a terminal, and print every step of a
    bar below the last.
    """
    if sys.stderr is None or not sys.stderr.isatty():  # None: it is closed
        return False
    return os.environ.get("TERM") != "dumb" and "JPY_PARENT_PID" not in os.environ
