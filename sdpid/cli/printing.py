"""What commands print: the options for it, lists and tables."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sdpid._common.text import printable
from sdpid.cli.config import read_config

if TYPE_CHECKING:
    from sdpid.assurance.diagnostics.validation import Validation
    from sdpid.experiment.inspection.kinds import Finding

_printing = functools.partial(typer.Option, rich_help_panel="Configuration and output")


@dataclass(frozen=True, kw_only=True)
class Printing:
    """Where options come from, and what is printed."""

    config: Annotated[
        Path | None,
        _printing(
            metavar="FILE",
            help="TOML file with values of options (cutoff = 10.0, friction = ['coulomb', "
            "'viscous']) and of LOG (log = 'run.csv'); options given here win over it.",
            is_eager=True,
            callback=read_config,
        ),
    ] = None
    json: Annotated[bool, _printing("--json", help="Print results as JSON.")] = False
    quiet: Annotated[bool, _printing("--quiet", "-q", help="Print nothing but errors.")] = False

    def show(self, values: Any, text: str) -> None:
        """Print the text, the values as JSON with ``--json``, or nothing with ``--quiet``."""
        if self.quiet:
            return
        if self.json:
            from sdpid._common.tables import json_text

            typer.echo(json_text(values))
        else:
            typer.echo(printable(text, keep="\n"))


def listed(title: str, lines: Iterable[object]) -> str:
    """Return indented lines under a title, line ends within them replaced."""
    return "\n".join((f"{title}:", *(f"  {printable(str(line))}" for line in lines)))


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
