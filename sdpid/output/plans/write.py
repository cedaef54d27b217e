"""The folder of a plan: what to run in every form, the page that explains it, what it was made of.

All files appear together, or none.
"""

from __future__ import annotations

import importlib.util
import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdpid import __version__
from sdpid._common.extras import installation
from sdpid._common.progress import progress
from sdpid._common.staging import RunFolder
from sdpid._common.tables import plain, plain_dict
from sdpid.excitation.geometry.obstacles import obstacles_to_dict
from sdpid.excitation.plan.plan import Plan
from sdpid.excitation.search.ipopt import INTERRUPTED
from sdpid.output.plans.motion_files import (
    JOINTS,
    write_joint_trajectory,
    write_motion_csv,
    write_urscript,
)
from sdpid.robot.description.catalog import robot_names

# What the plan can be made again from, and the files that it names.
PLAN, LIMITS, OBSTACLES = "plan.toml", "limits.toml", "obstacles.toml"

# Written last: it lists the other files.
_RESULT = "plan.json"

# Every file that a plan may have.
NAMES = (
    "trajectory.csv",
    "trajectory.toml",
    "joint_trajectory.yaml",
    "excitation.script",
    "report.html",
    LIMITS,
    OBSTACLES,
    PLAN,
    _RESULT,
)

_FOLDER = RunFolder(NAMES, _RESULT, PLAN, careful=True)

require_writable = _FOLDER.require_writable


def write_plan(
    plan: Plan,
    folder: str | os.PathLike[str],
    *,
    report: Callable[[str], None] | None = None,
    command: str | None = None,
    config: str | None = None,
) -> tuple[Path, ...]:
    """Write a plan into a folder, all files or none.

    ``trajectory.csv`` holds the motion sample by sample, ``trajectory.toml`` what it is made of and
    `simulate` takes, ``joint_trajectory.yaml`` the ROS message trajectory_msgs/JointTrajectory,
    ``excitation.script`` a program for arms of Universal Robots (six turning joints),
    ``report.html`` a page that explains the plan and
    plays the arm, ``plan.toml`` the options that make the plan again, and ``plan.json`` limits,
    expected errors and everything that was assumed.

    Parameters
    ----------
    plan : Plan
        From `design_excitation`.
    folder : str or path
        Made where it does not exist; the files of an earlier plan in it are replaced.
    report : callable, optional
        Called with a sentence for each file that is left out, and why.
    command : str, optional
        The command line that made the plan, for the report.
    config : str, optional
        Text of ``plan.toml``; by default it is made of `Plan.settings`, with ``limits.toml`` and
        ``obstacles.toml`` beside it.

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    ExportError
        When the folder cannot be written to, or holds files of these names that no plan wrote.

    Examples
    --------
    >>> files = sdpid.write_plan(plan, "plan")
    >>> sorted(path.name for path in files)[:3]
    ['joint_trajectory.yaml', 'limits.toml', 'plan.json']
    >>> sdpid.Trajectory.from_toml("plan/trajectory.toml").duration
    5.0
    """
    target = Path(folder)
    note = report or (lambda _: None)
    require_writable(target, writes_config=True)

    def fill(stage: Path) -> dict[str, Any]:
        texts = settings_files(plan, target) if config is None else {PLAN: config}
        if (reason := ended_early(plan)) is not None:
            texts[PLAN] = f"# {reason}\n{texts[PLAN]}"
        for name, text in texts.items():
            (stage / name).write_text(text, encoding="utf-8")
        with progress(2, "writing the plan") as advance:
            _write_motion(plan, stage, note)
            advance(1)
            _write_page(plan, stage, command, note)
            advance(1)
        return plan_content(plan)

    return _FOLDER.write(target, fill, note)


def plan_content(plan: Plan) -> dict[str, Any]:
    """Return a plan's results as plain values: limits, expected errors, notes, assumptions."""
    collision = plan.collision
    told = ("objective", "purpose", "condition_number", "log_det")
    made = ("notes", "motion", "settings")
    content = {
        "sdpid": __version__,
        "robot": plan.robot.name,
        "joint_names": plan.trajectory.joint_names,
        "duration_s": plan.trajectory.duration,
        "rate_hz": plan.trajectory.rate_hz,
        "periods": plan.trajectory.periods,
        **{name: getattr(plan, name) for name in told},
        "standard_errors": dict(zip(plan.names, plan.standard_errors.tolist(), strict=True)),
        "expected": plan.expected.to_dict(),
        "limits": plan.limits.to_dict(),
        "joint_limits": plan.joint_limits,
        "pairs": None if collision is None else collision.pairs,
        "left_out": None if collision is None else collision.left_out,
        "history": plan.history,
        "assumed": plan.limits.notes,
        **{name: getattr(plan, name) for name in made},
    }
    return plain_dict(content)


