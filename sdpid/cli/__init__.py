"""The command ``sdpid``: the whole way from a robot and a log file to files one can use.

What is heavy is imported by the commands, so that ``sdpid --help`` answers at once.
"""

from __future__ import annotations

import importlib.util
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from sdpid._common.extras import require
from sdpid._common.signals import clean_up_when_ended
from sdpid._common.text import printable
from sdpid.cli import errors
from sdpid.cli import options as opt
from sdpid.cli.audit import audit
from sdpid.cli.choices import (
    constraints_of,
    errors_table,
    friction_terms,
    processing,
    read,
)
from sdpid.cli.logs import info, validate
from sdpid.cli.payload import payload
from sdpid.cli.simulate import simulate

app = typer.Typer(
    cls=errors.Commands,
    add_completion=False,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    help="Robot dynamics identification: physically consistent, globally optimal, and proven so.",
    epilog="Exit status: 0 done, 2 bad input, 3 infeasible or not identifiable, 1 our failure.",
)


def _version(wanted: bool) -> None:
    if wanted:
        from sdpid import __version__

        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def common(
    debug: Annotated[
        bool, typer.Option("--debug", envvar="SDPID_DEBUG", help="Print tracebacks of errors.")
    ] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")
    ] = False,
) -> None:
    """Take the options of every command."""


@app.command()
def identify(
    ctx: typer.Context,
    logs: opt.Logs,
    robot: opt.Robot,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("sdpid-results"),
    validation: Annotated[
        list[Path] | None,
        typer.Option(metavar="LOG", help="Another recording, to be predicted. May be repeated."),
    ] = None,
    folds: Annotated[
        int | None,
        typer.Option(metavar="N", help="Also hold out N blocks of the logs in turn."),
    ] = None,
    intervals: Annotated[bool, typer.Option(help="Find intervals of the parameters.")] = True,
    interval_method: Annotated[
        opt.IntervalMethod,
        typer.Option(help="How; profile says most and takes some seconds."),
    ] = opt.IntervalMethod.gauss_markov,
    consistency: opt.ConsistencyOf = opt.Consistency.pseudo_inertia,
    margin: opt.Margin = 0.0,
    mass_max: opt.MassMax = None,
    prior: opt.PriorOf = None,
    friction: opt.Friction = None,
    without_effort: opt.WithoutEffort = None,
    weighting: opt.WeightingOf = None,
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
    figures: Annotated[
        bool | None, typer.Option(help="By default where matplotlib is installed.")
    ] = None,
    as_json: opt.Json = False,
) -> None:
    """Identify a robot: URDF and logs in; consistent URDF, tables, report, certificate out."""
    from sdpid.workflow.results_folder import require_writable

    require_writable(out, opt.files_read((*logs, *(validation or ())), robot, mapping))
    draw = importlib.util.find_spec("matplotlib") is not None if figures is None else figures
    if draw:
        require("matplotlib", extra="plot")
    how = opt.reading(column, unit, joint_names, effort_scale, mapping, topic)
    records = [read(log, **how, period=period, start=start, periods=periods) for log in logs]
    checks = [read(log, **how) for log in validation or ()]
    from sdpid import workflow
    from sdpid.robot.model.load import load_robot

    model = load_robot(robot)
    result = workflow.identify(
        model,
        records,
        validation=checks or None,
        processing=processing(cutoff, order, velocity, low_pass, derivative),
        friction=friction_terms(friction),
        without_effort=() if without_effort is None else opt.split_list(without_effort),
        weighting=None if weighting is None else weighting.value,
        consistency=consistency.value,
        constraints=constraints_of(model, margin, mass_max),
        prior=prior,
        intervals=interval_method.value if intervals else False,
        folds=folds,
    )
    beware = [result.intervals_note] if result.intervals_note else []
    notes = [*result.problem.samples.notes, *result.notes, *beware]
    command = errors.command_line(ctx)
    saved = result.save(out, figures=draw, report=notes.append, command=command)
    files = [str(path) for path in saved]
    if figures is None and not draw:
        notes.append("no figures: matplotlib is not installed (pip install 'sdpid[plot]')")
    if as_json:
        opt.print_json({**result.to_dict(), "notes": notes, "files": files})
    else:
        fits = {"constrained": result.training, "unconstrained": result.training_wls}
        if result.validation is not None:
            fits["validation"] = result.validation
        parts = [result.summary(), opt.listed("notes", notes), errors_table(fits)]
        if result.cross_validation is not None:
            parts.append(result.cross_validation.table())
        opt.echo("\n\n".join((*parts, opt.listed("files", files))))
    certificate = result.certificate
    if result.problem.consistency != "none" and not certificate.passed:
        typer.echo(printable(f"sdpid: not certified: {certificate.summary()}"), err=True)
        raise typer.Exit(errors.OURS)


