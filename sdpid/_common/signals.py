"""Signals: those that end the program let it clean up, and interrupts are noted."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from typing import Any

# Added to a signal's number for the exit status, by the shells' convention.
_SIGNALED = 128

# Signals that were to end this program.
_ending: list[int] = []


class Interrupts:
    """Whether an interrupt came.

    Attributes
    ----------
    came : bool
        True from the first on.
    """

    def __init__(self) -> None:
        self.came = False

    def note(self, number: int, frame: Any) -> None:
        """Handle SIGINT: note the first, and let others raise."""
        if self.came:
            signal.default_int_handler(number, frame)
        self.came = True


@contextlib.contextmanager
def noted_interrupts(noted: Interrupts) -> Iterator[None]:
    """Note SIGINT within the block where it would raise KeyboardInterrupt.

    For libraries that take an exception of a function they call for a failure of that function,
    and go on.
    """
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, noted.note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(number: int, _frame: object) -> None:
    """Handle a signal by ending the program."""
    _ending.append(number)
    end_if_signaled()


def end_if_signaled() -> None:
    """End the program if a signal was to end it: some imports swallow what its handler raises."""
    if _ending:
        raise SystemExit(_SIGNALED + _ending[0])


def clean_up_when_ended() -> None:
    """Let SIGTERM and SIGHUP raise `SystemExit`, so that unfinished files are removed."""
    for name in ("SIGTERM", "SIGHUP"):
        # What the caller had ignored (nohup) stays so; Windows has no SIGHUP.
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _end)
