"""Catch what libraries print on standard error, to put it into error messages."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import threading
from collections.abc import Iterator

# A process has one standard error: one thread at a time may hold it.
_LOCK = threading.Lock()

# Longest message, bytes.
_LONGEST = 2000

_STDERR = 2


class Caught:
    """Text that was printed on standard error.

    Attributes
    ----------
    text : str
        In one line, cut where it is very long; empty until the block that catches it is over.
    """

    text: str = ""


@contextlib.contextmanager
def caught_stderr() -> Iterator[Caught]:
    """Catch what a block prints on file descriptor 2, from Python or from C.

    What was printed is in `text` when the block ends by an error; otherwise it is passed on to
    standard error as it is, since something of another thread may be in it. Where there is no
    standard error, nothing is caught.

    Yields
    ------
    Caught
    """
    caught = Caught()
    with _LOCK, contextlib.ExitStack() as stack:
        try:
            if sys.stderr is not None:
                sys.stderr.flush()
            kept = os.dup(_STDERR)
            stack.callback(os.close, kept)
            file = stack.enter_context(tempfile.TemporaryFile())
        except (OSError, ValueError):
            yield caught
            return
        failed = True
        try:
            os.dup2(file.fileno(), _STDERR)
            yield caught
            failed = False
        finally:
            os.dup2(kept, _STDERR)
            file.seek(0)
            raw = file.read()
            if failed:
                text = raw[: _LONGEST + 1].decode("utf-8", errors="replace")
                caught.text = " ".join(text[:_LONGEST].split()) + " ..." * (len(text) > _LONGEST)
            elif raw:
                with contextlib.suppress(OSError):
                    os.write(_STDERR, raw)
