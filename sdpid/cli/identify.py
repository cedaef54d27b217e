"""The command ``sdpid identify``: consistent parameters with a proof, from logs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import sdpid.cli.options as opt
from sdpid._common.extras import require
from sdpid._common.files import Source
from sdpid._common.text import printable
from sdpid.cli.config import config_text
from sdpid.cli.endings import OURS, command_line
from sdpid.cli.formulated import robot_and_logs
from sdpid.cli.printing import Printing, errors_table, findings_listed, listed

if TYPE_CHECKING:
    from sdpid.output.robots.export_report import ExportReport


def identify(
    ctx: typer.Context,
    logs: opt.Logs,
    robot: opt.Robot,
    reading: opt.Reading,
    periods: opt.Periods,
    processing: opt.ProcessingOptions,
    estimation: opt.Estimation,
    acceptance: opt.Acceptance,
    printing: Printing,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("sdpid-results"),
    validation: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="LOG", help="Another recording, which is predicted only. May be repeated."
        ),
    ] = None,
    folds: Annotated[
        int | None,
        typer.Option(metavar="N", help="Cross-validate: hold out N blocks of the logs in turn."),
    ] = None,
    rollout: Annotated[
        bool,
        typer.Option(
            "--rollout",
            help="Simulate the first --validation recording in open loop too; takes seconds, a "
            "minute without Numba.",
        ),
    ] = False,
    intervals: Annotated[
        bool, typer.Option(help="Compute confidence intervals of the parameters.")
    ] = True,
    interval_method: Annotated[
        opt.IntervalMethod,
        typer.Option(
            help="Method for the intervals; profile respects the constraints and takes some "
            "seconds."
        ),
    ] = opt.IntervalMethod.gauss_markov,
    figures: Annotated[
        bool, typer.Option(help="Write training.png and validation.png too; needs matplotlib.")
    ] = False,
    offsets: Annotated[
        bool, typer.Option(help="Write offsets into identified.xml, as constant actuators.")
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option("--verbose", "-v", help="Print notes, tables and the whole verdict too."),
    ] = False,
) -> None:
    """Identify a robot: URDF and logs in; consistent URDF, tables, report, certificate out."""
    from sdpid.assurance.recipe.inputs import file_entry
    from sdpid.workflow.results_folder import require_writable

    config = printing.config
    inputs = reading.files((*logs, *(validation or ())), robot)
    require_writable(out, inputs, config=config, writes_config=True)
    if figures:
        require("matplotlib", extra="plot")
    from sdpid.experiment.preparation.prepare import columns_without
    from sdpid.workflow.identify import identify as run

    absent = opt.joints(estimation.without_effort)
    model, records = robot_and_logs(robot, logs, reading, periods, absent)
    columns = columns_without(model, absent)
    checks = [reading.read(log, without_effort=columns) for log in validation or ()]
    formulation = estimation.arguments(model)
    result = run(
        model,
        records,
        validation=checks or None,
        processing=processing.changes(),
        intervals=interval_method.value if intervals else False,
        folds=folds,
        rollout=rollout,
        **acceptance.arguments(),
        **formulation,
    )
    findings = {str(finding) for finding in result.findings}
    notes = [
        *result.problem.samples.notes,
        *(each for each in result.notes if each not in findings),
    ]
    notes += [note for note in (result.intervals_note, result.bias_note) if note]
    exports: list[ExportReport] = []
    if config is not None:
        result = replace(result, inputs=(*result.inputs, file_entry("config", Source.of(config))))
    if not printing.json:
        # Before the files: what it says is known already.
        printing.show(None, "\n".join(printable(line) for line in result.headline.lines))
    saved = result.save(
        out,
        figures=figures,
        offsets=offsets,
        report=notes.append,
        command=command_line(ctx),
        config=config_text(ctx, out),
        exported=exports.append,
    )
    files = [str(path) for path in saved]
    if verbose:
        fits = {"constrained": result.training, "unconstrained": result.training_wls}
        if result.held_out is not None:
            fits["held out"] = result.held_out.fit
        details = [result.summary(), findings_listed(result.findings), listed("notes", notes)]
        details.append(errors_table(fits))
        if result.cross_validation is not None:
            details.append(result.cross_validation.table())
        if result.held_out is not None:
            details.append(result.held_out.table())
        details += [each.table() for each in result.rollouts]
        details += [listed("verdict", result.verdict), listed("files", files)]
        details.append(f"certificate: {result.certificate.summary()}")
    else:
        details = [
            f"written to {out}: {', '.join(path.name for path in saved)}\n"
            f"{len(notes)} notes on choices: with -v, in report.html and result.json"
        ]
    content = {**result.to_dict(), "notes": notes, "files": files}
    content["exports"] = [export.to_dict() for export in exports]
    printing.show(content, "\n" + "\n\n".join(details))
    certificate = result.certificate
    if result.problem.consistency != "none" and not certificate.passed:
        typer.echo(printable(f"sdpid: not certified: {certificate.summary()}"), err=True)
        raise typer.Exit(OURS)