@app.command()
def compare(
    log: opt.Log,
    robot: opt.Robot,
    starts: Annotated[int, typer.Option(min=0, help="Random starts of the local solver.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Of the starts.")] = 0,
    max_iterations: Annotated[
        int | None, typer.Option(min=1, help="Limit of the local solvers; each has its own.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="CSV file for the rows.")] = None,
    jobs: Annotated[int | None, typer.Option(help="Processes; by default one a core.")] = None,
    consistency: opt.ConsistencyOf = opt.Consistency.pseudo_inertia,
    margin: opt.Margin = 0.0,
    mass_max: opt.MassMax = None,
    prior: opt.PriorOf = None,
    friction: opt.Friction = None,
    without_effort: opt.WithoutEffort = None,
    weighting: opt.WeightingOf = None,
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
    """Run every solver on one problem and measure them against the proven bound."""
    if out is not None:
        opt.require_folder("--out", out, opt.files_read((log,), robot, mapping))
    how = opt.reading(column, unit, joint_names, effort_scale, mapping, topic)
    record = read(log, **how, period=period, start=start, periods=periods)
    from sdpid import workflow
    from sdpid.robot.model.load import load_robot
    from sdpid.workflow.comparison import compare as run

    model = load_robot(robot)
    problem = workflow.formulate(
        model,
        record,
        processing=processing(cutoff, order, velocity, low_pass, derivative),
        friction=friction_terms(friction),
        without_effort=() if without_effort is None else opt.split_list(without_effort),
        weighting=None if weighting is None else weighting.value,
        consistency=consistency.value,
        constraints=constraints_of(model, margin, mass_max),
        prior=prior,
    )
    comparison = run(problem, starts=starts, seed=seed, max_iterations=max_iterations, n_jobs=jobs)
    if out is not None:
        comparison.to_csv(out)
    bound = comparison.certificate
    if as_json:
        opt.print_json(
            {
                "lower_bound": bound.lower_bound,
                "certified": bound.passed,
                "rows": [vars(row) for row in comparison.rows],
                "files": [] if out is None else [str(out)],
            }
        )
        return
    opt.echo(f"{comparison.table()}\n\nsdp: {bound.summary()}")
    if out is not None:
        opt.echo(opt.listed("files", [str(out)]))


for command in (simulate, audit, payload, validate, info):
    app.command()(command)


@app.command()
def verify(
    certificate: Annotated[Path, typer.Argument(help="File that `sdpid identify` wrote.")],
    as_json: opt.Json = False,
) -> None:
    """Check a certificate in exact arithmetic, from its own numbers; status 2 when it fails."""
    from sdpid.assurance.certificate.certificate import verify as run

    found = run(certificate)
    if as_json:
        opt.print_json(asdict(found))
    else:
        statements = map(printable, found.statements)
        opt.echo("\n".join((*statements, "PROVEN." if found.passed else "NOT PROVEN.")))
    if not found.passed:
        reasons = "; ".join(found.problems)
        text = f"sdpid: {certificate}: the certificate does not hold: {reasons}."
        typer.echo(printable(text), err=True)
        raise typer.Exit(errors.BAD_INPUT)


def main() -> None:
    """Run the command."""
    errors.open_standard_streams()
    clean_up_when_ended()
    app(prog_name="sdpid")
