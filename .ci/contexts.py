"""Plugin of pytest: tell coverage.py which test runs, and write how long each takes alone."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Generator
from pathlib import Path

import coverage
import pytest

_fixtures: dict[tuple[str, str], float] = {}
_seconds: dict[str, float] = {}


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Run a test under its own name."""
    measured = coverage.Coverage.current()
    if measured is not None:
        measured.switch_context(item.nodeid)
    paid = sum(_fixtures.values())
    started = time.perf_counter()
    result = yield
    whole = time.perf_counter() - started - (sum(_fixtures.values()) - paid)
    if measured is not None:
        measured.switch_context("")
    # A test alone also pays for the fixtures that another test of this run has paid for.
    shared = sum(
        seconds
        for (base, name), seconds in _fixtures.items()
        if name in getattr(item, "fixturenames", ()) and item.nodeid.startswith(base)
    )
    _seconds[item.nodeid] = whole + shared
    return result


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: pytest.FixtureDef[object]) -> Generator[None, object, object]:
    """Time what a fixture takes."""
    started = time.perf_counter()
    result = yield
    if fixturedef.scope != "function":
        key = (fixturedef.baseid, fixturedef.argname)
        _fixtures.setdefault(key, time.perf_counter() - started)
    return result


def pytest_sessionfinish() -> None:
    """Write the times of this process."""
    folder = os.environ.get("SDPID_KEPT")
    if folder and _seconds:
        path = Path(folder) / f"seconds-{os.getpid()}.json"
        path.write_text(json.dumps(_seconds), encoding="utf-8")
