"""Optional dependencies, imported on first use."""

from __future__ import annotations

import importlib
import importlib.metadata
import json
from pathlib import Path
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
    """Return the command that installs an extra from where sdpid itself came from."""
    try:
        distribution = importlib.metadata.distribution("sdpid")
    except importlib.metadata.PackageNotFoundError:
        return _from_checkout(extra)
    # PEP 610: pip leaves this file where it was given a folder, a file or a repository.
    text = distribution.read_text("direct_url.json")
    source = {} if text is None else json.loads(text)
    loaded = distribution.locate_file("sdpid/_common/extras.py")
    if "dir_info" in source or Path(str(loaded)).resolve() != Path(__file__).resolve():
        return _from_checkout(extra, editable=source.get("dir_info", {}).get("editable", False))
    if "vcs_info" in source:
        vcs = source["vcs_info"]
        return f"pip install 'sdpid[{extra}] @ {vcs['vcs']}+{source['url']}@{vcs['commit_id']}'"
    return f"pip install 'sdpid[{extra}]{' @ ' + source['url'] if source else ''}'"


def _from_checkout(extra: str, *, editable: bool = False) -> str:
    """Return the command for who runs a checkout, or installed it."""
    return f"pip install {'-e ' if editable else ''}'.[{extra}]' in the checkout of sdpid"
