"""What a folder of results seals of a run: its inputs, its recipe and its certificate."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sdpid.assurance.recipe.recipe import Recipe
from sdpid.errors import CertificateError
from sdpid.verifier import certificate, manifest
from sdpid.verifier.folder import CERTIFICATE
from sdpid.verifier.reading import REFUSED, read_bytes


@dataclass(frozen=True, eq=False)
class Sealed:
    """The parts of a results folder that say how it was made.

    Attributes
    ----------
    folder : Path
        The folder.
    files : tuple of str
        Names of the files that the manifest lists.
    logs : tuple of dict
        Name, bytes and SHA-256 of each log, in order.
    robot : dict or None
        The same of the robot's description; None where the manifest names none.
    recipe : Recipe
        How rows are made of the logs.
    data : dict
        The certificate.
    """

    folder: Path
    files: tuple[str, ...]
    logs: tuple[dict[str, Any], ...]
    robot: dict[str, Any] | None
    recipe: Recipe
    data: dict[str, Any]

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
        sealed = _read(whole / manifest.NAME, manifest.load)
        data = _read(whole / CERTIFICATE, certificate.load)
        if sealed["recipe"] is None:
            raise CertificateError(
                f"{whole / manifest.NAME}: has no recipe, so that the rows cannot be made again "
                "from the log: the run was not one of 'identify', or had friction terms of a class "
                "of its own."
            )
        recipe = Recipe.from_dict(sealed["recipe"])
        logs, robots = (
            tuple(entry for entry in sealed["inputs"] if entry["role"] == role)
            for role in ("log", "robot")
        )
        if len(logs) != len(recipe.reading):
            raise CertificateError(
                f"{whole / manifest.NAME}: names {len(logs)} logs and how {len(recipe.reading)} "
                "are read."
            )
        robot = robots[0] if robots else None
        return cls(whole, tuple(sealed["files"]), logs, robot, recipe, data)


def _read(path: Path, load: Callable[[bytes], dict[str, Any]]) -> dict[str, Any]:
    """Return the object in a JSON file."""
    try:
        return load(read_bytes(path))
    except OSError as cause:
        raise CertificateError(f"cannot read {path}: {cause.strerror}.") from None
    except REFUSED as cause:
        raise CertificateError(f"{path}: {cause}.") from None
