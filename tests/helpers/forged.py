"""Certificates and folders of results that were changed and sealed again, as any forger can."""

import copy
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from sdpid._common.files import hashed
from sdpid.verifier.manifest import sealed
from sdpid.verifier.reading import digest as digest_of


def written(data: Any, folder: Path) -> Path:
    """Write data as a proof, and return the file; NaN is written as Python does."""
    path = folder / "c.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


def with_row(data: Any, lower: float, multiplier: float, **coefficients: float) -> Any:
    """Return a certificate with one row more; keys are names of theta."""
    forged = copy.deepcopy(data)
    names = forged["origin"]["theta_names"]
    row = [coefficients.pop(name, 0.0) for name in names]
    assert not coefficients
    forged["problem"]["rows"].append(
        {"name": "light", "lower": lower, "upper": None, "coefficients": row}
    )
    forged["multipliers"]["rows"].append(multiplier)
    return forged


def paths(value: Any, before: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield where every value within lists and objects stands."""
    for key, item in value.items() if isinstance(value, dict) else enumerate(value):
        yield (*before, key)
        if isinstance(item, (dict, list)):
            yield from paths(item, (*before, key))


def at(data: Any, path: tuple[Any, ...]) -> Any:
    """Return what stands somewhere."""
    for key in path:
        data = data[key]
    return data


def change(how: Callable[[Any], Any], *path: Any) -> Callable[[Any], None]:
    """Return what changes one entry."""

    def apply(data: Any) -> None:
        at(data, path[:-1])[path[-1]] = how(at(data, path))

    return apply


def set_to(value: Any, *path: Any) -> Callable[[Any], None]:
    """Return what gives one entry a value, which may be new."""
    return lambda data: at(data, path[:-1]).update({path[-1]: value})


def edit(path: Path, change: Callable[[str], str]) -> None:
    """Change the text of a file."""
    before = path.read_text(encoding="utf-8")
    after = change(before)
    assert after != before
    path.write_text(after, encoding="utf-8")


def edit_json(path: Path, change: Callable[[Any], object]) -> None:
    """Change an object in a file."""
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    path.write_text(json.dumps(data), encoding="utf-8")


def contents(folder: Path) -> dict[str, bytes]:
    """Return what the files of a folder hold."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def reseal(folder: Path, *, without: str = "") -> str:
    """Make every digest right, list all files that are there but one; return the certificate's."""
    path, certificate = folder / "manifest.json", folder / "certificate.json"
    manifest, proof = (json.loads(file.read_text(encoding="utf-8")) for file in (path, certificate))
    edit_json(certificate, lambda data: data.update(sha256=digest_of(data)))
    manifest["certificate"] = digest_of(proof)
    manifest["files"] = {
        file.name: {"bytes": file.stat().st_size, "sha256": hashed(file)["sha256"]}
        for file in sorted(folder.iterdir())
        if file.name not in (path.name, without)
    }
    del manifest["sha256"]
    path.write_text(json.dumps(sealed(manifest)), encoding="utf-8")
    digest_of_proof: str = manifest["certificate"]
    return digest_of_proof
