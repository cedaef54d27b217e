"""Check a results folder: its seal, and its proof.

A digest finds what was changed after the manifest was written; whoever writes a manifest anew can
make one for any files. What the other files hold is compared by the package, which writes them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from . import certificate, manifest
from .reading import MalformedError, listed, read_bytes, shown
from .result import Result

CERTIFICATE = "certificate.json"

# Of the files that are sealed and are no proof.
ELSEWHERE = "sealed, and compared with nothing here"


def check(path: Any) -> tuple[Result, str, dict[str, float | None]]:
    """Check a folder that `sdpid identify` wrote, with nothing but what lies in it.

    Returns
    -------
    Result
        Every sentence names the file that it is of.
    str
        The manifest's digest.
    dict
        What the certificate claims.

    Raises
    ------
    OSError, or one of REFUSED
        When manifest or certificate are missing or make no sense.
    """
    folder, name = Path(path), CERTIFICATE
    if not (folder / manifest.NAME).is_file():
        raise MalformedError(f"it has no {manifest.NAME}: no results of this version")
    sealed = manifest.load(read_bytes(folder / manifest.NAME))
    if name not in sealed["files"]:
        raise MalformedError(f"its {manifest.NAME} lists no {name}")
    data = certificate.load(read_bytes(folder / name))
    checked = certificate.check(data)
    result = manifest.check(folder, sealed) + Result(
        *(tuple(f"{name}: {each}" for each in getattr(checked, kind)) for kind in Result.KINDS)
    )
    if sealed["certificate"] != data["sha256"]:
        problem = f"{manifest.NAME}: sealed with certificate {sealed['certificate']}, not this one"
        result += Result(problems=(problem,))
    others = sorted(sealed["files"].keys() - {name})
    unchecked = (
        *manifest.given(sealed),
        f"{listed(map(shown, others))}: {ELSEWHERE}",
        f"that {manifest.NAME} is the one that the run wrote: compare its digest "
        f"{sealed['sha256']} with one from whom you trust; a digest is no signature",
    )
    result += Result(unchecked=unchecked)
    return result, sealed["sha256"], certificate.claimed(data)
