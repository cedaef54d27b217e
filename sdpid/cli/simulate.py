"""The command ``sdpid simulate``: a motion of a simulated robot, recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import sdpid.cli.options as opt
from sdpid._common.extras import require
from sdpid.cli.printing import Printing, listed
from sdpid.errors import DataError, ExportError, SdpidError

if TYPE_CHECKING:
    from sdpid.experiment.recording.recording import Recording

# How far links of robots on legs are off their description.
_CHANGE = 0.15


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
    motion: Annotated[
        str | None,
        typer.Option(
            help="Motion of a robot on legs: stand, trot, step, walk or hang, or trajectory.csv of "
            "sdpid excite --stand. Its base floats; contacts and an IMU are recorded."
        ),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(help="Length of --motion, s; 10 by default, or that of the file."),
    ] = None,
    change: Annotated[
        float | None,
        typer.Option(
            help="With --motion: share by which the simulated links differ from the description; "
            "0.15 by default."
        ),
    ] = None,
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
    if motion is not None:
        fixed = {
            "--trajectory": trajectory,
            "--write-trajectory": write_trajectory,
            "--periods": periods,
            "--period": period,
            "--unmodeled": unmodeled or None,
            "--exact": exact or None,
        }
        if given := [name for name, value in fixed.items() if value is not None]:
            raise DataError(
                f"{given[0]}: is for robots on a fixed base, and --motion for robots on legs; "
                "leave one of them out."
            )
        _legged(robot, motion, out, printing, seed, duration, change, noise)
        return
    if given := [n for n, v in (("--duration", duration), ("--change", change)) if v is not None]:
        raise DataError(f"{given[0]}: goes with --motion, which is for robots on legs.")
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
        plan = read_trajectory(trajectory, model.joint_names)
        plan = between_rests(plan) if isinstance(plan.series, SampledCurve) else plan
        plan = plan if periods is None else plan.with_periods(periods)
        import numpy as np

        own, described = plan.velocity_limit, model.velocity_limits
        plan = replace(plan, velocity_limit=np.where(np.isinf(own), described, own))
    elif bundled:
        plan = paper_excitation(robot, seed, periods=periods, period=period)
    else:
        plan = default_motion(model, seed, periods=periods, period=period)
    if write_trajectory is not None:
        plan.to_toml(write_trajectory)
    recording = run(
        model,
        plan,
        theta=true_parameters(robot) if bundled else None,
        seed=seed,
        drives=load_drives(robot) if bundled else None,
        unmodeled=unmodeled,
        noise=noise,
        exact=exact,
    )
    _write(recording, out)
    files = [str(file) for file in (out, write_trajectory) if file is not None]
    kinds = {
        name: model.pin_model.joints[model.pin_model.getJointId(name)].shortname()
        for name in model.joint_names[model.n_base :]
    }
    sliding = [name for name, kind in kinds.items() if kind.startswith("JointModelP")]
    notes = [*plan.velocity_report(sliding), *plan.notes, *recording.notes]
    notes += [] if bundled else _of_a_held_base(robot, out)
    if suffix == ".csv" and recording.period is not None and recording.periods != 1:
        notes.append(
            f"{out} has no place for the period; to average its periods: sdpid identify --period "
            f"{recording.period:.10g} --start {recording.start:.10g} --periods {recording.periods}"
        )
    _show(printing, recording, notes, files)


def _legged(
    name: str,
    motion: str,
    out: Path,
    printing: Printing,
    seed: int,
    duration: float | None,
    change: float | None,
    noise: bool,
) -> None:
    """Record a motion of a simulated robot on legs."""
    from sdpid.experiment.plant.legged.sensors import Sensors
    from sdpid.experiment.plant.legged.simulate import simulate_legged
    from sdpid.experiment.plant.legged.truth import changed_parameters
    from sdpid.experiment.recording.floating.columns import mapping_beside
    from sdpid.experiment.trajectory.whole_body import WholeBodyMotion
    from sdpid.robot.model.load import load_robot

    beside = mapping_beside(out)
    opt.require_folder("--out", beside, [name, printing.config])
    if change is not None and not 0.0 <= change < 1.0:
        raise DataError(f"--change: is {change:g}, expected a share from 0 to less than 1.")
    robot = load_robot(name, root="free_flyer")
    # The same robot whatever the seed, so that several motions are of one.
    theta = changed_parameters(robot, change=_CHANGE if change is None else change)
    sensors = Sensors() if noise else replace(Sensors.exact(), forces=False)
    planned = motion.lower().endswith(".csv")
    run = simulate_legged(
        robot,
        WholeBodyMotion.from_csv(motion) if planned else motion,
        theta=theta,
        duration=duration,
        seed=seed,
        sensors=sensors,
    )
    log, files = run.recording, [str(out)]
    _write(log, out)
    if out.suffix.lower() == ".csv":
        files.append(str(beside))
    true, described = (
        float(bodies.reshape(-1, 10)[:, 0].sum())
        for bodies in (theta[: 10 * robot.n_links], robot.prior)
    )
    mass = f"true total mass {true:.4g} kg, of the description {described:.4g} kg"
    _show(printing, log, [mass, *log.notes], files)


def _of_a_held_base(name: str, out: Path) -> list[str]:
    """Return what to know where a robot on legs was simulated like an arm."""
    from sdpid.robot.legs.find import find_legs
    from sdpid.robot.model.load import load_robot

    try:
        robot = load_robot(name, root="free_flyer")
        find_legs(robot)
    except SdpidError:
        return []
    return [
        f"the base was held; --motion walk (stand, trot, hang) lets {robot.name} move on its legs. "
        f'Beside such logs this one says [base] held = "{robot.link_names[0]}" in '
        f"{out.with_suffix('.toml').name}"
    ]


def _write(recording: Recording, out: Path) -> None:
    """Write a recording in the format that its file's suffix names."""
    (recording.to_csv if out.suffix.lower() == ".csv" else recording.to_parquet)(out)


def _show(printing: Printing, recording: Recording, notes: list[str], files: list[str]) -> None:
    """Print what was recorded."""
    content = {
        "samples": recording.n_samples,
        "duration_s": recording.duration,
        "rate_hz": recording.rate_hz,
        "joints": recording.names,
        "notes": notes,
        "files": files,
    }
    printing.show(content, "\n".join((*notes, repr(recording), listed("files", files))))
