"""Commands that judge what was made elsewhere: descriptions, tables, proofs, results."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from sdpid._common.files import printable
from sdpid.cli.commands import Given, command, panel
from sdpid.cli.endings import NO_ANSWER, OURS, complain
from sdpid.errors import DataError

if TYPE_CHECKING:
    from sdpid.assurance.tables.audit import BaseAudit
    from sdpid.workflow.verify import Verification

_FEW = 3  # things not checked that are listed without --verbose


@command(
    {"source FILE": "Table of base parameters (.csv), URDF, MJCF, or name of a robot."},
    panel(
        "Table of base parameters (.csv)",
        {
            "--robot ROBOT": "Robot whose base parameters they are: URDF file, or name of a "
            "bundled or example robot.",
            "--consistency pseudo_inertia|spatial_inertia|none = pseudo_inertia": "Physical "
            "consistency that every link must have.",
            "--value COLUMN = value": "Column of values.",
            "--halfwidth X|COLUMN": "Largest error of a value: a number, or a column. Default: the "
            "column halfwidth, or half a unit in the last printed place.",
            "--margin X = 0": "Smallest margin of every link, kg.m2.",
            "--mass-max KG = 100": "Largest mass of a link, kg.",
            "--friction TERM ...": "Friction term of the table, by name; repeat for several. "
            "Default: those whose parameters the table names.",
            "--proof FILE": "JSON file for the proof, which `sdpid verify` checks.",
            "--template": "Write FILE, a table of the robot's base parameters without values, to "
            "fill in.",
        },
    ),
    panel("Robot description (.urdf, .xml)", {"--repair FILE": "File for the repaired URDF."}),
)
def audit(given: Given) -> None:
    """Check a URDF, MJCF or table of base parameters for physical consistency.

    Ends with status 3 when there is something that no body can have, or it could not be decided.
    """
    given.require_file("proof")
    given.require_file("repair")
    if given.source.suffix.lower() != ".csv":
        given.refuse("robot proof template", f"is for tables, and {given.source} is no .csv.")
        passed = _audit_description(given)
    else:
        given.refuse("repair", "a table of base parameters has no bodies to repair.")
        if given.robot is None:
            raise DataError(f"{given.source}: is a table; say whose parameters with --robot.")
        passed = _write_template(given) if given.template else _audit_table(given)
    if not passed:
        raise typer.Exit(NO_ANSWER)


def _audit_table(given: Given) -> bool:
    """Audit a table of base parameters; return whether it is proven realisable."""
    from sdpid.assurance.tables.audit import audit_base_parameters
    from sdpid.assurance.tables.coefficients import named_terms
    from sdpid.assurance.tables.csv_table import read_base_table
    from sdpid.robot.model.load import load_robot

    width = given.halfwidth
    # The name of a column, or None.
    with suppress(ValueError, TypeError):
        width = float(width)
    published = read_base_table(given.source, value=given.value, halfwidth=width)
    model = load_robot(given.robot)
    result = audit_base_parameters(
        model,
        published.values,
        published.halfwidths,
        friction=given.friction or named_terms(model, published.mentioned),
        table=published.file,
        **given.chosen("consistency margin mass_max"),
    )
    if given.proof is not None:
        write_proof(given.proof, result)
    given.show(result.to_dict(), result.summary())
    return result.verdict == "realisable"


def write_proof(path: Path, result: BaseAudit) -> None:
    """Write the proof of an audit, or say that there is none."""
    if result.certificate is None:
        complain(f"{path}: not written: undecided, so there is no proof.")
    else:
        result.certificate.to_json(path)


def _write_template(given: Given) -> bool:
    """Write a table without values; return True, for there is nothing to judge."""
    from sdpid.assurance.tables.csv_table import write_empty_table
    from sdpid.robot.model.load import load_robot

    given.require_file("source")
    terms = given.friction or ("coulomb", "viscous")
    table = write_empty_table(given.source, load_robot(given.robot), terms)
    names = [str(row[0]) for row in table.rows]
    given.show(
        {"files": [str(given.source)], "names": names},
        f"written: {given.source}, {len(names)} base parameters; type in what the table has, and "
        "leave the rest empty",
    )
    return True


def _audit_description(given: Given) -> bool:
    """Audit a URDF or MJCF, repair it where asked to, and return whether it has no errors."""
    from sdpid.assurance.descriptions.audit import audit_urdf
    from sdpid.output.robots.repair import repair_urdf
    from sdpid.robot.description.catalog import find_robot

    file = given.source if given.source.is_file() else find_robot(str(given.source))
    result = audit_urdf(file)
    content, repaired = {**result.to_dict(), "repair": None}, ""
    if given.repair is not None:
        report = repair_urdf(file, target=given.repair)
        content["repair"] = report.to_dict()
        repaired = f"{report.path}: {report.describe()}"
    given.show(content, result.table(), result.describe(), repaired)
    return result.passed


@command(
    {
        "path FILE|FOLDER": "Folder that `sdpid identify` wrote, with all its files; or one proof.",
        "--data LOG ...": "Log that the folder's result was made of: the recipe is run again, "
        "and all that is in the folder compared. Repeat for several, in the order of the run.",
        "--robot ROBOT": "URDF or MJCF file, or name. Beside --data the run's robot; default: "
        "identified.urdf, where it has the run's kinematics. Of a proof about a table: the "
        "robot whose coefficients it must have.",
        "--verbose -v": "List all that was not checked.",
    }
)
def verify(given: Given) -> None:
    """Check a folder of results, or one proof, in exact arithmetic, from its own numbers.

    With --data, make again what lies before and beside the proof, and compare it.
    Ends with status 1 when something does not hold.
    """
    from sdpid.workflow.verify import verify as run

    verification = run(given.path, data=given.data or None, robot=given.robot)
    lines = verification.lines
    if not given.verbose and len(verification.unchecked) > _FEW:
        lines = _shortened(verification, needs_log=not given.data and given.path.is_dir())
    given.show(verification, "\n".join(map(printable, lines)))
    if not verification.passed:
        count = len(verification.problems)
        where = "; ".join(verification.problems) if given.quiet else "above"
        claims = f"{count} claims do" if count > 1 else "1 claim does"
        complain(f"{given.path}: NOT PROVEN: {claims} not hold ({where}).")
        raise typer.Exit(OURS)


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


@command(
    {
        "first FOLDER": "Folder that `sdpid identify` wrote.",
        "other FOLDER": "Another, of the same robot.",
        "--verbose -v": "Print what is the same and all parameters too.",
    }
)
def compare_runs(given: Given) -> None:
    """Compare two results folders from their files: inputs, options, errors, parameters, proofs.

    Nothing is computed anew, and nothing is proven: `sdpid verify` checks a folder.
    """
    from sdpid.workflow.runs import compare_runs as run

    found = run(given.first, given.other)
    more = "" if given.verbose else "\nWhat is the same, and all parameters: -v."
    given.show(found.to_dict(), found.text(full=given.verbose) + more)
