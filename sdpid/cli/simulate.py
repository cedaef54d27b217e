"""The command ``sdpid simulate``: the paper's experiment on a simulated robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdpid._extras import require
from sdpid.cli import options as opt
from sdpid.errors import ExportError, ModelError


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
    opt.require_folder("--out", out, [robot])
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
    opt.echo("\n".join((*trajectory.velocity_report(), *trajectory.notes)))
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
    opt.echo(f"{recording!r}\n{opt.listed('files', [str(out)])}")
