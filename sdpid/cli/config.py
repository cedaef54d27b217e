"""Options of commands: groups that share them, and files that hold their values.

``--config run.toml`` reads the values of options, and a run writes its own.
A key is the name of an option without dashes before it (``mass_max`` or ``mass-max``), or ``log``
for the logs. Files are named relative to the folder of the TOML file.
"""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer

from sdpid._common.progress import hidden_progress
from sdpid.errors import DataError

# Parameters of every command, by its name.
_PARAMETERS: dict[str, list[inspect.Parameter]] = {}

# Options that a file does not repeat: where it is itself, and what is printed.
_NOT_WRITTEN = ("config", "json", "quiet")

# Options whose value may be the name of a file, or something else.
_PERHAPS_FILES = ("robot", "mapping")

# Keys that differ from the parameter's name.
_KEYS = {"logs": "log", "purpose": "for", "with_load": "with"}

# Commands that take the file of another one's run: options that they do not have are passed over.
_FILES_OF = {"certify": "identify", "sample": "identify"}

# Near names that a message lists.
_NEAR = 3


def expand_groups(function: Callable[..., None]) -> Callable[..., None]:
    """Return a command whose parameters that are option groups are replaced by their options."""
    parameters: list[inspect.Parameter] = []
    groups: dict[str, Any] = {}
    for parameter in inspect.signature(function, eval_str=True).parameters.values():
        group = parameter.annotation
        if not is_dataclass(group):
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        groups[parameter.name] = group
        types = get_type_hints(group, include_extras=True)
        for field in fields(group):
            option = inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=field.default,
                annotation=types[field.name],
            )
            parameters.append(option)

    _PARAMETERS[function.__name__] = parameters

    @functools.wraps(function)
    def command(**values: Any) -> None:
        with hidden_progress(values["quiet"]):
            for name, group in groups.items():
                values[name] = group(**{each.name: values.pop(each.name) for each in fields(group)})
            function(**values)

    del command.__wrapped__
    signature = inspect.Signature(parameters)
    command.__signature__ = signature  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    return command


@dataclass(frozen=True)
class _Entry:
    """What the file may say of one option: its parameter, and the kind of its value."""

    parameter: str
    several: bool
    flag: bool
    is_file: bool


def _entries(command: str) -> dict[str, _Entry]:
    """Return what may stand in a file for a command, by key."""
    entries = {}
    for parameter in _PARAMETERS[command]:
        if get_origin(parameter.annotation) is not Annotated or parameter.name == "config":
            continue
        kinds = {kind for kind in _flat(get_args(parameter.annotation)[0]) if kind is not NoneType}
        entries[_KEYS.get(parameter.name, parameter.name)] = _Entry(
            parameter=parameter.name,
            several=list in kinds,
            flag=bool in kinds,
            is_file=Path in kinds or parameter.name in _PERHAPS_FILES,
        )
    return entries


def _flat(annotation: Any) -> list[Any]:
    """Return the types in an annotation: [list, Path, NoneType] of ``list[Path] | None``."""
    origin = get_origin(annotation)
    inner = [kind for each in get_args(annotation) for kind in _flat(each)]
    return [list, *inner] if origin is list else (inner or [annotation])


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
    entries = _entries(command)
    passed_over = _entries(_FILES_OF[command]) if command in _FILES_OF else {}
    values: dict[str, Any] = {}
    for name, content in load_toml(value).items():
        entry = entries.get(name.replace("-", "_"))
        if entry is None and name.replace("-", "_") in passed_over:
            continue
        if entry is None:
            near = get_close_matches(name, entries, n=_NEAR) or sorted(entries)
            raise DataError(
                f"{value}: {name!r} is no option of 'sdpid {command}'; there is {', '.join(near)}."
            )
        values[entry.parameter] = _values(f"{value}: {name}", content, entry, value.parent)
    ctx.default_map = {**(ctx.default_map or {}), **values}
    return value


def _values(where: str, content: Any, entry: _Entry, folder: Path) -> Any:
    """Return what the file says of an option as the command line would."""
    if not entry.several:
        return _value(where, content, entry, folder)
    if isinstance(content, dict):  # [column] effort = "tau" for --column effort=tau
        content = [f"{name}={_joined(each)}" for name, each in content.items()]
    several = content if isinstance(content, list) else [content]
    return [_value(where, each, entry, folder) for each in several]


def _value(where: str, content: Any, entry: _Entry, folder: Path) -> Any:
    """Return one value."""
    if not entry.flag:
        content = _joined(content)
    if isinstance(content, bool) != entry.flag or not isinstance(content, (bool, int, float, str)):
        expected = "true or false" if entry.flag else "text or a number"
        raise DataError(f"{where}: is {content!r}; give {expected}.")
    if entry.is_file and isinstance(content, str):
        file = folder / content
        if entry.parameter not in _PERHAPS_FILES or os.path.exists(file):  # noqa: PTH110
            return str(file)
    return content if entry.flag else str(content)


def _joined(content: Any) -> Any:
    """Return a list with commas, as options take it: effort_scale = [1.5, 2.0]."""
    return ",".join(map(str, content)) if isinstance(content, list) else content


def config_text(ctx: typer.Context, folder: Path) -> str:
    """Return the TOML text that repeats this run from a file in `folder`."""
    import tomli_w

    from sdpid import __version__

    values = {
        key: _written(value, entry, folder)
        for key, entry in _entries(str(ctx.command.name)).items()
        if (value := ctx.params.get(entry.parameter)) not in (None, (), [])
        and key not in _NOT_WRITTEN
    }
    heading = f"# sdpid {__version__}: sdpid {ctx.command.name} --config FILE repeats this run.\n"
    return heading + tomli_w.dumps(values)


def _written(value: Any, entry: _Entry, folder: Path) -> Any:
    """Return a value for TOML; files are named relative to a folder."""
    if isinstance(value, (list, tuple)):
        return [_written(each, entry, folder) for each in value]
    if isinstance(value, Enum):
        return value.value
    if entry.is_file and (entry.parameter not in _PERHAPS_FILES or os.path.exists(value)):  # noqa: PTH110
        return os.path.relpath(os.path.realpath(value), os.path.realpath(folder))
    return value
