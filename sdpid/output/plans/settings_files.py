"""Settings of a plan as files that ``sdpid excite --config`` reads."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sdpid import __version__
from sdpid._common.tables import plain
from sdpid.excitation.geometry.obstacles import obstacles_to_dict
from sdpid.excitation.plan.plan import Plan
from sdpid.robot.description.catalog import robot_names

PLAN = "plan.toml"
LIMITS = "limits.toml"
OBSTACLES = "obstacles.toml"

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
