"""Drives that were fitted under a known law, as simulators take them: files to paste from.

Names of joints are of others: they stand in literals and in JSON, as ASCII, and nowhere else.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.files import atomic_write_text
from sdpid._common.tables import Table
from sdpid.estimation.positions.drives import UNITS
from sdpid.estimation.positions.law_fit import FittedDrives
from sdpid.estimation.positions.rollout import STEP

# Friction over the position is f0 + f1·(q − middle) + f2·(q − middle)².
OVER_POSITION = {"f0": "friction", "f1": "slope", "f2": "curve"}

_BAM = "drives_bam.json: without kt and R of a motor, which no log under a law in N·m shows"


def _numbers(fit: FittedDrives) -> dict[str, dict[str, float]]:
    """Return the numbers of each joint, with constants; the limit where there is one."""
    kinds = {name: fit.reduced[name] for name in ("kp", "kd", "armature", "damping", "friction")}
    if fit.law.limit is not None:
        kinds["limit"] = np.asarray(fit.law.limit)
    return {
        joint: {name: float(values[j]) for name, values in kinds.items()}
        for j, joint in enumerate(fit.joint_names)
    }


def _call(name: str, fields: Mapping[str, Any]) -> list[str]:
    """Return the lines of a call with keyword arguments, given as source code."""
    return [f"{name}(", *(f"    {field}={text}," for field, text in fields.items()), ")"]


def _head(fit: FittedDrives, about: str, names: str) -> list[str]:
    """Return the first lines of a block: what it is, what it imports, the delay in steps."""
    return [
        f'"""Drives for {about}',
        "",
        "Found by sdpid from commanded and measured positions under a known law.",
        '"""',
        "",
        f"from {names}",
        "",
        f"PHYSICS_STEP = {STEP!r}  # s: that of your simulation",
        f"# {fit.delay_in_words}",
        f"DELAY = {fit.delay!r}  # s, from a command to its effort",
        "DELAY_STEPS = round(DELAY / PHYSICS_STEP)",
        "",
    ]


def isaaclab(fit: FittedDrives) -> str:
    """Return configurations of Isaac Lab: an implicit actuator, and one that knows the delay."""
    numbers = _numbers(fit)

    def column(kind: str) -> str:
        # Keys are regular expressions.
        return ascii({re.escape(joint): row[kind] for joint, row in numbers.items()})

    drives = {"joint_names_expr": ascii([re.escape(joint) for joint in numbers])}
    drives |= {"stiffness": column("kp"), "damping": column("kd"), "armature": column("armature")}
    drives |= {name: column("friction") for name in ("friction", "dynamic_friction")}
    drives["viscous_friction"] = column("damping")
    implicit, explicit = dict[str, str](), {"min_delay": "DELAY_STEPS", "max_delay": "DELAY_STEPS"}
    if fit.law.limit is not None:
        implicit["effort_limit_sim"] = explicit["effort_limit"] = column("limit")
    about = "Isaac Lab, with Isaac Sim 5.0 or later: before, friction was no effort."
    names = "isaaclab.actuators import DelayedPDActuatorCfg, ImplicitActuatorCfg"
    lines = _head(fit, about, names)
    lines += ["# Knows no delay.", *_call("IMPLICIT = ImplicitActuatorCfg", drives | implicit), ""]
    return "\n".join([*lines, *_call("DELAYED = DelayedPDActuatorCfg", drives | explicit), ""])


def mjlab(fit: FittedDrives) -> str:
    """Return configurations of mjlab, one for each joint, which take single numbers."""
    fields = {"stiffness": "kp", "damping": "kd", "effort_limit": "limit", "armature": "armature"}
    fields |= {"frictionloss": "friction", "viscous_damping": "damping"}
    lines = _head(fit, "mjlab 1.3 or later.", "mjlab.actuator import BuiltinPositionActuatorCfg")
    lines.append("ACTUATORS = (")
    for joint, row in _numbers(fit).items():
        given = {"target_names_expr": f"({re.escape(joint)!a},)"}
        given |= {field: repr(row[kind]) for field, kind in fields.items() if kind in row}
        given |= {"delay_min_lag": "DELAY_STEPS", "delay_max_lag": "DELAY_STEPS"}
        made = _call("BuiltinPositionActuatorCfg", given)
        lines += [*(f"    {line}" for line in made[:-1]), "    ),"]
    return "\n".join([*lines, ")", ""])


def mujoco(fit: FittedDrives) -> str:
    """Return an MJCF that adds the law's servos to identified.xml; the delay is the caller's."""
    from lxml import etree

    root = etree.Element("mujoco")
    words = (
        f"ctrl: commanded positions, {fit.delay!r} s after they were given. {fit.delay_in_words}"
    )
    root.append(etree.Comment(f" {words.replace('--', '-')} "))
    etree.SubElement(root, "include", file="identified.xml")
    servos = etree.SubElement(root, "actuator")
    for joint, row in _numbers(fit).items():
        servo = {"joint": joint, "kp": repr(row["kp"]), "kv": repr(row["kd"])}
        if "limit" in row:
            servo["forcerange"] = f"{-row['limit']!r} {row['limit']!r}"
        etree.SubElement(servos, "position", servo)
    etree.indent(root)
    return str(etree.tostring(root, encoding="ascii").decode()) + "\n"


def bam(fit: FittedDrives) -> str:
    """Return a table by joint of parameters as BAM names them, of its model with Coulomb friction.

    BAM keeps those of one motor in a file.
    """
    names = {"armature": "armature", "friction_base": "friction", "friction_viscous": "damping"}
    motors = {
        joint: {"model": "m1", **{name: row[kind] for name, kind in names.items()}}
        | {"command_delay": fit.delay, "q_offset": 0.0}
        for joint, row in _numbers(fit).items()
    }
    return json.dumps(motors, indent=2, allow_nan=False) + "\n"


def table(fit: FittedDrives) -> Table:
    """Return a row a joint: the law, the numbers of the drive, and friction over the position."""
    numbers = _numbers(fit)
    units = UNITS | {"limit": "N.m"}
    columns: dict[str, list[Any]] = {"joint": [*numbers]}
    for kind in ("kp", "kd", "limit", "armature", "damping", "friction"):
        columns[f"{kind} [{units[kind]}]"] = [row.get(kind) for row in numbers.values()]
    columns["delay [s]"] = [fit.delay] * len(numbers)
    if "slope" in fit.kinds:
        for name, kind in OVER_POSITION.items():
            columns[f"{name} [{units[kind]}]"] = fit.rich[kind].tolist()
        columns["middle [rad]"] = fit.rich.middle.tolist()
    return Table.of_columns(columns)


WRITERS: dict[str, Callable[[FittedDrives], str]] = {
    "drives_isaaclab.py": isaaclab,
    "drives_mjlab.py": mjlab,
    "drives_mujoco.xml": mujoco,
    "drives_bam.json": bam,
}
_TABLE = "drives.csv"
NAMES = (_TABLE, *WRITERS)


def write_drives(fit: FittedDrives, folder: Path) -> str:
    """Write all of `NAMES` into a folder, and return what they leave out, in words."""
    table(fit).write(folder / _TABLE)
    for name, text in WRITERS.items():
        atomic_write_text(folder / name, text(fit))
    return _BAM
