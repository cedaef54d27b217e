"""Optional dependencies, imported on first use."""

from __future__ import annotations

import importlib
import importlib.metadata
import re
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
            f"install it with: {installation(extra)}"
        ) from None


def installation(extra: str) -> str:
    """Return the command that installs the packages of an extra, wherever sdpid came from."""
    try:
        lines = importlib.metadata.requires("sdpid") or []
    except importlib.metadata.PackageNotFoundError:
        lines = []
    packages = [
        line.partition(";")[0] for line in lines if re.search(f"extra == .{extra}\\b", line)
    ]
    if not packages:
        return f"pip install '.[{extra}]' in the checkout of sdpid"
    return f"pip install {' '.join(map(repr, map(str.strip, packages)))}"
