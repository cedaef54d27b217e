"""What a results folder seals of a run: its inputs, its recipe and its certificate."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sdpid.assurance.log_proof.recipe import Recipe
from sdpid.errors import CertificateError
from sdpid.verifier import certificate
from sdpid.verifier.bound import Recomputed
from sdpid.verifier.reading import REFUSED, parse, read_bytes

_ENTRY = {"role": (str,), "name": (str, type(None)), "bytes": (int, type(None)), "sha256": (str,)}


@dataclass(frozen=True, eq=False)
class Sealed:
    """The parts of a results folder that a log is checked against.

    Attributes
    ----------
    folder : Path
        The folder.
    logs : tuple of dict
        Name, bytes and SHA-256 of each log, in order.
    robot : dict or None
        The same of the robot's description; None where the manifest names none.
    recipe : Recipe
        How rows are made of the logs.
    data : dict
        The certificate.
    found : Recomputed
        What its numbers prove of the compressed cost.
    """

    folder: Path
    logs: tuple[dict[str, Any], ...]
    robot: dict[str, Any] | None
    recipe: Recipe
    data: dict[str, Any]
    found: Recomputed

    @classmethod
    def read(cls, folder: str | os.PathLike[str]) -> Sealed:
        """Read manifest.json and certificate.json.

        Raises
        ------
        CertificateError
            When a file is missing or damaged, or the manifest has no recipe.
        """
        whole = Path(folder)
        if not whole.is_dir():
            raise CertificateError(
                f"{folder}: is no folder; a log is checked against the whole folder that "
                "'sdpid identify' wrote."
            )
        manifest, data = (
            _read(whole / name, load)
            for name, load in (("manifest.json", parse), ("certificate.json", certificate.load))
        )
        inputs, given = manifest.get("inputs"), manifest.get("recipe")
        if given is None:
            raise CertificateError(
                f"{whole / 'manifest.json'}: has no recipe, so that the rows cannot be made again "
                "from the log: the run was not one of 'identify', or had friction terms of a class "
                "of its own."
            )
        recipe = Recipe.from_dict(given)
        entries = _entries(whole / "manifest.json", inputs)
        logs = tuple(entry for entry in entries if entry["role"] == "log")
        robots = [entry for entry in entries if entry["role"] == "robot"]
        if len(logs) != len(recipe.reading):
            raise CertificateError(
                f"{whole / 'manifest.json'}: names {len(logs)} logs and how {len(recipe.reading)} "
                "are read."
            )
        try:
            found = Recomputed(data)
        except REFUSED as cause:
            raise CertificateError(f"{whole / 'certificate.json'}: {cause}.") from None
        return cls(whole, logs, robots[0] if robots else None, recipe, data, found)


def _read(path: Path, load: Any) -> dict[str, Any]:
    """Return the object in a JSON file."""
    try:
        content: dict[str, Any] = load(read_bytes(path))
    except OSError as cause:
        raise CertificateError(f"cannot read {path}: {cause.strerror}.") from None
    except REFUSED as cause:
        raise CertificateError(f"{path}: {cause}.") from None
    return content


def _entries(path: Path, given: Any) -> list[dict[str, Any]]:
    """Return the manifest's inputs, each of the expected keys and kinds."""
    entries = given if isinstance(given, list) else [given]
    for entry in entries:
        if not (
            isinstance(entry, dict)
            and entry.keys() == _ENTRY.keys()
            and all(type(entry[key]) in kinds for key, kinds in _ENTRY.items())
        ):
            raise CertificateError(f"{path}: {entry!r:.80} does not name an input.")
    return entries
