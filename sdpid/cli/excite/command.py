"""The command ``sdpid excite``: what to run on the robot, within its limits."""

from __future__ import annotations

import functools
import time
from collections.abc import Iterable
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import sdpid.cli.options as opt
from sdpid._common.text import printable
from sdpid.cli.config import config_text
from sdpid.cli.endings import NO_ANSWER, command_line
from sdpid.cli.excite.standing import Standing, excite_standing
from sdpid.cli.excite.surroundings import Surroundings
from sdpid.cli.printing import Printing, listed
from sdpid.cli.values import friction_terms, numbers
from sdpid.errors import DataError

if TYPE_CHECKING:
    from sdpid.excitation.plan.plan import Plan
    from sdpid.robot.model.model import RobotModel


class Objective(str, Enum):
    """What is made best."""

    mixed = "mixed"
    D = "D"
    A = "A"
    E = "E"
    V = "V"
    condition = "condition"


class Motion(str, Enum):
    """What the motion is made of."""

    spline = "spline"
    fourier = "fourier"
    postures = "postures"
    one_by_one = "one_by_one"


class Purpose(str, Enum):
    """What a run is for."""

    all = "all"
    payload = "payload"
    friction = "friction"
    gravity = "gravity"
    torque = "torque"


_purpose = functools.partial(typer.Option, rich_help_panel="What the run is for")
_motion = functools.partial(typer.Option, rich_help_panel="Motion and search")


# Of a time limit, s, what starting takes at most and what is kept for the plan's files; and the
# least share of it that is searched.
_STARTING, _WRITING, _SHARE = 5.0, 1.2, 0.2

# Of the whole command with --quick, s: an arm of seven joints is ready within ten.
_QUICK = 7.0

# Broken limits that the last line names.
_FEW = 4


def excite(
    ctx: typer.Context,
    robot: Annotated[
        str,
        typer.Argument(
            metavar="ROBOT",
            help="URDF or MJCF file, or name of a bundled or example robot.",
            autocompletion=opt.complete_robot,
        ),
    ],
    surroundings: Surroundings,
    standing: Standing,
    printing: Printing,
    duration: Annotated[
        float, _motion(metavar="S", help="Length of the motion; it may be repeated.")
    ] = 20.0,
    out: Annotated[Path, typer.Option(help="Folder for the plan.")] = Path("sdpid-plan"),
    check: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Design nothing; check the limits of this trajectory, from any tool: CSV, "
            "Parquet, NPZ with time, position_<joint>, ..., or trajectory.toml.",
        ),
    ] = None,
    purpose: Annotated[Purpose, _purpose("--for", help="What must be known well.")] = Purpose.all,
    predict: Annotated[
        Path | None,
        _purpose(
            metavar="FILE", help="With --for torque: the motion whose efforts must be predicted."
        ),
    ] = None,
    objective: Annotated[
        Objective | None,
        _purpose(
            help="What is made best: log det of the information and condition number both "
            "(mixed), one of the classical criteria, or the condition number. Default: mixed, or "
            "what fits the purpose."
        ),
    ] = None,
    previous: Annotated[
        list[Path] | None,
        _purpose(
            metavar="LOG|FOLDER",
            help="Recording of an earlier run, or the folder of its results: this run asks for "
            "what is still open. May be repeated.",
        ),
    ] = None,
    friction: Annotated[
        list[str] | None,
        _purpose(
            metavar="TERM",
            help="Friction term that will be identified, as in sdpid identify. May be repeated.",
        ),
    ] = None,
    noise: Annotated[
        str | None,
        _purpose(
            metavar="X,Y,...",
            help="Standard deviation of the noise of each joint's effort at 500 Hz, N.m.",
        ),
    ] = None,
    motion: Annotated[Motion, _motion(help="What the motion is made of.")] = Motion.spline,
    closed: Annotated[
        bool, _motion("--closed/--open", help="End where the motion starts, or anywhere.")
    ] = True,
    harmonics: Annotated[
        int | None, _motion(metavar="N", min=1, help="Harmonics of a Fourier series.")
    ] = None,
    start: Annotated[
        str | None,
        _motion(
            metavar="X,Y,...",
            help="Positions at which the motion starts, rad or m. Default: the search chooses.",
        ),
    ] = None,
    periods: Annotated[int, _motion(metavar="N", min=1, help="How often it is run.")] = 1,
    starts: Annotated[
        int | None, _motion(metavar="N", min=1, help="Starts of the search. Default: 4.")
    ] = None,
    time_limit: Annotated[
        float | None,
        _motion(
            metavar="S",
            help="Time for the whole command, s; of a robot that stands for search and check.",
        ),
    ] = None,
    quick: Annotated[
        bool,
        _motion(
            "--quick/--no-quick",
            help="A first safe motion, within 10 s; without it the search goes on.",
        ),
    ] = False,
    seed: Annotated[int, _motion(min=0, help="Random seed of the search.")] = 0,
    figures: Annotated[
        bool | None,
        typer.Option(
            help="Draw plots of a robot that stands. Default: where matplotlib is installed."
        ),
    ] = None,
) -> None:
    """Design a motion to run: safe at every instant, and with what it will buy told before."""
    from sdpid.robot.model.load import load_robot

    # Time of the processor is what the command took to start, unless another program calls it.
    began = time.monotonic() - min(time.process_time(), _STARTING)
    standing.require_stand()
    if quick:
        time_limit = min(time_limit or _QUICK, _QUICK)
    if standing.stand:
        around = surroundings
        excite_standing(
            robot,
            out,
            standing,
            printing,
            options={
                "duration": duration,
                "limits": around.given_limits(),
                "friction": friction_terms(friction),
                "noise": None if noise is None else _one_or_more(numbers(noise, "--noise")),
                "starts": starts,
                "time_limit": time_limit,
                "seed": seed,
            },
            unfit={
                "--check": check is not None,
                "--for": purpose is not Purpose.all,
                "--predict": predict is not None,
                "--objective": objective is not None,
                "--previous": bool(previous),
                "--motion": motion is not Motion.spline,
                "--open": not closed,
                "--harmonics": harmonics is not None,
                "--start": start is not None,
                "--periods": periods != 1,
                "--table": bool(around.obstacles_around()),
                "--clearance": around.clearance is not None,
                "--torque-spread": around.torque_spread != 0.0,
            },
            figures=figures,
            config=config_text(ctx, out),
        )
        return
    if check is not None:
        _check(load_robot(robot), check, surroundings, printing)
        return
    from sdpid.output.plans.write import plan_content, require_writable, write_plan

    inputs = [robot, surroundings.limits, surroundings.obstacles, predict, *(previous or ())]
    require_writable(out, inputs, config=printing.config, writes_config=True)
    from sdpid._common.signals import keyboard_interrupts
    from sdpid.excitation.design.design import design_excitation
    from sdpid.experiment.trajectory.reading import read_trajectory

    model = load_robot(robot)
    given: dict[str, Any] = {
        "friction": friction_terms(friction),
        "noise": None if noise is None else _one_or_more(numbers(noise, "--noise")),
        "start": None if start is None else numbers(start, "--start"),
        "objective": None if objective is None else objective.value,
        "predict": None if predict is None else read_trajectory(predict, model.joint_names),
        "previous": _logs(previous or ()) or None,
        "harmonics": harmonics,
        "starts": starts,
        "time_limit": time_limit and _left(time_limit, time.monotonic() - began),
    }
    with keyboard_interrupts():
        plan = design_excitation(
            model,
            duration=duration,
            **surroundings.arguments(),
            collisions=surroundings.collisions,
            torque_spread=surroundings.torque_spread,
            purpose=purpose.value,
            motion=motion.value,
            closed=closed,
            periods=periods,
            seed=seed,
            **{name: value for name, value in given.items() if value is not None},
        )
    notes: list[str] = []
    files = write_plan(
        plan,
        out,
        command=command_line(ctx),
        config=config_text(ctx, out),
        report=notes.append,
    )
    content = {**plan_content(plan), "notes": [*plan.notes, *notes], "files": map(str, files)}
    text = _printed(plan, out, [file.name for file in files], notes)
    if quick:
        text += f"\nquick: sdpid excite --config {out / 'plan.toml'} --no-quick searches on"
    printing.show(content, text)


