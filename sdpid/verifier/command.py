"""The command: check one file or folder, and say what is proven of it."""

from __future__ import annotations

import hashlib
import io
import sys
from pathlib import Path
from typing import Any

from . import certificate, folder, manifest, tables
from .reading import REFUSED, MalformedError, parse, read_bytes, shown
from .result import Result

# By schema: how a file is read and checked, and the numbers that it claims.
CHECKS = {
    certificate.SCHEMA: (certificate.load, certificate.check, certificate.claimed),
    **dict.fromkeys(tables.SCHEMAS, (tables.load, tables.check, lambda _: {})),
}


# A result, the file's SHA-256 or the manifest's digest, and what is claimed.
Checked = tuple[Result, str, dict[str, float | None]]


def check_path(path: Any) -> Checked:
    """Check a results folder, or one file; OSError or one of REFUSED where it is no proof."""
    return folder.check(path) if Path(path).is_dir() else check_file(path)


def check_file(path: Any) -> Checked:
    """Check one file of any schema; OSError or one of REFUSED where it is no proof."""
    content = read_bytes(path)
    schema = parse(content).get("schema")
    if type(schema) is not str or schema not in CHECKS:
        part = (Path(path).parent / manifest.NAME).is_file()
        advice = "; it is part of a results folder: give the folder" if part else ""
        raise MalformedError(f"its schema is none of {', '.join(CHECKS)}{advice}")
    load, check, claims = CHECKS[schema]
    data, sha256 = load(content), hashlib.sha256(content).hexdigest()
    result = Result((f"File {shown(str(path))}, SHA-256 {sha256}.",)) + check(data)
    return result, sha256, claims(data)


def main(arguments: list[str]) -> int:
    """Check a path: status 0 where all is proven, 1 where not, 2 where there is no proof."""
    for stream in (sys.stdout, sys.stderr):
        # Names may have letters that a terminal's encoding lacks.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    if len(arguments) != 1:
        print("usage: python verifier FILE_OR_FOLDER", file=sys.stderr)
        return 2
    try:
        result = check_path(arguments[0])[0]
    except OSError as cause:
        print(f"{shown(arguments[0])}: cannot be read: {cause.strerror}", file=sys.stderr)
        return 2
    except REFUSED as cause:
        print(f"{shown(arguments[0])}: not a proof: {cause}", file=sys.stderr)
        return 2
    print("\n".join(result.lines))
    return 0 if result.passed else 1
