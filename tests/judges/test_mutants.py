"""Errors are made where they are meant, drawn alike each time, and found again."""

from __future__ import annotations

import ast
import json
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import pytest

from tests.judges import SCRIPTS, imported

mutations = imported("mutations")
mutants = imported("mutants")
rooms = imported("rooms")


def made(source: str, file: str = "sdpid/robot/a.py") -> list[Any]:
    """Return the errors that can be made in a source."""
    return mutations.mutants(file, source.encode())


def body(line: str) -> str:
    """Return a module with a function of one statement."""
    return f"def f(x, y):\n    {line}\n"


@pytest.mark.parametrize(
    ("line", "kind", "changed"),
    [
        ("return x < y", "comparison", "return (x >= y)"),
        ("return x is None", "comparison", "return (x is not None)"),
        ("return x in y", "comparison", "return (x not in y)"),
        ("return x + y", "sign", "return (x - y)"),
        ("return x / y", "sign", "return (x * y)"),
        ("return -x", "sign", "return (x)"),
        ("return x @ 0.5", "constant", "return x @ (0.55)"),
        ("return x[1]", "constant", "return x[(2)]"),
        ("return x and y", "junction", "return (x or y)"),
        ("raise ValueError(x)", "raise", "pass"),
        ("x.sort()", "dropped", "pass"),
        ("x += y", "dropped", "pass"),
        ("x.a = y", "dropped", "pass"),
        ("x['μ'] = 'σ', x @ 2.0", "constant", "x['μ'] = 'σ', x @ (2.2)"),
    ],
)
def test_one_error_of_each_kind(line: str, kind: str, changed: str) -> None:
    source = body(line)
    (mutant,) = [each for each in made(source) if each.place.kind == kind]
    assert mutant.applied(source.encode()).decode() == body(changed)
    assert mutant.place == mutations.Place("sdpid/robot/a.py", "f", line, kind, 0)
    assert mutant.numbers == (2, 2)


@pytest.mark.parametrize(
    "source",
    [
        "LIMIT = 1.0 + 2.0\nprint(LIMIT)\n",
        "class A:\n    x: float = -1.0\n",
        "@decorated(1.0)\ndef f(x: Literal[1] = 2, *, y=3):\n    '''Say 1 < 2.'''\n    return x\n",
        body("x: Literal[1] = y"),
        body("return f'{x + 1:.3f}', True, 0.0, 'text', x ** y, ..."),
        body("return x / 'name', 'text' + y"),
        body("x = y"),
    ],
)
def test_what_runs_on_import_and_what_is_no_code_is_left(source: str) -> None:
    assert made(source) == []


def test_only_the_place_of_the_error_changes() -> None:
    source = (
        "class A:\n    def f(self, x):\n        # a comment\n        def g():\n"
        "            return (x +  # why\n                    1) * 2.5  # so\n        return g\n"
    )
    found = made(source)
    assert {each.place.function for each in found} == {"A.f.g"}
    assert [(each.place.kind, each.place.line) for each in found] == [
        ("sign", "return (x +  # why 1) * 2.5  # so"),
        ("sign", "return (x +  # why 1) * 2.5  # so"),
        ("constant", "1) * 2.5  # so"),
        ("constant", "1) * 2.5  # so"),
    ]
    assert [each.place.index for each in found] == [0, 1, 0, 1]
    assert [each.numbers for each in found] == [(5, 5), (5, 5), (6, 5), (6, 5)]
    assert found[1].applied(source.encode()).decode() == source.replace(
        "x +  # why\n                    1", "(x - 1)"
    )
    assert found[3].applied(source.encode()).decode() == source.replace("2.5", "(2.75)")


def test_every_error_in_a_room_compiles_and_is_one() -> None:
    for path in sorted((rooms.ROOT / "sdpid" / "plots").glob("*.py")):
        source = path.read_bytes()
        whole = ast.dump(ast.parse(source))
        for mutant in mutations.mutants(path.name, source)[::10]:
            assert ast.dump(ast.parse(mutant.applied(source))) != whole


