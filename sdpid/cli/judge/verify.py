"""The command ``sdpid verify``: proofs, and what is made again from a log beside them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import sdpid.cli.options as opt
from sdpid._common.text import printable
from sdpid.cli.endings import OURS
from sdpid.cli.printing import Printing

if TYPE_CHECKING:
    from sdpid.workflow.verify import Verification

_FEW = 3  # things not checked that are listed without --verbose


def _shortened(verification: Verification, *, needs_log: bool) -> tuple[str, ...]:
    """Return the lines with all that was not checked told in one, before the verdict.

    What was to be made again of the log and was not is listed all the same.
    """
    missing = () if verification.log is None else verification.log.unchecked
    others = (each for each in verification.unchecked if each not in missing)
    listed = tuple(f"not checked: {each}" for each in others)
    *lines, verdict = (line for line in verification.lines if line not in listed)
    log = "; --data LOG makes again what follows from the log" * needs_log
    told = f"not checked: {len(listed)} things beside these (-v lists them){log}"
    return (*lines, told, verdict)


def verify(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="PATH",
            help="Folder that `sdpid identify` wrote, with all its files; or one proof.",
        ),
    ],
    printing: Printing,
    data: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="LOG",
            help="Log that the folder's result was made of: the recipe is run again, and all that "
            "is in the folder compared. Repeat for several, in the order of the run.",
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            metavar="ROBOT",
            help="URDF or MJCF file, or name. Beside --data the run's robot; default: "
            "identified.urdf, where it has the run's kinematics. Of a proof about a table: the "
            "robot whose coefficients it must have.",
            autocompletion=opt.complete_robot,
        ),
    ] = None,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="List all that was not checked.")
    ] = False,
) -> None:
    """Check a folder of results, or one proof, in exact arithmetic, from its own numbers.

    With --data, make again what lies before and beside the proof, and compare it.
    Ends with status 1 when something does not hold.
    """
    from sdpid.workflow.verify import verify as run

    verification = run(path, data=data or None, robot=robot)
    lines = verification.lines
    if not verbose and len(verification.unchecked) > _FEW:
        lines = _shortened(verification, needs_log=data is None and path.is_dir())
    printing.show(verification, "\n".join(map(printable, lines)))
    if not verification.passed:
        count = len(verification.problems)
        where = "; ".join(verification.problems) if printing.quiet else "above"
        claims = f"{count} claims do" if count > 1 else "1 claim does"
        text = f"sdpid: {path}: NOT PROVEN: {claims} not hold ({where})."
        typer.echo(printable(text), err=True)
        raise typer.Exit(OURS)
