"""``sdpid audit robot.urdf``: what is wrong with a description, and its repair."""

from __future__ import annotations

import os
from pathlib import Path

from sdpid.cli import options as opt

_CLEAN, _ERRORS = 0, 3


def run_audit_urdf(
    path: str | os.PathLike[str],
    repair: str | os.PathLike[str] | None = None,
    as_json: bool = False,
) -> int:
    """Audit a URDF or MJCF file, print what was found, and repair it if asked to.

    Parameters
    ----------
    path : str or path
        The file; the name of a bundled robot or of one of example-robot-data where there is none.
    repair : str or path, optional
        Where to write the repaired URDF.
    as_json : bool, optional
        Print one JSON object.

    Returns
    -------
    int
        Exit status: 0 without errors (warnings may be), 3 with errors in `path`.

    Raises
    ------
    ModelError
        When `path` cannot be read.
    ExportError
        When the repaired file cannot be written.
    """
    from sdpid.assurance.descriptions.audit import audit_urdf
    from sdpid.output.robots.repair import repair_urdf

    file = _find(path)
    audit = audit_urdf(file)
    report = None if repair is None else repair_urdf(file, target=repair)
    if as_json:
        content = audit.to_dict()
        content["repair"] = None if report is None else report.to_dict()
        opt.print_json(content)
    else:
        opt.echo(audit.table() + "\n\n" + audit.describe())
        if report is not None:
            opt.echo(f"\n{report.path}: {report.describe()}")
    return _CLEAN if audit.passed else _ERRORS


def _find(path: str | os.PathLike[str]) -> Path:
    from sdpid.robot.description.catalog import find_robot

    file = Path(path)
    return file if file.is_file() else find_robot(str(path))
