"""The command ``sdpid gains``: joint torque per ampere, from currents."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import sdpid.cli.options as opt
from sdpid._common.text import printable
from sdpid.cli.endings import OURS
from sdpid.cli.printing import Printing
from sdpid.cli.values import numbers, pairs
from sdpid.errors import DataError

if TYPE_CHECKING:
    from sdpid.assurance.drive_gains.load import Load

# Entries of a symmetric tensor in the order of a URDF, and where they stand in its matrix.
_TENSOR = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def gains(
    robot: opt.Robot,
    without: Annotated[
        list[Path],
        typer.Option(metavar="LOG", help="Currents without the load, A. May be repeated."),
    ],
    reading: opt.Reading,
    processing: opt.ProcessingOptions,
    acceptance: opt.Acceptance,
    printing: Printing,
    with_load: Annotated[
        list[Path] | None,
        typer.Option("--with", metavar="LOG", help="Currents with the load, A. May be repeated."),
    ] = None,
    load: Annotated[
        list[float] | None,
        typer.Option(
            metavar="KG", help="Mass of the load; repeat it for one of each recording with load."
        ),
    ] = None,
    load_error: Annotated[
        float | None, typer.Option(metavar="KG", help="Standard error of that mass. Default: 0.")
    ] = None,
    load_com: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            help="Center of mass of the load in the frame, m. Default: it is estimated.",
        ),
    ] = None,
    load_inertia: Annotated[
        str | None,
        typer.Option(
            metavar="XX,XY,XZ,YY,YZ,ZZ",
            help="Inertia of the load about its center of mass, kg.m2, beside --load-com. "
            "Default: it is estimated.",
        ),
    ] = None,
    link: Annotated[
        str | None, typer.Option(help="Link that carries the load. Default: the last one.")
    ] = None,
    frame: Annotated[
        str | None,
        typer.Option(help="Frame of --load-com, fixed to the link, such as tool0."),
    ] = None,
    known: Annotated[
        list[str] | None,
        typer.Option(metavar="JOINT=X", help="A gain that is known, N.m/A. May be repeated."),
    ] = None,
    description_error: Annotated[
        float | None,
        typer.Option(
            metavar="X",
            help="Believe the URDF's inertias, each to this relative standard deviation, such as "
            "0.1. Default: nothing is taken from them.",
        ),
    ] = None,
    effects: Annotated[
        str,
        typer.Option(
            metavar="auto|none|A,B,...",
            help="Effects beside friction, as for 'sdpid identify'.",
        ),
    ] = "auto",
    level: Annotated[float, typer.Option(help="Probability of the intervals.")] = 0.95,
    out: Annotated[Path, typer.Option(help="File for the gains.")] = Path("gains.toml"),
) -> None:
    """Identify drive gains, N.m/A, from motor currents without and with a known load."""
    from sdpid._common.arrays import require_probability
    from sdpid.assurance.drive_gains.identify import identify_drive_gains
    from sdpid.robot.model.load import load_robot

    require_probability(level, "level")
    every = [*without, *(with_load or ())]
    opt.require_folder("--out", out, reading.files(every, robot, printing.config))
    model = load_robot(robot)
    loads = _loads(load, load_error, load_com, load_inertia)
    result = identify_drive_gains(
        model,
        [reading.read(log, currents=True) for log in without],
        [reading.read(log, currents=True) for log in with_load or ()] or None,
        load=loads or None,
        link=link,
        frame=frame,
        known=_known(known),
        description_error=description_error,
        effects=effects,
        processing=processing.changes(),
        **acceptance.arguments(),
    )
    if result.status != "optimal":
        typer.echo(printable(f"sdpid: {out} is not written: {result.status}"), err=True)
        raise typer.Exit(OURS)
    result.gains.to_toml(out)
    text = f"{result.describe(level)}\nwritten to {out}: --gains {out} uses them"
    printing.show({**result.to_dict(), "file": str(out)}, text)


def _loads(
    masses: list[float] | None, error: float | None, com: str | None, inertia: str | None
) -> list[Load]:
    """Return what is known of the loads.

    Raises
    ------
    DataError
        When a list has another length, or something is said of a load without mass.
    """
    from sdpid.assurance.drive_gains.load import Load

    if not masses:
        given = {"--load-error": error, "--load-com": com, "--load-inertia": inertia}
        if others := [name for name, value in given.items() if value is not None]:
            raise DataError(f"{', '.join(others)}: of a load without a mass; give --load.")
        return []
    center = None if com is None else _several(com, "--load-com", 3)
    tensor = None
    if inertia is not None:
        tensor = [[0.0] * 3 for _ in range(3)]
        six = _several(inertia, "--load-inertia", len(_TENSOR))
        for (i, j), value in zip(_TENSOR, six, strict=True):
            tensor[i][j] = tensor[j][i] = value
    return [
        Load(mass=mass, mass_error=error or 0.0, com=center, inertia=tensor)  # type: ignore[arg-type]
        for mass in masses
    ]


def _several(text: str, option: str, count: int) -> list[float]:
    """Return so many numbers."""
    found = numbers(text, option)
    if len(found) != count:
        raise DataError(f"{option} {text}: has {len(found)} numbers, expected {count}.")
    return found


def _known(given: list[str] | None) -> dict[str, float] | None:
    """Return known gains by joint."""
    found = pairs(given, "--known")
    return {name: _several(value, "--known", 1)[0] for name, value in found.items()} or None
