"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TypeAlias

from sdpid.errors import ExportError

PathLike: TypeAlias = "str | os.PathLike[str]"


def is_irregular(path: PathLike) -> bool:
    """Return whether a path is there and no regular file: a folder, or what may never end."""
    # os.path's, because they do not raise for a name that is too long to be one.
    return os.path.exists(path) and not os.path.isfile(path)  # noqa: PTH110, PTH113


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path` that replaces it when the block ends without error.

    A symbolic link stays; the file that it points to is replaced.

    Raises
    ------
    ExportError
        When `path` is a folder, a device or a link to itself, its folder does not exist, or
        writing fails.
    """
    target = Path(os.path.realpath(path))
    if target.is_symlink():  # what is left of a circle
        raise ExportError(
            f"cannot write {path}: it is a symbolic link that leads back to itself; remove it, or "
            "choose another name."
        )
    if target.exists() and not target.is_file():
        what = "a folder" if target.is_dir() else "no regular file"
        raise ExportError(f"cannot write {path}: it is {what}; choose another name.")
    temporary = target.with_name(f".{target.stem[:40]}.{secrets.token_hex(6)}{target.suffix}")
    try:
        # Created with the permissions of any new file: the umask of the process is applied.
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield temporary
        temporary.replace(target)
    except OSError as cause:
        raise ExportError(
            f"cannot write {path}: {cause.strerror or cause}; choose another folder."
        ) from cause
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def atomic_write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write `text` to `path` in UTF-8, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def require_other_files(
    option: str, outputs: Iterable[PathLike], inputs: Iterable[PathLike | None]
) -> None:
    """Refuse to write over a file that is read.

    Parameters
    ----------
    option : str
        What names the outputs, for the message.
    outputs : iterable of path
        Files that will be written.
    inputs : iterable of path
        Files that are read; None, and names of what is no file, are passed over.

    Raises
    ------
    ExportError
        When an output is one of the inputs, also by another name of the same file.
    """
    existing = [Path(file) for file in outputs if Path(file).is_file()]
    for file in (Path(file) for file in inputs if file is not None):
        # os.path's, because it is not a file either whose name is too long to be one.
        if os.path.isfile(file) and any(map(file.samefile, existing)):  # noqa: PTH113
            raise ExportError(
                f"{option}: would write over {file}, which this run reads; choose another name."
            )
