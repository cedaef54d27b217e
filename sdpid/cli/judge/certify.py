"""The command ``sdpid certify``: parameters found elsewhere, against the proven optimum."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import sdpid.cli.options as opt
from sdpid.cli.endings import NO_ANSWER
from sdpid.cli.formulated import formulated
from sdpid.cli.printing import Printing, findings_listed, listed


def certify(
    parameters: Annotated[
        Path,
        typer.Argument(
            metavar="PARAMETERS",
            help="Standard or base parameters: parameters.json or .yaml of a run, a table (.csv), "
            "or a URDF or MJCF.",
        ),
    ],
    logs: Annotated[
        list[Path],
        typer.Option("--log", metavar="LOG", help="Log as for `sdpid identify`. May be repeated."),
    ],
    robot: opt.Robot,
    reading: opt.Reading,
    periods: opt.Periods,
    processing: opt.ProcessingOptions,
    estimation: opt.Estimation,
    acceptance: opt.Acceptance,
    printing: Printing,
    value: Annotated[
        str, typer.Option(metavar="COLUMN", help="Column of the values in a table.")
    ] = "value",
    certificate: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="JSON file for the proof, which `sdpid verify` checks."),
    ] = None,
) -> None:
    """Say how far parameters that were found elsewhere are from the best feasible ones.

    The problem is the one that `sdpid identify` solves with the same options; --config takes its
    run.toml. Ends with status 3 when the parameters break a constraint.
    """
    if certificate is not None:
        inputs = [parameters, *reading.files(logs, robot, printing.config)]
        opt.require_folder("--certificate", certificate, inputs)
    from sdpid.workflow.certify_parameters import certify_parameters, read_given

    problem, prepared = formulated(
        robot, logs, reading, periods, processing, estimation, acceptance
    )
    given = read_given(parameters, problem.robot, value=value)
    judged = certify_parameters(problem, given)
    files = [] if certificate is None else [str(certificate)]
    text = judged.summary()
    if prepared.findings:
        text = f"{findings_listed(prepared.findings)}\n\n{text}"
    if certificate is not None:
        judged.certificate.to_json(certificate)
        text = f"{text}\n{listed('files', files)}"
    content = {
        **judged.to_dict(),
        "findings": [finding.to_dict() for finding in prepared.findings],
        "files": files,
    }
    printing.show(content, text)
    if judged.feasible is False:
        raise typer.Exit(NO_ANSWER)
