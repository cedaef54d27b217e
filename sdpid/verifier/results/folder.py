"""Check a results folder: its seal, its proof, and that all its files hold the numbers proven.

A digest finds what was changed after the manifest was written; whoever writes a manifest anew can
make one for any files. So every number that follows from the certificate is compared with it too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from .. import certificate
from ..reading import REFUSED, MalformedError, read_bytes, shown
from ..result import Result
from . import friction_code, manifest
from .parameters import Certified, check_parameters, check_result, check_table, exports

CERTIFICATE, RESULT = "certificate.json", "result.json"
URDF, MJCF = "identified.urdf", "identified.xml"

# What the package reads, and this checker does not.
ROBOTS = (URDF, MJCF, *friction_code.NAMES)
ELSEWHERE = "sealed; 'sdpid verify' of the whole package compares what they hold"


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
    checked, proof = certificate.examine(data)
    result = manifest.check(folder, sealed) + _named([(name, checked)])
    if sealed["certificate"] != data["sha256"]:
        problem = f"{manifest.NAME}: sealed with certificate {sealed['certificate']}, not this one"
        result += Result(problems=(problem,))
    certified = Certified.of(data, proof)
    result += _named(list(_files(folder, sealed, certified, checked.passed)))
    result += Result(unchecked=(*manifest.given(sealed), *_only_sealed(sealed)))
    return result, sealed["sha256"], certificate.claimed(data)


def _named(found: Sequence[tuple[str, Result]]) -> Result:
    """Return sentences with the names of the files that they are of; one for files alike."""

    def merged(kind: str) -> tuple[str, ...]:
        files: dict[str, dict[str, None]] = {}
        for name, result in found:
            for sentence in getattr(result, kind):
                files.setdefault(sentence, {})[name] = None
        return tuple(f"{', '.join(names)}: {said}" for said, names in files.items())

    return Result(merged("statements"), merged("problems"), merged("unchecked"))


def _checks(certified: Certified, holds: bool) -> dict[str, Callable[[bytes], Result]]:
    """Return the check of every file that repeats numbers of the certificate."""
    return {
        RESULT: lambda content: check_result(content, certified, holds),
        "parameters.json": lambda content: check_parameters(content, certified),
        "parameters.csv": lambda content: check_table(content, certified.theta),
        "base_parameters.csv": lambda content: check_table(content, certified.base),
    }


def _files(
    folder: Path, sealed: Mapping[str, Any], certified: Certified, holds: bool
) -> Iterator[tuple[str, Result]]:
    """Yield what was found in each file that repeats numbers of the certificate."""
    try:
        written = exports(read_bytes(folder / RESULT))
    except (OSError, *REFUSED) as cause:
        written = []
        yield RESULT, Result(problems=(f"the robots it names cannot be read: {_reason(cause)}",))
    checks = _checks(certified, holds)
    for name in (*checks, *ROBOTS):
        if name not in sealed["files"]:
            if name in (*checks, *written) or (folder / name).exists():
                yield name, Result(problems=("it is a result, and not sealed",))
        elif name in (URDF, MJCF) and name not in written:
            yield name, Result(problems=(f"{RESULT} does not name it among what was written",))
        elif name in checks:
            try:
                yield name, checks[name](read_bytes(folder / name))
            except (OSError, *REFUSED) as cause:
                yield name, Result(problems=(f"cannot be read: {_reason(cause)}",))


def _reason(cause: BaseException) -> str:
    """Return why something cannot be read; what is no message of ours is shown as a name."""
    if isinstance(cause, MalformedError):
        return str(cause)
    return f"{type(cause).__name__} {shown(str(cause))}"


def _only_sealed(sealed: Mapping[str, Any]) -> tuple[str, ...]:
    """Return what nothing but its digest speaks for."""
    compared = {CERTIFICATE, RESULT, "parameters.json", "parameters.csv", "base_parameters.csv"}
    others = sorted(sealed["files"].keys() - compared - {*ROBOTS})
    robots = [name for name in ROBOTS if name in sealed["files"]]
    said = [f"{manifest.listed(robots)}: {ELSEWHERE}"] if robots else []
    said += [f"{manifest.listed(others)}: sealed, and not derivable"] if others else []
    return (
        *said,
        f"that {manifest.NAME} is the one that the run wrote: compare its digest "
        f"{sealed['sha256']} with one from whom you trust; a digest is no signature",
    )
