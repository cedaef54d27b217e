"""Files: written whole or not at all; known, when they were read, by their SHA-256; their text."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import sys
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from sdpid.errors import DataError, ExportError, SdpidError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PathLike: TypeAlias = "str | os.PathLike[str]"

# Tables, settings and parameters have less: those of a hundred links some 300 kB.
MAX_BYTES = 32 * 2**20

# Bytes hashed at a time.
_BLOCK = 1 << 20


def is_irregular(path: PathLike) -> bool:
    """Return whether a path is there and no regular file: a folder, or what may never end."""
    # os.path's, because they do not raise for a name that is too long to be one.
    return os.path.exists(path) and not os.path.isfile(path)  # noqa: PTH110, PTH113


def read_regular(
    path: PathLike, most: int = MAX_BYTES, error: type[SdpidError] = DataError
) -> bytes:
    """Return what is in a regular file; a device may never end, and a pipe never begin.

    Raises
    ------
    SdpidError
        When it is no regular file, cannot be read, or has more than `most` bytes.
    """
    if is_irregular(path):
        raise error(f"cannot read {path}: it is no regular file.")
    try:
        with Path(path).open("rb") as file:
            content = file.read(most + 1)
    except (OSError, ValueError) as cause:
        raise error(f"cannot read {path}: {getattr(cause, 'strerror', None) or cause}.") from None
    if len(content) > most:
        raise error(f"{path}: has more than {most} bytes, which are read at most.")
    return content


def require_replaceable(path: PathLike) -> Path:
    """Return the file that a path leads to, which need not exist.

    Raises
    ------
    ExportError
        When no file can take its place: of a folder, or a device.
    """
    target = Path(os.path.realpath(path))
    if is_irregular(target):
        what = "a folder" if target.is_dir() else "no regular file"
        raise ExportError(
            f"cannot write {path}: it is {what}; move it away, or choose another name."
        )
    return target


def load_toml(path: PathLike, error: type[SdpidError] = DataError) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    SdpidError
        When the file cannot be read or is not TOML.
    """
    content = read_regular(path, error=error)
    try:
        return dict(tomllib.loads(content.decode("utf-8")))
    except (ValueError, RecursionError) as cause:  # wrong, of endless digits, or nested endlessly
        raise error(f"{path}: not a TOML file ({cause}).") from None


def require_known(
    given: Iterable[object], known: Iterable[str], where: str, wrong: str = "is not known"
) -> None:
    """Raise DataError where given names are not among known ones; `where` begins the message."""
    known = tuple(known)
    if unknown := sorted({f"{name!s:.80}" for name in given if name not in known}):
        raise DataError(f"{where}: {', '.join(unknown)} {wrong}; known are {', '.join(known)}.")


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path` that replaces it when the block ends without error.

    A symbolic link stays; the file that it points to is replaced.

    Raises
    ------
    ExportError
        When `path` is a folder or a device, its folder does not exist, or writing fails.
    """
    target = require_replaceable(path)
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


@dataclass(frozen=True, kw_only=True)
class Source:
    """A file that was read.

    Attributes
    ----------
    name : str
        The file's name without its folder, or the name in a catalog that stands for it.
    size : int
        Bytes.
    sha256 : str
        Of the bytes; of a folder that of the SHA-256 and name of every file in it (see `of`).
    options : mapping
        How it was read: the arguments that read the same again, as plain values.
    """

    name: str
    size: int
    sha256: str
    options: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, path: str | os.PathLike[str], options: Mapping[str, Any] | None = None) -> Source:
        """Hash a file or a folder, whose files count in the order of their names.

        A folder's digest is that of lines ``<SHA-256>  <relative path>``, as `sha256sum` prints.

        Raises
        ------
        OSError
            When it cannot be read.
        """
        whole = Path(path)
        if not whole.is_dir():
            return cls(name=whole.name, **hashed(whole), options=options or {})
        files = sorted(file.relative_to(whole).as_posix() for file in _files(whole))
        found = [(name, hashed(whole / name)) for name in files]
        lines = "".join(f"{each['sha256']}  {name}\n" for name, each in found)
        digest = hashlib.sha256(lines.encode("utf-8", "surrogateescape")).hexdigest()
        size = sum(each["size"] for _, each in found)
        return cls(name=whole.name, size=size, sha256=digest, options=options or {})

    @classmethod
    def of_bytes(cls, data: bytes, name: str, options: Mapping[str, Any] | None = None) -> Source:
        """Hash what was read from a file of this name."""
        digest = hashlib.sha256(data).hexdigest()
        return cls(name=name, size=len(data), sha256=digest, options=options or {})


@contextlib.contextmanager
def unchanged(path: Path) -> Iterator[None]:
    """Refuse a file, or a folder's files, that change while the block reads them.

    Raises
    ------
    DataError
        When one did: what was read may be neither the old nor the new content.
    """
    before = _states(path)
    yield
    if _states(path) != before:
        raise DataError(f"{path}: changed while it was read; wait until it is written, and retry.")


def _states(path: Path) -> list[tuple[str, int, int]]:
    """Return name, size and time of the last change of a file, or of a folder's files."""
    files = _files(path) if path.is_dir() else iter([path])
    return sorted((str(f), (s := f.stat()).st_size, s.st_mtime_ns) for f in files if f.exists())


def _files(folder: Path) -> Iterator[Path]:
    return (path for path in folder.rglob("*") if path.is_file())


def hashed(path: Path) -> dict[str, Any]:
    """Return the ``size`` of a file in bytes and its ``sha256`` in hexadecimal digits."""
    digest, size = hashlib.sha256(), 0
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
            size += len(block)
    return {"size": size, "sha256": digest.hexdigest()}


# Characters that a terminal obeys instead of showing: controls (escape sequences begin with one),
# format characters (they reverse the order of a line, or have no width), line and paragraph
# separators, and halves of surrogate pairs.
_OBEYED = frozenset({"Cc", "Cf", "Zl", "Zp", "Cs"})

_REPLACEMENT = "\ufffd"


def printable(text: str, *, keep: str = "") -> str:
    """Return text with every character that a terminal would obey replaced by U+FFFD.

    Parameters
    ----------
    text : str
        The text to print.
    keep : str, optional
        Characters that stay, such as line ends in text of several lines.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        c if c in keep or unicodedata.category(c) not in _OBEYED else _REPLACEMENT for c in text
    )
