"""Options as rows of tables, commands made of these, files of options, and what is printed.

``--config run.toml`` reads the values of options, and a run writes its own.
A key is the name of an option without dashes before it (``mass_max`` or ``mass-max``), or ``log``
for the logs. Files are named relative to the folder of the TOML file.

A row is a usage and its help: ``"--cutoff HZ": "Cut-off frequency of the filter, Hz."``. The usage
has the names (of an argument its key in files of options), and the word for the value, which says
what may be given (`KINDS` of `sdpid.cli.values`). ``...`` follows where it may be repeated, and
``= 0.95`` where it has a default, or is ``required``. Words with bars between them are the choices.
An option without a value is off unless given; one with two names, ``--prior/--no-prior``, is on,
off, or left open.
"""

from __future__ import annotations

import inspect
import math
import os
from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from keyword import iskeyword
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from sdpid._common.files import printable, require_other_files
from sdpid._common.progress import hidden_progress
from sdpid.cli.values import KINDS, ValueKind
from sdpid.errors import DataError, ExportError

if TYPE_CHECKING:
    from sdpid.assurance.diagnostics.validation import Validation
    from sdpid.experiment.inspection.kinds import Finding


REQUIRED = inspect.Parameter.empty

# Options that name what a command writes.
_WRITTEN = {"out", "robots", "figure", "certificate", "proof", "repair", "write_trajectory"}


class OptionRow(NamedTuple):
    """An argument or option: how it is called, what may be given, and what it is for."""

    name: str
    flags: tuple[str, ...]
    metavar: str | None
    kind: ValueKind
    several: bool
    default: Any
    help: str
    panel: str | None

    @property
    def key(self) -> str:
        """The name in files of options."""
        return self.name.rstrip("_")

    def label(self, value: object = True) -> str:
        """Return what is typed for a value: ``--no-prior`` for False."""
        return self.flags[0].split("/")[-1 if value is False else 0]

    def value(self, given: Any) -> Any:
        """Return what a value means: text for several numbers becomes their list."""
        if self.several:
            given = list(given or ())
        if given is None or self.kind.parse is None:
            return given
        return self.kind.parse(given, self.label())

    def parameter(self, callback: Callable[..., Any] | None) -> inspect.Parameter:
        """Return the parameter that typer makes an option of."""
        more = {**self.kind.more, "callback": callback, "is_eager": callback is not None}
        if self.several and not self.flags:
            # Without a variable of the environment, older versions of typer do not look up --config
            # for an argument of any number of values.
            more |= {"envvar": f"SDPID_{self.name.upper()}S", "show_envvar": False}
        declare: Any = typer.Option if self.flags else typer.Argument
        panel = {"help": self.help, "metavar": self.metavar, "rich_help_panel": self.panel}
        kind: Any = list[self.kind.type] if self.several else self.kind.type  # type: ignore[name-defined]
        return inspect.Parameter(
            self.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=self.default,
            annotation=Annotated[
                kind | None if self.default is None else kind,
                declare(*self.flags, **panel, **more),
            ],
        )


# Rows under titles, or usages and help texts under the usual one.
Table = tuple[OptionRow, ...] | dict[str, str]


def panel(title: str | None, texts: Mapping[str, str]) -> tuple[OptionRow, ...]:
    """Return the rows of a table of usages and help texts, under a title in the help."""
    return tuple(_row(title, *row) for row in texts.items())


def rows_of(*tables: Table) -> tuple[OptionRow, ...]:
    """Return the rows of several tables."""
    every = (panel(None, each) if isinstance(each, dict) else each for each in tables)
    return tuple(row for rows in every for row in rows)


def _row(title: str | None, usage: str, text: str) -> OptionRow:
    """Return what a usage says."""
    usage, _, default = usage.partition(" = ")
    words = usage.removesuffix(" ...").split()
    flags = tuple(word for word in words if word.startswith("-"))
    long = [flag for flag in flags if flag.startswith("--")]
    name = long[-1].split("/")[0].strip("-").replace("-", "_") if flags else words[0]
    metavar = words[-1] if words[-1] not in flags else None
    if metavar is None:
        kind = ValueKind(bool)
    elif metavar not in KINDS and "|" in metavar:
        words = metavar.split("|")
        choice = Enum("Choice", {word: word for word in words}, type=str)  # type: ignore[misc]
        kind = ValueKind(choice, lambda chosen, _: chosen.value)
        metavar, text = "WORD", f"{text} One of {', '.join(words)}."
    else:
        kind = KINDS.get(metavar, ValueKind())
    several = usage.endswith(" ...")
    return OptionRow(
        name=f"{name}_" if iskeyword(name) else name,
        flags=flags,
        metavar=f"{metavar}..." if several and not flags else metavar,
        kind=kind,
        several=several,
        default=_default(default, kind.type, flags),
        help=text,
        panel=title,
    )


