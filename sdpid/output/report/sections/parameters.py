"""Base and standard parameters with their intervals and sources."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sdpid.assurance.diagnostics.provenance import provenance
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.output.report.judged import Judged
from sdpid.output.report.sections.forest import pictures
from sdpid.output.tables.intervals_shown import Ends, ends_of, in_words
from sdpid.output.tables.parameter_tables import base_table

# Values below this share of their standard error are what a solver leaves of zero, at a bound.
_NOTHING = 1e-6


def values(result: Judged, intervals: Intervals | None) -> dict[str, Any]:
    """Return the values of the template."""
    ends = ends_of(intervals)
    base, theta = list(base_rows(result, ends)), list(_theta(result, ends))
    return {
        "forest": list(pictures(result, ends)),
        "base": base,
        "theta": theta,
        "has_errors": any(row["error"] is not None for row in base),
        "has_intervals": any(row["interval"] for row in (*base, *theta)),
        "intervals_in_words": in_words(intervals),
    }


def base_rows(result: Judged, ends: dict[str, Ends]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table of base parameters."""
    for row in base_table(result.estimate, result.wls).rows:
        name, unit, value, error, free, regrouping = row
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
