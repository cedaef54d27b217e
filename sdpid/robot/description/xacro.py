"""xacro files: URDF with macros, expanded in a child process (extra ``xacro``)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from sdpid._common.extras import require
from sdpid._common.sandbox import run_in_sandbox
from sdpid.errors import ModelError, SdpidError
from sdpid.robot.description.xml import Description, parse_xml

TIMEOUT = 60.0


def is_xacro(found: Description) -> bool:
    """Return whether a description is xacro, by its file's name or its elements.

    Raises
    ------
    ModelError
        When it is not well-formed XML.
    """
    if found.path is not None and found.path.suffix == ".xacro":
        return True
    if "xacro" not in found.text:
        return False
    root = parse_xml(found.text, found.what)
    return any("xacro}" in str(element.tag) for element in root.iter())


def expand_xacro(found: Description, arguments: Mapping[str, str] | None = None) -> Description:
    """Return the URDF that a xacro file stands for, and any other description as it is.

    xacro evaluates expressions of Python; the child process that does so has limits of memory and
    time, but reads and writes files as the user. Packages (``$(find …)``) are found above the
    file, in a ROS environment, and on ``ROS_PACKAGE_PATH``.

    Parameters
    ----------
    found : Description
        What was read.
    arguments : mapping, optional
        Values of ``<xacro:arg>``.

    Raises
    ------
    ModelError
        When it cannot be expanded, or there are arguments for what is no xacro file.
    MissingExtraError
        When xacrodoc is not installed.
    """
    if not is_xacro(found):
        if arguments is not None:
            raise ModelError(f"{found.what}: xacro_args are given, and it is no xacro file.")
        return found
    path = None if found.path is None else str(found.path.resolve())
    values = {str(key): str(value) for key, value in (arguments or {}).items()}
    text = run_in_sandbox(
        _expanded,
        *(found.text, path, values, found.what),
        subject=found.what,
        error=ModelError,
        timeout=TIMEOUT,
    )
    return replace(found, text=str(text))


def _expanded(text: str, path: str | None, arguments: dict[str, str], what: str) -> str:
    """Return the URDF of a xacro text, in a child process."""
    xacrodoc = require("xacrodoc", extra="xacro")
    folder = None
    if path is not None:
        xacrodoc.packages.walk_up_from(path)
        folder = Path(path).parent
        # Files that it includes are named relative to it.
        os.chdir(folder)
    try:
        document = xacrodoc.XacroDoc.from_string(text, subargs=arguments, rootdir=folder)
        return str(document.to_urdf_string())
    except SdpidError:
        raise
    except Exception as cause:  # macros raise whatever their expressions raise
        message = " ".join(str(cause).split()) or type(cause).__name__
        raise ModelError(
            f"{what}: xacro cannot expand it ({message[:300]}); give missing arguments as "
            "xacro_args."
        ) from None
