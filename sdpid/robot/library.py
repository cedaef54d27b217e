"""Robots that can be loaded by name: the bundled folders, and those of example-robot-data."""

from __future__ import annotations

import importlib.metadata
from functools import cache
from pathlib import Path

from sdpid.errors import ModelError

_PACKAGE = Path(__file__).resolve().parent.parent


def models_folder() -> Path:
    """Return the folder of bundled robots: of the checkout, or packed into the wheel."""
    checkout = _PACKAGE.parent / "models"
    packed = _PACKAGE / "models"
    return packed if packed.is_dir() else checkout


def bundled_robots() -> tuple[str, ...]:
    """Return the names of the bundled robots."""
    folder = models_folder()
    return tuple(sorted(path.parent.name for path in folder.glob("*/kinematics.toml")))


def bundled_folder(name: str) -> Path:
    """Return the folder of a bundled robot.

    Raises
    ------
    ModelError
        When there is none of that name.
    """
    if name not in bundled_robots():
        raise ModelError(f"no bundled robot is called {name!r}: {', '.join(bundled_robots())}.")
    return models_folder() / name


@cache
def example_robots() -> dict[str, Path]:
    """Return the URDF files of the installed example-robot-data, by folder/stem."""
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        return {}
    robots = {}
    for file in files:
        if file.suffix == ".urdf" and "robots" in file.parts:
            folder = file.parts[file.parts.index("robots") + 1]
            robots[f"{folder}/{file.stem}"] = Path(str(file.locate()))
    return dict(sorted(robots.items()))


def find_example_robot(name: str) -> Path | None:
    """Return the URDF of example-robot-data with this stem or folder/stem, None if there is none.

    Raises
    ------
    ModelError
        When several folders have a file of that stem.
    """
    robots = example_robots()
    if name in robots:
        return robots[name]
    matches = [key for key in robots if key.split("/")[1] == name]
    if len(matches) > 1:
        raise ModelError(f"robot name {name!r} is ambiguous: use one of {', '.join(matches)}.")
    return robots[matches[0]] if matches else None
