"""Helpers: files, jobs, progress, sandboxes, tables and threads."""

import csv
import gc
import hashlib
import importlib.metadata
import io
import json
import os
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

import sdpid
from sdpid._common.extras import installation, require
from sdpid._common.files import Source, load_toml, unchanged
from sdpid._common.progress import progress
from sdpid._common.sandbox import memory_limit, run_in_sandbox
from sdpid._common.tables import Table, facts_html, plain
from sdpid._common.threads import one_thread
from sdpid.assurance.tables.csv_table import read_base_table
from sdpid.errors import DataError, MissingExtraError, ModelError
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.experiment.trajectory.whole_body import WholeBodyMotion
from sdpid.robot.description.xml import read_description
from tests.helpers import sandboxed
from tests.helpers.refusals import refuses


def test_a_file_has_the_digest_of_its_bytes(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    file.write_bytes(b"t,q1\n" * 1000)
    found = Source.of(file)
    assert (found.name, found.size) == ("run.csv", 5000)
    assert found.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
    assert found == Source.of_bytes(file.read_bytes(), "run.csv")


def test_a_folder_counts_the_names_and_bytes_of_its_files(tmp_path: Path) -> None:
    for number in range(2):
        folder = tmp_path / str(number)
        (folder / "deeper").mkdir(parents=True)
        (folder / "a.db3").write_bytes(b"1")
        (folder / "deeper" / "b.db3").write_bytes(b"23")
    first, second = (Source.of(tmp_path / name) for name in "01")
    assert first.sha256 == second.sha256
    assert first.size == 3
    (tmp_path / "1" / "a.db3").rename(tmp_path / "1" / "c.db3")
    assert Source.of(tmp_path / "1").sha256 != first.sha256


@pytest.mark.parametrize(
    ("read", "error"),
    [
        (load_toml, DataError),
        (sdpid.read_parameters, DataError),
        (read_base_table, DataError),
        (true_parameters, DataError),
        (WholeBodyMotion.from_csv, DataError),
        (read_description, ModelError),
    ],
)
def test_files_are_read_up_to_a_size_and_devices_not_at_all(
    tmp_path: Path, read: Callable[[Path], object], error: type[sdpid.errors.SdpidError]
) -> None:
    endless, large = tmp_path / "endless.json", tmp_path / "large.json"
    endless.symlink_to("/dev/zero")
    with large.open("wb") as file:
        file.truncate(2**28 + 2)
    if read is true_parameters:
        for name in ("endless", "large"):
            (tmp_path / name).mkdir()
            (tmp_path / name / "true_parameters.csv").symlink_to(tmp_path / f"{name}.json")
        endless, large = tmp_path / "endless", tmp_path / "large"
    refuses(error, "no regular file", read, endless)
    refuses(error, r"has more than .* bytes, which are read at most", read, large)


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    file.write_bytes(b"1")
    with unchanged(file):
        pass
    with pytest.raises(DataError, match=r"run\.csv: changed while it was read"), unchanged(file):
        file.write_bytes(b"12")


# A progress bar is drawn where it can be taken back, and nowhere else.


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("variable", "value", "drawn"),
    [("TERM", "xterm", True), ("TERM", "dumb", False), ("JPY_PARENT_PID", "1", False)],
)
def test_a_bar_only_on_a_terminal_that_draws(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str, drawn: bool
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("JPY_PARENT_PID", raising=False)
    monkeypatch.setenv(variable, value)
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    with progress(2.0, "working") as advance:
        advance(1.0)
    assert ("working" in terminal.getvalue()) is drawn


# What is missing is installed from where sdpid itself came from.


@dataclass(frozen=True)
class Distribution:
    """How pip recorded an installation: what it was given, if not a name, and where it lies."""

    source: dict[str, Any] | None
    folder: Path = Path(sdpid.__file__).parents[1]

    def read_text(self, name: str) -> str | None:
        assert name == "direct_url.json"
        return None if self.source is None else json.dumps(self.source)

    def locate_file(self, path: str) -> Path:
        return self.folder / path


CHECKOUT = "'.[sim]' in the checkout of sdpid"


@pytest.mark.parametrize(
    ("distribution", "command"),
    [
        (Distribution(None), "pip install 'sdpid[sim]'"),
        (Distribution({"url": "file:///a", "dir_info": {}}), f"pip install {CHECKOUT}"),
        (
            Distribution({"url": "file:///a", "dir_info": {"editable": True}}, Path("/none")),
            f"pip install -e {CHECKOUT}",
        ),
        (Distribution(None, Path("/none")), f"pip install {CHECKOUT}"),
        (
            Distribution({"url": "file:///a.whl", "archive_info": {}}),
            "pip install 'sdpid[sim] @ file:///a.whl'",
        ),
        (
            Distribution({"url": "https://a/b", "vcs_info": {"vcs": "git", "commit_id": "c0"}}),
            "pip install 'sdpid[sim] @ git+https://a/b@c0'",
        ),
    ],
    ids=["index", "folder", "editable", "another's", "wheel", "repository"],
)
def test_an_extra_is_installed_from_where_sdpid_came_from(
    distribution: Distribution, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.metadata, "distribution", lambda name: distribution)
    assert installation("sim") == command
    with pytest.raises(MissingExtraError, match="package 'none_such'") as missing:
        require("none_such.part", extra="sim")
    assert str(missing.value).endswith(command)


def test_an_extra_of_what_is_not_installed_is_in_its_checkout(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(importlib.metadata, "distribution", raising_not_found)
    assert installation("sim") == f"pip install {CHECKOUT}"


def raising_not_found(name: str) -> None:
    raise importlib.metadata.PackageNotFoundError(name)


# A child process takes the harm that a file can do; the parent gets a result or one error.


def run(function: Any, *arguments: Any, **how: Any) -> Any:
    return run_in_sandbox(function, *arguments, subject="run.h5", **how)


def test_plain_values_and_arrays_come_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    value = run(sandboxed.echo, "é\n\u202e", None, {"a": [1, 2.5, True]})
    assert value["arguments"] == ["é\n\u202e", None, {"a": [1, 2.5, True]}]
    numbers, names, empty = value["arrays"]
    np.testing.assert_array_equal(numbers, [[0, 1, 2], [3, 4, 5]])
    assert names.tolist() == ["ä", "b"]
    assert empty.shape == (0, 2)
    assert value["scalar"] == 1.5
    # The file of a large array is gone, its values are not; nothing is left behind.
    assert list(tmp_path.iterdir()) == []
    gc.collect()
    np.testing.assert_array_equal(value["large"], np.arange(200_000))
    assert not value["large"].flags.writeable


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (sandboxed.crash, "run.h5: cannot be read: the library that reads it crashed .SIGABRT"),
        (sandboxed.fail, r"run.h5: cannot be read \('inside.nmore'\)"),
        (sandboxed.leave, r"run.h5: cannot be read: .* status 3 \(no message\)"),
        (sandboxed.hand_back_object, "run.h5: cannot be read .Object arrays"),
    ],
)
def test_what_goes_wrong_is_one_error(function: Any, words: str) -> None:
    refuses(DataError, words, run, function)
    refuses(ModelError, words, run, function, error=ModelError)


