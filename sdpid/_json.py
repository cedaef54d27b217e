"""Plain values as JSON."""

from __future__ import annotations

import json
import math
from typing import Any


def finite(value: Any) -> Any:
    """Return nested dicts and lists with None in place of NaN and infinite numbers."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    return value


def json_text(value: Any) -> str:
    """Return JSON with an indent of one; numbers that JSON cannot hold are null."""
    return json.dumps(finite(value), indent=1, allow_nan=False)
