"""Run a function in a child process with limits, for libraries that read foreign files.

A damaged or hostile file can make a library hang, crash or ask for all memory. The child takes
the harm; the parent gets a result or one error. The result comes back as JSON and plain NumPy
files, so the parent unpickles nothing.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sdpid import errors
from sdpid.errors import DataError, SdpidError

# An honest log of an hour is read within this time, in s.
TIMEOUT = 120.0
# The most that reading may take, in bytes: an hour of a six-axis arm at 4 kHz with ten
# quantities has 7 GB ...
_MOST_MEMORY = 1 << 33
# ... and at most this part of the machine's memory.
_MEMORY_SHARE = 0.4
# What the interpreter and the libraries take before the first byte is read: about 80 MB.
_BASE_MEMORY = 1 << 28
# A result without its arrays is not larger; larger arrays are mapped, not loaded.
_LARGEST_RESULT = 1 << 26
_MAPPED = 1 << 16
_REQUEST, _RESULT, _ERRORS = "request.json", "result.json", "stderr.txt"
# What marks the place of an array in the result.
_ARRAY = "__array__"


def run_in_sandbox(
    function: Callable[..., Any],
    *arguments: Any,
    subject: str,
    error: type[SdpidError] = DataError,
    timeout: float = TIMEOUT,
    memory: int | None = None,
) -> Any:
    """Return `function(*arguments)`, computed in a child process with limits.

    The child has the parent's `sys.path` without the current folder, so a file ``numpy.py``
    beside the log is not imported. It starts in about 0.2 s.

    Parameters
    ----------
    function : callable
        A function at the top level of a module; the child imports it by name.
    *arguments
        None, bool, numbers, str, and lists, tuples and dicts (with str keys) of them.
    subject : str
        What is being read, usually the path; messages begin with it.
    error : type of SdpidError, optional
        What to raise when the child fails by anything but an error of sdpid.
    timeout : float, optional
        Limit in s.
    memory : int, optional
        Limit in bytes, `memory_limit` by default. Enforced where the system does so (Linux).

    Returns
    -------
    Any
        What the function returned: the same kinds as the arguments, and arrays of numbers or
        text. Tuples come back as lists, large arrays as read-only memory maps of files that are
        already unlinked.

    Raises
    ------
    SdpidError
        The error that the function raised, by its class and message; else `error`.
    """
    limit = memory_limit() if memory is None else memory
    with tempfile.TemporaryDirectory(prefix="sdpid-") as name:
        folder = Path(name)
        request = {
            "function": [function.__module__, function.__qualname__],
            "arguments": arguments,
            "memory": limit + _BASE_MEMORY,
            "seconds": math.ceil(timeout) + 1,
        }
        (folder / _REQUEST).write_text(json.dumps(request), encoding="utf-8")
        # The path is set before anything is imported.
        code = (
            "import sys; folder = sys.argv[1]; sys.path[:] = sys.argv[2:]; "
            "from sdpid._common.sandbox import _child; _child(folder)"
        )
        try:
            with (folder / _ERRORS).open("wb") as stderr:
                status = subprocess.run(
                    [sys.executable, "-c", code, name, *_clean_path()],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=stderr,
                    # One thread, or linear algebra reserves memory for every core.
                    env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
                    timeout=timeout,
                    check=False,
                ).returncode
        except subprocess.TimeoutExpired:
            raise error(
                f"{subject}: cannot be read: it took more than {timeout:g} s; the file is "
                "damaged, or should be cut into parts."
            ) from None
        return _result(folder, status, subject, error, limit)


def memory_limit() -> int:
    """Return how many bytes reading one file may take: 8 GB, or 40 % of the machine's memory."""
    try:
        physical = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return _MOST_MEMORY
    return min(_MOST_MEMORY, int(_MEMORY_SHARE * physical))


def _clean_path() -> list[str]:
    """Return the parent's import path without the current folder, unless sdpid lies in it."""
    here, root = Path.cwd().resolve(), Path(__file__).resolve().parents[2]
    path = [entry for entry in sys.path if entry and Path(entry).resolve() != here]
    known = any(Path(entry).resolve() == root for entry in path)
    return path if known else [str(root), *path]


