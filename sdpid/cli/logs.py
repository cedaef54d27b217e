"""The commands about a log: ``sdpid info`` shows it, ``sdpid validate`` predicts its efforts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from sdpid._common.extras import require
from sdpid.cli import options as opt
from sdpid.cli.choices import errors_table, processing, read


def validate(
    log: opt.Log,
    robot: opt.Robot,
    figure: Annotated[Path | None, typer.Option(help="Image file for the plot.")] = None,
    cutoff: opt.Cutoff = None,
    order: opt.Order = None,
    velocity: opt.VelocityFrom = None,
    low_pass: opt.Filter = None,
    derivative: opt.DerivativeBy = None,
    period: opt.Period = None,
    start: opt.Start = None,
    periods: opt.Periods = None,
    column: opt.Column = None,
    unit: opt.Unit = None,
    joint_names: opt.JointNames = None,
    effort_scale: opt.EffortScale = None,
    mapping: opt.Mapping = None,
    topic: opt.Topic = None,
    as_json: opt.Json = False,
) -> None:
    """Predict a log's efforts with a URDF: its inertias, its damping and its friction.

    Offsets and rotor inertias have no place in a URDF and are not predicted.
    """
    if figure is not None:
        require("matplotlib", extra="plot")
        opt.require_folder("--figure", figure, opt.files_read((log,), robot, mapping))
    how = opt.reading(column, unit, joint_names, effort_scale, mapping, topic)
    record = read(log, **how, period=period, start=start, periods=periods)
    from sdpid.assurance.diagnostics.validation import validate_robot
    from sdpid.experiment.preparation.for_robot import SMOOTH, prepare
    from sdpid.experiment.preparation.several import chosen_processing
    from sdpid.output.report.prediction_verdict import prediction_findings
    from sdpid.robot.model.load import load_robot

    model = load_robot(robot)
    changes = processing(cutoff, order, velocity, low_pass, derivative)
    chosen, _ = chosen_processing([record], changes)
    samples = prepare(model, record, replace(chosen, covariance=None))
    fit = validate_robot(model, samples, width=0.0 if record.period is not None else SMOOTH)
    files = []
    if figure is not None:
        from sdpid.output.plots.plots import plot_fit, save_figure

        save_figure(plot_fit(samples, fit), figure)
        files.append(str(figure))
    verdict = [finding.text for finding in prediction_findings(samples, fit)]
    if as_json:
        notes = list(samples.notes)
        opt.print_json({**fit.to_dict(), "verdict": verdict, "notes": notes, "files": files})
        return
    opt.echo(f"{model.name}: relative residual {100 * fit.relative:.2f} %")
    parts = (
        opt.listed("verdict", verdict),
        opt.listed("notes", samples.notes),
        errors_table({"prediction": fit}),
    )
    opt.echo("\n\n".join(parts))
    if files:
        opt.echo(opt.listed("\nfiles", files))


def info(
    log: opt.Log,
    robot: Annotated[str | None, typer.Option(help="Robot to compare with.")] = None,
    period: opt.Period = None,
    start: opt.Start = None,
    periods: opt.Periods = None,
    column: opt.Column = None,
    unit: opt.Unit = None,
    joint_names: opt.JointNames = None,
    effort_scale: opt.EffortScale = None,
    mapping: opt.Mapping = None,
    topic: opt.Topic = None,
    as_json: opt.Json = False,
) -> None:
    """Show what was understood of a log, and what looks wrong with it."""
    how = opt.reading(column, unit, joint_names, effort_scale, mapping, topic)
    from sdpid.experiment.preparation.overview import overview
    from sdpid.experiment.readers.read import read_described
    from sdpid.robot.model.load import load_robot

    found = read_described(log, **how, period=period, start=start, periods=periods)
    facts = overview(found.recording, None if robot is None else load_robot(robot))
    facts = {"file": found.file, "mapping": found.mapping, "read_from": found.sources, **facts}
    if as_json:
        opt.print_json(facts)
        return
    from sdpid._common.tables import Table

    joints = facts.pop("joints")
    findings = facts.pop("findings")
    sources = [f"{quantity}: {source}" for quantity, source in facts.pop("read_from").items()]
    facts["processing"] = ", ".join(f"{k}={v}" for k, v in (facts["processing"] or {}).items())
    width = max(map(len, facts))
    for key, value in facts.items():
        shown = f"{value:.6g}" if isinstance(value, float) else value
        opt.echo(f"{key.replace('_', ' '):{width}}  {'-' if shown is None else shown}")
    rows = tuple(tuple(joint.values()) for joint in joints)
    opt.echo("\n" + opt.listed("read from", sources))
    opt.echo("\n" + Table(tuple(joints[0]), rows).text())
    if findings:
        lines = [f"{each['severity']}: {each['text']}" for each in findings]
        opt.echo("\n" + opt.listed("findings", lines))
