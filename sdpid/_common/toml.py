"""TOML files, read on every supported Python."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from sdpid._common.files import is_irregular
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
    if is_irregular(path):
        raise DataError(f"cannot read {path}: it is no regular file.")
    try:
        with Path(path).open("rb") as file:
            return dict(tomllib.load(file))
    except OSError as cause:
        raise DataError(f"cannot read {path}: {cause.strerror}.") from None
    except (ValueError, RecursionError) as cause:  # wrong, of endless digits, or nested endlessly
        raise DataError(f"{path}: not a TOML file ({cause}).") from None
