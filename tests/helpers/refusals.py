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
) -> Any:
    """Return the error that a call raises; its message holds words, a regular expression."""
    with pytest.raises(error, match=words) as caught:
        call(*given, **named)
    return caught.value