def ended_early(plan: Plan) -> str | None:
    """Return why the options alone do not make a plan again, None where they do."""
    if plan.settings.get("time_limit") is not None:
        cause = "The search had a time limit"
    elif any(row.get("status") == INTERRUPTED for row in plan.history):
        cause = "The search was interrupted"
    else:
        return None
    return (
        f"{cause}: another run may end elsewhere. trajectory.toml holds this motion without loss."
    )


def _write_motion(plan: Plan, folder: Path, note: Callable[[str], None]) -> None:
    """Write the motion in every form that the robot can take."""
    motion = plan.trajectory
    write_motion_csv(motion, folder / "trajectory.csv")
    motion.to_toml(folder / "trajectory.toml")
    write_joint_trajectory(motion, folder / "joint_trajectory.yaml")
    if motion.n == JOINTS and not np.any(plan.joint_limits.sliding):
        write_urscript(motion, folder / "excitation.script")
    else:
        note(
            f"no excitation.script: arms of Universal Robots have {JOINTS} turning joints, this "
            "robot has others"
        )


def _write_page(plan: Plan, folder: Path, command: str | None, note: Callable[[str], None]) -> None:
    """Write the page, where jinja2 is installed."""
    if importlib.util.find_spec("jinja2") is None:
        note(f"no report.html: jinja2 is not installed ({installation('report')})")
        return
    from sdpid.output.plans.page import plan_html

    there = [name for name in NAMES if (folder / name).exists()]
    text = plan_html(plan, command=command, names=[*there, _RESULT])
    (folder / "report.html").write_text(text, encoding="utf-8")


# Arguments of `design_excitation` that are options, and their names.
_OPTIONS = {
    name: name
    for name in (
        *("robot", "duration", "collisions", "friction", "previous", "noise", "objective"),
        *("motion", "closed", "harmonics", "start", "periods", "torque_spread", "starts"),
        *("time_limit", "seed"),
    )
} | {"purpose": "for", "package_dirs": "package_dir"}

# Those that name files, perhaps among others.
_FILES = ("robot", "previous", "package_dirs")

# Limits of joints; the others are of the whole arm.
_OF_JOINTS = ("lower", "upper", "velocity", "acceleration", "jerk", "torque")


def settings_files(plan: Plan, folder: Path) -> dict[str, str]:
    """Return texts of ``plan.toml`` and the files that it names, from a plan's settings.

    What no option can say, such as a robot or a recording in memory, stands in comments.

    Parameters
    ----------
    plan : Plan
        Its settings.
    folder : Path
        Where the files will be; others are named relative to it.
    """
    import tomli_w

    settings = dict(plan.settings)
    texts: dict[str, str] = {}
    values: dict[str, Any] = {}
    if limits := settings.pop("limits", None):
        table = _limits_table(limits, plan.trajectory.joint_names)
        texts[LIMITS], values["limits"] = tomli_w.dumps(table), LIMITS
    if settings.pop("obstacles", None) and plan.collision is not None:
        table = obstacles_to_dict(plan.collision.obstacles)
        texts[OBSTACLES], values["obstacles"] = tomli_w.dumps(plain(table)), OBSTACLES
    comments = [f"# sdpid {__version__}: sdpid excite --config FILE makes this plan again."]
    for name, value in settings.items():
        several = isinstance(value, Sequence) and not isinstance(value, str)
        each = [_written(name, v, folder) for v in (value if several else [value])]
        if name not in _OPTIONS or None in each:
            comments.append(f"# no option says this: {name} = {json.dumps(plain(value))}")
        else:
            values[_OPTIONS[name]] = each if several else each[0]
    return {PLAN: "\n".join(comments) + "\n" + tomli_w.dumps(values), **texts}


def _written(name: str, value: Any, folder: Path) -> Any:
    """Return a value for TOML, None where there is none."""
    if name in _FILES and isinstance(value, str) and Path(value).exists():
        return os.path.relpath(Path(value).resolve(), folder.resolve())
    if isinstance(value, Mapping) or (name == "robot" and value not in robot_names()):
        return None
    return value


def _limits_table(limits: Mapping[str, Any], joints: Sequence[str]) -> dict[str, Any]:
    """Return the fields of `Limits` as the tables of its file."""
    table: dict[str, Any] = {"arm": {}}
    for key, value in limits.items():
        if value is None:
            continue
        if key not in _OF_JOINTS or isinstance(value, int | float | str):
            table["arm"][key] = value
            continue
        named = value if isinstance(value, Mapping) else dict(zip(joints, value, strict=True))
        for joint, each in named.items():
            if each is not None:
                table.setdefault("arm" if joint == "*" else joint, {})[key] = each
    return table
