"""The command ``sdpid excite``: what to run on the robot, within its limits."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from sdpid._common.files import printable
from sdpid.cli.commands import Given, command, config_text, listed, panel
from sdpid.cli.endings import NO_ANSWER, command_line, complain
from sdpid.errors import DataError

if TYPE_CHECKING:
    from sdpid.excitation.geometry.obstacles import Obstacle
    from sdpid.excitation.limits.limits import Limits

# Of a time limit, s, what starting takes at most and what is kept for the plan's files; and the
# least share of it that is searched.
_STARTING, _WRITING, _SHARE = 5.0, 1.2, 0.2

# Of the whole command with --quick, s: an arm of seven joints is ready within ten.
_QUICK = 7.0

# Broken limits that the last line names.
_FEW = 4

SURROUNDINGS = panel(
    "Limits and surroundings",
    {
        "--limits FILE": "TOML file with a table a joint (lower, upper, velocity, acceleration, "
        "jerk, torque), one named arm (tool_speed, clearance), and obstacles as in --obstacles. "
        "The tighter of it and the description holds.",
        "--table": "A table under the arm, at the height of its base.",
        "--table-height M": "A table whose top is at this height, m.",
        "--wall DIRECTION=M ...": "A wall at a distance from the base, such as -x=0.3. May be "
        "repeated.",
        "--obstacles FILE": "TOML file of planes, boxes, meshes, tables and walls.",
        "--clearance M": "Least distance between parts, and to obstacles, m.",
        "--collisions/--no-collisions = on": "Keep the robot from touching itself and obstacles.",
        "--torque-spread X = 0": "Standard deviations of the description's inertias by which "
        "torques may be larger than nominal.",
        "--package-dir FOLDER ...": "Where package:// names of meshes are. May be repeated.",
    },
)


@command(
    {
        "robot ROBOT": "URDF or MJCF file, or name of a bundled or example robot.",
        "--out FOLDER = sdpid-plan": "Folder for the plan.",
        "--check FILE": "Design nothing; check the limits of this trajectory, from any tool: "
        "CSV, Parquet, NPZ with time, position_<joint>, ..., or trajectory.toml.",
        "--figures/--no-figures": "Draw plots of a robot that stands. Default: where "
        "matplotlib is installed.",
    },
    SURROUNDINGS,
    panel(
        "Robots on legs",
        {
            "--stand": "The robot stands on its legs: its base moves, its feet stay where they "
            "are.",
            "--sway M": "With --stand: the base moves by at most this much along each axis, m. "
            "Default: a quarter of its height, a tenth on soles.",
            "--tilt RAD": "With --stand: it turns by at most this much. Default: 0.35.",
            "--grip X": "With --stand: coefficient of friction of the ground that may be used. "
            "Default: 0.5.",
            "--load X": "With --stand: least force on a foot, as a share of that when standing "
            "still. Default: 0.3.",
            "--steps COUNT": "With --stand: steps of the search from one start. Default: 30.",
        },
    ),
    panel(
        "Motion and search",
        {
            "--duration S = 20": "Length of the motion; it may be repeated.",
            "--motion spline|fourier|postures|one_by_one = spline": "What the motion is made of.",
            "--closed/--open = on": "End where the motion starts, or anywhere.",
            "--harmonics COUNT": "Harmonics of a Fourier series.",
            "--start X,Y,...": "Positions at which the motion starts, rad or m. Default: the "
            "search chooses.",
            "--periods COUNT = 1": "How often it is run.",
            "--starts COUNT": "Starts of the search. Default: 4.",
            "--time-limit S": "Time for the whole command, s; of a robot that stands for search "
            "and check.",
            "--quick/--no-quick = off": "A first safe motion, within 10 s; without it the search "
            "goes on.",
            "--seed SEED = 0": "Random seed of the search.",
        },
    ),
    panel(
        "What the run is for",
        {
            "--for all|payload|friction|gravity|torque = all": "What must be known well.",
            "--predict FILE": "With --for torque: the motion whose efforts must be predicted.",
            "--objective mixed|D|A|E|V|condition": "What is made best: log det of the information "
            "and condition number both (mixed), one of the classical criteria, or the condition "
            "number. Default: mixed, or what fits the purpose.",
            "--previous LOG|FOLDER ...": "Recording of an earlier run, or the folder of its "
            "results: this run asks for what is still open. May be repeated.",
            "--friction TERM ...": "Friction term that will be identified, as in sdpid identify. "
            "May be repeated.",
            "--noise X,Y,...": "Standard deviation of the noise of each joint's effort at 500 Hz, "
            "N.m.",
        },
    ),
)
def excite(given: Given) -> None:
    """Design a motion to run: safe at every instant, and with what it will buy told before."""
    # Time of the processor is what the command took to start, unless another program calls it.
    began = time.monotonic() - min(time.process_time(), _STARTING)
    if given.quick:
        given.time_limit = min(given.time_limit or _QUICK, _QUICK)
    if given.stand:
        _stand(given)
        return
    given.refuse("sway tilt grip load steps", "is for robots that stand; give --stand.")
    if given.check is not None:
        _check(given)
        return
    from sdpid.output.plans.write import plan_content, require_writable, write_plan

    out = given.out
    require_writable(out, given.inputs("config"), config=given.config, writes_config=True)
    from sdpid.excitation.design.design import design_excitation
    from sdpid.experiment.trajectory.reading import read_trajectory
    from sdpid.robot.model.load import load_robot

    model = load_robot(given.robot)
    if given.predict is not None:
        given.predict = read_trajectory(given.predict, model.joint_names)
    if given.time_limit:
        given.time_limit = _left(given.time_limit, time.monotonic() - began)
    given.previous = _logs(given.previous)
    plan = design_excitation(
        model,
        purpose=given.for_,
        **_around(given),
        **_search(given),
        **given.chosen("collisions torque_spread motion closed periods"),
        **given.chosen("start objective predict previous harmonics"),
    )
    notes: list[str] = []
    files = write_plan(
        plan,
        out,
        command=command_line(given.ctx),
        config=config_text(given.ctx, out),
        report=notes.append,
    )
    from sdpid.output.plans.page import sentences

    content = {**plan_content(plan), "notes": [*plan.notes, *notes], "files": files}
    text = "\n".join(f"{title.lower()}: {printable(text)}" for _, title, text in sentences(plan))
    if given.quick:
        text += f"\nquick: sdpid excite --config {out / 'plan.toml'} --no-quick searches on"
    given.show(
        content,
        f"{plan.robot.name}: written to {out}: {', '.join(file.name for file in files)}",
        listed("notes", (it for it in (*plan.notes, *notes) if it not in plan.limits.notes)),
        listed("assumed", plan.limits.notes),
        text,
    )


def _left(time_limit: float, used: float) -> float:
    """Return what is left of a time limit for search and check."""
    if not time_limit > 0.0:
        return time_limit
    return max(time_limit - used - min(_WRITING, _SHARE * time_limit), _SHARE * time_limit)


def _search(given: Given) -> dict[str, Any]:
    """Return the arguments that designs of motions of arms and of robots that stand share."""
    found = given.chosen("duration friction noise starts time_limit seed")
    if len(found.get("noise", ())) == 1:  # for all joints
        (found["noise"],) = found["noise"]
    return found


def _around(given: Given) -> dict[str, Any]:
    """Return the arguments that `design_excitation` and `check_trajectory` share."""
    return {
        "limits": _limits(given),
        "obstacles": obstacles(given),
        "package_dirs": tuple(given.package_dir),
    }


def _limits(given: Given) -> Limits | None:
    """Return the limits that narrow the description's, None where none are given."""
    from sdpid.excitation.limits.limits import Limits

    if given.limits is None and given.clearance is None:
        return None
    limits = Limits() if given.limits is None else Limits.from_toml(given.limits)
    return limits if given.clearance is None else replace(limits, clearance=given.clearance)


