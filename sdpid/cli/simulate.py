"""The command ``sdpid simulate``: a motion of a simulated robot, recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import sdpid.cli.options as opt
from sdpid._common.extras import require
from sdpid.cli.printing import Printing, listed
from sdpid.errors import DataError, ExportError


def simulate(
    robot: Annotated[
        str,
        typer.Argument(help="URDF file, name of a robot, or a folder like that of a bundled one."),
    ],
    out: Annotated[Path, typer.Option(help="CSV or Parquet file for the recording.")],
    printing: Printing,
    trajectory: Annotated[
        Path | None,
        typer.Option(
            help="Motion: a TOML file as --write-trajectory makes, or samples of any tool (CSV, "
            "Parquet, NPZ with time, position_<joint>, velocity_<joint>, acceleration_<joint>). "
            "By default the paper's excitation for a bundled robot, else a motion within the "
            "robot's limits."
        ),
    ] = None,
    write_trajectory: Annotated[
        Path | None, typer.Option(help="TOML file for the motion that was made.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of motion and noise.")] = 0,
    periods: Annotated[int | None, typer.Option(min=1, help="Number of periods.")] = None,
    period: Annotated[float | None, typer.Option(help="Length of a period, s.")] = None,
    unmodeled: Annotated[
        bool, typer.Option("--unmodeled", help="Add effects that no linear model has.")
    ] = False,
    noise: Annotated[bool, typer.Option(help="Add sensor noise and quantization.")] = True,
    exact: Annotated[
        bool, typer.Option("--exact", help="Follow the motion exactly, without a controller.")
    ] = False,
) -> None:
    """Record a motion of a simulated robot."""
    suffix = out.suffix.lower()
    if suffix not in (".csv", ".parquet"):
        raise ExportError(
            f"--out {out}: recordings are written as .csv or .parquet; change the suffix."
        )
    inputs = [robot, trajectory, printing.config]
    opt.require_folder("--out", out, inputs)
    if write_trajectory is not None:
        opt.require_folder("--write-trajectory", write_trajectory, inputs)
    if trajectory is not None and period is not None:
        raise DataError("--period: the trajectory's file has its own; leave one of them out.")
    if suffix == ".parquet":
        require("pyarrow", extra="io")
    from sdpid.experiment.plant.default_motion import default_motion
    from sdpid.experiment.plant.drives import load_drives, plant_folder
    from sdpid.experiment.plant.simulate import simulate as run
    from sdpid.experiment.plant.simulate import true_parameters
    from sdpid.experiment.trajectory.paper import paper_excitation
    from sdpid.experiment.trajectory.reading import between_rests, read_trajectory
    from sdpid.experiment.trajectory.sampled import SampledCurve
    from sdpid.robot.model.load import load_robot
    from sdpid.robot.model.model import RobotModel

    table = plant_folder(robot) / "kinematics.toml"
    bundled = table.is_file()
    model = RobotModel.from_mdh(table) if bundled else load_robot(robot)
    if trajectory is not None:
        motion = read_trajectory(trajectory, model.joint_names)
        motion = between_rests(motion) if isinstance(motion.series, SampledCurve) else motion
        motion = motion if periods is None else motion.with_periods(periods)
    elif bundled:
        motion = paper_excitation(robot, seed, periods=periods, period=period)
    else:
        motion = default_motion(model, seed, periods=periods, period=period)
    if write_trajectory is not None:
        motion.to_toml(write_trajectory)
    recording = run(
        model,
        motion,
        theta=true_parameters(robot) if bundled else None,
        seed=seed,
        drives=load_drives(robot) if bundled else None,
        unmodeled=unmodeled,
        noise=noise,
        exact=exact,
    )
    (recording.to_csv if suffix == ".csv" else recording.to_parquet)(out)
    files = [str(file) for file in (out, write_trajectory) if file is not None]
    kinds = {
        name: model.pin_model.joints[model.pin_model.getJointId(name)].shortname()
        for name in model.joint_names[model.n_base :]
    }
    sliding = [name for name, kind in kinds.items() if kind.startswith("JointModelP")]
    notes = [*motion.velocity_report(sliding), *motion.notes, *recording.notes]
    if suffix == ".csv" and recording.period is not None and recording.periods != 1:
        notes.append(
            f"{out} has no place for the period; to average its periods: sdpid identify --period "
            f"{recording.period:.10g} --start {recording.start:.10g} --periods {recording.periods}"
        )
    content = {
        "samples": recording.n_samples,
        "duration_s": recording.duration,
        "rate_hz": recording.rate_hz,
        "joints": recording.names,
        "notes": notes,
        "files": files,
    }
    printing.show(content, "\n".join((*notes, repr(recording), listed("files", files))))
