"""The folder of a plan for a standing robot."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from typing import Any

from sdpid import __version__
from sdpid._common.staging import RunFolder
from sdpid._common.tables import plain_dict
from sdpid.excitation.standing.plan import StandingPlan
from sdpid.plots.figures import save_figure

_TRAJECTORY, _PLOT, _CONFIG, _RESULT = "trajectory.csv", "plot.png", "plan.toml", "plan.json"
_FOLDER = RunFolder((_TRAJECTORY, _PLOT, _CONFIG, _RESULT), _RESULT, _CONFIG, careful=True)

require_writable = _FOLDER.require_writable


def write_standing(
    plan: StandingPlan,
    folder: str | os.PathLike[str],
    *,
    figures: bool | None = None,
    config: str | None = None,
) -> tuple[Path, ...]:
    """Write a plan into a folder, all files or none.

    ``trajectory.csv`` holds joints, torques, base, contacts and planned forces at 500 Hz,
    ``plot.png`` shows the base and what the feet bear, ``plan.toml`` the options of the command,
    and ``plan.json`` limits, expected errors and everything that was assumed.

    Parameters
    ----------
    plan : StandingPlan
        From `design_standing`.
    folder : str or path
        Made where it does not exist; the files of an earlier plan in it are replaced.
    figures : bool, optional
        Draw the plot; by default where matplotlib is installed.
    config : str, optional
        Text of ``plan.toml``, which is not written without; settings stand in ``plan.json``.

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    ExportError
        When the folder cannot be written to, or holds files of these names that no plan wrote.
    MissingExtraError
        When figures are asked for and matplotlib is not installed (extra ``plot``).

    Examples
    --------
    >>> from sdpid.excitation.standing.write import write_standing
    >>> standing = sdpid.design_standing("solo12", duration=2.0, steps=2)
    >>> [path.name for path in write_standing(standing, "standing", figures=False)]
    ['trajectory.csv', 'plan.json']
    """
    target = Path(folder)
    require_writable(target, writes_config=config is not None)
    draw = importlib.util.find_spec("matplotlib") is not None if figures is None else figures

    def fill(stage: Path) -> dict[str, Any]:
        plan.motion.to_csv(stage / _TRAJECTORY)
        if draw:
            save_figure(plan.plot()[0], stage / _PLOT)
        if config is not None:
            (stage / _CONFIG).write_text(config, encoding="utf-8")
        return plan_content(plan)

    return _FOLDER.write(target, fill)


def plan_content(plan: StandingPlan) -> dict[str, Any]:
    """Return a plan's results as plain values: limits, expected errors, notes."""
    table = plan.table()
    content = {
        "sdpid": __version__,
        "robot": plan.robot.name,
        "joint_names": plan.motion.joint_names,
        "feet": plan.motion.frames,
        "duration_s": plan.motion.duration,
        "base_parameters": [dict(zip(table.header, row, strict=True)) for row in table.rows],
        "limits": plan.limits.to_dict(),
        "sentences": plan.sentences(),
        "notes": plan.notes,
        "settings": plan.settings,
    }
    return plain_dict(content)
