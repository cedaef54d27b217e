"""Tables of base and standard parameters."""

from __future__ import annotations

from collections.abc import Sequence

from sdpid._common.tables import Table, plain
from sdpid.assurance.diagnostics.provenance import provenance
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.errors import DataError, IdentifiabilityError
from sdpid.estimation.estimate import Estimate
from sdpid.output.tables.intervals_shown import Ends, ends_of

# Columns of an interval.
_ENDS = ("lower", "upper", "label")


def base_table(
    estimate: Estimate, wls: Estimate | None = None, intervals: Intervals | None = None
) -> Table:
    """Return the table of base parameters, with errors, the unconstrained fit and intervals."""
    base = estimate.problem.base
    header = ["parameter", "unit", "value", "standard_error"]
    columns: list[Sequence[object]] = [base.names, base.units, estimate.base.tolist()]
    columns.append(known_errors(estimate))
    if wls is not None:
        header.append("unconstrained")
        columns.append(wls.base.tolist())
    if intervals is not None:
        header += _ENDS
        columns += _end_columns(base.names, intervals)
    header.append("regrouping")
    columns.append([base.expression(name) for name in base.names])
    return Table(tuple(header), tuple(zip(*columns, strict=True)))


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
    sources = None if estimate.theta is None else provenance(estimate)
    columns: list[Sequence[object]] = [base.theta_names, base.theta_units]
    columns.append(none if estimate.theta is None else estimate.theta.tolist())
    header = ["parameter", "unit", "value"]
    if intervals is not None:
        header += _ENDS
        columns += _end_columns(base.theta_names, intervals)
    for name in ("data", "physics", "prior"):
        header.append(name)
        columns.append(none if sources is None else getattr(sources, name).tolist())
    return Table(tuple(header), tuple(zip(*columns, strict=True)))


def _end_columns(names: Sequence[str], intervals: Intervals) -> list[Sequence[object]]:
    """Return lower ends, upper ends and labels of the intervals of the named parameters."""
    ends, none = ends_of(intervals), Ends(None, None, "")
    rows = [ends.get(name, none) for name in names]
    return [[row.lower for row in rows], [row.upper for row in rows], [row.label for row in rows]]