LONG = "def f(x, y):\n" + "".join(
    f"    x[{at}] = y - {at}.5 if y < {at} else -x\n" for at in range(30)
)


def test_the_same_seed_draws_the_same() -> None:
    found = made(LONG)

    def draw(seed: str, number: int = 12) -> list[Any]:
        return mutations.drawn(found, lambda each: each.numbers[0] % 2 == 0, number, seed)

    assert draw("0 robot") == draw("0 robot")
    assert draw("0 robot") != draw("1 robot")
    assert Counter(each.place.kind for each in draw("0 robot")) == {
        "comparison": 3,
        "constant": 3,
        "dropped": 3,
        "sign": 3,
    }
    lines = [each.numbers[0] for each in draw("0 robot", 100)]
    assert sorted(lines) == list(range(2, 32, 2))


def test_a_place_is_found_where_its_line_went() -> None:
    before = made("def f(x):\n    return x < 1\n\n\ndef g(x):\n    x.sort()\n    x.sort()\n")
    comparison, first, second = (
        each.place for each in before if each.place.kind in ("comparison", "dropped")
    )
    moved = made("import os\n\n\ndef h(x):\n    x.sort()\n    return x < 1\n")
    other = made("class A:\n    def f(self, x):\n        return x < 1\n", "sdpid/robot/b.py")
    now = mutations.matched([comparison, first, second], [*moved, *other])
    # A function of that name comes before another with the same line.
    assert now[comparison].place.file == "sdpid/robot/b.py"
    assert now[first] == now[second]
    assert now[first].place.function == "h"
    assert mutations.matched([comparison], moved)[comparison].place.function == "h"
    assert mutations.matched([comparison], made(body("return x <= 1"))) == {comparison: None}
    in_place = mutations.matched([comparison, first, second], [*before, *other])
    assert all(mutant.place == place for place, mutant in in_place.items())


def test_the_fastest_tests_within_number_and_time() -> None:
    seconds = {"a": 3.0, "b": 1.0, "c": 2.0, "d": 9.0}
    assert mutations.chosen_tests("abcde", seconds, 20, 20.0) == ["b", "c", "a", "d"]
    assert mutations.chosen_tests("abcde", seconds, 2, 20.0) == ["b", "c"]
    assert mutations.chosen_tests("abcde", seconds, 20, 5.9) == ["b", "c"]
    assert mutations.chosen_tests("de", seconds, 20, 8.0) == []


@dataclass
class Pool:
    """Runs nothing, and says of each source what its tests do."""

    notice: dict[str, str]
    met: list[tuple[str, ...]] = field(default_factory=list)

    def apply(self, _: Any, arguments: tuple[Any]) -> Any:
        """Let the tests pass in the unchanged copy, but for one."""
        failed = [test for test in arguments[0].tests if test == "broken"]
        return mutants.Outcome("killed" if failed else "survived", failed)

    def map(self, _: Any, tasks: list[Any], chunksize: int) -> list[Any]:
        """Let those tests fail that notice something in the changed source."""
        results = []
        for task in tasks:
            self.met.append(tuple(task.tests))
            failed = [
                test
                for test in task.tests
                if test in self.notice and self.notice[test] in task.source.decode()
            ]
            results.append(mutants.Outcome("killed" if failed else "survived", failed[:1]))
        return results


def room_of(source: str, covering: dict[int, list[str]], seconds: dict[str, float]) -> Any:
    """Return a room of one module without measuring it."""
    room = object.__new__(mutants.Room)
    room.name = "robot"
    room.seconds = seconds
    room.sources = {"sdpid/robot/a.py": source.encode()}
    room.mutants = made(source)
    room._tests = {"sdpid/robot/a.py": covering}
    return room


SOURCE = "def f(x):\n    if x < 0:\n        raise ValueError\n    return x\n"
COVERING = {2: ["quick", "slow (call)", "broken", ""], 3: ["slow (call)"]}
SECONDS = {"quick": 0.1, "slow": 50.0, "broken": 0.2, "other": 0.1}


