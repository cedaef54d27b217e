"""The command ``sdpid validate``: efforts of a log, predicted with a robot description."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import sdpid.cli.options as opt
from sdpid._common.extras import require
from sdpid.cli.formulated import robot_and_logs
from sdpid.cli.printing import Printing, errors_table, findings_listed, listed

if TYPE_CHECKING:
    from sdpid.assurance.rollouts.result import Rollout


def validate(
    log: opt.Log,
    robot: opt.Robot,
    reading: opt.Reading,
    periods: opt.Periods,
    processing: opt.ProcessingOptions,
    acceptance: opt.Acceptance,
    printing: Printing,
    without_effort: opt.WithoutEffort = None,
    figure: Annotated[Path | None, typer.Option(help="Image file for the plot.")] = None,
    rollout: Annotated[
        bool,
        typer.Option(
            "--rollout",
            help="Simulate the robot under the log's efforts too, and compare positions.",
        ),
    ] = False,
) -> None:
    """Predict a log's efforts with a URDF: its inertias, its damping and its friction.

    An MJCF's armature counts too. Offsets have no place in either and are not predicted.
    """
    if figure is not None:
        require("matplotlib", extra="plot")
        opt.require_folder("--figure", figure, reading.files((log,), robot, printing.config))
    from sdpid.assurance.diagnostics.validation import validate_robot
    from sdpid.experiment.preparation.prepare import prepare
    from sdpid.output.report.verdict import prediction_findings

    absent = opt.joints(without_effort)
    model, (record,) = robot_and_logs(robot, [log], reading, periods, absent)
    prepared = prepare(
        model,
        record,
        {**processing.changes(), "covariance": None},
        without_effort=absent,
        **acceptance.arguments(),
    )
    findings, samples, chosen = prepared.findings, prepared.samples, prepared.processing
    fit = validate_robot(model, samples)
    files = []
    if figure is not None:
        from sdpid.plots.figures import save_figure

        save_figure(fit.plot(), figure)
        files.append(str(figure))
    verdict = [finding.text for finding in prediction_findings(model, samples, fit)]
    notes = list(samples.notes)
    parts = [
        f"{model.name}: relative residual in motion {100 * fit.told.relative:.2f} %\n"
        + listed("verdict", verdict),
        listed("notes", notes),
        errors_table({"prediction": fit}),
    ]
    moved: tuple[Rollout, ...] = ()
    if rollout:
        from sdpid.assurance.diagnostics.described import described_dynamics
        from sdpid.assurance.rollouts.rollout import rollouts
        from sdpid.output.report.parameters import fresh_notes

        described = described_dynamics(model, samples)
        moved = rollouts(described, record, processing=chosen, without_effort=absent)
        verdict += [each.verdict for each in moved]
        for each, told in zip(moved, fresh_notes(moved), strict=True):
            parts += [each.table(), *([listed("notes", told)] if told else [])]
    if findings:
        parts.insert(1, findings_listed(findings))
    if files:
        parts.append(listed("files", files))
    found = [finding.to_dict() for finding in findings]
    content = {
        **fit.to_dict(),
        "findings": found,
        "verdict": verdict,
        "notes": notes,
        "files": files,
        "rollouts": [each.to_dict() for each in moved],
    }
    printing.show(content, "\n\n".join(parts))
