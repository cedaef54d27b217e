"""Find robots by name: bundled, identified, in example-robot-data, or in robot_descriptions."""

from __future__ import annotations

import difflib
import importlib
import importlib.metadata
import os
import sys
from functools import cache
from pathlib import Path

from sdpid._common.extras import installation
from sdpid._common.files import is_irregular
from sdpid.errors import ModelError

# Number of near names that an error lists, and their least similarity (1: equal).
_SHOWN, _ALIKE = 5, 0.6
_LONGEST_NAME = 80
# Extensions that names are compared without, the last one first.
_EXTENSIONS = (".xacro", ".urdf", ".xml", ".mjcf")

# Ends the names of robots whose links were identified.
_IDENTIFIED = "_identified"

_PACKAGE = Path(__file__).resolve().parents[2]


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


def identified_robots() -> dict[str, Path]:
    """Return the folders of the results that come with the package, by names of their robots."""
    found = sorted(models_folder().glob("*/identified/result.json"))
    return {f"{path.parents[1].name}{_IDENTIFIED}": path.parent for path in found}


def results_folder(given: str | os.PathLike[str]) -> Path:
    """Return a path of results: what is there, or where what comes with the package lies."""
    path, name = Path(given), f"{str(given).removesuffix(_IDENTIFIED)}{_IDENTIFIED}"
    return path if path.exists() else identified_robots().get(name, path)


@cache
def example_robots() -> dict[str, Path]:
    """Return the URDF files of the installed example-robot-data, by folder/stem."""
    robots = {}
    for file in _example_files():
        below = file.as_posix().rpartition("/example-robot-data/")[2].split("/")
        if file.suffix == ".urdf" and "robots" in below:
            folder = below[below.index("robots") + 1]
            robots[f"{folder}/{file.stem}"] = file
    return dict(sorted(robots.items()))


def _example_files() -> list[Path]:
    """Return the files of example-robot-data: pip keeps a record, conda has a shared folder."""
    shared = Path("share", "example-robot-data")
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        return [*Path(sys.prefix, shared).rglob("*.urdf")]
    return [Path(str(file.locate())) for file in files if shared.as_posix() in file.as_posix()]


def downloadable_robots() -> tuple[str, ...]:
    """Return the names of robot_descriptions, where it is installed (extra ``descriptions``)."""
    try:
        import robot_descriptions
    except ModuleNotFoundError:
        return ()
    return tuple(sorted(robot_descriptions.DESCRIPTIONS))


def robot_names() -> tuple[str, ...]:
    """Return the names that `load_robot` knows: those that come with the package come first."""
    ours = (*bundled_robots(), *identified_robots())
    return (*ours, *example_robots(), *downloadable_robots())


def _download(name: str) -> Path:
    """Return the URDF, xacro or MJCF of a robot of robot_descriptions, cached after a download.

    Raises
    ------
    ModelError
        When it cannot be downloaded, or has none of these files.
    """
    try:
        module = importlib.import_module(f"robot_descriptions.{name}")
    except Exception as cause:  # git fails in many ways
        reason = " ".join(str(cause).split())[:200]
        raise ModelError(
            f"robot {name!r} cannot be fetched by robot_descriptions ({reason}); it needs the "
            "network the first time."
        ) from None
    for kind in ("URDF_PATH", "XACRO_PATH", "MJCF_PATH"):
        path = getattr(module, kind, None)
        if path is not None:
            return Path(path)
    raise ModelError(f"robot {name!r} of robot_descriptions has neither URDF, xacro nor MJCF.")


def find_robot(name: str) -> Path:
    """Return the description of a robot by name.

    Bundled and identified robots come first, then those of example-robot-data by stem or
    folder/stem, then those of robot_descriptions, which are downloaded (extra ``descriptions``).

    Raises
    ------
    ModelError
        When there is none, with names that are near; when several folders have a file of that
        stem; or when a download fails.
    """
    if name in bundled_robots():
        return bundled_folder(name) / f"{name}.urdf"
    if folder := identified_robots().get(name):
        urdf = folder / "identified.urdf"
        return urdf if urdf.exists() else folder / "identified.xml"
    robots = example_robots()
    matches = [key for key in robots if name in (key, key.split("/")[1])]
    if len(matches) > 1:
        raise ModelError(f"robot name {name!r} is ambiguous: use one of {', '.join(matches)}.")
    if matches:
        return robots[matches[0]]
    if name in downloadable_robots():
        return _download(name)
    if is_irregular(name):
        raise ModelError(
            f"cannot read {name}: it is no regular file; give a URDF or MJCF file, or the "
            "name of a robot."
        )
    shown = name if len(name) <= 80 else name[:77] + "..."
    more = ""
    if name.endswith("_description") and not downloadable_robots():
        more = f"; for names of robot_descriptions: {installation('descriptions')}"
    raise ModelError(f"no robot {shown!r}: not a file, and not a known name; {_near(name)}{more}.")


def _near(name: str) -> str:
    """Return the known names that are most like one that is not known."""
    letters = {key.split("/")[-1]: _letters(key.split("/")[-1]) for key in robot_names()}
    word = _letters(name[:_LONGEST_NAME])
    near = [stem for stem, other in letters.items() if word and (word in other or other in word)]
    alike = difflib.get_close_matches(word, letters.values(), n=_SHOWN, cutoff=_ALIKE)
    near += [stem for other in alike for stem in letters if letters[stem] == other]
    if near:
        return "near it are " + ", ".join([*dict.fromkeys(near)][:_SHOWN])
    some = ", ".join([*bundled_robots(), *list(example_robots())[-_SHOWN:]])
    return f"{len(robot_names())} robots are known, such as {some}; sdpid robots lists them all"


def _letters(name: str) -> str:
    """Return what of a name is compared: small letters and digits, without an extension."""
    stem = name.lower()
    for extension in _EXTENSIONS:
        stem = stem.removesuffix(extension)
    return "".join(filter(str.isalnum, stem))