def _result(folder: Path, status: int, subject: str, error: type[SdpidError], limit: int) -> Any:
    """Return what the child wrote, or raise what it ended with."""
    result = folder / _RESULT
    if status < 0:
        name = signal.Signals(-status).name if -status in set(signal.Signals) else str(-status)
        raise error(
            f"{subject}: cannot be read: the library that reads it crashed ({name}); the file is "
            "damaged."
        )
    if not result.is_file():
        lines = (folder / _ERRORS).read_text(encoding="utf-8", errors="replace").splitlines()
        raise error(
            f"{subject}: cannot be read: the process that reads it ended with status {status} "
            f"({(lines or ['no message'])[-1][:200]})."
        )
    if result.stat().st_size > _LARGEST_RESULT:
        raise error(f"{subject}: cannot be read: it holds too many names.")
    text = result.read_text(encoding="utf-8")
    answer = json.loads(text, object_hook=partial(_decoded, folder))
    kind = answer.get("error")
    if kind is None:
        return answer["result"]
    if kind == "MemoryError":
        raise error(
            f"{subject}: needs more memory than the limit of {limit / 1e9:.3g} GB; the file is "
            "damaged, or should be cut into parts."
        )
    public = getattr(errors, kind, None) if kind in errors.__all__ else None
    if public is not None:
        raise public(answer["message"])
    raise error(f"{subject}: cannot be read ({answer['message']}).")


def _child(name: str) -> None:
    """Run the function that a request names, within its limits, and write the result."""
    folder = Path(name)
    request = json.loads((folder / _REQUEST).read_text(encoding="utf-8"))
    _limit(request["memory"], request["seconds"])
    module, function = request["function"]
    try:
        value = getattr(importlib.import_module(module), function)(*request["arguments"])
        text = json.dumps({"result": value}, default=partial(_encoded, folder))
    except SdpidError as cause:
        kind = next(kind for kind in type(cause).__mro__ if kind.__name__ in errors.__all__)
        text = json.dumps({"error": kind.__name__, "message": str(cause)})
    except MemoryError:
        text = json.dumps({"error": "MemoryError"})
    except Exception as cause:  # a damaged file makes a library raise almost anything
        line = (str(cause).splitlines() or [""])[0][:200]
        text = json.dumps({"error": "Exception", "message": line or type(cause).__name__})
    (folder / _RESULT).write_text(text, encoding="utf-8")


def _limit(memory: int, seconds: int) -> None:
    """Limit this process's memory, the files it writes, its time and its core dump."""
    try:
        import resource
    except ImportError:  # a system without such limits
        return
    limits = {"RLIMIT_DATA": memory, "RLIMIT_FSIZE": memory, "RLIMIT_CPU": seconds}
    for name, value in {**limits, "RLIMIT_CORE": 0}.items():
        with contextlib.suppress(AttributeError, OSError, ValueError):
            kind = getattr(resource, name)
            hard = resource.getrlimit(kind)[1]
            most = value if hard == resource.RLIM_INFINITY else min(value, hard)
            resource.setrlimit(kind, (most, hard))


def _encoded(folder: Path, value: Any) -> Any:
    """Return a number of NumPy as a plain one; write an array to a file, and return which."""
    if not isinstance(value, np.ndarray):
        return value.item()
    number = sum(1 for _ in folder.glob("*.npy"))
    np.save(folder / f"{number}.npy", value, allow_pickle=False)
    return {_ARRAY: number}


def _decoded(folder: Path, value: dict[str, Any]) -> Any:
    """Return the array whose file an object in JSON names; other objects as they are."""
    if set(value) != {_ARRAY}:
        return value
    file = folder / f"{int(value[_ARRAY])}.npy"
    if file.stat().st_size <= _MAPPED:
        return np.load(file, allow_pickle=False)
    return np.asarray(np.load(file, mmap_mode="r", allow_pickle=False))
