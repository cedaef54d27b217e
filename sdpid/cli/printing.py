"""What commands print: lists and tables."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from sdpid._common.files import printable

if TYPE_CHECKING:
    from sdpid.assurance.diagnostics.validation import Validation
    from sdpid.experiment.inspection.kinds import Finding


def listed(title: str, lines: Iterable[object]) -> str:
    """Return indented lines under a title, line ends within them replaced; of none, nothing."""
    shown = [f"  {printable(str(line))}" for line in lines]
    return "\n".join((f"{title}:", *shown)) if shown else ""


def findings_listed(findings: Iterable[Finding]) -> str:
    """Return what is wrong with recordings that are used, a line each."""
    return listed("findings", (each.line() for each in findings))


def errors_table(fits: dict[str, Validation]) -> str:
    """Return the errors of every joint, a pair of columns for each fit."""
    from sdpid._common.tables import Table

    first = next(iter(fits.values()))
    header = ["joint"]
    # A base that is held in one recording may move in another.
    free = next((fit.floating for fit in fits.values() if fit.floating is not None), None)
    base = () if free is None else tuple(name for name, _ in free.rows)
    columns: list[list[Any]] = [[*first.joint_names[first.n_base :], *base]]
    for label, fit in fits.items():
        header += [f"{label} RMSE [N.m]", "NRMSE [%]"]
        missed: list[float | None] = [None] * len(base)
        if fit.floating is not None:
            missed = [size for _, size in fit.floating.rows]
        own = fit.told
        for values, more in ((own.rmse, missed), (100.0 * own.nrmse, [None] * len(base))):
            rows = zip(values.tolist(), own.rows.tolist(), strict=True)
            columns.append([*[x if k else None for x, k in rows][fit.n_base :], *more])
    table = Table(tuple(header), tuple(zip(*columns, strict=True))).text(4)
    silent = [
        name
        for j, name in enumerate(first.joint_names)
        if any(math.isinf(fit.told.nrmse[j]) for fit in fits.values())
    ]
    note = f"\nno effort of which errors are a share: {', '.join(silent)}" if silent else ""
    return f"in motion:\n{table}{note}"
