"""Several files that appear together in a folder, or not at all."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import secrets
import shutil
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from sdpid._common.files import atomic_path
from sdpid._common.signals import end_if_signaled
from sdpid.errors import ExportError

# Beginning of the names of hidden folders in which files are prepared.
_STAGE = ".sdpid-"

# Seconds to wait for another process that writes into the same folder.
_PATIENCE = 60.0


@contextlib.contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """Yield an empty hidden folder within `folder`; both are made where they do not exist.

    In the end it is removed, and so are folders that were made for it and hold nothing. While the
    folder is locked, every other hidden folder in it was left by a process that was killed, and is
    removed too.

    Raises
    ------
    ExportError
        When another process keeps the folder locked.
    """
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    name = f"{_STAGE}{secrets.token_hex(6)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _locked(folder) as alone:
            pattern = f"{_STAGE}*" if alone else name
            try:
                _remove(folder, pattern)
                (folder / name).mkdir()
                yield folder / name
            finally:
                try:
                    _remove(folder, pattern)
                finally:
                    _remove(folder, name)  # a signal may have come in the midst of the first
    finally:
        with contextlib.suppress(OSError):
            for each in made:
                each.rmdir()


def _remove(folder: Path, pattern: str) -> None:
    for path in folder.glob(pattern):
        shutil.rmtree(path, ignore_errors=True)


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    """Let one process at a time write into a folder; yield False where it cannot be locked.

    The lock is one of the operating system: it ends with the process, however that ends.
    """
    try:
        import fcntl

        handle = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):  # no POSIX
        yield False
        return
    try:
        end = time.monotonic() + _PATIENCE
        locked = False
        while not locked:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                locked = True
            except BlockingIOError:
                if time.monotonic() > end:
                    raise ExportError(
                        f"cannot write into {folder}: another run has been writing into it for "
                        f"more than {_PATIENCE:g} s; choose another folder."
                    ) from None
                time.sleep(0.05)
            except OSError:  # a file system without locks
                break
        yield locked
    finally:
        os.close(handle)


def digest(file: Path) -> str:
    """Return the SHA-256 of a file's content in hexadecimal digits."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def exchange(stage: Path, folder: Path, new: Sequence[str], stale: Sequence[str]) -> None:
    """Move files from a stage into a folder and remove others from it: all, or nothing.

    Whatever interrupts it, also a signal, the files that were there before are put back. Symbolic
    links stay, and the files that they point to are replaced.

    Parameters
    ----------
    stage : Path
        Folder with the new files, on the same disk.
    folder : Path
        Where they go.
    new : sequence of str
        Names of the files to move.
    stale : sequence of str
        Names of the files to remove.
    """
    end_if_signaled()
    kept = stage / "replaced"
    kept.mkdir()
    targets = {name: Path(os.path.realpath(folder / name)) for name in (*new, *stale)}
    for name, target in targets.items():
        if target.exists():
            shutil.copy2(target, kept / name)
    try:
        for name in new:
            _move(stage / name, targets[name])
        for name in stale:
            (folder / name).unlink()
    except BaseException:
        for name, target in targets.items():
            with contextlib.suppress(OSError):
                if (kept / name).exists():
                    _move(kept / name, target)
                elif not (stage / name).exists():
                    target.unlink(missing_ok=True)
        raise


def _move(source: Path, target: Path) -> None:
    """Move a file over another, which may lie on another disk."""
    try:
        source.replace(target)
    except OSError as cause:
        if cause.errno != errno.EXDEV:
            raise
        with atomic_path(target) as temporary:
            shutil.copyfile(source, temporary)
        source.unlink()
