"""The command ``sdpid audit``: published base parameters, and robot descriptions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdpid.cli import options as opt
from sdpid.cli.errors import NO_ANSWER
from sdpid.errors import DataError, ExportError

if TYPE_CHECKING:
    from sdpid.assurance.tables.audit import BaseAudit

_TABLE = "Base parameters (.csv)"
_DESCRIPTION = "Robot description (.urdf, .xml)"


def audit(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="Table of base parameters (.csv), URDF, MJCF, or name of a robot."
        ),
    ],
    robot: Annotated[
        str | None,
        typer.Option(
            metavar="ROBOT",
            help="Whose base parameters: URDF file, or name of a bundled or example robot.",
            rich_help_panel=_TABLE,
        ),
    ] = None,
    consistency: Annotated[
        opt.Consistency,
        typer.Option("--consistency", help="What every link must obey.", rich_help_panel=_TABLE),
    ] = opt.Consistency.pseudo_inertia,
    value: Annotated[
        str, typer.Option(metavar="COLUMN", help="Column of values.", rich_help_panel=_TABLE)
    ] = "value",
    halfwidth: Annotated[
        str | None,
        typer.Option(
            metavar="X|COLUMN",
            help="How far off values may be: a number, or a column. By default the column "
            "halfwidth, or half a unit in the last printed place.",
            rich_help_panel=_TABLE,
        ),
    ] = None,
    margin: Annotated[
        float,
        typer.Option(metavar="X", help="Least margin of links, kg.m2.", rich_help_panel=_TABLE),
    ] = 0.0,
    mass_max: Annotated[
        float,
        typer.Option(metavar="X", help="Largest mass of a link, kg.", rich_help_panel=_TABLE),
    ] = 100.0,
    friction: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TERM",
            help="Friction term of the table, by name; repeat for several. By default those whose "
            "parameters the table names.",
            rich_help_panel=_TABLE,
        ),
    ] = None,
    proof: Annotated[
        Path | None,
        typer.Option(help="JSON file for the proof, in exact numbers.", rich_help_panel=_TABLE),
    ] = None,
    repair: Annotated[
        Path | None,
        typer.Option(help="File for the repaired URDF.", rich_help_panel=_DESCRIPTION),
    ] = None,
    as_json: opt.Json = False,
) -> None:
    """Say what cannot exist: base parameters that no links have, bodies that no mass makes.

    Ends with status 3 when something cannot exist, or when it could not be decided.
    """
    for option, file in (("--proof", proof), ("--repair", repair)):
        if file is not None:
            opt.require_folder(option, file, (source, robot))
    if source.suffix.lower() == ".csv":
        if repair is not None:
            raise ExportError("--repair: a table of base parameters has no bodies to repair.")
        if robot is None:
            raise DataError(f"{source}: is a table; say whose parameters they are with --robot.")
        found = _table(source, robot, consistency, value, halfwidth, margin, mass_max, friction)
        if proof is not None:
            _write_proof(proof, found)
        if as_json:
            opt.print_json(found.to_dict())
        else:
            opt.echo(found.summary())
        if found.verdict != "realisable":
            raise typer.Exit(NO_ANSWER)
        return
    if proof is not None or robot is not None:
        raise DataError(f"{source}: is no .csv; --robot and --proof are for tables.")
    from sdpid.cli.audit_urdf import run_audit_urdf

    status = run_audit_urdf(source, repair, as_json)
    if status:
        raise typer.Exit(status)


def _table(
    source: Path,
    robot: str,
    consistency: opt.Consistency,
    value: str,
    halfwidth: str | None,
    margin: float,
    mass_max: float,
    friction: list[str] | None,
) -> BaseAudit:
    from sdpid.assurance.tables.audit import audit_base_parameters
    from sdpid.assurance.tables.csv_table import read_base_table
    from sdpid.assurance.tables.question import named_terms
    from sdpid.robot.model.load import load_robot

    width: str | float | None = halfwidth
    if halfwidth is not None:
        try:
            width = float(halfwidth)
        except ValueError:
            width = halfwidth
    table = read_base_table(source, value=value, halfwidth=width)
    model = load_robot(robot)
    return audit_base_parameters(
        model,
        table.values,
        table.halfwidths,
        consistency=consistency.value,
        margin=margin,
        mass_max=mass_max,
        friction=named_terms(model, table.mentioned) if friction is None else friction,
    )


def _write_proof(path: Path, found: BaseAudit) -> None:
    from sdpid._common.files import atomic_write_text

    if found.certificate is None:
        typer.echo(f"sdpid: {path}: not written, as there is no proof to write.", err=True)
        return
    atomic_write_text(path, json.dumps(found.certificate.to_dict(), indent=1) + "\n")