def obstacles(given: Given) -> tuple[Obstacle, ...]:
    """Return the obstacles that options and files name.

    Raises
    ------
    DataError
        When a wall or file is not understood.
    """
    from sdpid._common.files import load_toml
    from sdpid.excitation.geometry.obstacles import obstacles_from_toml, table, wall
    from sdpid.excitation.limits.limits import OBSTACLES

    found: list[Obstacle] = []
    if given.table or given.table_height is not None:
        found.append(table(given.table_height or 0.0))
    found += [wall(distance, direction) for direction, distance in given.wall.items()]
    if given.obstacles is not None:
        found += obstacles_from_toml(given.obstacles)
    if given.limits is not None:
        own = {k: v for k, v in load_toml(given.limits).items() if k in OBSTACLES}
        found += obstacles_from_toml(own, given.limits.parent)
    return tuple(found)


def _logs(previous: Iterable[Path]) -> list[Path] | None:
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
    return logs or None


def _check(given: Given) -> None:
    """Check the limits of a trajectory, print them, and end with 3 where one is not held."""
    from sdpid.excitation.limits.check import check_trajectory
    from sdpid.robot.model.load import load_robot

    found = check_trajectory(
        load_robot(given.robot),
        given.check,
        **_around(given),
        collision=None if given.collisions else False,
        spread=given.torque_spread,
    )
    verdict = "every limit holds at every instant" if found.ok else "limits are not held"
    last = f"{given.check}: {verdict}"
    given.show(found.to_dict(), found.table().text(), listed("notes", found.notes), last)
    if not found.ok:
        complain(f"{last}: {' '.join(found.sentences()[:_FEW])}")
        raise typer.Exit(NO_ANSWER)


def _stand(given: Given) -> None:
    """Design a motion of a robot that stands, and write it."""
    from sdpid.excitation.standing.design import design_standing
    from sdpid.excitation.standing.plan import plan_content, write_standing
    from sdpid.robot.model.load import load_robot

    why = "is for robots on a fixed base, and --stand for robots on legs; leave one of them out."
    given.refuse(
        "check for_ predict objective previous motion closed harmonics start periods table "
        "table_height wall obstacles clearance torque_spread",
        why,
    )
    if obstacles(given):
        raise DataError(f"--limits: a table of obstacles {why}")
    robot = load_robot(given.robot, root="free_flyer")
    plan = design_standing(
        robot,
        limits=_limits(given),
        **_search(given),
        **given.chosen("sway tilt grip load steps"),
    )
    config = config_text(given.ctx, given.out)
    files = write_standing(plan, given.out, figures=given.figures, config=config)
    given.show(
        {**plan_content(plan), "files": files},
        f"{robot.name}: written to {given.out}: {', '.join(file.name for file in files)}",
        listed("notes", dict.fromkeys((*plan.notes, *plan.limits.notes))),
        "\n".join(printable(line) for line in plan.sentences()),
    )
