"""The command ``sdpid simulate``: a motion of a simulated robot, recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from sdpid._common.extras import require
from sdpid.cli.commands import Given, command, listed
from sdpid.errors import DataError, ExportError, SdpidError

if TYPE_CHECKING:
    from sdpid.experiment.recording.recording import Recording


@command(
    {
        "robot ROBOT": "URDF file, name of a robot, or a folder like that of a bundled one.",
        "--out FILE = required": "CSV or Parquet file for the recording.",
        "--trajectory FILE": "Motion: a TOML file as --write-trajectory makes, or samples of "
        "any tool (CSV, Parquet, NPZ with time, and position, velocity, acceleration of each "
        "joint as position_<joint>, ...). By default the paper's excitation for a bundled "
        "robot, else a motion within the robot's limits.",
        "--write-trajectory FILE": "TOML file for the motion that was made.",
        "--seed SEED = 0": "Random seed of motion and noise.",
        "--periods COUNT": "Number of periods.",
        "--period S": "Length of a period, s.",
        "--unmodeled": "Add effects that no linear model has.",
        "--noise/--no-noise = on": "Add sensor noise and quantization.",
        "--exact": "Follow the motion exactly, without a controller.",
        "--motion NAME|FILE": "Motion of a robot on legs: stand, trot, step, walk or hang, or "
        "trajectory.csv of sdpid excite --stand. Its base floats; contacts and an IMU are "
        "recorded.",
        "--duration S": "Length of --motion, s; 10 by default, or that of the file.",
        "--change X = 0.15": "With --motion: share by which the simulated links differ from the "
        "description.",
    }
)
def simulate(given: Given) -> None:
    """Record a motion of a simulated robot."""
    out = given.out
    if out.suffix.lower() not in (".csv", ".parquet"):
        raise ExportError(
            f"--out {out}: recordings are written as .csv or .parquet; change the suffix."
        )
    given.require_file("out")
    given.require_file("write_trajectory")
    if given.trajectory is not None:
        given.refuse("period", "the trajectory's file has its own; leave one of them out.")
    if out.suffix.lower() == ".parquet":
        require("pyarrow", extra="io")
    if given.motion is None:
        given.refuse("duration change", "goes with --motion, which is for robots on legs.")
        _arm(given)
        return
    given.refuse(
        "trajectory write_trajectory periods period unmodeled exact",
        "is for robots on a fixed base, and --motion for robots on legs; leave one of them out.",
    )
    _legged(given)


def _arm(given: Given) -> None:
    """Record a motion of a simulated robot on a fixed base."""
    import numpy as np

    from sdpid.experiment.plant.simulate import load_drives, true_parameters
    from sdpid.experiment.plant.simulate import simulate as run
    from sdpid.experiment.trajectory.curve import SampledCurve
    from sdpid.experiment.trajectory.drawn import default_motion, paper_excitation, plant_folder
    from sdpid.experiment.trajectory.reading import between_rests, read_trajectory
    from sdpid.robot.model.load import load_robot
    from sdpid.robot.model.model import RobotModel

    robot, out, seed, periods = given.robot, given.out, given.seed, given.periods
    table = plant_folder(robot) / "kinematics.toml"
    bundled = table.is_file()
    model = RobotModel.from_mdh(table) if bundled else load_robot(robot)
    if given.trajectory is not None:
        plan = read_trajectory(given.trajectory, model.joint_names)
        plan = between_rests(plan) if isinstance(plan.series, SampledCurve) else plan
        plan = plan if periods is None else plan.with_periods(periods)
        own = plan.velocity_limit
        limit = np.where(np.isinf(own), model.velocity_limits, own)
        plan = replace(plan, velocity_limit=limit)
    elif bundled:
        plan = paper_excitation(robot, seed, periods=periods, period=given.period)
    else:
        plan = default_motion(model, seed, periods=periods, period=given.period)
    if given.write_trajectory is not None:
        plan.to_toml(given.write_trajectory)
    log = run(
        model,
        plan,
        theta=true_parameters(robot) if bundled else None,
        drives=load_drives(robot) if bundled else None,
        **given.chosen("seed unmodeled noise exact"),
    )
    sliding = [name for name, slides in zip(model.joint_names, model.slides, strict=True) if slides]
    notes = [*plan.velocity_report(sliding), *plan.notes, *log.notes]
    notes += [] if bundled else _of_a_held_base(robot, out)
    if out.suffix.lower() == ".csv" and log.period is not None and log.periods != 1:
        notes.append(
            f"{out} has no place for the period; to average its periods: sdpid identify --period "
            f"{log.period:.10g} --start {log.start:.10g} --periods {log.periods}"
        )
    _write(given, log, notes, [given.write_trajectory])


def _legged(given: Given) -> None:
    """Record a motion of a simulated robot on legs."""
    from sdpid.experiment.plant.legged.simulate import Sensors, simulate_legged
    from sdpid.experiment.plant.legged.truth import changed_parameters
    from sdpid.experiment.recording.recording import mapping_beside
    from sdpid.experiment.trajectory.whole_body import WholeBodyMotion
    from sdpid.robot.model.load import load_robot

    if not 0.0 <= given.change < 1.0:
        raise DataError(f"--change: is {given.change:g}, expected a share from 0 to less than 1.")
    beside = mapping_beside(given.out)
    given.require_file("out", beside)
    robot = load_robot(given.robot, root="free_flyer")
    # The same robot whatever the seed, so that several motions are of one.
    theta = changed_parameters(robot, change=given.change)
    planned = given.motion.lower().endswith(".csv")
    run = simulate_legged(
        robot,
        WholeBodyMotion.from_csv(given.motion) if planned else given.motion,
        theta=theta,
        duration=given.duration,
        seed=given.seed,
        sensors=Sensors() if given.noise else replace(Sensors.exact(), forces=False),
    )
    true, described = theta[: 10 * robot.n_links : 10].sum(), robot.prior[:, 0].sum()
    mass = f"true total mass {true:.4g} kg, of the description {described:.4g} kg"
    csv = given.out.suffix.lower() == ".csv"
    _write(given, run.recording, [mass, *run.recording.notes], [beside if csv else None])


def _of_a_held_base(name: str, out: Path) -> list[str]:
    """Return what to know where a robot on legs was simulated like an arm."""
    from sdpid.robot.legs import find_legs
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


def _write(given: Given, log: Recording, notes: list[str], others: list[Path | None]) -> None:
    """Write a recording in the format that its file's suffix names, and print what it holds."""
    (log.to_csv if given.out.suffix.lower() == ".csv" else log.to_parquet)(given.out)
    files = [file for file in (given.out, *others) if file is not None]
    content = {
        "samples": log.n_samples,
        "duration_s": log.duration,
        "rate_hz": log.rate_hz,
        "joints": log.names,
        "notes": notes,
        "files": files,
    }
    given.show(content, "\n".join((*notes, repr(log), listed("files", files))))
