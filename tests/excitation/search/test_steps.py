"""The progress bar of a search."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from sdpid.excitation.search import steps
from sdpid.excitation.search.steps import counted_steps


@pytest.mark.parametrize(("deadline", "length"), [(np.inf, 7.0), (102.0, 2.0)])
def test_a_bar_counts_steps_or_seconds(
    deadline: float, length: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    lengths, moves = [], []

    @contextmanager
    def bar(total: float, *_: Any, **__: Any) -> Iterator[Callable[[float], None]]:
        lengths.append(total)
        yield moves.append

    clock = iter([100.5, 101.5])
    monkeypatch.setattr(steps, "progress", bar)
    monkeypatch.setattr(steps.time, "monotonic", lambda: next(clock))
    with counted_steps(7, 100.0, deadline, None) as step:
        step()
        step()
    assert lengths == [length]
    assert moves == ([1.0, 1.0] if np.isinf(deadline) else [0.5, 1.0])
