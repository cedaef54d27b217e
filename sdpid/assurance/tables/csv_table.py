"""Read tables of published parameters from CSV, with half a unit of the last printed place."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from hashlib import sha256
from pathlib import Path

from sdpid._common.files import read_regular
from sdpid._common.tables import Table
from sdpid.assurance.tables.answers import TableFile, exact_decimal
from sdpid.assurance.tables.coefficients import regrouping
from sdpid.errors import DataError, ExportError
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.model import RobotModel

_NAMES = ("name", "parameter")

# The column that says what folds into a base parameter, and a name in it.
_REGROUPING = "regrouping"
_NAME = re.compile(r"[A-Za-z]\w*")


@dataclass(frozen=True)
class BaseTable:
    """Parameters as printed.

    Attributes
    ----------
    values, halfwidths : dict
        By name, as exact numbers.
    mentioned : frozenset of str
        Names in the table: of its parameters, and in its column ``regrouping`` if it has one.
    file : TableFile or None
        The file.
    """

    values: Mapping[str, Fraction]
    halfwidths: Mapping[str, Fraction]
    mentioned: frozenset[str]
    file: TableFile | None = None


def half_unit(text: str) -> Fraction:
    """Return half a unit in the last place of a printed decimal: 0.005 for ``"7.10"``.

    Raises
    ------
    DataError
        When it is not a decimal number.
    """
    exponent = exact_decimal(text, text, "value").as_tuple().exponent
    return Fraction(10) ** int(exponent) / 2


def read_base_table(
    path: str | os.PathLike[str],
    *,
    value: str = "value",
    halfwidth: str | float | None = None,
) -> BaseTable:
    """Read a table with a column ``name`` (or ``parameter``) and one of values.

    Parameters
    ----------
    path : str or path
        CSV file with a header. Rows without a value are left out: those parameters are unknown.
    value : str, optional
        The column of the values.
    halfwidth : str or float, optional
        A column of halfwidths, or one number for all. By default the column ``halfwidth`` where
        there is one, and where that is empty half a unit in the last place of the printed value.

    Returns
    -------
    BaseTable

    Raises
    ------
    DataError
        When it is no regular file, a column is missing, a name comes twice, or a number is none.
    """
    content = read_regular(path)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise DataError(f"{path}: is not text; expected CSV.") from None
    reader = csv.DictReader(text.splitlines(), skipinitialspace=True)
    try:
        columns = reader.fieldnames = [name.strip() for name in reader.fieldnames or ()]
        rows = list(reader)
    except csv.Error as cause:
        raise DataError(f"{path}: line {reader.line_num}: is no CSV ({cause}).") from None
    named = next((name for name in _NAMES if name in columns), None)
    if named is None or value not in columns:
        missing = "name" if named is None else value
        raise DataError(
            f"{path}: has no column {missing!r}, only {', '.join(columns) or 'none'}; name the "
            "column of the values."
        )
    if halfwidth is None and "halfwidth" in columns:
        halfwidth = "halfwidth"
    if isinstance(halfwidth, str) and halfwidth not in columns:
        raise DataError(
            f"{path}: has no column {halfwidth!r} of halfwidths, only {', '.join(columns)}."
        )
    values: dict[str, Fraction] = {}
    halves: dict[str, Fraction] = {}
    for row in rows:
        name, printed = (row[named] or "").strip(), (row[value] or "").strip()
        if not name or not printed:
            continue
        if name in values:
            raise DataError(f"{path}: {name} comes twice.")
        values[name] = Fraction(exact_decimal(printed, printed, f"{path}: {name}"))
        if isinstance(halfwidth, str):
            own = (row[halfwidth] or "").strip()
        else:
            own = "" if halfwidth is None else repr(float(halfwidth))
        where = f"{path}: halfwidth of {name}"
        halves[name] = Fraction(exact_decimal(own, own, where)) if own else half_unit(printed)
    if not values:
        raise DataError(f"{path}: column {value!r} has no values.")
    mentioned = _NAME.findall(" ".join(row.get(_REGROUPING) or "" for row in rows))
    file = TableFile(Path(path).name, sha256(content).hexdigest())
    return BaseTable(values, halves, frozenset([*values, *mentioned]), file)


def write_empty_table(
    path: str | os.PathLike[str],
    robot: RobotModel,
    friction: Iterable[str | FrictionTerm] = ("coulomb", "viscous"),
) -> Table:
    """Write the names of a robot's base parameters, for values to be typed in.

    Parameters
    ----------
    path : str or path
        CSV file, which must not be there yet.
    robot : RobotModel
        The robot.
    friction : iterable, optional
        Friction terms of the table.

    Returns
    -------
    Table
        What was written: ``name``, ``unit``, ``value`` and ``halfwidth``, which are empty, and
        ``regrouping``, what the parameter stands for.

    Raises
    ------
    ExportError
        When the file is there, or cannot be written.
    """
    if os.path.lexists(path):
        raise ExportError(f"cannot write {path}: it is there already; choose another name.")
    base = regrouping(robot, friction)[1]
    table = Table(
        ("name", "unit", "value", "halfwidth", _REGROUPING),
        tuple(
            (name, unit, None, None, base.expression(name))
            for name, unit in zip(base.names, base.units, strict=True)
        ),
    )
    table.write(path)
    return table