def test_a_renewed_list_says_what_noticed_each_error() -> None:
    room = room_of(SOURCE, COVERING, dict(SECONDS))
    pool = Pool({"quick": "x >= 0", "broken": "x"})
    entries = mutants.renew(pool, room, 0)
    # The test of the `raise` takes too long for a draw.
    assert [(each["kind"], each["result"], each["by"]) for each in entries] == [
        ("comparison", "killed", "quick")
    ]
    assert pool.met == [("quick", "broken")]


def test_what_fails_without_an_error_notices_none() -> None:
    pool = Pool({"broken": "x"})
    (entry,) = mutants.renew(pool, room_of(SOURCE, COVERING, dict(SECONDS)), 0)
    assert (entry["result"], entry["by"]) == ("survived", "")
    assert pool.met == [("quick", "broken"), ("quick",)]


def noticed(kind: str, line: str, by: str) -> dict[str, Any]:
    """Return an entry of the list for an error that was noticed."""
    place = {"file": "sdpid/robot/a.py", "function": "f", "line": line, "kind": kind, "index": 0}
    return {"room": "robot", **place, "result": "killed", "by": by}


ENTRIES = [
    noticed("comparison", "if x < 0:", "other"),
    noticed("raise", "raise ValueError", "slow"),
    noticed("sign", "return x + 1", "quick"),
]


def test_errors_that_tests_still_notice_are_no_loss() -> None:
    pool = Pool({"quick": "x >= 0", "slow": "pass"})
    assert mutants.again(pool, room_of(SOURCE, COVERING, dict(SECONDS)), ENTRIES) == []
    # What noticed an error before comes first, and goes beyond the time.
    assert pool.met == [("other", "quick", "broken"), ("slow",)]


def test_an_error_that_is_noticed_no_more_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    pool = Pool({"slow": "pass"})
    (line,) = mutants.again(pool, room_of(SOURCE, COVERING, dict(SECONDS)), ENTRIES)
    assert line.startswith("sdpid/robot/a.py, f: comparison in 'if x < 0:' was noticed (other)")
    assert "3 tests that run the line" in line
    # Before that it met the slow test, too.
    assert pool.met[-1] == ("quick", "broken", "slow")
    assert "robot: 1 noticed, 1 no more, 1 gone" in capsys.readouterr().out


def test_a_check_that_is_gone_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    source = SOURCE.replace("raise ValueError", "return None")
    assert mutants.again(Pool({}), room_of(source, COVERING, dict(SECONDS)), ENTRIES[1:2]) == []
    shown = capsys.readouterr().out
    assert "robot: gone from f in sdpid/robot/a.py: raise ValueError" in shown
    assert "robot: 0 noticed, 0 no more, 1 gone" in shown


def test_a_line_that_no_test_runs_any_more_is_a_loss() -> None:
    room = room_of(SOURCE, {2: ["quick"]}, {"quick": 0.1})
    (line,) = mutants.again(Pool({"quick": "x"}), room, ENTRIES[1:2])
    assert "0 tests that run the line" in line


def test_the_list_is_well_formed() -> None:
    text = (SCRIPTS / "mutants.jsonl").read_text(encoding="utf-8")
    entries = [json.loads(line) for line in text.splitlines()]
    names = ["room", *mutations.Place.__dataclass_fields__, "result", "by"]
    assert all(list(each) == names for each in entries)
    places = [tuple(each[name] for name in names[:-2]) for each in entries]
    assert places == sorted(set(places))
    assert {each["room"] for each in entries} <= set(rooms.rooms())
    assert {each["kind"] for each in entries} <= set(mutations.KINDS)
    assert {each["result"] for each in entries} <= {"killed", "timeout", "survived"}
    assert max(Counter(each["room"] for each in entries).values()) <= mutants.NUMBER
    for each in entries:
        assert each["file"].startswith(f"sdpid/{each['room']}/")
        assert not (each["by"] and each["result"] == "survived")
