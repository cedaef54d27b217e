"""Commands that take logs: identify, compare solvers, certify parameters, validate a robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

import sdpid.cli.logs as logs
from sdpid._common.extras import require
from sdpid._common.files import Source, printable
from sdpid.cli.commands import Given, command, config_text, errors_table, findings_listed, listed
from sdpid.cli.endings import NO_ANSWER, OURS, command_line, complain

if TYPE_CHECKING:
    from sdpid.output.robots.export_report import ExportReport
    from sdpid.workflow.result import Identification


@command(
    {"log LOG ...": "One or several: CSV, Parquet, NPZ, MAT, HDF5 file or ROS bag."},
    logs.PROBLEM,
    logs.LAW,
    {
        "--out FOLDER = sdpid-results": "Folder for the results.",
        "--validation LOG ...": "Another recording, which is predicted only. May be repeated.",
        "--folds N": "Cross-validate: hold out N blocks of the logs in turn.",
        "--rollout": "Simulate the first --validation recording in open loop too; takes "
        "seconds, many minutes without Numba.",
        "--intervals/--no-intervals = on": "Compute confidence intervals of the parameters.",
        "--interval-method gauss_markov|profile|bootstrap = gauss_markov": "Method for the "
        "intervals; profile respects the constraints and takes some seconds.",
        "--figures/--no-figures = off": "Write training.png and validation.png too; needs "
        "matplotlib.",
        "--offsets/--no-offsets = off": "Write offsets into identified.xml, as constant actuators.",
        "--rotor-inertia X,Y,...": "Rotor inertia of every joint, seen from behind its gear, kg.m2 "
        "(nan where unknown), for the stiffness of gears where logs have positions of links.",
        "--elastic/--no-elastic = off": "Write identified_elastic.xml too: springs between motors "
        "and links.",
        "--bare/--no-bare = off": "Leave out report.html and the draws of drives: a folder to "
        "hand on.",
        "--verbose -v": "Print notes, tables and the whole verdict too.",
    },
)
def identify(given: Given) -> None:
    """Identify a robot: URDF and logs in; consistent URDF, tables, report, certificate out."""
    from sdpid._common.staging import Unwritten
    from sdpid.assurance.recipe.inputs import file_entry
    from sdpid.workflow.result import WRITTEN, require_writable

    out, config = given.out, given.config
    require_writable(out, given.inputs("config"), config=config, writes_config=True)
    if given.figures:
        require("matplotlib", extra="plot")
    from sdpid.experiment.preparation.prepare import columns_without
    from sdpid.workflow.identify import identify as run

    model, records = logs.robot_and_logs(given, given.log)
    columns = columns_without(model, given.without_effort or [])
    result = run(
        model,
        records,
        validation=[logs.read(given, log, without_effort=columns) for log in given.validation]
        or None,
        processing=logs.processing(given),
        intervals=given.interval_method if given.intervals else False,
        **given.chosen("folds rollout accept rotor_inertia"),
        **logs.formulation(given, model),
        **logs.law(given, model),
    )
    findings = {str(finding) for finding in result.findings}
    notes = [
        *result.problem.samples.notes,
        *(each for each in result.notes if each not in findings),
        *(each for each in (result.intervals_note, result.bias_note) if each),
    ]
    exports: list[ExportReport] = []
    if config is not None:
        result = replace(result, inputs=(*result.inputs, file_entry("config", Source.of(config))))
    if not given.json:
        # Before the files: what it says is known already.
        told = [] if result.elasticity is None else [result.elasticity.in_words()]
        lines = [*result.headline.lines, *told]
        given.show(None, "\n".join(printable(line) for line in lines))
    saved = result.save(
        out,
        **given.chosen(" ".join(WRITTEN)),
        report=notes.append,
        command=command_line(given.ctx),
        config=config_text(given.ctx, out),
        exported=exports.append,
    )
    content = {**result.to_dict(), "notes": notes, "files": saved, "exports": exports}
    if given.verbose:
        details = _details(result, notes, saved)
    else:
        lines = [
            f"written to {out}: {', '.join(path.name for path in saved)}",
            *(each for each in notes if isinstance(each, Unwritten)),
            f"{len(notes)} notes on choices: with -v, and in result.json",
        ]
        details = ["\n".join(lines)]
    details[0] = f"\n{details[0]}"
    given.show(content, *details)
    certificate = result.certificate
    if result.problem.consistency != "none" and not certificate.passed:
        complain(f"not certified: {certificate.summary()}")
        raise typer.Exit(OURS)


def _details(result: Identification, notes: list[str], files: Sequence[Path]) -> list[str]:
    """Return what is printed of a result with ``--verbose``."""
    fits = {"constrained": result.training, "unconstrained": result.training_wls}
    tables: list[Any] = [*result.rollouts]
    if result.held_out is not None:
        fits["held out"] = result.held_out.fit
        tables.insert(0, result.held_out)
    if result.cross_validation is not None:
        tables.insert(0, result.cross_validation)
    return [
        result.summary(),
        findings_listed(result.findings),
        listed("notes", notes),
        errors_table(fits),
        *(each.table() for each in tables),
        listed("verdict", result.verdict),
        listed("files", files),
        f"certificate: {result.certificate.summary()}",
    ]


@command(
    logs.LOG,
    logs.PROBLEM,
    {
        "--starts 0,1,2,... = 20": "Number of random starts of each local solver.",
        "--seed SEED = 0": "Random seed of the starts.",
        "--max-iterations COUNT": "Largest number of iterations of the local solvers; each has "
        "its own.",
        "--out FILE": "CSV file for the rows.",
        "--jobs N": "Number of processes. Default: one a core.",
    },
)
def compare(given: Given) -> None:
    """Run every solver on one problem and measure them against the proven lower bound."""
    given.require_file("out")
    from sdpid.workflow.comparison import compare as run

    problem, prepared = logs.formulated(given, [given.log])
    comparison = run(problem, n_jobs=given.jobs, **given.chosen("starts seed max_iterations"))
    files = [] if given.out is None else [given.out]
    if files:
        comparison.to_csv(given.out)
    certificate = comparison.certificate
    content = {
        "findings": prepared.findings,
        "lower_bound": certificate.lower_bound,
        "certified": certificate.passed,
        "rows": comparison.rows,
        "files": files,
    }
    parts = (findings_listed(prepared.findings), comparison.table())
    given.show(content, *parts, f"sdp: {certificate.summary()}", listed("files", files))


@command(
    {
        "parameters FILE": "Standard or base parameters: parameters.json or .yaml of a run, a "
        "table (.csv), or a URDF or MJCF."
    },
    logs.LOGS_OF_A_RUN,
    logs.PROBLEM,
    {
        "--value COLUMN = value": "Column of the values in a table.",
        "--certificate FILE": "JSON file for the proof, which `sdpid verify` checks.",
    },
)
def certify(given: Given) -> None:
    """Say how far parameters that were found elsewhere are from the best feasible ones.

    The problem is the one that `sdpid identify` solves with the same options; --config takes its
    run.toml. Ends with status 3 when the parameters break a constraint.
    """
    given.require_file("certificate")
    from sdpid.workflow.certify_parameters import certify_parameters, read_given

    problem, prepared = logs.formulated(given, given.log)
    judged = certify_parameters(
        problem, read_given(given.parameters, problem.robot, value=given.value)
    )
    files = [] if given.certificate is None else [given.certificate]
    if files:
        judged.certificate.to_json(given.certificate)
    content = {**judged.to_dict(), "findings": prepared.findings, "files": files}
    parts = (findings_listed(prepared.findings), judged.summary(), listed("files", files))
    given.show(content, *parts)
    if judged.feasible is False:
        raise typer.Exit(NO_ANSWER)


@command(
    logs.LOG,
    logs.ROBOT,
    logs.READING,
    logs.PERIODS,
    logs.PROCESSING,
    logs.ACCEPTANCE,
    logs.WITHOUT_EFFORT,
    {
        "--figure FILE": "Image file for the plot.",
        "--rollout": "Simulate the robot under the log's efforts too, and compare positions.",
    },
)
def validate(given: Given) -> None:
    """Predict a log's efforts with a URDF: its inertias, its damping and its friction.

    An MJCF's armature counts too. Offsets have no place in either and are not predicted.
    """
    if given.figure is not None:
        require("matplotlib", extra="plot")
    given.require_file("figure")
    from sdpid.assurance.diagnostics.validation import validate_robot
    from sdpid.experiment.preparation.prepare import prepare
    from sdpid.output.report.verdict import prediction_findings

    absent = given.without_effort or []
    model, (record,) = logs.robot_and_logs(given, [given.log])
    prepared = prepare(
        model,
        record,
        {**logs.processing(given), "covariance": None},
        without_effort=absent,
        accept=given.accept,
    )
    findings, samples = prepared.findings, prepared.samples
    fit = validate_robot(model, samples)
    files = [] if given.figure is None else [given.figure]
    if files:
        from sdpid.plots.figures import save_figure

        save_figure(fit.plot(), given.figure)
    verdict = [finding.text for finding in prediction_findings(model, samples, fit)]
    parts = [
        f"{model.name}: relative residual in motion {100 * fit.told.relative:.2f} %\n"
        + listed("verdict", verdict),
        findings_listed(findings),
        listed("notes", samples.notes),
        errors_table({"prediction": fit}),
    ]
    moved: tuple[Any, ...] = ()
    if given.rollout:
        from sdpid.assurance.diagnostics.described import described_dynamics
        from sdpid.assurance.rollouts.rollout import rollouts
        from sdpid.output.report.parameters import fresh_notes

        described = described_dynamics(model, samples)
        moved = rollouts(described, record, processing=prepared.processing, without_effort=absent)
        verdict += [each.verdict for each in moved]
        for each, told in zip(moved, fresh_notes(moved), strict=True):
            parts += [each.table(), listed("notes", told)]
    content = {
        **fit.to_dict(),
        "findings": findings,
        "verdict": verdict,
        "notes": samples.notes,
        "files": files,
        "rollouts": moved,
    }
    given.show(content, *parts, listed("files", files))
