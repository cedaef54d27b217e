"""The command ``sdpid sample``: robots drawn from what a run knows, for simulation and learning."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from sdpid.cli.commands import Given, command, findings_listed, listed, read_config
from sdpid.cli.logs import LOGS_OF_A_RUN, PROBLEM, formulated
from sdpid.errors import DataError

if TYPE_CHECKING:
    from sdpid.output.samples.write import RobotKind

# Files of a results folder.
_RUN, _PARAMETERS = "run.toml", "parameters.json"


def _read_run(ctx: typer.Context, value: Path | None) -> Path | None:
    """Take the options of the run that wrote a folder."""
    if value is None or ctx.resilient_parsing:
        return value
    if not (value / _RUN).is_file():
        raise DataError(
            f"{value}: has no {_RUN}; give the folder that `sdpid identify` wrote, or its options "
            "by --config."
        )
    read_config(ctx, value / _RUN)
    return value


@command(
    {
        "results FOLDER = none": "Folder that `sdpid identify` wrote; its run is made again, "
        "and must give its parameters. Without it: the options of `sdpid identify`, or its "
        "file by --config."
    },
    LOGS_OF_A_RUN,
    PROBLEM,
    {
        "--number -n COUNT = 100": "Robots to draw.",
        "--seed SEED = 0": "The same seed gives the same robots.",
        "--out --robots FOLDER = robots": "Folder for the robots.",
        "--urdf/--no-urdf": "Write URDFs. Default: unless --mjcf is given, or the robot has none.",
        "--mjcf/--no-mjcf": "Write MJCFs (extra sim). Default: where no URDF is written.",
        "--source FILE": "URDF or MJCF to change, such as one with meshes. Default: the "
        "robot's URDF.",
        "--probability X = 0.95": "Share of the robots within each range.",
    },
    results=_read_run,
)
def sample(given: Given) -> None:
    """Draw consistent robots from the posterior of a run: URDFs or MJCFs, and ranges.

    Every robot obeys all constraints of the run, and every link of it can be a body.
    """
    from sdpid._common.arrays import require_probability
    from sdpid.output.samples.write import RANGES, run_folder
    from sdpid.output.tables.parameters_file import read_parameters
    from sdpid.robot.model.load import load_robot
    from sdpid.workflow.sample import optimum, require_same, sample_parameters

    robots = given.robots
    if given.results is not None and given.config is not None:
        raise DataError(f"give the folder {given.results} or --config {given.config}, not both.")
    run_folder(robots).require_writable(robots, given.inputs())
    require_probability(given.probability, "probability")
    model = load_robot(given.robot)
    kinds = _kinds(given.urdf, given.mjcf, described=model.urdf is not None)
    problem, prepared = formulated(given, given.log)
    best = optimum(problem)
    if given.results is not None:
        file = given.results / _PARAMETERS
        require_same(best.certified, read_parameters(file), str(file))
    drawn = sample_parameters(best, given.number, given.seed)
    notes = list(drawn.notes)
    files = drawn.save(
        robots, kinds, source=given.source, probability=given.probability, report=notes.append
    )
    ranges = json.loads((robots / RANGES).read_text(encoding="utf-8"))
    mixed, widened = drawn.diagnostics, ranges["independent"]["efforts_widened"]
    names = [path.name for path in files if not path.name.startswith("robot_")]
    notes += ranges["notes"]
    independent = "ranges of one robot have no width"
    if widened is not None:
        independent = (
            f"ranges of {100.0 * given.probability:g} %: drawn from them, each number by itself, "
            f"efforts spread {widened:.3g} times as far as those of the robots"
        )
    text = (
        f"{model.name}: {len(drawn)} robots drawn with seed {given.seed}, effective sample size at "
        f"least {mixed['least_effective_size']:.0f} ({mixed['least_of']}), split R-hat at most "
        f"{mixed['largest_r_hat']:.3f} ({mixed['largest_of']})\n"
        f"written to {robots}: {len(files) - len(names)} robots, {', '.join(names)}\n{independent}"
    )
    content = {
        "robot": model.name,
        "number": len(drawn),
        "seed": given.seed,
        "diagnostics": mixed,
        "ranges": ranges,
        "findings": prepared.findings,
        "notes": notes,
        "files": files,
    }
    given.show(content, findings_listed(prepared.findings), text, listed("notes", notes))


def _kinds(urdf: bool | None, mjcf: bool | None, *, described: bool) -> tuple[RobotKind, ...]:
    """Return the formats to write: what was asked for, else URDF, or MJCF where there is none."""
    urdf = described and not mjcf if urdf is None else urdf
    asked: dict[RobotKind, bool] = {"urdf": urdf, "mjcf": not urdf if mjcf is None else mjcf}
    if not any(asked.values()):
        raise DataError("--no-urdf, --no-mjcf: nothing to write; leave one of them out.")
    return tuple(kind for kind, wanted in asked.items() if wanted)
