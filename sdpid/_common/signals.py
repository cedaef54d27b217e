"""Signals that end the program raise `SystemExit`, so that unfinished files are removed."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any

# Added to a signal's number for the exit status, by the shells' convention.
_SIGNALED = 128

# Signals that were to end this program.
_ending: list[int] = []


def end_by(number: int, _frame: object = None) -> None:
    """Handle a signal by ending the program."""
    _ending.append(number)
    raise SystemExit(_SIGNALED + number)


def end_if_signaled() -> None:
    """End the program if `end_by` was called: some imports swallow even what it raises."""
    if _ending:
        raise SystemExit(_SIGNALED + _ending[0])


@contextlib.contextmanager
def keyboard_interrupts() -> Iterator[None]:
    """Let SIGINT raise KeyboardInterrupt within the block, for work that ends well when stopped."""
    usual = signal.getsignal(signal.SIGINT)
    if usual is not end_by or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)


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


def clean_up_when_ended() -> None:
    """Let SIGINT, SIGTERM and SIGHUP raise `SystemExit`.

    SIGINT does so too: where a KeyboardInterrupt came amid the import of an extension module, the
    interpreter was now and then seen to end by the signal itself, with another exit status.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        # What the caller had ignored (nohup) stays so; Windows has no SIGHUP.
        number = getattr(signal, name, None)
        usual = (signal.SIG_DFL, signal.default_int_handler)
        if number is not None and signal.getsignal(number) in usual:
            signal.signal(number, end_by)
    usual_hook = sys.unraisablehook

    def hook(unraisable: Any) -> None:
        # SystemExit cannot leave a callback of the import system; `end_if_signaled` ends the
        # program then, and there is nothing to print.
        if not issubclass(unraisable.exc_type, SystemExit):
            usual_hook(unraisable)

    sys.unraisablehook = hook
