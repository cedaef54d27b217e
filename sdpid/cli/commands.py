"""Commands that are made of tables of options, and files that hold values of these.

``--config run.toml`` reads the values of options, and a run writes its own.
A key is the name of an option without dashes before it (``mass_max`` or ``mass-max``), or ``log``
for the logs. Files are named relative to the folder of the TOML file.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Any

import typer

from sdpid._common.progress import hidden_progress
from sdpid.cli.options import Given, OptionRow, Table, panel, rows_of
from sdpid.errors import DataError

# Options of every command, by the name of its function.
TABLES: dict[str, tuple[OptionRow, ...]] = {}

# Options that a file does not repeat: where it is itself, and what is printed.
_NOT_WRITTEN = ("config", "json", "quiet")

# Commands that take the file of another one's run: options that they do not have are passed over.
_FILES_OF = {"certify": "identify", "sample": "identify"}

# Near names that a message lists.
_NEAR = 3


def _rows(command: str) -> dict[str, OptionRow]:
    """Return what may stand in a file for a command, by key."""
    rows = TABLES.get(command.replace("-", "_"), ())
    return {row.key: row for row in rows if row.name != "config"}


def read_config(ctx: typer.Context, value: Path | None) -> Path | None:
    """Let values in a TOML file stand for options that are not given; called by ``--config``.

    Raises
    ------
    DataError
        When the file cannot be read, names no option of the command, or has a value of another
        kind.
    """
    if value is None or ctx.resilient_parsing:
        return value
    from difflib import get_close_matches

    from sdpid._common.files import load_toml

    command = str(ctx.command.name)
    rows, passed_over = _rows(command), _rows(_FILES_OF.get(command, ""))
    values: dict[str, Any] = {}
    for name, content in load_toml(value).items():
        key = name.replace("-", "_")
        if key in rows:
            values[rows[key].name] = _values(f"{value}: {name}", content, rows[key], value.parent)
        elif key not in passed_over:
            near = get_close_matches(name, rows, n=_NEAR) or sorted(rows)
            raise DataError(
                f"{value}: {name!r} is no option of 'sdpid {command}'; there is {', '.join(near)}."
            )
    ctx.default_map = {**(ctx.default_map or {}), **values}
    return value


def _values(where: str, content: Any, row: OptionRow, folder: Path) -> Any:
    """Return what the file says of an option as the command line would."""
    if not row.several:
        return _value(where, content, row, folder)
    if isinstance(content, dict):  # [column] effort = "tau" for --column effort=tau
        content = [f"{name}={_joined(each)}" for name, each in content.items()]
    several = content if isinstance(content, list) else [content]
    return [_value(where, each, row, folder) for each in several]


def _value(where: str, content: Any, row: OptionRow, folder: Path) -> Any:
    """Return one value."""
    flag = row.kind.type is bool
    if not flag:
        content = _joined(content)
    if isinstance(content, bool) != flag or not isinstance(content, (bool, int, float, str)):
        expected = "true or false" if flag else "text or a number"
        raise DataError(f"{where}: is {content!r}; give {expected}.")
    if flag:
        return content
    named = _names_file(row, folder / str(content))
    return str(folder / content if named and isinstance(content, str) else content)


def _names_file(row: OptionRow, file: Path | str) -> bool:
    """Return whether a value is the name of a file, which is there if it might be another name."""
    # os.path's, because it does not raise for a name that is too long to be one.
    return row.kind.is_file and (not row.kind.may_be_file or os.path.exists(file))  # noqa: PTH110


def _joined(content: Any) -> Any:
    """Return a list with commas, as options take it: effort_scale = [1.5, 2.0]."""
    return ",".join(map(str, content)) if isinstance(content, list) else content


def config_text(ctx: typer.Context, folder: Path) -> str:
    """Return the TOML text that repeats this run from a file in `folder`."""
    import tomli_w

    from sdpid import __version__

    values = {
        key: _written(value, row, folder)
        for key, row in _rows(str(ctx.command.name)).items()
        if (value := ctx.params.get(row.name)) not in (None, (), []) and key not in _NOT_WRITTEN
    }
    heading = f"# sdpid {__version__}: sdpid {ctx.command.name} --config FILE repeats this run.\n"
    return heading + tomli_w.dumps(values)


def _written(value: Any, row: OptionRow, folder: Path) -> Any:
    """Return a value for TOML; files are named relative to a folder."""
    if isinstance(value, (list, tuple)):
        return [_written(each, row, folder) for each in value]
    if isinstance(value, Enum):
        return value.value
    if _names_file(row, value):
        return os.path.relpath(os.path.realpath(value), os.path.realpath(folder))
    return value


_PRINTING = panel(
    "Configuration and output",
    {
        "--config FILE": "TOML file with values of options (cutoff = 10.0, friction = ['coulomb', "
        "'viscous']) and of LOG (log = 'run.csv'); options given here win over it.",
        "--json": "Print results as JSON.",
        "--quiet -q": "Print nothing but errors.",
    },
)

Command = Callable[[Given], None]


def command(*tables: Table, **callbacks: Callable[..., Any]) -> Callable[[Command], Any]:
    """Return a decorator that makes a function of what was given ready for typer.

    Parameters
    ----------
    tables : tuple of OptionRow, or dict
        Its options.
    callbacks : callable
        By names of options: called with their values before others are looked at.
    """
    rows = rows_of(*tables, _PRINTING)
    callbacks.setdefault("config", read_config)

    def decorate(function: Command) -> Any:
        def run(ctx: typer.Context, **values: Any) -> None:
            with hidden_progress(values["quiet"]):
                function(Given(rows, values, ctx))

        parameters = [row.parameter(callbacks.get(row.name)) for row in rows]
        of_typer = inspect.Parameter(
            "ctx", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context
        )
        run.__signature__ = inspect.Signature([of_typer, *parameters])  # type: ignore[attr-defined]
        run.__annotations__ = {each.name: each.annotation for each in (of_typer, *parameters)}
        run.__name__, run.__doc__ = function.__name__, function.__doc__
        TABLES[function.__name__] = rows
        return run

    return decorate