def _left(time_limit: float, used: float) -> float:
    """Return what is left of a time limit for search and check."""
    if not time_limit > 0.0:
        return time_limit
    return max(time_limit - used - min(_WRITING, _SHARE * time_limit), _SHARE * time_limit)


def _one_or_more(values: list[float]) -> float | list[float]:
    """Return one number for all joints, or one a joint."""
    return values[0] if len(values) == 1 else values


def _logs(previous: Iterable[Path]) -> list[Path]:
    """Return recordings of earlier runs; of a folder of results those that it was made from.

    Raises
    ------
    DataError
        When a folder holds no results.
    """
    from sdpid._common.files import load_toml

    logs: list[Path] = []
    for path in previous:
        if not path.is_dir():
            logs.append(path)
            continue
        named = load_toml(path / "run.toml").get("log")
        if not named:
            raise DataError(f"--previous {path}: its run.toml names no log; give the recording.")
        logs += [path / each for each in ([named] if isinstance(named, str) else named)]
    return logs


def _printed(plan: Plan, out: Path, names: list[str], notes: list[str]) -> str:
    """Return what is printed of a plan: the sentences of its page, and what was written."""
    from sdpid.output.plans.page import sentences

    parts = [f"{plan.robot.name}: written to {out}: {', '.join(names)}"]
    noted = [note for note in (*plan.notes, *notes) if note not in plan.limits.notes]
    for title, told in (("notes", noted), ("assumed", plan.limits.notes)):
        if told:
            parts.append(listed(title, told))
    lines = [f"{title.lower()}: {text}" for _, title, text in sentences(plan)]
    return "\n\n".join([*parts, "\n".join(printable(line) for line in lines)])


def _check(
    robot: RobotModel, trajectory: Path, surroundings: Surroundings, printing: Printing
) -> None:
    """Check the limits of a trajectory, print them, and end with 3 where one is not held."""
    from sdpid.excitation.limits.check import check_trajectory

    found = check_trajectory(
        robot,
        trajectory,
        **surroundings.arguments(),
        collision=None if surroundings.collisions else False,
        spread=surroundings.torque_spread,
    )
    verdict = "every limit holds at every instant" if found.ok else "limits are not held"
    parts = [found.table().text(), *([listed("notes", found.notes)] if found.notes else [])]
    printing.show(found.to_dict(), "\n\n".join([*parts, f"{trajectory}: {verdict}"]))
    if not found.ok:
        worst = " ".join(found.sentences()[:_FEW])
        typer.echo(printable(f"sdpid: {trajectory}: {verdict}: {worst}"), err=True)
        raise typer.Exit(NO_ANSWER)
