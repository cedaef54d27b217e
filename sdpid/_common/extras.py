"""Optional dependencies, imported on first use."""

from __future__ import annotations

import importlib
from typing import Any

from sdpid.errors import MissingExtraError


def require(module: str, *, extra: str) -> Any:
    """Import `module`, or say which extra brings it.

    Raises
    ------
    MissingExtraError
        When the module is not installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as cause:
        package = module.split(".")[0]
        if cause.name is not None and cause.name.split(".")[0] != package:
            raise
        raise MissingExtraError(
            f"this needs the package '{package}', which is not installed; "
            f"install it with: pip install 'sdpid[{extra}]'"
        ) from None
