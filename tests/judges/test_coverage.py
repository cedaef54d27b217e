"""The table of coverage is whole, and a fall of it is noticed."""

from __future__ import annotations

from typing import Any

import pytest

from tests.judges import SCRIPTS, imported

coverage = imported("coverage")
rooms = imported("rooms")

TABLE = (SCRIPTS / "coverage.toml").read_text(encoding="utf-8")


def row(covered: int, total: int) -> object:
    """Return a row of the table."""
    return coverage.Row(covered, total)


def test_the_table_has_every_room_and_sub_package_and_no_other() -> None:
    tables, accepted = coverage.read(TABLE)
    every = {*rooms.rooms(), *rooms.sub_packages()}
    assert set(tables["own"]) == every
    assert set(tables.get("all", every)) == every
    assert set(accepted) <= every
    assert all(accepted.values())


def test_the_table_is_as_it_would_be_written() -> None:
    tables, accepted = coverage.read(TABLE)
    assert coverage.written(tables, accepted) == TABLE
    assert all(
        0 <= each.covered <= each.total for rows in tables.values() for each in rows.values()
    )


def test_a_fall_names_room_number_and_limit() -> None:
    old = {"robot": row(900, 1000), "plots": row(50, 100)}
    (line,) = coverage.falls(old, {"robot": row(899, 1000), "plots": row(50, 100)}, "own")
    assert "robot (own tests): 89.90 %" in line
    assert "limit 89.95 %" in line
    assert "101 of 1000 are missed, 100 of 1000 were before" in line


@pytest.mark.parametrize(
    ("old", "new", "number"),
    [
        ((9000, 10000), (8995, 10000), 0),
        ((9000, 10000), (8994, 10000), 1),
        ((9000, 10000), (9001, 10000), 0),
        # Less to run is no fall, nor is it a rise.
        ((900, 1000), (450, 500), 0),
        ((900, 1000), (440, 500), 1),
        ((0, 0), (0, 0), 0),
        # A room that came, and one that went.
        (None, (0, 10), 0),
        ((5, 10), None, 0),
    ],
)
def test_what_rounding_takes_is_no_fall(old: Any, new: Any, number: int) -> None:
    tables = ({} if each is None else {"robot": row(*each)} for each in (old, new))
    assert len(coverage.falls(*tables, "all")) == number


def test_what_one_run_executes_counts_once() -> None:
    def report(*found: list[Any]) -> dict[str, list[Any]]:
        names = ("executed_lines", "missing_lines", "executed_branches", "missing_branches")
        return dict(zip(names, found, strict=True))

    a, b = "robot/model/a.py", "robot/b.py"
    first = {a: report([1, 2], [3], [[1, 2]], [[1, 3]]), "robots.py": report([1], [], [], [])}
    second = {a: report([1, 3], [2], [[1, 3]], [[1, 2]]), b: report([], [1, 2], [], [])}
    names = ["robot", "robot/model", "plots"]
    for reports, of_robot, of_model in (
        ([first], row(3, 5), row(3, 5)),
        ([first, second], row(5, 7), row(5, 5)),
    ):
        counted = coverage.counted(reports, names)
        assert counted == {"robot": of_robot, "robot/model": of_model, "plots": row(0, 0)}


def test_a_table_is_read_as_it_was_written() -> None:
    tables = {"own": {"robot": row(2, 3), "robot/model": row(1, 1)}, "all": {"robot": row(3, 3)}}
    accepted = {"robot": 'a reason with "quotes"'}
    text = coverage.written(tables, accepted)
    assert coverage.read(text) == (tables, accepted)
    assert '"robot" = { percent = 66.67, covered = 2, of = 3 }' in text


@pytest.mark.parametrize("name", ["_common", "common", "tests/common", "sdpid/_common/"])
def test_a_room_goes_by_its_name_and_its_folders(name: str) -> None:
    assert rooms.named(name) == "_common"


def test_an_unknown_room_is_refused() -> None:
    with pytest.raises(SystemExit, match=r"'robots' is no room: there are _common, .*rest\."):
        rooms.named("robots")


def test_each_test_belongs_to_one_room_or_to_the_rest() -> None:
    paths = [path for room in [*rooms.rooms(), rooms.REST] for path in rooms.tests_of(room)]
    assert len(paths) == len(set(paths))
    found = {path.relative_to(rooms.ROOT) for path in (rooms.ROOT / "tests").rglob("test_*.py")}
    assert {"/".join(path.parts[:2]) for path in found} == set(paths)


def test_only_changes_of_the_room_ask_for_a_new_run() -> None:
    own, test, other = "sdpid/_common/a.py", "tests/common/test_a.py", "sdpid/robot/b.py"
    before = {own: "1", test: "1", other: "1"}
    now = {own: "2", "tests/common/test_b.py": "1", other: "2"}
    assert rooms.changed("plots", before, now) == []
    assert rooms.changed("robot", before, now) == [other]
    assert rooms.changed("_common", before, now) == [own, test, "tests/common/test_b.py"]
