"""The report: one HTML file with the verdict, data, fit, parameters and certificate.

It loads no other file: style and pictures are in it, and a Content-Security-Policy forbids the
rest. Names of robots, joints and links, and notes, are escaped.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.extras import require
from sdpid._common.files import atomic_write_text
from sdpid.assurance.diagnostics.active_constraints import constraint_states
from sdpid.assurance.diagnostics.provenance import provenance
from sdpid.assurance.diagnostics.residuals import JointErrors, period
from sdpid.assurance.diagnostics.validation import Errors
from sdpid.estimation.information import WEAK
from sdpid.experiment.processing.samples import Samples
from sdpid.output.report.headline import headline
from sdpid.output.report.judged import Judged, errors_of, grades_of, judged
from sdpid.output.report.page import page
from sdpid.output.report.verdict import findings
from sdpid.output.robots.export_report import ExportReport
from sdpid.output.tables.intervals_shown import Ends, GivenIntervals, ends_of, in_words
from sdpid.output.tables.parameter_tables import base_table
from sdpid.plots.figures import stretch
from sdpid.plots.inline_svg import image_source
from sdpid.plots.joints import COLUMNS, plot_joint, plot_joint_errors

# Weakly excited directions that are listed one by one; more say no more.
_DIRECTIONS = 12

# What the pictures show.
_EFFORTS = "measured against predicted effort, and the error"
_ERRORS = "spectrum, autocorrelation and velocity dependence of the error"

# Values below this share of their standard error are what a solver leaves of zero, at a bound.
_NOTHING = 1e-6


def write_report(
    identification: Judged,
    target: str | os.PathLike[str],
    *,
    command: str | None = None,
    intervals: GivenIntervals | None = None,
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
        Draw plots; by default where matplotlib is installed.
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
    intervals: GivenIntervals | None = None,
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
    shown = _context(identification, drawable if figures is None else figures, intervals)
    return page(
        "sdpid.output.report",
        "report.html.j2",
        **shown,
        exports=exports,
        command=command,
        sha256=sha256,
        drawable=drawable,
    )


def _context(result: Judged, draw: bool, intervals: GivenIntervals | None) -> dict[str, Any]:
    """Return the variables of the template."""
    problem, certificate = result.problem, result.certificate
    samples, _ = judged(result)
    errors = errors_of(result)
    ends = ends_of(intervals)
    base, theta = list(_base(result, ends)), list(_theta(result, ends))
    states = constraint_states(result.estimate)
    return {
        "robot": problem.robot,
        "result": result,
        "problem": problem,
        "sample_count": problem.n_samples,
        "thinned": _thinned(result),
        "held": result.held_out,
        "held_title": _held_title(result),
        "other_motion": result.held_out is not None and result.held_out.by == "recording",
        "beside": list(_beside(result)),
        "headline": headline(result),
        "findings": findings(result, errors),
        "data": list(_data(result)),
        "joints": list(_joints(result)),
        "excitation": _excitation(result),
        "weak_limit": WEAK,
        "fits": list(_fits(result)),
        "has_mask": samples.mask is not None,
        "plots": list(_plots(result, errors)) if draw else [],
        "stretch": stretch(samples.n_samples, points=2 * COLUMNS),
        "base": base,
        "theta": theta,
        "friction": [_term(term) for term in problem.friction.described()],
        "has_errors": any(row["error"] is not None for row in base),
        "has_intervals": any(row["interval"] for row in (*base, *theta)),
        "intervals_in_words": in_words(intervals),
        "crossed": result.cross_validation,
        "states": [s for s in states if s.active],
        "state_count": len(states),
        "certificate": certificate,
        "certified": certificate.passed and problem.consistency != "none",
        "cost": certificate.cost,
        "lower_bound": certificate.lower_bound,
        "gap": certificate.gap,
        "worst_margin": result.estimate.worst_margin,
    }


def _data(result: Judged) -> Iterator[tuple[str, list[str]]]:
    """Yield facts about the recordings: a label, and a value for each recording."""
    problem = result.problem
    parts = [problem.samples]
    counts = [(problem.n_samples, problem.n_rows)]
    rates = [_rate(problem.samples, problem.n_samples)]
    if (fresh := result.validation_samples) is not None:
        parts.append(fresh)
        counts.append((fresh.n_samples, fresh.n_rows))
        rates.append(_rate(fresh, fresh.n_samples))
    yield "samples", [f"{samples:,}" for samples, _ in counts]
    yield "rows used", [f"{rows:,} of {samples * problem.robot.n:,}" for samples, rows in counts]
    yield "rate", rates
    yield "duration", [_duration(s) for s in parts]
    if any(len(s.starts) > 1 for s in parts):
        yield "pieces, recorded apart", [str(len(s.starts)) for s in parts]
    if any(s.periods is not None for s in parts):
        yield "periods averaged", ["–" if s.periods is None else str(s.periods) for s in parts]


def _thinned(result: Judged) -> int:
    """Return how many samples each one here stands for: over 1 if rows are on a cluster."""
    problem = result.problem
    return max(round(problem.n_samples / max(problem.samples.n_samples, 1)), 1)


def _rate(samples: Samples, count: int) -> str:
    """Return the sample rate in words; of `count` samples these are all, or evenly spread."""
    if samples.time is None:
        return "–"
    if count == samples.n_samples:
        return f"{1.0 / period(samples):.5g} Hz"
    return f"{count / _seconds(samples):.4g} Hz"


def _duration(samples: Samples) -> str:
    return "–" if samples.time is None else f"{_seconds(samples):.5g} s"


def _seconds(samples: Samples) -> float:
    # The last sample of a piece lasts as long as the others.
    assert samples.time is not None
    pieces = [samples.time[part] for part in samples.parts]
    return sum(float(piece[-1] - piece[0]) + period(samples) for piece in pieces)


def _term(described: dict[str, Any]) -> str:
    """Return a friction term, its parameters and its numbers in words."""
    names = described["parameters"]
    numbers = [", ".join(names) if len(names) < 4 else f"{names[0]} to {names[-1]}"]
    for key, value in described.items():
        # Bodies that columns were taken at are those of the estimate, which stand in a table.
        if key in ("term", "parameters", "bodies") or value in (None, 0.0, [], ()):
            continue
        many = value if isinstance(value, (list, tuple)) else [value]
        shown = (f"{v:.3g}" if isinstance(v, float) else str(v) for v in many)
        numbers.append(f"{key.replace('_', ' ')} {', '.join(shown)}")
    return f"{described['term']} ({'; '.join(numbers)})"


def _joints(result: Judged) -> Iterator[dict[str, Any]]:
    """Yield range, peak speed, peak acceleration and RMS effort of every joint."""
    samples, robot = result.problem.samples, result.problem.robot
    shift = samples.position.shape[1] - robot.n
    for j in range(robot.n):
        kept = samples.used[:, j]
        own = j >= robot.n_base
        q = samples.position[:, j + shift] if own else None
        yield {
            "name": robot.joint_names[j],
            "low": None if q is None else float(q.min()),
            "high": None if q is None else float(q.max()),
            "speed": float(np.abs(samples.velocity[:, j]).max()),
            "acceleration": float(np.abs(samples.acceleration[:, j]).max()),
            "effort": float(np.sqrt(np.mean(samples.effort[kept, j] ** 2))) if kept.any() else None,
        }


def _excitation(result: Judged) -> dict[str, Any]:
    """Return condition number and weakly excited directions."""
    excitation = result.problem.excitation
    weak = excitation.weak()
    return {
        "condition": excitation.condition_number,
        "largest": float(excitation.singular_values[0]),
        "count": len(excitation.names),
        "weak": weak[::-1][:_DIRECTIONS],
        "weak_count": len(weak),
    }


def _fits(result: Judged) -> Iterator[dict[str, Any]]:
    """Yield the errors of every joint, on training and validation data."""
    training, free = result.training, result.training_wls
    held = None if result.held_out is None else result.held_out.fit.moving
    levels = {each.joint: each.level for each in grades_of(result)}
    for j, name in enumerate(training.joint_names):
        if training.rows[j] == 0:
            continue
        yield {
            "name": name,
            "level": levels[j],
            "training": _errors(training, j),
            "free": _errors(free, j),
            "held": None if held is None else _errors(held, j),
        }


def _held_title(result: Judged) -> str:
    """Return what was held out, as the title of columns."""
    if result.held_out is None:
        return ""
    if result.held_out.by == "recording":
        return "validation (held out)"
    return f"{result.held_out.blocks} blocks (held out in turn)"


def _beside(result: Judged) -> Iterator[dict[str, Any]]:
    """Yield the errors on what was held out of the baselines and of the estimate."""
    if result.held_out is None:
        return
    for name, fit in result.held_out.every.items():
        joints = zip(fit.moving.rmse.tolist(), fit.moving.rows.tolist(), strict=True)
        yield {
            "name": name,
            "moving": fit.moving.relative,
            "resting": None if fit.resting is None else fit.resting.relative,
            "rmse": [value if rows else None for value, rows in joints],
        }


def _errors(fit: Errors, j: int) -> dict[str, float]:
    return {"rmse": float(fit.rmse[j]), "nrmse": float(fit.nrmse[j]), "r2": float(fit.r2[j])}


def _plots(result: Judged, errors: tuple[JointErrors, ...]) -> Iterator[dict[str, Any]]:
    """Yield the figures of every joint."""
    samples, fit = judged(result)
    shown = {each.joint: each for each in errors}
    for j, name in enumerate(fit.joint_names):
        if name not in shown:
            continue
        columns = samples.effort[:, j], fit.effort_predicted[:, j], samples.used[:, j]
        efforts = plot_joint(samples.time, *columns, starts=samples.starts)
        found = plot_joint_errors(shown[name], timed=samples.time is not None)
        yield {
            "name": name,
            "rmse": float(fit.rmse[j]),
            "r2": float(fit.r2[j]),
            "pictures": [
                (image_source(efforts), _EFFORTS),
                (image_source(found), _ERRORS),
            ],
        }


def _base(result: Judged, ends: dict[str, Ends]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table of base parameters."""
    for row in base_table(result.estimate, result.wls).rows:
        name, unit, value, free, error, regrouping = row
        if isinstance(error, float) and isinstance(value, float) and abs(value) < _NOTHING * error:
            value = 0.0
        yield {
            "name": name,
            "unit": unit,
            "value": value,
            "free": free,
            "error": error,
            "regrouping": regrouping,
            "interval": ends.get(str(name)),
        }


def _theta(result: Judged, ends: dict[str, Ends]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table of standard parameters, with shares of their sources."""
    estimate, base = result.estimate, result.problem.base
    if estimate.theta is None:
        return
    sources = provenance(estimate)
    for k, name in enumerate(base.theta_names):
        shares = [float(sources.data[k]), float(sources.physics[k]), float(sources.prior[k])]
        yield {
            "name": name,
            "unit": base.theta_units[k],
            "value": float(estimate.theta[k]),
            "shares": shares,
            "interval": ends.get(name),
        }
