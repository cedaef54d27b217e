"""Tables of parameters, and intervals as they are shown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from sdpid._common.tables import Table, plain
from sdpid.assurance.diagnostics.provenance import provenance
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.errors import DataError, IdentifiabilityError
from sdpid.estimation.estimate import Estimate

_ABOUT = {
    "profile": "the values of physically possible parameters that the data do not rule out",
    "gauss_markov": "how far the estimate may be from the truth; standard parameters that the data "
    "alone do not determine have none",
    "bootstrap": "how the constrained estimate scatters when blocks of the data are drawn again",
}


class Ends(NamedTuple):
    """An interval and its label; an end that is not finite is None."""

    lower: float | None
    upper: float | None
    label: str


def ends_of(intervals: Intervals | None) -> dict[str, Ends]:
    """Return the intervals by parameter."""
    if intervals is None:
        return {}
    ends = plain(intervals.lower), plain(intervals.upper)
    columns = zip(intervals.names, *ends, intervals.label, strict=True)
    return {str(name): Ends(low, high, str(label)) for name, low, high, label in columns}


def intervals_dict(intervals: Intervals) -> dict[str, Any]:
    """Return intervals as plain values, with the ends that tables show."""
    ends = ends_of(intervals)
    content = intervals.to_dict()
    for entry in content["parameters"]:
        entry["lower"], entry["upper"], _ = ends[entry["name"]]
    return content


def in_words(intervals: Intervals | None) -> str | None:
    """Return level and meaning of intervals in words; None for an unknown method."""
    method = getattr(intervals, "method", None)
    level = getattr(intervals, "level", None)
    if method not in _ABOUT or level is None:
        return None
    return f"{100.0 * level:g} % intervals ({method}): {_ABOUT[method]}"


def base_table(
    estimate: Estimate, wls: Estimate | None = None, intervals: Intervals | None = None
) -> Table:
    """Return the table of base parameters, with errors, the unconstrained fit and intervals."""
    base = estimate.problem.base
    columns: dict[str, Sequence[object]] = {"parameter": base.names, "unit": base.units}
    columns |= {"value": estimate.base.tolist(), "standard_error": known_errors(estimate)}
    if wls is not None:
        columns["unconstrained"] = wls.base.tolist()
    columns |= _end_columns(base.names, intervals)
    columns["regrouping"] = [base.expression(name) for name in base.names]
    return Table.of_columns(columns)


def known_errors(estimate: Estimate) -> list[float | None]:
    """Return the standard errors of the base parameters, None where there are none."""
    try:
        return list(plain(estimate.standard_errors))
    except (IdentifiabilityError, DataError):
        # Without rows there are none, nor where data without a prior leave something open.
        return [None] * estimate.problem.base.count


def theta_table(estimate: Estimate, intervals: Intervals | None = None) -> Table:
    """Return the table of standard parameters, with intervals and shares of their sources."""
    base = estimate.problem.base
    none: list[None] = [None] * len(base.theta_names)
    columns: dict[str, Sequence[object]] = {"parameter": base.theta_names, "unit": base.theta_units}
    columns["value"] = none if estimate.theta is None else estimate.theta.tolist()
    columns |= _end_columns(base.theta_names, intervals)
    sources = None if estimate.theta is None else provenance(estimate)
    for name in ("data", "physics", "prior"):
        columns[name] = none if sources is None else getattr(sources, name).tolist()
    return Table.of_columns(columns)


def _end_columns(names: Sequence[str], intervals: Intervals | None) -> dict[str, Sequence[object]]:
    """Return lower ends, upper ends and labels of the intervals of the named parameters."""
    if intervals is None:
        return {}
    ends, none = ends_of(intervals), Ends(None, None, "")
    columns = zip(*(ends.get(name, none) for name in names), strict=True)
    return dict(zip(Ends._fields, columns, strict=True))