def test_errors_of_ours_keep_class_and_message() -> None:
    refuses(ModelError, r"^arm.xml: two\nlines$", run, sandboxed.refuse, "arm.xml: two\nlines")


def test_time_is_limited() -> None:
    refuses(DataError, "it took more than 2 s", run, sandboxed.hang, timeout=2.0)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit memory")
def test_memory_is_limited() -> None:
    assert run(sandboxed.take, 1 << 20) == 1 << 20
    with pytest.raises(DataError, match=r"needs more memory than the limit of 0\.05 GB"):
        run(sandboxed.take, 1 << 30, memory=50_000_000)
    assert 1 << 20 < memory_limit() <= 1 << 33


def test_modules_beside_the_log_are_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("numpy", "json", "h5py", "lazy_loader", "sdpid"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    monkeypatch.syspath_prepend(os.curdir)
    monkeypatch.syspath_prepend(str(tmp_path))
    # A child that is measured imports coverage.py, and json with it, before its path is set.
    monkeypatch.delenv("COVERAGE_PROCESS_START", raising=False)
    # Of a path in the environment an empty entry is the current folder.
    monkeypatch.setenv("PYTHONPATH", os.pathsep + os.environ.get("PYTHONPATH", ""))
    assert run(sandboxed.take, 10) == 10
    assert not (tmp_path / "ran").exists()


# One table, written as text, CSV and HTML; one way to plain values.


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


# Linear algebra on one thread: as long as anyone needs it, and no longer.


@pytest.fixture(autouse=True)
def libraries() -> Iterator[None]:
    """Load all libraries of linear algebra, and let each use three threads."""
    one_thread(int)()
    with threadpool_limits(3, user_api="blas"):
        yield


def blas_threads() -> set[int]:
    """Return the numbers of threads of the linear algebra libraries that have threads.

    SCS, which other tests load, brings one that was built without.
    """
    found = (each for each in threadpool_info() if each["user_api"] == "blas")
    return {each["num_threads"] for each in found if each["threading_layer"] != "disabled"}


def test_one_thread_while_it_runs_and_as_many_as_before_after_it() -> None:
    assert one_thread(blas_threads)() == {1}
    assert one_thread(one_thread(blas_threads))() == {1}
    assert blas_threads() == {3}


def test_overlapping_calls_leave_the_number_of_threads_as_it_was() -> None:
    """The one that began first ends first: the other still has one thread, and puts it back."""
    first_runs, second_runs, first_ended = (threading.Event() for _ in range(3))
    seen: list[set[int]] = []

    @one_thread
    def first() -> None:
        first_runs.set()
        assert second_runs.wait(10.0)

    @one_thread
    def second() -> None:
        second_runs.set()
        assert first_ended.wait(10.0)
        seen.append(blas_threads())

    one, two = threading.Thread(target=first), threading.Thread(target=second)
    one.start()
    # The second begins while the first runs.
    assert first_runs.wait(10.0)
    two.start()
    one.join()
    first_ended.set()
    two.join()
    assert seen == [{1}]
    assert blas_threads() == {3}


def test_an_error_puts_the_number_of_threads_back() -> None:
    @one_thread
    def fail() -> None:
        raise ValueError("failed")

    refuses(ValueError, "failed", fail)
    assert blas_threads() == {3}
