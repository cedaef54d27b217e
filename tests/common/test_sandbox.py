"""A child process takes the harm that a file can do; the parent gets a result or one error."""

import gc
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sdpid._common.sandbox import memory_limit, run_in_sandbox
from sdpid.errors import DataError, ModelError
from tests.helpers import sandboxed
from tests.helpers.refusals import refuses


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
