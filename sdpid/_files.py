"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
import signal
import tempfile
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path

from sdpid.errors import ExportError


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path` that replaces it when the block ends without error.

    Raises
    ------
    ExportError
        When the folder does not exist or cannot be written to.
    """
    target = Path(path)
    try:
        handle, name = tempfile.mkstemp(
            prefix=f".{target.stem}.", suffix=target.suffix, dir=target.parent
        )
    except OSError as cause:
        raise ExportError(
            f"cannot write {target}: {cause.strerror}; choose another folder."
        ) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes private files; the result should have the permissions of any new file.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


# Of a program that a signal ended, by the shells' convention.
_SIGNALLED = 128

# Signals that were to end this program.
_ending: list[int] = []


def end_by(number: int, _frame: object = None) -> None:
    """Handle a signal by ending the program, so that unfinished files are removed on the way."""
    _ending.append(number)
    raise SystemExit(_SIGNALLED + number)


def end_if_told() -> None:
    """End the program if `end_by` was called: some imports swallow even what it raises."""
    if _ending:
        raise SystemExit(_SIGNALLED + _ending[0])


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Hold back signals that end a program until the block is over: it must take a moment only."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are handled in the main thread
        return
    caught: list[int] = []
    names = ("SIGINT", "SIGTERM", "SIGHUP")
    before = {}
    try:
        for number in (getattr(signal, name) for name in names if hasattr(signal, name)):
            if (handler := signal.getsignal(number)) is not None:
                before[number] = handler
                signal.signal(number, lambda got, _: caught.append(got))
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for got in caught:
            signal.raise_signal(got)


def move_into(folder: Path, files: Iterable[Path]) -> None:
    """Move finished files into a folder of the same disk; no signal comes between them.

    Nothing is moved once a signal was to end the program.
    """
    with undisturbed():
        end_if_told()
        for file in files:
            file.replace(folder / file.name)


def atomic_write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write `text` to `path` in UTF-8, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
