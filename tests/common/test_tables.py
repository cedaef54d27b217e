"""One table, written as text, CSV and HTML; one way to plain values."""

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid._common.tables import Table, facts_html, plain

TABLE = Table(
    ("name", "cost", "status"),
    (("a <b>", 1.23456789, "optimal"), ("long name", float("inf"), None), ("c", None, "bad")),
    {"cost": ".3e"},
)


def test_numbers_stand_on_the_right_and_what_is_missing_is_a_dash() -> None:
    assert TABLE.text().splitlines() == [
        "name            cost  status",
        "a <b>      1.235e+00  optimal",
        "long name          -  -",
        "c                  -  bad",
    ]
    assert Table(("n", "x"), ((1, 0.123456),)).text(2).splitlines()[1] == "1  0.12"
    assert Table(("n", "x"), ()).text() == "n  x"


def test_csv_has_every_digit_and_empty_fields(tmp_path: Path) -> None:
    TABLE.write(tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[1] == ["a <b>", "1.23456789", "optimal"]
    assert rows[2] == ["long name", "", ""]


def test_html_is_escaped() -> None:
    page = facts_html("<i>", {"a&b": 1.0, "none": None}, TABLE)
    assert "<i>" not in page
    assert "a &lt;b&gt;" in page
    assert "a&amp;b" in page
    assert page.count("<table>") == page.count("</table>") == 2


@dataclass(frozen=True)
class Inner:
    values: np.ndarray
    _hidden: int = 3


@dataclass(frozen=True)
class Outer:
    path: Path
    inner: tuple[Inner, ...]
    numbers: dict[int, object]


def test_results_become_plain_values() -> None:
    outer = Outer(
        Path("a"), (Inner(np.array([1.0, np.nan])),), {1: np.float64(np.inf), 2: np.int64(4)}
    )
    assert plain(outer) == {
        "path": "a",
        "inner": [{"values": [1.0, None]}],
        "numbers": {"1": None, "2": 4},
    }
    with pytest.raises(TypeError):
        plain(object())


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    )
)
def test_plain_values_are_what_json_can_say(value: object) -> None:
    once = plain(value)
    assert json.loads(json.dumps(once, allow_nan=False)) == once
    assert plain(once) == once
