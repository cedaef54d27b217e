"""The folder that the files of a run are written into: whole, or not there."""

from __future__ import annotations

import contextlib
import json
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sdpid._common.files import (
    PathLike,
    hashed,
    read_regular,
    require_other_files,
    require_replaceable,
)
from sdpid._common.signals import end_if_signaled
from sdpid._common.tables import json_text
from sdpid.errors import DataError, ExportError


class Unwritten(str):
    """A note that says what a run does not write, and why."""

    __slots__ = ()


def _is(file: Path, written: object) -> bool:
    """Return whether a file is there with the digest of one that a run wrote."""
    return file.is_file() and hashed(file)["sha256"] == written


def _sealed(file: Path) -> dict[str, Any]:
    """Return the size and the SHA-256 of a file's content."""
    found = hashed(file)
    return {"bytes": found["size"], "sha256": found["sha256"]}


@contextlib.contextmanager
def _stage(folder: Path) -> Iterator[Path]:
    """Yield a hidden folder within one; both are made, and go again where nothing is in them."""
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    # Named before it is made, so that a signal at any time leaves none: TemporaryDirectory may.
    stage = folder / f".sdpid-{secrets.token_hex(8)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        stage.mkdir(mode=0o700)
        yield stage
    finally:
        shutil.rmtree(stage, ignore_errors=True)
        with contextlib.suppress(OSError):
            for each in made:
                each.rmdir()


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
        if config is not None and not _is(config, listed.get(self.config)):
            inputs = (*inputs, config)
        require_other_files("--out", (folder / name for name in self.names), inputs)
        known = {*listed, self.listing} if listed else set()
        guarded = {*self.names, self.listing} - known if self.careful else set()
        if writes_config and not _is(folder / self.config, listed.get(self.config)):
            guarded.add(self.config)
        for name in sorted(guarded):
            if (folder / name).exists():
                raise ExportError(
                    f"--out: would write over {folder / name}, which no run like this wrote; "
                    "choose another folder."
                )

    def write(
        self,
        folder: Path,
        fill: Callable[[Path], Mapping[str, object]],
        note: Callable[[str], None] = lambda _: None,
    ) -> tuple[Path, ...]:
        """Write the files of a run into a folder and return them.

        They are made in a hidden folder and then moved; the listing goes first and comes last, so
        a folder that has one is whole, whatever ended the program. Files that an earlier run listed
        and this one does not write are removed; `note` is called with a sentence about each that
        was changed since, which stays.

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
            with _stage(folder) as stage:
                content = fill(stage)
                names = [each for each in self.names if (stage / each).exists()]
                files = {name: _sealed(stage / name) for name in names}
                text = json_text(self.seal({**content, "files": files}))
                (stage / self.listing).write_text(text + "\n", encoding="utf-8")
                stale = self._stale(folder, names, note)
                end_if_signaled()
                # Without its listing the folder holds no results: it goes first, and comes last.
                (folder / self.listing).unlink(missing_ok=True)
                for name in stale:
                    (folder / name).unlink()
                names.append(self.listing)
                for name in names:
                    (stage / name).replace(folder / name)
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

    def _stale(self, folder: Path, new: Iterable[str], note: Callable[[str], None]) -> list[str]:
        """Return the unchanged files of an earlier run that this one does not replace."""
        stale = []
        for name, written in self.listed(folder).items():
            if name in new or not (folder / name).is_file():
                continue
            if _is(folder / name, written):
                stale.append(name)
            else:
                note(f"{name} of an earlier run was changed since and stays; this run writes none")
        return stale
