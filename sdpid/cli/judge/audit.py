"""The command ``sdpid audit``: physical consistency of descriptions and published tables."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import sdpid.cli.options as opt
from sdpid.cli.endings import NO_ANSWER
from sdpid.cli.printing import Printing
from sdpid.errors import DataError, ExportError

if TYPE_CHECKING:
    from sdpid.assurance.tables.audit import BaseAudit

# Options under a title in the help.
_table = functools.partial(typer.Option, rich_help_panel="Table of base parameters (.csv)")
_description = functools.partial(typer.Option, rich_help_panel="Robot description (.urdf, .xml)")


@dataclass(frozen=True, kw_only=True)
class TableOptions:
    """What a table of base parameters is, and what its links must obey."""

    robot: Annotated[
        str | None,
        _table(
            metavar="ROBOT",
            help="Robot whose base parameters they are: URDF file, or name of a bundled or "
            "example robot.",
            autocompletion=opt.complete_robot,
        ),
    ] = None
    consistency: Annotated[
        opt.Consistency, _table(help="Physical consistency that every link must have.")
    ] = opt.Consistency.pseudo_inertia
    value: Annotated[str, _table(metavar="COLUMN", help="Column of values.")] = "value"
    halfwidth: Annotated[
        str | None,
        _table(
            metavar="X|COLUMN",
            help="Largest error of a value: a number, or a column. Default: the column halfwidth, "
            "or half a unit in the last printed place.",
        ),
    ] = None
    margin: Annotated[float, _table(metavar="X", help="Smallest margin of every link, kg.m2.")] = (
        0.0
    )
    mass_max: Annotated[float, _table(metavar="X", help="Largest mass of a link, kg.")] = 100.0
    friction: Annotated[
        list[str] | None,
        _table(
            metavar="TERM",
            help="Friction term of the table, by name; repeat for several. Default: those whose "
            "parameters the table names.",
        ),
    ] = None
    proof: Annotated[
        Path | None, _table(help="JSON file for the proof, which `sdpid verify` checks.")
    ] = None
    template: Annotated[
        bool,
        _table(
            "--template",
            help="Write FILE, a table of the robot's base parameters without values, to fill in.",
        ),
    ] = False


def audit(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="Table of base parameters (.csv), URDF, MJCF, or name of a robot."
        ),
    ],
    table: TableOptions,
    printing: Printing,
    repair: Annotated[Path | None, _description(help="File for the repaired URDF.")] = None,
) -> None:
    """Check a URDF, MJCF or table of base parameters for physical consistency.

    Ends with status 3 when there is something that no body can have, or it could not be decided.
    """
    for option, file in (("--proof", table.proof), ("--repair", repair)):
        if file is not None:
            opt.require_folder(option, file, (source, table.robot, printing.config))
    if source.suffix.lower() == ".csv":
        if repair is not None:
            raise ExportError("--repair: a table of base parameters has no bodies to repair.")
        passed = _audit_table(source, table, printing)
    else:
        if table.proof is not None or table.robot is not None or table.template:
            raise DataError(
                f"{source}: is no .csv; --robot, --proof and --template are for tables."
            )
        passed = _audit_description(source, repair, printing)
    if not passed:
        raise typer.Exit(NO_ANSWER)


def _audit_table(source: Path, table: TableOptions, printing: Printing) -> bool:
    """Audit a table of base parameters; return whether it is proven realisable."""
    from sdpid.assurance.tables.audit import audit_base_parameters
    from sdpid.assurance.tables.coefficients import named_terms
    from sdpid.assurance.tables.csv_table import read_base_table
    from sdpid.robot.model.load import load_robot

    if table.robot is None:
        raise DataError(f"{source}: is a table; say whose parameters they are with --robot.")
    if table.template:
        return _write_template(source, table.robot, table.friction, printing)
    width: str | float | None = table.halfwidth
    if table.halfwidth is not None:
        try:
            width = float(table.halfwidth)
        except ValueError:
            width = table.halfwidth
    published = read_base_table(source, value=table.value, halfwidth=width)
    model = load_robot(table.robot)
    terms = named_terms(model, published.mentioned) if table.friction is None else table.friction
    result = audit_base_parameters(
        model,
        published.values,
        published.halfwidths,
        consistency=table.consistency.value,
        margin=table.margin,
        mass_max=table.mass_max,
        friction=terms,
        table=published.file,
    )
    if table.proof is not None:
        _write_proof(table.proof, result)
    printing.show(result.to_dict(), result.summary())
    return result.verdict == "realisable"


def _write_template(path: Path, robot: str, friction: list[str] | None, printing: Printing) -> bool:
    """Write a table without values; return True, for there is nothing to judge."""
    from sdpid.assurance.tables.csv_table import write_empty_table
    from sdpid.robot.model.load import load_robot

    opt.require_folder("FILE", path, (robot, printing.config))
    terms = ("coulomb", "viscous") if friction is None else friction
    table = write_empty_table(path, load_robot(robot), terms)
    names = [str(row[0]) for row in table.rows]
    printing.show(
        {"files": [str(path)], "names": names},
        f"written: {path}, {len(names)} base parameters; type in what the table has, and leave the "
        "rest empty",
    )
    return True


def _write_proof(path: Path, result: BaseAudit) -> None:
    """Write the proof of an audit, or say that there is none."""
    if result.certificate is None:
        typer.echo(f"sdpid: {path}: not written: undecided, so there is no proof.", err=True)
        return
    result.certificate.to_json(path)


def _audit_description(source: Path, repair: Path | None, printing: Printing) -> bool:
    """Audit a URDF or MJCF, repair it where asked to, and return whether it has no errors."""
    from sdpid.assurance.descriptions.audit import audit_urdf
    from sdpid.output.robots.repair import repair_urdf
    from sdpid.robot.description.catalog import find_robot

    file = source if source.is_file() else find_robot(str(source))
    result = audit_urdf(file)
    report = None if repair is None else repair_urdf(file, target=repair)
    content = {**result.to_dict(), "repair": None if report is None else report.to_dict()}
    parts = [result.table(), result.describe()]
    if report is not None:
        parts.append(f"{report.path}: {report.describe()}")
    printing.show(content, "\n\n".join(parts))
    return result.passed
