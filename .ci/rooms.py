"""The rooms of the package and their tests, and what .ci/coverage keeps of a run of these."""

from __future__ import annotations

import hashlib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Outside git: data of coverage.py with the tests that ran each line, and what was read from them.
KEPT = ROOT / ".coverage.rooms"
# The tests that belong to no room, such as those of the documentation.
REST = "rest"
# Which tests judge: the slow ones, too, whatever counts as slow.
MARKED = "not examples and not studies"


def rooms() -> list[str]:
    """Return the names of the rooms: the folders of the package."""
    return sorted(path.parent.name for path in (ROOT / "sdpid").glob("*/__init__.py"))


def sub_packages() -> list[str]:
    """Return the sub-packages of all rooms, as room/name."""
    found = (ROOT / "sdpid").glob("*/*/__init__.py")
    return sorted(path.parent.relative_to(ROOT / "sdpid").as_posix() for path in found)


def named(argument: str) -> str:
    """Return the room that is meant by its name, or by the folder of its code or its tests."""
    name = Path(argument).name
    for room in [*rooms(), REST]:
        if name in (room, _tests(room)):
            return room
    raise SystemExit(f"'{argument}' is no room: there are {', '.join([*rooms(), REST])}.")


def tests_of(room: str) -> list[str]:
    """Return the folder of a room's tests, or all paths of tests that belong to no room."""
    if room != REST:
        return [f"tests/{_tests(room)}"]
    taken = {_tests(room) for room in rooms()}
    files = sorted((ROOT / "tests").glob("test_*.py"))
    folders = sorted({path.relative_to(ROOT / "tests").parts[0] for path in _modules_of_tests()})
    return [
        *(path.relative_to(ROOT).as_posix() for path in files),
        *(f"tests/{name}" for name in folders if name not in taken),
    ]


def _tests(room: str) -> str:
    """Return the name of the folder of a room's tests."""
    return room.removeprefix("_")


def _modules_of_tests() -> list[Path]:
    """Return the modules of tests in folders."""
    return list((ROOT / "tests").glob("*/**/test_*.py"))


def fingerprints() -> dict[str, str]:
    """Return a hash of each file of the package and of its tests."""
    paths = sorted([*(ROOT / "sdpid").rglob("*.py"), *(ROOT / "tests").rglob("*.py")])
    return {
        path.relative_to(ROOT).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in paths
    }


def changed(room: str, before: dict[str, str], now: dict[str, str]) -> list[str]:
    """Return the files of a room's code and tests that differ between two sets of hashes."""
    folders = (f"sdpid/{room}/", f"tests/{_tests(room)}/")
    names = sorted(name for name in {*before, *now} if name.startswith(folders))
    return [name for name in names if before.get(name) != now.get(name)]
