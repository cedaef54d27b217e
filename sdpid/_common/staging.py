"""Several files that appear together in a folder, or not at all."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import secrets
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sdpid._common.files import (
    PathLike,
    atomic_path,
    hashed,
    read_regular,
    require_other_files,
    require_replaceable,
)
from sdpid._common.signals import end_if_signaled
from sdpid._common.tables import json_text
from sdpid.errors import DataError, ExportError

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
    return str(hashed(file)["sha256"])


def _sealed(file: Path) -> dict[str, Any]:
    """Return the size and the SHA-256 of a file's content."""
    found = hashed(file)
    return {"bytes": found["size"], "sha256": found["sha256"]}


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


@dataclass(frozen=True)
class RunFolder:
    """What a kind of run writes into a folder.

    Attributes
    ----------
    names : tuple of str
        Every file that a run may write.
    listing : str
        The JSON file that is written last and holds sizes and digests of the others.
    config : str
        The options of the run. It replaces only one that an earlier run wrote: people have files
        of that name.
    careful : bool
        Whether that holds for every file: no run replaces one that no earlier run listed.
    seal : callable
        Returns the content of the listing from that without a digest of its own.
    """

    names: tuple[str, ...]
    listing: str
    config: str
    careful: bool = False
    seal: Callable[[dict[str, Any]], dict[str, Any]] = dict

    def require_writable(
        self,
        folder: Path,
        inputs: Iterable[PathLike | None] = (),
        *,
        config: Path | None = None,
        writes_config: bool = False,
    ) -> None:
        """Refuse a folder that files cannot be written into, before the work is done.

        Parameters
        ----------
        folder : Path
            Need not exist yet.
        inputs : iterable of path
            Files that the run reads: its own must not replace them.
        config : Path, optional
            The file that the options of the run were read from, if any.
        writes_config : bool, optional
            Whether the file of options is among those written.

        Raises
        ------
        ExportError
            When the folder is a file, one of the files is a folder or no regular file, or would
            replace an input, or options that no run wrote.
        """
        if folder.exists() and not folder.is_dir():
            raise ExportError(f"cannot write into {folder}: it is a file; name a folder.")
        for name in self.names:
            require_replaceable(folder / name)
        listed = self.listed(folder)
        if self.careful:
            for name in (*self.names, self.listing):
                ours = name in listed or (name == self.listing and bool(listed))
                if (folder / name).exists() and not ours:
                    raise ExportError(
                        f"--out: would write over {folder / name}, which no run like this wrote; "
                        "choose another folder."
                    )
        written = listed.get(self.config)
        if config is not None and config.is_file() and written != digest(config):
            inputs = (*inputs, config)
        require_other_files("--out", (folder / name for name in self.names), inputs)
        existing = folder / self.config
        if writes_config and existing.is_file() and written != digest(existing):
            raise ExportError(
                f"--out: would write over {existing}, which no run wrote; choose another folder."
            )

    def write(
        self,
        folder: Path,
        fill: Callable[[Path], Mapping[str, object]],
        note: Callable[[str], None] = lambda _: None,
    ) -> tuple[Path, ...]:
        """Write the files of a run into a folder, all or nothing, and return them.

        Files that an earlier run listed and this one does not write are removed; `note` is called
        with a sentence about each that was changed since, which stays.

        Parameters
        ----------
        folder : Path
            Made where it does not exist.
        fill : callable
            Writes files of these names into an empty folder, and returns what the listing holds
            beside them.
        note : callable, optional
            Called with sentences.

        Raises
        ------
        ExportError
            When the folder cannot be written to.
        """
        try:
            with staged(folder) as stage:
                content = fill(stage)
                names = [each for each in self.names if (stage / each).exists()]
                files = {name: _sealed(stage / name) for name in names}
                listing = json_text(self.seal({**content, "files": files}))
                (stage / self.listing).write_text(listing + "\n", encoding="utf-8")
                names.append(self.listing)
                exchange(stage, folder, names, self._stale(folder, names, note))
        except OSError as cause:
            raise ExportError(
                f"cannot write into {folder}: {cause.strerror or cause}; choose another folder."
            ) from cause
        return tuple(folder / name for name in names)

    def listed(self, folder: Path) -> dict[str, object]:
        """Return the digests of the files that an earlier run wrote, by name."""
        try:
            listed = json.loads(read_regular(folder / self.listing))["files"]
            return {name: listed[name]["sha256"] for name in self.names if name in listed}
        except (DataError, ValueError, LookupError, TypeError, RecursionError):
            return {}  # no earlier run, or a file that none wrote

    def _stale(self, folder: Path, new: Sequence[str], note: Callable[[str], None]) -> list[str]:
        """Return the unchanged files of an earlier run that this one does not replace."""
        stale = []
        for name, written in self.listed(folder).items():
            if name in new or not (folder / name).is_file():
                continue
            if digest(folder / name) == written:
                stale.append(name)
            else:
                note(f"{name} of an earlier run was changed since and stays; this run writes none")
        return stale
