"""The command ``sdpid sample``: robots drawn from what a run knows, for simulation and learning."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import sdpid.cli.options as opt
from sdpid.cli.config import read_config
from sdpid.cli.formulated import formulated
from sdpid.cli.printing import Printing, findings_listed, listed
from sdpid.errors import DataError

if TYPE_CHECKING:
    from sdpid.output.samples.write import RobotKind

# Files of a results folder.
_RUN, _PARAMETERS = "run.toml", "parameters.json"


def _read_run(ctx: typer.Context, folder: Path | None) -> Path | None:
    """Take the options of the run that wrote a folder."""
    if folder is None or ctx.resilient_parsing:
        return folder
    if not (folder / _RUN).is_file():
        raise DataError(
            f"{folder}: has no {_RUN}; give the folder that `sdpid identify` wrote, or its options "
            "by --config."
        )
    read_config(ctx, folder / _RUN)
    return folder


def sample(
    robot: opt.Robot,
    logs: Annotated[
        list[Path],
        typer.Option("--log", metavar="LOG", help="Log as for `sdpid identify`. May be repeated."),
    ],
    reading: opt.Reading,
    periods: opt.Periods,
    processing: opt.ProcessingOptions,
    estimation: opt.Estimation,
    acceptance: opt.Acceptance,
    printing: Printing,
    results: Annotated[
        Path | None,
        typer.Argument(
            metavar="RESULTS",
            help="Folder that `sdpid identify` wrote; its run is made again, and must give its "
            "parameters. Without it: the options of `sdpid identify`, or its file by --config.",
            is_eager=True,
            callback=_read_run,
            show_default=False,
        ),
    ] = None,
    number: Annotated[int, typer.Option("--number", "-n", min=1, help="Robots to draw.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same robots.")] = 0,
    robots: Annotated[
        Path, typer.Option("--out", "--robots", help="Folder for the robots.")
    ] = Path("robots"),
    urdf: Annotated[
        bool | None,
        typer.Option(
            "--urdf/--no-urdf",
            help="Write URDFs. Default: unless --mjcf is given, or the robot has none.",
        ),
    ] = None,
    mjcf: Annotated[
        bool | None,
        typer.Option(
            "--mjcf/--no-mjcf", help="Write MJCFs (extra sim). Default: where no URDF is written."
        ),
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="URDF or MJCF to change, such as one with meshes. Default: the robot's URDF.",
        ),
    ] = None,
    probability: Annotated[
        float, typer.Option(metavar="X", help="Share of the robots within each range.")
    ] = 0.95,
) -> None:
    """Draw consistent robots from the posterior of a run: URDFs or MJCFs, and ranges.

    Every robot obeys all constraints of the run, and every link of it can be a body.
    """
    from sdpid._common.arrays import require_probability
    from sdpid.output.samples.write import RANGES, run_folder
    from sdpid.output.tables.parameters_file import read_parameters
    from sdpid.robot.model.load import load_robot
    from sdpid.workflow.sample import (
        optimum,
        require_same,
        sample_parameters,
    )

    if results is not None and printing.config is not None:
        raise DataError(f"give the folder {results} or --config {printing.config}, not both.")
    inputs = reading.files(logs, robot, printing.config, source)
    run_folder(robots).require_writable(robots, inputs)
    require_probability(probability, "probability")
    model = load_robot(robot)
    kinds = _kinds(urdf, mjcf, described=model.urdf is not None)
    problem, prepared = formulated(
        robot, logs, reading, periods, processing, estimation, acceptance
    )
    best = optimum(problem)
    if results is not None:
        file = results / _PARAMETERS
        require_same(best.estimate, read_parameters(file), str(file))
    drawn = sample_parameters(best, number, seed)
    notes = list(drawn.notes)
    files = drawn.save(robots, kinds, source=source, probability=probability, report=notes.append)
    ranges = json.loads((robots / RANGES).read_text(encoding="utf-8"))
    mixed, lost = drawn.diagnostics, ranges["independent"]
    names = [path.name for path in files if not path.name.startswith("robot_")]
    notes += ranges["notes"]
    independent = (
        f"ranges of {100.0 * probability:g} %: drawn from them, each number by itself, efforts "
        f"spread {lost['efforts_widened']:.3g} times as far as those of the robots"
        if lost["efforts_widened"] is not None
        else "ranges of one robot have no width"
    )
    text = "\n".join(
        (
            f"{model.name}: {len(drawn)} robots drawn with seed {seed}, effective sample size at "
            f"least {mixed['least_effective_size']:.0f} ({mixed['least_of']}), split R-hat at most "
            f"{mixed['largest_r_hat']:.3f} ({mixed['largest_of']})",
            f"written to {robots}: {len(files) - len(names)} robots, {', '.join(names)}",
            independent,
        )
    )
    if prepared.findings:
        text = f"{findings_listed(prepared.findings)}\n\n{text}"
    if notes:
        text = f"{text}\n{listed('notes', notes)}"
    content = {
        "robot": model.name,
        "number": len(drawn),
        "seed": seed,
        "diagnostics": mixed,
        "ranges": ranges,
        "findings": [finding.to_dict() for finding in prepared.findings],
        "notes": notes,
        "files": [str(path) for path in files],
    }
    printing.show(content, text)


def _kinds(urdf: bool | None, mjcf: bool | None, *, described: bool) -> tuple[RobotKind, ...]:
    """Return the formats to write: what was asked for, else URDF, or MJCF where there is none."""
    if urdf is None:
        urdf = described and not mjcf
    if mjcf is None:
        mjcf = not urdf
    if not (urdf or mjcf):
        raise DataError("--no-urdf, --no-mjcf: nothing to write; leave one of them out.")
    return (*(("urdf",) if urdf else ()), *(("mjcf",) if mjcf else ()))