def _default(text: str, kind: Any, flags: tuple[str, ...]) -> Any:
    """Return the default that a usage states, or what is so where it states none."""
    if kind is bool:
        return text == "on" if text or "/" not in flags[0] else None
    if text == "required" or not (text or flags):
        return REQUIRED
    return None if text in ("", "none") else kind(text)


class Given(SimpleNamespace):
    """What was given to a command: the values of its options, by their names."""

    def __init__(
        self, rows: Iterable[OptionRow], values: Mapping[str, Any], ctx: typer.Context | None = None
    ) -> None:
        found = {row.name: row.value(values.get(row.name, row.default)) for row in rows}
        super().__init__(**found, ctx=ctx, rows={row.name: row for row in rows})

    def refuse(self, names: str, why: str) -> None:
        """Refuse options that are given.

        Raises
        ------
        DataError
            When one is given on the command line, or in a file with another value than its default:
            files of earlier runs hold defaults too.
        """
        for row in (self.rows[name] for name in names.split()):
            value, source = getattr(self, row.name), self.ctx.get_parameter_source(row.name)
            if value != row.value(row.default) or source.name == "COMMANDLINE":
                raise DataError(f"{row.label(value)}: {why}")

    def chosen(self, names: str) -> dict[str, Any]:
        """Return those of some options that have a value."""
        found = {name: getattr(self, name) for name in names.split()}
        return {name: value for name, value in found.items() if value is not None}

    def inputs(self, *others: str) -> list[Path | str | None]:
        """Return the files that the command reads, but for some options; beside logs mappings."""
        from sdpid.experiment.recording.recording import mapping_beside

        found: list[Path | str | None] = []
        for row in self.rows.values():
            if row.kind.is_file and row.name not in _WRITTEN and row.name not in others:
                value = getattr(self, row.name)
                files = value if row.several else [value]
                found += files
                if row.metavar in ("LOG", "LOG..."):
                    found += [mapping_beside(file) for file in files if file is not None]
        return found

    def require_file(self, name: str, *beside: Path) -> None:
        """Refuse a file that cannot be written, before the work is done; None passes.

        Files that are written beside it must not be inputs either.

        Raises
        ------
        ExportError
            When its folder is not there, it is a folder itself, or an input.
        """
        file, row = getattr(self, name), self.rows[name]
        if file is None:
            return
        if not file.parent.is_dir() or file.is_dir():
            what = "is a folder" if file.is_dir() else f"there is no folder {file.parent}"
            raise ExportError(f"cannot write {file}: {what}.")
        label = row.label() if row.flags else str(row.metavar)
        require_other_files(label, [file, *beside], self.inputs(name))

    def show(self, values: Any, *parts: str) -> None:
        """Print the parts that say something, the values with ``--json``, or with -q nothing."""
        if self.quiet:
            return
        if self.json:
            from sdpid._common.tables import json_text

            typer.echo(json_text(values))
        else:
            typer.echo(printable("\n\n".join(filter(None, parts)), keep="\n"))


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


def listed(title: str, lines: Iterable[object]) -> str:
    """Return indented lines under a title, line ends within them replaced; of none, nothing."""
    shown = [f"  {printable(str(line))}" for line in lines]
    return "\n".join((f"{title}:", *shown)) if shown else ""


def findings_listed(findings: Iterable[Finding]) -> str:
    """Return what is wrong with recordings that are used, a line each."""
    return listed("findings", (each.line() for each in findings))


def errors_table(fits: dict[str, Validation]) -> str:
    """Return the errors of every joint, a pair of columns for each fit."""
    from sdpid._common.tables import Table

    first = next(iter(fits.values()))
    header = ["joint"]
    # A base that is held in one recording may move in another.
    free = next((fit.floating for fit in fits.values() if fit.floating is not None), None)
    base = () if free is None else tuple(name for name, _ in free.rows)
    columns: list[list[Any]] = [[*first.joint_names[first.n_base :], *base]]
    for label, fit in fits.items():
        header += [f"{label} RMSE [N.m]", "NRMSE [%]"]
        missed: list[float | None] = [None] * len(base)
        if fit.floating is not None:
            missed = [size for _, size in fit.floating.rows]
        own = fit.told
        for values, more in ((own.rmse, missed), (100.0 * own.nrmse, [None] * len(base))):
            rows = zip(values.tolist(), own.rows.tolist(), strict=True)
            columns.append([*[x if k else None for x, k in rows][fit.n_base :], *more])
    table = Table(tuple(header), tuple(zip(*columns, strict=True))).text(4)
    silent = [
        name
        for j, name in enumerate(first.joint_names)
        if any(math.isinf(fit.told.nrmse[j]) for fit in fits.values())
    ]
    note = f"\nno effort of which errors are a share: {', '.join(silent)}" if silent else ""
    return f"in motion:\n{table}{note}"
