"""Calls that are refused, each in a line."""

from collections.abc import Callable
from typing import Any

import pytest


def refuses(
    error: type[Exception] | tuple[type[Exception], ...],
    words: str,
    call: Callable[..., object],
    /,
    *given: Any,
    **named: Any,
) -> None:
    """Assert that a call raises an error whose message holds words, a regular expression."""
    with pytest.raises(error, match=words):
        call(*given, **named)
