"""The command ``sdpid``: the whole way from a robot and a log file to files one can use.

What is heavy is imported by the commands, so that ``sdpid --help`` answers at once.
"""

from __future__ import annotations

import importlib.util
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sdpid import _cli_support as cli
from sdpid._extras import require
from sdpid.cli_audit import audit
from sdpid.cli_payload import payload
from sdpid.errors import ExportError, ModelError

if TYPE_CHECKING:
    from collections.abc import Callable

    from sdpid.assurance.validation import Validation
    from sdpid.estimation.constraints import Constraints
    from sdpid.experiment.processing import Processing
    from sdpid.experiment.recording import Recording
    from sdpid.robot.friction import FrictionTerm
    from sdpid.robot.model import RobotModel

app = typer.Typer(
    cls=cli.Commands,
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
def options(
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
    log: cli.Log,
    robot: cli.Robot,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("sdpid-results"),
    validation: Annotated[
        Path | None, typer.Option(help="Another recording, to be predicted.")
    ] = None,
    consistency: cli.ConsistencyOf = cli.Consistency.pseudo_inertia,
    margin: cli.Margin = 0.0,
    mass_max: cli.MassMax = None,
    prior: cli.PriorOf = None,
    friction: cli.Friction = None,
    weighting: cli.WeightingOf = None,
    cutoff: cli.Cutoff = None,
    order: cli.Order = None,
    velocity: cli.VelocityFrom = None,
    period: cli.Period = None,
    start: cli.Start = None,
    periods: cli.Periods = None,
    column: cli.Column = None,
    unit: cli.Unit = None,
    joint_names: cli.JointNames = None,
    effort_scale: cli.EffortScale = None,
    mapping: cli.Mapping = None,
    topic: cli.Topic = None,
    figures: Annotated[
        bool | None, typer.Option(help="By default where matplotlib is installed.")
    ] = None,
    as_json: cli.Json = False,
) -> None:
    """Identify a robot: URDF and log in, consistent URDF, tables, report and certificate out."""
    if out.exists() and not out.is_dir():
        raise ExportError(f"--out {out}: is a file; name a folder.")
    draw = importlib.util.find_spec("matplotlib") is not None if figures is None else figures
    if draw:
        require("matplotlib", extra="plot")
    how = cli.reading(column, unit, joint_names, effort_scale, mapping, topic)
    record = _read(log, **how, period=period, start=start, periods=periods)
    check = None if validation is None else _read(validation, **how)
    from sdpid import workflow
    from sdpid.robot.load import load_robot

    model = load_robot(robot)
    result = workflow.identify(
        model,
        record,
        validation=check,
        processing=_processing(record, cutoff, order, velocity),
        friction=_friction(friction),
        weighting=None if weighting is None else weighting.value,
        consistency=consistency.value,
        constraints=_constraints(model, margin, mass_max),
        prior=prior,
    )
    notes = list(result.problem.samples.notes)
    command = cli.command_line(ctx)
    saved = result.save(out, figures=draw, report=notes.append, command=command)
    files = [str(path) for path in saved]
    if figures is None and not draw:
        notes.append("no figures: matplotlib is not installed (pip install 'sdpid[plot]')")
    if as_json:
        cli.print_json({**result.to_dict(), "notes": notes, "files": files})
    else:
        fits = {"constrained": result.training, "unconstrained": result.training_wls}
        if result.validation is not None:
            fits["validation"] = result.validation
        parts = (result.summary(), cli.listed("notes", notes), _errors_table(fits))
        typer.echo("\n\n".join((*parts, cli.listed("files", files))))
    certificate = result.certificate
    if result.problem.consistency != "none" and not certificate.passed:
        typer.echo(f"sdpid: not certified: {certificate.summary()}", err=True)
        raise typer.Exit(cli.OURS)


@app.command()
def compare(
    log: cli.Log,
    robot: cli.Robot,
    starts: Annotated[int, typer.Option(min=0, help="Random starts of the local solver.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Of the starts.")] = 0,
    max_iterations: Annotated[
        int | None, typer.Option(min=1, help="Limit of the local solvers; each has its own.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="CSV file for the rows.")] = None,
    jobs: Annotated[int | None, typer.Option(help="Processes; by default one a core.")] = None,
    consistency: cli.ConsistencyOf = cli.Consistency.pseudo_inertia,
    margin: cli.Margin = 0.0,
    mass_max: cli.MassMax = None,
    prior: cli.PriorOf = None,
    friction: cli.Friction = None,
    weighting: cli.WeightingOf = None,
    cutoff: cli.Cutoff = None,
    order: cli.Order = None,
    velocity: cli.VelocityFrom = None,
    period: cli.Period = None,
    start: cli.Start = None,
    periods: cli.Periods = None,
    column: cli.Column = None,
    unit: cli.Unit = None,
    joint_names: cli.JointNames = None,
    effort_scale: cli.EffortScale = None,
    mapping: cli.Mapping = None,
    topic: cli.Topic = None,
    as_json: cli.Json = False,
) -> None:
    """Run every solver on one problem and measure them against the proven bound."""
    if out is not None:
        cli.require_folder(out)
    how = cli.reading(column, unit, joint_names, effort_scale, mapping, topic)
    record = _read(log, **how, period=period, start=start, periods=periods)
    from sdpid import workflow
    from sdpid.output.comparison import compare as run
    from sdpid.robot.load import load_robot

    model = load_robot(robot)
    problem = workflow.formulate(
        model,
        record,
        processing=_processing(record, cutoff, order, velocity),
        friction=_friction(friction),
        weighting=None if weighting is None else weighting.value,
        consistency=consistency.value,
        constraints=_constraints(model, margin, mass_max),
        prior=prior,
    )
    comparison = run(problem, starts=starts, seed=seed, max_iterations=max_iterations, n_jobs=jobs)
    if out is not None:
        comparison.to_csv(out)
    bound = comparison.certificate
    if as_json:
        cli.print_json(
            {
                "lower_bound": bound.lower_bound,
                "certified": bound.passed,
                "rows": [vars(row) for row in comparison.rows],
                "files": [] if out is None else [str(out)],
            }
        )
        return
    typer.echo(f"{comparison.table()}\n\nsdp: {bound.summary()}")
    if out is not None:
        typer.echo(cli.listed("files", [str(out)]))


@app.command()
def simulate(
    robot: Annotated[str, typer.Argument(help="Bundled robot, or a folder like that of one.")],
    out: Annotated[Path, typer.Option(help="Parquet file for the recording.")],
    seed: Annotated[int, typer.Option(min=0, help="Of the excitation and the noise.")] = 0,
    periods: Annotated[int | None, typer.Option(min=1, help="Recorded periods.")] = None,
    period: Annotated[float | None, typer.Option(help="Length of a period, s.")] = None,
    unmodelled: Annotated[
        bool, typer.Option("--unmodelled", help="Add effects that no linear model has.")
    ] = False,
    noise: Annotated[bool, typer.Option(help="Quantisation and noise of the sensors.")] = True,
) -> None:
    """Record the paper's experiment on a simulated robot."""
    if out.suffix.lower() != ".parquet":
        raise ExportError(f"--out {out}: recordings are written as .parquet; change the suffix.")
    cli.require_folder(out)
    require("pyarrow", extra="io")
    from sdpid.experiment.drives import load_drives, plant_folder
    from sdpid.experiment.excitation import paper_excitation
    from sdpid.experiment.plant import simulate as run
    from sdpid.experiment.plant import true_parameters
    from sdpid.robot.model import RobotModel

    table = plant_folder(robot) / "kinematics.toml"
    if not table.is_file():
        raise ModelError(f"no robot {robot!r}: neither bundled nor a folder with {table.name}.")
    trajectory = paper_excitation(robot, seed, periods=periods, period=period)
    typer.echo("\n".join((*trajectory.velocity_report(), *trajectory.notes)))
    recording = run(
        RobotModel.from_mdh(table),
        trajectory,
        theta=true_parameters(robot),
        seed=seed,
        drives=load_drives(robot),
        unmodelled=unmodelled,
        noise=noise,
    )
    recording.to_parquet(out)
    typer.echo(f"{recording!r}\n{cli.listed('files', [str(out)])}")


app.command()(audit)
app.command()(payload)


@app.command()
def verify(
    certificate: Annotated[Path, typer.Argument(help="File that `sdpid identify` wrote.")],
    as_json: cli.Json = False,
) -> None:
    """Check a certificate in exact arithmetic, from its own numbers; status 2 when it fails."""
    from sdpid.assurance.certificate import verify as run

    found = run(certificate)
    if as_json:
        cli.print_json(asdict(found))
    else:
        typer.echo("\n".join((*found.statements, "PROVEN." if found.passed else "NOT PROVEN.")))
    if not found.passed:
        reasons = "; ".join(found.problems)
        typer.echo(f"sdpid: {certificate}: the certificate does not hold: {reasons}.", err=True)
        raise typer.Exit(cli.BAD_INPUT)


@app.command()
def validate(
    log: cli.Log,
    robot: cli.Robot,
    figure: Annotated[Path | None, typer.Option(help="Image file for the plot.")] = None,
    cutoff: cli.Cutoff = None,
    order: cli.Order = None,
    velocity: cli.VelocityFrom = None,
    period: cli.Period = None,
    start: cli.Start = None,
    periods: cli.Periods = None,
    column: cli.Column = None,
    unit: cli.Unit = None,
    joint_names: cli.JointNames = None,
    effort_scale: cli.EffortScale = None,
    mapping: cli.Mapping = None,
    topic: cli.Topic = None,
    as_json: cli.Json = False,
) -> None:
    """Predict a log's efforts with a URDF: its inertias, its damping and its friction.

    Offsets and rotor inertias have no place in a URDF and are not predicted.
    """
    if figure is not None:
        require("matplotlib", extra="plot")
        cli.require_folder(figure)
    how = cli.reading(column, unit, joint_names, effort_scale, mapping, topic)
    record = _read(log, **how, period=period, start=start, periods=periods)
    from sdpid.assurance.prediction_verdict import prediction_findings
    from sdpid.assurance.validation import validate_robot
    from sdpid.experiment.preparation import SMOOTH, default_processing, prepare
    from sdpid.robot.load import load_robot

    model = load_robot(robot)
    changed = _processing(record, cutoff, order, velocity) or default_processing(record)
    samples = prepare(model, record, replace(changed, covariance=None))
    fit = validate_robot(model, samples, width=0.0 if record.period is not None else SMOOTH)
    files = []
    if figure is not None:
        from sdpid.output.plots import save_figure
        from sdpid.workflow import plot_fit

        save_figure(plot_fit(samples, fit), figure)
        files.append(str(figure))
    verdict = [finding.text for finding in prediction_findings(samples, fit)]
    if as_json:
        notes = list(samples.notes)
        cli.print_json({**fit.to_dict(), "verdict": verdict, "notes": notes, "files": files})
        return
    typer.echo(f"{model.name}: relative residual {100 * fit.relative:.2f} %")
    parts = (
        cli.listed("verdict", verdict),
        cli.listed("notes", samples.notes),
        _errors_table({"prediction": fit}),
    )
    typer.echo("\n\n".join(parts))
    if files:
        typer.echo(cli.listed("\nfiles", files))


@app.command()
def info(
    log: cli.Log,
    robot: Annotated[str | None, typer.Option(help="Robot to compare with.")] = None,
    period: cli.Period = None,
    start: cli.Start = None,
    periods: cli.Periods = None,
    column: cli.Column = None,
    unit: cli.Unit = None,
    joint_names: cli.JointNames = None,
    effort_scale: cli.EffortScale = None,
    mapping: cli.Mapping = None,
    topic: cli.Topic = None,
    as_json: cli.Json = False,
) -> None:
    """Show what was understood of a log, and what looks wrong with it."""
    how = cli.reading(column, unit, joint_names, effort_scale, mapping, topic)
    from sdpid.experiment.overview import overview
    from sdpid.experiment.readers import read_described
    from sdpid.robot.load import load_robot

    read = read_described(log, **how, period=period, start=start, periods=periods)
    facts = overview(read.recording, None if robot is None else load_robot(robot))
    facts = {"file": read.file, "mapping": read.mapping, "read_from": read.sources, **facts}
    if as_json:
        cli.print_json(facts)
        return
    from sdpid.output.tables import Table

    joints = facts.pop("joints")
    warnings = facts.pop("warnings")
    sources = [f"{quantity}: {source}" for quantity, source in facts.pop("read_from").items()]
    facts["processing"] = ", ".join(f"{k}={v}" for k, v in (facts["processing"] or {}).items())
    width = max(map(len, facts))
    for key, value in facts.items():
        shown = f"{value:.6g}" if isinstance(value, float) else value
        typer.echo(f"{key.replace('_', ' '):{width}}  {'-' if shown is None else shown}")
    rows = tuple(tuple(joint.values()) for joint in joints)
    typer.echo("\n" + cli.listed("read from", sources))
    typer.echo("\n" + Table(tuple(joints[0]), rows).text())
    if warnings:
        typer.echo("\n" + cli.listed("warnings", warnings))


def _read(path: Path, **how: Any) -> Recording:
    from sdpid.experiment.readers import read_recording

    return read_recording(path, **how)


def _processing(
    log: Recording, cutoff: float | None, order: int | None, velocity: cli.Velocity | None
) -> Processing | None:
    """Return the default processing with changes, None when there are none."""
    from sdpid.experiment.preparation import default_processing

    changes: dict[str, Any] = {
        "cutoff_hz": cutoff,
        "order": order,
        "velocity": None if velocity is None else velocity.value,
    }
    changes = {name: value for name, value in changes.items() if value is not None}
    return replace(default_processing(log), **changes) if changes else None


def _friction(given: list[str] | None) -> list[str | FrictionTerm] | None:
    """Turn options into terms: names, or names with a speed or joints."""
    from sdpid.robot.friction import AsymmetricCoulomb, Coulomb, Coupling, SigmoidFriction, Stribeck

    smooth: dict[str, Callable[[float | None], FrictionTerm]] = {
        "coulomb": lambda width: Coulomb(width=width),
        "asymmetric_coulomb": lambda width: AsymmetricCoulomb(width=width),
        "stribeck": lambda speed: Stribeck(velocity=speed),
        "sigmoid": lambda speed: SigmoidFriction(velocity=speed),
    }
    terms: list[str | FrictionTerm] = []
    for text in given or ():
        name, equals, value = text.partition("=")
        if not equals:
            terms.append(text)
        elif name in smooth:
            given_speed = None if value == "fit" else cli.numbers(value, f"--friction {name}")[0]
            terms.append(smooth[name](given_speed))
        elif name == "coupling" and value.count(",") == 1:
            first, second = cli.split_list(value)
            terms.append(Coupling(first, second))
        else:
            raise ModelError(
                f"--friction {text}: takes no value; with one there are coulomb=WIDTH, "
                "asymmetric_coulomb=WIDTH, stribeck=SPEED, sigmoid=SPEED (a speed in rad/s, or "
                "fit) and coupling=JOINT,JOINT."
            )
    return terms or None


def _constraints(robot: RobotModel, margin: float, mass_max: float | None) -> Constraints:
    from sdpid.estimation.constraints import Constraints

    given = {} if mass_max is None else {"mass_max": mass_max}
    return Constraints.of_size(robot, margin=margin, **given)


def _errors_table(fits: dict[str, Validation]) -> str:
    from sdpid.output.tables import Table

    names = next(iter(fits.values())).joint_names
    header = ["joint"]
    columns: list[list[Any]] = [list(names)]
    for label, fit in fits.items():
        header += [f"{label} RMSE [N.m]", "NRMSE [%]"]
        columns += [fit.rmse.tolist(), (100.0 * fit.nrmse).tolist()]
    return Table(tuple(header), tuple(zip(*columns, strict=True))).text(4)


def main() -> None:
    """Run the command."""
    cli.clean_up_when_ended()
    app(prog_name="sdpid")
