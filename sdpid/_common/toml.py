"""TOML files, read on every supported Python."""

from __future__ import annotations

import os
import sys
from typing import Any

from sdpid._common.files import read_regular
from sdpid.errors import DataError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def load_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    DataError
        When the file cannot be read or is not TOML.
    """
    content = read_regular(path)
    try:
        return dict(tomllib.loads(content.decode("utf-8")))
    except (ValueError, RecursionError) as cause:  # wrong, of endless digits, or nested endlessly
        raise DataError(f"{path}: not a TOML file ({cause}).") from None
