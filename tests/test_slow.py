"""The list of slow tests names tests that are there."""

from __future__ import annotations


def test_every_slow_test_is_there(unknown_slow_tests: list[str]) -> None:
    assert unknown_slow_tests == [], "tests/slow.txt names what is no test"
