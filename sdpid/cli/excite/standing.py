"""``sdpid excite --stand``: what a robot on legs is to do while it stands."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sdpid._common.text import printable
from sdpid.cli.printing import Printing, listed
from sdpid.errors import DataError

if TYPE_CHECKING:
    from sdpid.robot.model.model import RobotModel

_standing = functools.partial(typer.Option, rich_help_panel="Robots on legs")


@dataclass(frozen=True, kw_only=True)
class Standing:
    """How a robot on legs moves its base over feet that stay where they are."""

    stand: Annotated[
        bool,
        _standing(
            "--stand",
            help="The robot stands on its legs: its base moves, its feet stay where they are.",
        ),
    ] = False
    sway: Annotated[
        float | None,
        _standing(
            metavar="M",
            help="With --stand: the base moves by at most this much along each axis, m. Default: "
            "a quarter of its height, a tenth on soles.",
        ),
    ] = None
    tilt: Annotated[
        float | None,
        _standing(
            metavar="RAD", help="With --stand: it turns by at most this much. Default: 0.35."
        ),
    ] = None
    grip: Annotated[
        float | None,
        _standing(
            metavar="X",
            help="With --stand: coefficient of friction of the ground that may be used. Default: "
            "0.5.",
        ),
    ] = None
    load: Annotated[
        float | None,
        _standing(
            metavar="X",
            help="With --stand: least force on a foot, as a share of that when standing still. "
            "Default: 0.3.",
        ),
    ] = None
    steps: Annotated[
        int | None,
        _standing(
            metavar="N",
            min=1,
            help="With --stand: steps of the search from one start. Default: 30.",
        ),
    ] = None

    @property
    def given(self) -> dict[str, Any]:
        """What is given of the options, by their names in `design_standing`."""
        named = {
            "sway": self.sway,
            "tilt": self.tilt,
            "grip": self.grip,
            "load": self.load,
            "steps": self.steps,
        }
        return {name: value for name, value in named.items() if value is not None}

    def require_stand(self) -> None:
        """Refuse options of a robot that stands without ``--stand``.

        Raises
        ------
        DataError
            When there is one.
        """
        if not self.stand and self.given:
            raise DataError(f"--{next(iter(self.given))}: is for robots that stand; give --stand.")


def excite_standing(
    name: str,
    out: Path,
    standing: Standing,
    printing: Printing,
    *,
    options: dict[str, Any],
    unfit: dict[str, bool],
    figures: bool | None,
    config: str,
) -> None:
    """Design a motion of a robot that stands, and write it.

    Parameters
    ----------
    name : str
        The robot.
    out : Path
        The folder.
    standing : Standing
        Its options.
    printing : Printing
        How it is told.
    options : dict
        Further arguments of `design_standing`, None for those that are not given.
    unfit : dict of str to bool
        Options for robots on a fixed base, and whether they are given.
    figures : bool or None
        Whether to draw.
    config : str
        Text of ``plan.toml``.

    Raises
    ------
    DataError
        When an option for robots on a fixed base is given.
    """
    from sdpid._common.signals import keyboard_interrupts
    from sdpid.excitation.standing.design import design_standing
    from sdpid.excitation.standing.write import plan_content, write_standing
    from sdpid.robot.model.load import load_robot

    if wrong := [option for option, given in unfit.items() if given]:
        raise DataError(
            f"{wrong[0]}: is for robots on a fixed base, and --stand for robots on legs; leave one "
            "of them out."
        )
    robot: RobotModel = load_robot(name, root="free_flyer")
    given = {key: value for key, value in options.items() if value is not None}
    with keyboard_interrupts():
        plan = design_standing(robot, **given, **standing.given)
    files = write_standing(plan, out, figures=figures, config=config)
    content = {**plan_content(plan), "files": [str(file) for file in files]}
    parts = [f"{robot.name}: written to {out}: {', '.join(file.name for file in files)}"]
    told = list(dict.fromkeys((*plan.notes, *plan.limits.notes)))
    parts += [listed("notes", told), "\n".join(printable(line) for line in plan.sentences())]
    printing.show(content, "\n\n".join(parts))
