"""The inner loops, compiled where Numba is installed."""

from __future__ import annotations

import functools
import hashlib
import inspect
import itertools
from collections.abc import Callable
from contextlib import nullcontext
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from sdpid.experiment.simulation.kernels import links, loops, solve
from sdpid.robot.model.regressor_kernel import announced

_MODULES: tuple[ModuleType, ...] = (links, solve, loops)

# What is called from outside, and kept on the disk.
_ENTRIES = ("closed_loop", "open_loop", "dynamics")


@functools.cache
def entries() -> SimpleNamespace:
    """Return the loops: compiled, or as they are where Numba is missing."""
    try:
        import numba
    except ImportError:  # missing, or it refuses this NumPy
        # A motion may diverge: no warnings of numbers that overflow.
        quiet = np.errstate(all="ignore")
        return SimpleNamespace(**{name: quiet(getattr(loops, name)) for name in _ENTRIES})
    try:
        # Beside the modules or, where that is not writable, in the user's cache folder.
        return _linked(numba.njit, cache=True)
    except (OSError, RuntimeError):  # neither is writable, or the disk is full
        return _linked(numba.njit)


def _linked(njit: Any, **kept: Any) -> SimpleNamespace:
    """Compile copies of the functions that call each other's copies."""
    found: dict[str, Any] = {}
    for module in _MODULES:
        found |= vars(module)
    # The compiled code of an entry holds that of the others: their text is part of its name.
    texts = "".join(inspect.getsource(module) for module in _MODULES)
    digest = hashlib.sha256(texts.encode()).hexdigest()[:16]
    options = {"nogil": True, "error_model": "numpy", "fastmath": {"contract", "nsz", "reassoc"}}
    # Nothing here allocates: counting the users of arrays and a door from Python for each function
    # would take most of the time to compile, and part of that to run.
    inner = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}
    for module in _MODULES:
        for name, function in vars(module).items():
            if isinstance(function, FunctionType) and function.__module__ == module.__name__:
                copy = FunctionType(function.__code__, found, name)
                copy.__module__ = function.__module__
                copy.__qualname__ = f"{name}_{digest}"
                more = kept if name in _ENTRIES else inner
                found[name] = njit(**options, **more)(copy)
    return SimpleNamespace(**{name: _announced(found[name]) for name in _ENTRIES})


def _announced(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function with a line to the user where its first call takes long."""
    calls = itertools.count()

    def call(*arguments: Any) -> Any:
        with nullcontext() if next(calls) else announced("the simulation"):
            return function(*arguments)

    return call
