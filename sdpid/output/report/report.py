"""The report: one HTML file with the verdict, data, fit, parameters and certificate.

It loads no other file: style and pictures are in it, and a Content-Security-Policy forbids the
rest. Names of robots, joints and links, and notes, are escaped.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sdpid._common.extras import require
from sdpid._common.files import atomic_write_text
from sdpid.assurance.diagnostics.active_constraints import constraint_states
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.output.report.judged import Judged, errors_of
from sdpid.output.report.page import page
from sdpid.output.report.sections import (
    gait,
    joints,
    links,
    mass_matrix,
    parameters,
    recording,
    rollouts,
    short,
)
from sdpid.output.robots.export_report import ExportReport
from sdpid.output.scene.identified import identified_scene
from sdpid.output.scene.scene import Scene


def write_report(
    identification: Judged,
    target: str | os.PathLike[str],
    *,
    command: str | None = None,
    intervals: Intervals | None = None,
    figures: bool | None = None,
    sha256: str | None = None,
    exports: Sequence[ExportReport] = (),
) -> Path:
    """Write a self-contained HTML report on an identification, whole or not at all.

    Parameters
    ----------
    identification : Identification
        What `identify` found.
    target : path
        The file.
    command : str, optional
        The command line that made it.
    intervals : Intervals, optional
        For the parameter tables.
    figures : bool, optional
        Draw plots; by default where matplotlib is installed. False leaves out the robot, too.
    sha256 : str, optional
        The certificate's digest, where it is known; else the certificate is written out once
        more to find it.
    exports : sequence of ExportReport, optional
        Files of the robot that were written.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    MissingExtraError
        When jinja2 is not installed (extra ``report``), or matplotlib is not and figures are
        asked for (extra ``plot``).
    ExportError
        When the file cannot be written.

    Examples
    --------
    >>> path = sdpid.write_report(result, "report.html", figures=False)
    >>> path.name
    'report.html'
    """
    text = report_html(
        identification,
        command=command,
        intervals=intervals,
        figures=figures,
        sha256=sha256,
        exports=exports,
    )
    atomic_write_text(target, text)
    return Path(target)


def report_html(
    identification: Judged,
    *,
    command: str | None = None,
    intervals: Intervals | None = None,
    figures: bool | None = None,
    sha256: str | None = None,
    exports: Sequence[ExportReport] = (),
) -> str:
    """Return the page that `write_report` writes, with the same arguments and errors."""
    drawable = importlib.util.find_spec("matplotlib") is not None
    if figures:
        require("matplotlib", extra="plot")
    if sha256 is None:
        sha256 = str(identification.certificate.to_dict()["sha256"])
    scene = None if figures is False else _scene(identification)
    shown = _context(identification, drawable if figures is None else figures, intervals)
    return page(
        "sdpid.output.report",
        "report.html.j2",
        scripts=() if scene is None else (scene.script,),
        scene=scene,
        **shown,
        exports=exports,
        command=command,
        sha256=sha256,
        drawable=drawable,
    )


def _scene(result: Judged) -> Scene:
    """Return the robot along the motion that was recorded, with its inertia ellipsoids."""
    return identified_scene(result.problem.robot, result.problem.samples, result.estimate.theta)


def _context(result: Judged, draw: bool, intervals: Intervals | None) -> dict[str, Any]:
    """Return the variables of the templates."""
    problem, certificate = result.problem, result.certificate
    errors = errors_of(result)
    states = constraint_states(result.estimate)
    return {
        "robot": problem.robot,
        "result": result,
        "problem": problem,
        "sample_count": problem.n_samples,
        "thinned": recording.thinned(result),
        "crossed": result.cross_validation,
        "states": [s for s in states if s.active],
        "state_count": len(states),
        "certificate": certificate,
        "certified": certificate.passed and problem.consistency != "none",
        "worst_margin": result.estimate.worst_margin,
        **short.values(result, errors),
        **joints.values(result, errors, draw),
        **parameters.values(result, intervals, draw),
        **links.values(result),
        **mass_matrix.values(result, draw),
        **rollouts.values(result, draw),
        **recording.values(result),
        **gait.values(result),
    }
