"""The manifest of a results folder: every file by its SHA-256, and what the run was given."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .reading import (
    MalformedError,
    digest,
    index,
    items,
    listed,
    parse,
    require_keys,
    require_schema,
    shown,
    text,
)
from .result import Result

NAME = "manifest.json"
SCHEMA, VERSION = "sdpid-manifest", 1
KEYS = ("schema", "version", "metadata", "inputs", "recipe", "certificate", "files", "sha256")
_ROLES = ("log", "validation", "robot", "gains", "config")
_SHA256 = re.compile("[0-9a-f]{64}")

# The files of a run have less bytes together. Hashing a GiB takes some seconds.
_MOST = 2**29

# Bytes hashed at a time.
_BLOCK = 1 << 20


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return a manifest with its digest."""
    return {**content, "sha256": digest(dict(content))}


def load(content: bytes) -> dict[str, Any]:
    """Parse a manifest; MalformedError where it is none of this version."""
    data = parse(content)
    require_schema(data, SCHEMA, VERSION)
    require_keys(data, KEYS, "the manifest")
    require_keys(data["metadata"], ("software",), "metadata")
    text(data["metadata"]["software"], "software")
    _hexadecimal(data["certificate"], "certificate")
    _hexadecimal(data["sha256"], "sha256")
    if data["recipe"] is not None and type(data["recipe"]) is not dict:
        raise MalformedError("recipe is no object")
    for entry in items(data["inputs"], "inputs"):
        require_keys(entry, ("role", "name", "bytes", "sha256"), "an input")
        if entry["role"] not in _ROLES:
            raise MalformedError("an input has a role that is not known")
        for key, kind in (("name", str), ("bytes", int)):
            if entry[key] is not None and type(entry[key]) is not kind:
                raise MalformedError(f"{key} of an input is neither null nor {kind.__name__}")
        _hexadecimal(entry["sha256"], "sha256 of an input")
    if type(data["files"]) is not dict:
        raise MalformedError("files is no object")
    for name, entry in data["files"].items():
        if not name or name.startswith(".") or {*name} & {*"/\\\0"} or name == NAME:
            raise MalformedError(f"{shown(name)} is no name of a file of a run")
        require_keys(entry, ("bytes", "sha256"), shown(name))
        index(entry["bytes"], _MOST)
        _hexadecimal(entry["sha256"], f"sha256 of {shown(name)}")
    if (size := sum(entry["bytes"] for entry in data["files"].values())) >= _MOST:
        raise MalformedError(f"its files have {size} bytes, and less than {_MOST} are hashed")
    return data


def _hexadecimal(value: Any, where: str) -> None:
    if not _SHA256.fullmatch(text(value, where)):
        raise MalformedError(f"{where} is no SHA-256")


def check(folder: Path, data: Mapping[str, Any]) -> Result:
    """Check that a folder holds the files of its manifest, each with its bytes, and no others."""
    problems, unchecked = [], []
    if digest(dict(data)) != data["sha256"]:
        problems.append(f"{NAME}: its digest is another: something in it was changed")
    for name, entry in data["files"].items():
        path = folder / name
        if not path.is_file():
            problems.append(f"{shown(name)} is missing, or no regular file")
        elif (size := path.stat().st_size) != entry["bytes"]:
            # Not read: it may have no end.
            problems.append(
                f"{shown(name)} was changed: it has {size} bytes, sealed are {entry['bytes']}"
            )
        elif (found := _sha256(path)) != entry["sha256"]:
            problems.append(
                f"{shown(name)} was changed: its SHA-256 is {found}, sealed is {entry['sha256']}"
            )
    others = sorted({path.name for path in folder.iterdir()} - {NAME, *data["files"]})
    if others:
        unchecked.append(f"{listed(map(shown, others))}: not of this run")
    said = f"All {len(data['files'])} files have the SHA-256 that {NAME} lists."
    return Result(() if problems else (said,), tuple(problems), tuple(unchecked))


def _sha256(path: Path) -> str:
    found = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            found.update(block)
    return found.hexdigest()


def given(data: Mapping[str, Any]) -> tuple[str, ...]:
    """Return what the run was given, which is not in the folder, in words."""
    said = []
    for entry in data["inputs"]:
        what = "in memory" if entry["name"] is None else shown(entry["name"])
        said.append(f"the {entry['role']} {what}, SHA-256 {entry['sha256']}: it is not here")
    return tuple(said) or ("what the run was given: the manifest does not say",)
