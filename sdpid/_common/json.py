"""Results as JSON text."""

from __future__ import annotations

import json
from typing import Any

from sdpid._common.tables import plain


def json_text(value: Any) -> str:
    """Return a value as JSON with an indent of one; numbers that are not finite are null."""
    return json.dumps(plain(value), indent=1, allow_nan=False)
