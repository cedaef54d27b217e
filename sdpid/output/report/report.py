"""The report: one HTML file with the verdict, data, fit, parameters and certificate.

It loads no other file: style and pictures are in it, and a Content-Security-Policy forbids the
rest. Names of robots, joints and links, and notes, are escaped.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.files import atomic_write_text
from sdpid.assurance.diagnostics.active_constraints import constraint_states
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.estimation.positions.law_fit import FittedDrives
from sdpid.output.charts.page import Charts
from sdpid.output.report import joints, parameters, recording
from sdpid.output.report.headline import headline
from sdpid.output.report.kinds import LEVELS
from sdpid.output.report.subject import Judged, VerdictSubject
from sdpid.output.report.verdict import findings
from sdpid.output.robots.export_report import ExportReport
from sdpid.output.scene.scene import identified_scene
from sdpid.plots.lines import TimeLine

# Of lines of joints, one after the other.
_COLORS = ("blue", "red", "green", "orange", "purple", "gray")


def write_report(
    identification: Judged,
    target: str | os.PathLike[str],
    *,
    command: str | None = None,
    intervals: Intervals | None = None,
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
        When jinja2 is not installed (extra ``report``).
    ExportError
        When the file cannot be written.

    Examples
    --------
    >>> path = sdpid.write_report(result, "report.html")
    >>> path.name
    'report.html'
    """
    text = report_html(identification, command, intervals, sha256, exports)
    atomic_write_text(target, text)
    return Path(target)


def report_html(
    identification: Judged,
    command: str | None = None,
    intervals: Intervals | None = None,
    sha256: str | None = None,
    exports: Sequence[ExportReport] = (),
) -> str:
    """Return the page that `write_report` writes, with the same arguments and errors."""
    if sha256 is None:
        sha256 = str(identification.certificate.to_dict()["sha256"])
    result, of, charts = identification, identification._subject, Charts()
    problem, states = result.problem, constraint_states(result.estimate)
    # The robot along the motion that charts show, with its inertia ellipsoids.
    line = TimeLine.of(of.samples.time, of.samples.n_samples, of.samples.starts)
    scene = identified_scene(problem.robot, of.samples, result.estimate.theta, line.instants)
    every = findings(result)
    return charts.page(
        "sdpid.output.report",
        "report.html.j2",
        scene=scene,
        result=result,
        of=of,
        problem=problem,
        headline=headline(result),
        findings=every,
        level=min((each.level for each in every), key=LEVELS.index, default="caution"),
        held=result.held_out,
        other_motion=of.other_motion,
        beside=list(_beside(of)),
        crossed=result.cross_validation,
        states=[s for s in states if s.active],
        constraints=states,
        certified=result.certificate.passed and problem.consistency != "none",
        exports=exports,
        deflections=_deflections(result, charts),
        command=command,
        sha256=sha256,
        **joints.values(of, charts, line),
        **parameters.values(of, intervals, charts),
        **recording.values(of),
        drives=None if result.drives is None else _drives(result.drives, charts),
    )


def _drives(drives: FittedDrives, charts: Charts) -> dict[str, Any]:
    """Return drives that were fitted to positions, and charts of them over the delay."""
    joints, along = drives.joint_names, drives.along
    numbers = []
    if drives.delay_found:
        open_ = 1e3 * np.array([drives.delay_interval])
        columns = [{"error": 1e3 * along["error"]}]
        columns += [dict(zip(joints, along[x].T, strict=True)) for x in ("armature", "damping")]
        numbers = [charts.add(x=1e3 * along["delay"], shaded=open_, **each) for each in columns]
    return {
        "of": drives,
        "charts": numbers,
        "lines": [(joint, _COLORS[k % len(_COLORS)]) for k, joint in enumerate(joints)],
        "sharp": drives.sharp_table(),
    }


def _deflections(result: Judged, charts: Charts) -> list[tuple[str, int]]:
    """Return the joints with two encoders, and the charts of their deflection (mrad, mm)."""
    curves = {} if result.elasticity is None else result.elasticity.curves
    found = []
    for name, (torque, measured, predicted) in curves.items():
        order = np.argsort(torque)
        values = {"x": torque[order], "predicted": 1e3 * predicted[order]}
        held = charts.add(**values, at=torque, measured=1e3 * measured)
        found.append((name, held))
    return found


def _beside(of: VerdictSubject) -> Iterator[dict[str, Any]]:
    """Yield the errors on what was held out of the baselines and of the estimate.

    Bars are logarithmic, from 0.1 % to 100 %.
    """
    for name, fit in () if of.held_out is None else of.held_out.every.items():
        told, joints = fit.told.relative, zip(fit.moving.rmse, fit.moving.rows, strict=True)
        yield {
            "name": name,
            "ours": fit is of.fit,
            "moving": told,
            "length": float(np.clip(1.0 + np.log10(max(told, 1e-9)) / 3.0, 0.0, 1.0)),
            "resting": None if fit.resting is None else fit.resting.relative,
            "rmse": [value if rows else None for value, rows in joints][fit.n_base :],
        }
