"""The command ``sdpid compare``: every solver on one problem."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import sdpid.cli.options as opt
from sdpid.cli.formulated import formulated
from sdpid.cli.printing import Printing, findings_listed, listed


def compare(
    log: opt.Log,
    robot: opt.Robot,
    reading: opt.Reading,
    periods: opt.Periods,
    processing: opt.ProcessingOptions,
    estimation: opt.Estimation,
    acceptance: opt.Acceptance,
    printing: Printing,
    starts: Annotated[
        int, typer.Option(min=0, help="Number of random starts of each local solver.")
    ] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the starts.")] = 0,
    max_iterations: Annotated[
        int | None,
        typer.Option(
            min=1, help="Largest number of iterations of the local solvers; each has its own."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="CSV file for the rows.")] = None,
    jobs: Annotated[
        int | None, typer.Option(help="Number of processes. Default: one a core.")
    ] = None,
) -> None:
    """Run every solver on one problem and measure them against the proven lower bound."""
    if out is not None:
        opt.require_folder("--out", out, reading.files((log,), robot, printing.config))
    from sdpid.workflow.comparison import compare as run

    problem, prepared = formulated(
        robot, [log], reading, periods, processing, estimation, acceptance
    )
    comparison = run(problem, starts=starts, seed=seed, max_iterations=max_iterations, n_jobs=jobs)
    files = [] if out is None else [str(out)]
    if out is not None:
        comparison.to_csv(out)
    certificate = comparison.certificate
    text = f"{comparison.table()}\n\nsdp: {certificate.summary()}"
    if prepared.findings:
        text = f"{findings_listed(prepared.findings)}\n\n{text}"
    content = {
        "findings": [finding.to_dict() for finding in prepared.findings],
        "lower_bound": certificate.lower_bound,
        "certified": certificate.passed,
        "rows": comparison.rows,
        "files": files,
    }
    printing.show(content, "\n".join((text, listed("files", files))) if files else text)
